"""Pictures as files: formats, and writing a file as a whole."""
