"""Package data, built-in scenes, bench and report template, and what reads them."""
