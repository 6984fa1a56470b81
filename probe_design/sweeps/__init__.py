"""``sweep``: file, designs, rows, store; workers local or on Dask."""
