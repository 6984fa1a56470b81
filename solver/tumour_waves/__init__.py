"""A population of tumours under many probes at once, in closed form to first order: what a search of designs asks for."""
