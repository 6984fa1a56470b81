"""Estimate modulus, size or depth of a tumour from readings, with intervals (command ``estimate``)."""
