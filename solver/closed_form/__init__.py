"""Level 1: formulas on arrays of designs; a file for each mechanical piece, one for the stated error."""

# Imports inside functions: scipy.special loads only for orders whose tables are not stored.
