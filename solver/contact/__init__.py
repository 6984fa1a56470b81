"""Evaluator `contact`: finite strain and contact in the meridian plane, for loads of a hand and gaps that close."""

# Imports inside functions: scipy.interpolate loads scipy.optimize, which commands that only read have no use for.
