"""Read oscilloscopes over USB or a network as sources of samples."""
