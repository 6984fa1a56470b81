"""Package data, built-in scenes, bench, noise and report template, and what reads them."""
