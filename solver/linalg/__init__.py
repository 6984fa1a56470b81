"""Factorisations, conjugate gradients, threads and memory of the process; no physics."""
