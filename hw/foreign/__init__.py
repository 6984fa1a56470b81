"""What other programs recorded: CSV, HDF5 and WAV files as sources of samples, and recordings as HDF5 files."""
