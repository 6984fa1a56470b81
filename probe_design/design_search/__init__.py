"""``optimize``: variables and limits, objectives by formulas, one search, verification by finer evaluators, what is best."""
