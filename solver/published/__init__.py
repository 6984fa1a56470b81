"""Evaluator `published`: the paper's equations as printed and corrected, and its Table 3."""
