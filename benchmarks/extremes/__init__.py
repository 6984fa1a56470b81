"""Every evaluator at the limits of the range of designs; writes ``docs/evidence/extremes.md``."""
