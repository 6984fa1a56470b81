"""Helpers of every package: errors, files that are written whole or not at all, text files."""

# Imports inside functions: platformdirs, where tables are cached.
