"""A scene in, stresses out: one evaluator per level of fidelity behind one small interface.

    >>> from solver import evaluate
    >>> evaluate("examples/scene.toml", evaluator="closed-form").ratio  # doctest: +SKIP

`evaluate`, `plan`, `curve` and `load` take a ``geometry.Scene`` or the name of a scene file; `evaluator` returns one level.
"""

from solver.levels import curve, evaluate, evaluator, load, plan
from solver.linalg.workspace import Workspace
from solver.results.evaluator import Evaluator
from solver.results.result import Curve, Decision, Result

__all__ = ["Curve", "Decision", "Evaluator", "Result", "Workspace", "curve", "evaluate", "evaluator", "load", "plan"]
