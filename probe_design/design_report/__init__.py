"""Build the output of ``optimize``: table, maps over depth and diameter, sensitivity analysis, fronts, report and parts."""
