"""Verbs: click options in, one call, one table or JSON object out. No physics."""
