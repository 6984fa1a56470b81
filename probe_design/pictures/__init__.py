"""Pictures as files: which formats there are, and how one is written whole."""
