"""Helpers of every package: errors, files that are written whole or not at all, text files."""
