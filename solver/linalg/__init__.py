"""Factorisations, conjugate gradients, threads and memory of the process; knows no physics."""
