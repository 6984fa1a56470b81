"""Simulated readings, good and faulty: whether their stated errors hold, and whether hours can be read."""
