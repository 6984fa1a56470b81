"""Waves on layers of tissue bonded to each other: what each reflects, what the surface gives way. Knows no probe."""
