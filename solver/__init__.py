"""A scene in, stresses out: one evaluator per level of fidelity behind one small interface."""

from solver.levels import curve, evaluate, evaluator, load, plan
from solver.linalg.workspace import Workspace
from solver.results.evaluator import Evaluator
from solver.results.result import Curve, Decision, Result

__all__ = ["Curve", "Decision", "Evaluator", "Result", "Workspace", "curve", "evaluate", "evaluator", "load", "plan"]
