"""Evaluator `axisymmetric`, and the linear systems of the meridian plane that `equivalent-inclusion` uses."""

# Imports inside functions: scipy.interpolate loads only for tissue whose sides are not round.
