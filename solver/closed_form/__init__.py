"""Level 1: formulas on arrays of designs; a file for each mechanical piece, two for the stated error."""
