"""Read design files, which state tumours, readings and noise, and compute which fraction of the tumours a probe detects."""

# Imports inside functions: records of calibrations load SciPy's packages, and few populations name one.
