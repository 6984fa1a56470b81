"""Record raw bytes on disk, and replay them in place of a device."""
