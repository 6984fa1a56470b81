"""Build the output of ``optimize``: table, maps over depth and diameter, sensitivity analysis, fronts, report and parts."""

# Imports inside functions: tomli_w loads only where the design file is written.
