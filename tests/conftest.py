"""Hypothesis draws the same examples every time: a test that fails for one fails for all."""

from hypothesis import settings

settings.register_profile("seeded", derandomize=True, deadline=None, database=None)
settings.load_profile("seeded")
