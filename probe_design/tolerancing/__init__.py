"""Compute the scatter of a probe's readings by manufacturing tolerances, and the tolerances required (``tolerances``)."""
