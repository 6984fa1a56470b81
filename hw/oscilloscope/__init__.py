"""Read oscilloscopes over USB or a network as sources of samples."""

# Imports inside functions: pydantic loads only for what an oscilloscope notes of its acquisition.
