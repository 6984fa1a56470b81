"""Package data: built-in scenes, bench, tissues, noise and report template, and functions that read them."""
