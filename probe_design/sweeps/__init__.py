"""Command ``sweep``: its file, designs, rows and store; worker pools on this computer or a Dask cluster."""
