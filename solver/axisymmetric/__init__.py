"""Evaluator `axisymmetric`, and the systems of the meridian plane that `equivalent-inclusion` stands on."""
