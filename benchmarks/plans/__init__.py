"""Scenes on which ``auto`` has to decide, given to `plan` and to `evaluate`."""
