"""Sensitivity, optimisation, sweeps, report and command line."""

from __future__ import annotations

TYPE_CHECKING = False  # typing's, which takes longer to import than all that the program does before it listens to signals
if TYPE_CHECKING:
    from probe_design.sweeps.run import sweep

__all__ = ["sweep"]


def __getattr__(name: str) -> object:
    """Import what is asked for by name only then: the command line's help needs none of it."""
    if name == "sweep":
        from probe_design.sweeps.run import sweep

        return sweep
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
