"""Command ``sweep``: its file, designs, rows and store; worker pools on this computer or a Dask cluster."""

# Imports inside functions: scipy.stats, matplotlib, planning and the executor on Dask load only for sweeps that use them.
