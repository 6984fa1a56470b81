"""``estimate``: from readings to modulus, size, depth with intervals."""
