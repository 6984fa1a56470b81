"""Raw bytes on disk, and their replay in place of a device."""
