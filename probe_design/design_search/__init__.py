"""Command ``optimize``: variables and limits, objectives by the closed form, the search, and verification by finer evaluators."""
