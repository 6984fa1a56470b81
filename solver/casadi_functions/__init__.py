"""Evaluators as differentiable casadi functions for IPOPT. Only this package imports casadi."""
