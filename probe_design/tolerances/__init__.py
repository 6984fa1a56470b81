"""Command ``tolerances``: how manufacturing tolerances scatter the readings of a probe, and how tight each must be."""
