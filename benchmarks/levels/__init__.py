"""The levels one by one: tumours off the axis, solids, plans, sweeps, factorisations."""
