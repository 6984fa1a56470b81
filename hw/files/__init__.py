"""Read CSV, HDF5 and WAV files of other programs as sources of samples."""

# Imports inside functions: h5py and scipy.io load only for their files; Windows has no resource.
