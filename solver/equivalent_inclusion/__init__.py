"""Evaluator `equivalent-inclusion`: many tumours under one solved probe; first order, bounds, ellipsoids, readings, gradients."""
