"""Evaluator `published`: the paper's equations as printed, and eq. (8) corrected."""
