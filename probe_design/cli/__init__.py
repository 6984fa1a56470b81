"""Verbs: click options in, one call, one table or JSON object out. No physics."""

from probe_design.cli.main import main

__all__ = ["main"]
