"""Evaluate scenes: evaluators of several fidelities behind one small interface.

    >>> from solver import evaluate
    >>> evaluate("examples/scene.toml", evaluator="closed-form").ratio  # doctest: +SKIP

The public functions take a ``geometry.Scene`` or the name of a scene file:

    evaluate       film stresses, their ratio and its log-sensitivity to the tumour's modulus: a Result
    evaluate_many  the same for many scenes at once, in order; work that they share is done once
    plan           the evaluator that reaches an accuracy, and what it leaves out: a Decision for each feature
    curve          ratio and log-sensitivity as functions of the target's Young's modulus: a Curve
    press          the same, and the distance of the gap's walls, under rising loads: a LoadCurve
    evaluator      one evaluator by its name: an Evaluator
    Workspace      keeps meshes and factors from one evaluation to the next
"""

# Imports inside functions: planning, contact and phase load SciPy, and whoever shows a result imports this package.

from solver.batch import evaluate_many
from solver.evaluation import curve, evaluate, plan, press
from solver.evaluators import evaluator
from solver.linalg.workspace import Workspace
from solver.results.evaluator import Evaluator
from solver.results.result import Curve, Decision, LoadCurve, Result

__all__ = [
    "Curve",
    "Decision",
    "Evaluator",
    "LoadCurve",
    "Result",
    "Workspace",
    "curve",
    "evaluate",
    "evaluate_many",
    "evaluator",
    "plan",
    "press",
]
