"""The levels as differentiable casadi functions for IPOPT; the only room that imports casadi."""
