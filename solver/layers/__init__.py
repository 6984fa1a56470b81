"""Waves in layers of tissue bonded to each other: reflections and the surface's compliance, independent of the probe."""
