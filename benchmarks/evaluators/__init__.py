"""The evaluators one by one: off-axis tumours, solids, plans, sweeps, factorisations."""
