"""Measurements too long for tests, and the independent codes behind the reference scenes."""
