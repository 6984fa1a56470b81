"""Evaluator `contact`: finite strain and contact in the meridian plane, for loads of a hand and gaps that close."""
