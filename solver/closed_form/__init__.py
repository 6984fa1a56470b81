"""Formulas on arrays of designs: a file for each mechanical part, and one for the stated error."""

# Imports inside functions: scipy.special loads only for orders whose tables are not stored.
