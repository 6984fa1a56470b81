"""Support a session at the bench: the printed page, readings fitted as they come, and their prediction."""

# Imports inside functions: matplotlib loads only where the protocol's page is drawn.
