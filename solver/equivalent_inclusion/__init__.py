"""Evaluator `equivalent-inclusion`: many tumours under one solved probe; first order, bounds, ellipsoids, readings, gradients."""

# Imports inside functions: scipy.ndimage takes longer to load than the evaluation of a scene on the axis.
