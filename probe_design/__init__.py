"""Design, check and export tactile palpation probes, from Python as from the command line.

A scene says which probe is pressed on which tissue: ``geometry.Scene``, or a TOML file (docs/reference/scene-file.md).
Numbers are in SI units. What a user calls:

    evaluate       what both films feel, and how well their ratio tells E_object
    evaluate_many  the same of many scenes, in order: designs that differ in moduli or loads come from one curve
    plan           which model answers a scene at which accuracy, and what it leaves out
    curve          ratio and log-sensitivity over the target's Young's modulus
    load           the same, and the gap's walls, under rising loads
    scan           what the probe reads along a line over the tissue
    detectability  which tumours it sees, and of which it tells the stiffness
    estimate       from readings to modulus, diameter or depth
    optimize       a better probe for a population of tumours, or for the one of a scene
    sweep          thousands of designs, answered once each
    export         the probe as the workshop needs it: STEP, drawings, film patterns, moulds, lists

    >>> from probe_design import evaluate
    >>> evaluate("examples/scene.toml", evaluator="closed-form").ratio  # doctest: +SKIP

Results are frozen; in a notebook they show themselves, ``plot()`` draws those that have a picture, ``to_dataset()`` returns
arrays with their labels and units.
"""

from __future__ import annotations

TYPE_CHECKING = False  # typing's, which takes longer to import than all that the program does before it listens to signals
if TYPE_CHECKING:
    from probe_design.functions import detectability, estimate, export, optimize, scan
    from probe_design.sweeps.run import sweep
    from solver.answers import curve, evaluate, load, plan
    from solver.many import evaluate_many

__all__ = [
    "curve",
    "detectability",
    "estimate",
    "evaluate",
    "evaluate_many",
    "export",
    "load",
    "optimize",
    "plan",
    "scan",
    "sweep",
]

_ROOMS = dict.fromkeys(("curve", "evaluate", "load", "plan"), "solver.answers")
_ROOMS |= {"evaluate_many": "solver.many", "sweep": "probe_design.sweeps.run"}


def __getattr__(name: str) -> object:
    """Import what is asked for by name only then: the command line's help needs none of it."""
    if name in __all__:
        from importlib import import_module

        return getattr(import_module(_ROOMS.get(name, "probe_design.functions")), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    """What a user calls: the rooms are imported by their names."""
    return sorted([*__all__, "__all__", "__doc__", "__file__", "__name__", "__path__"])
