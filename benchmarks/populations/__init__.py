"""Populations of tumours: what judging a probe takes, and whether simulated scans find as many as it says."""
