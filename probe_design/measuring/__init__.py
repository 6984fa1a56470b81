"""Support a session at the bench: the printed page, readings fitted as they come, and their prediction."""
