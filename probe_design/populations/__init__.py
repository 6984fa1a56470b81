"""Read design files, which state tumours, readings and noise, and compute which fraction of the tumours a probe detects."""
