"""A scene in, stresses out: one evaluator per level of fidelity behind one small interface.

    >>> from solver import evaluate
    >>> evaluate("examples/scene.toml", evaluator="closed-form").ratio  # doctest: +SKIP

What a user calls, with a ``geometry.Scene`` or the name of a scene file:

    evaluate       what both films feel, and how well their ratio tells E_object: a Result
    evaluate_many  the same of many scenes at once, in order: what they share is found once
    plan           which level answers at which accuracy, and what it leaves out: a Decision for each feature
    curve          ratio and log-sensitivity over the target's Young's modulus: a Curve
    load           the same, and the gap's walls, under rising loads
    evaluator      one level by its name: an Evaluator
    Workspace      keeps factors from one answer to the next
"""

from solver.answers import curve, evaluate, load, plan
from solver.levels import evaluator
from solver.linalg.workspace import Workspace
from solver.many import evaluate_many
from solver.results.evaluator import Evaluator
from solver.results.result import Curve, Decision, Result

__all__ = [
    "Curve",
    "Decision",
    "Evaluator",
    "Result",
    "Workspace",
    "curve",
    "evaluate",
    "evaluate_many",
    "evaluator",
    "load",
    "plan",
]
