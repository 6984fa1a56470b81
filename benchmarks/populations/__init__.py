"""Populations of tumours: the cost of verifying a probe, and simulated scans against the stated detection."""
