"""`rerun`: what made a file is done again, and its numbers are compared."""
