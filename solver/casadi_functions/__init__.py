"""Evaluators as differentiable casadi functions for IPOPT; the only package that imports casadi."""
