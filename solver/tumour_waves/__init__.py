"""Compute film forces of many probes over a population of tumours, in closed form to first order, for a search of designs."""
