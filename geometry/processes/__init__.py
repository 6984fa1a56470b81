"""Functions in processes of their own, under limits of time and memory: one child, a pool on this computer, a Dask cluster."""
