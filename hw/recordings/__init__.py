"""Record raw bytes on disk, and replay them in place of a device."""

# Imports inside functions: pydantic loads only where the header of a recording is read.
