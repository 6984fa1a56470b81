"""Command `rerun`: run the command that made a file again, and compare the numbers."""
