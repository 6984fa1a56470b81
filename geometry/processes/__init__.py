"""Functions in processes of their own, under limits of time and memory: one child, a pool on this computer, a Dask cluster."""

# Imports inside functions: resource, which Windows has not, limits the memory of a child process.
