"""Evaluator `axisymmetric`, and the linear systems of the meridian plane that `equivalent-inclusion` uses."""
