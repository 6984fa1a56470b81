"""Measure locating: the forward model of scans, what is stated of tumours against the truth, and surveys."""
