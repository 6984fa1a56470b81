"""A scene in, stresses out: one evaluator per level of fidelity behind one small interface."""

from solver.levels import evaluate, evaluator
from solver.result import Decision, Evaluator, Result

__all__ = ["Decision", "Evaluator", "Result", "evaluate", "evaluator"]
