"""Evaluator `solid`: tetrahedra, and the difference between a scene and its rotationally symmetric reference."""
