"""The largest load at which linear elasticity holds on a scene; all commands use these functions.

A rule (``loads.py``) bounds what a load changes. It follows from the coarsest mesh of the probe on its tissue and from what the
scene's tumours change there, so it does not depend on the evaluator. The evaluator ``contact`` computes the loads themselves.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from geometry.common.arrays import Floats
from geometry.scenes.scene import Scene
from solver.linalg.workspace import kept, kept_table
from solver.planning.loads import LoadRule
from solver.results.load_limits import (
    GAP_OPEN,
    Known,
    LargestLoad,
    LoadLimits,
    auto_question,
    ratio_question,
    sensitivity_question,
)

if TYPE_CHECKING:
    from solver.contact.load_curve import Ends
    from solver.planning.coarse_model import CoarseModel

LOAD_SHARE = 0.8  # fraction of the accuracy for the load's effect; the rest is for the evaluator's error


def load_rule(scene: Scene) -> LoadRule:
    """Build the rule for loads on a scene from the coarsest mesh and its tumours' first-order effects.

    Raises:
        InputError: a surface file that cannot be used.
        Refusal: so extreme that not even the coarsest mesh can be solved in double precision.
    """
    from solver.planning.coarse_model import without_tumours  # formulas start without finite elements

    return _coarse(without_tumours(scene)).rule(scene)


def rule_numbers(scene: Scene) -> tuple[Floats, float]:
    """Return film forces per indentation without tumours, N/m, shape (2,), and the force that closes the gap, N.

    Raises:
        Refusal: see ``build_load_rule``.
    """
    from solver.planning.coarse_model import without_tumours

    return _alone(without_tumours(scene))


@kept
def _coarse(scene: Scene) -> CoarseModel:
    """Solve the coarse model of a scene without tumours; it is cached, as many tumours may follow."""
    from solver.planning.coarse_model import CoarseModel

    return CoarseModel.of(scene, details=False)


@kept_table
def _alone(scene: Scene) -> tuple[Floats, float]:
    """Return film forces per indentation, N/m, shape (2,), and the closing force, N; cached for more scenes than models are."""
    coarse = _coarse(scene)
    return coarse.forces.sum(axis=1), coarse.closure


def load_limits(scene: Scene, accuracy: float) -> LoadLimits:
    """Return the loads up to which linear elasticity holds on a scene, by the rule.

    Args:
        scene: its own load does not matter.
        accuracy: relative, on ratio, stresses and stiffness; the log-sensitivity of a target has five times that.

    Raises:
        InputError, Refusal: see ``build_load_rule``.
    """
    return limits_of(load_rule(scene), accuracy, scene.target is not None)


def limits_of(rule: LoadRule, accuracy: float, promise: bool, known: Known = "bound") -> LoadLimits:
    """Build the load limits that a rule sets.

    Args:
        rule: of the scene.
        accuracy: see ``compute_load_limits``.
        promise: whether the log-sensitivity is promised too.
        known: how the rule's numbers are.
    """
    sensitive = rule.largest_for_sensitivity(accuracy) if promise else None
    return LoadLimits(
        ratio=replace(rule.largest_for_ratio(accuracy), question=ratio_question(accuracy), known=known),
        log_sensitivity=sensitive and replace(sensitive, question=sensitivity_question(accuracy), known=known),
        gap_closure=replace(rule.largest_open, question=GAP_OPEN, known=known),
        auto=replace(largest(rule, accuracy, promise), question=auto_question(accuracy), known=known),
    )


def computed_limits(ends: Ends, bounds: LoadLimits, accuracy: float) -> LoadLimits:
    """Return the limits that ``contact`` computed; the linear limit of ``auto`` still follows from the rule.

    Args:
        ends: of the load curve that ``contact`` computed.
        bounds: by the rule.
        accuracy: see ``compute_load_limits``.
    """

    def told(end: LargestLoad | None, question: str) -> LargestLoad | None:
        return None if end is None else replace(end, question=question, known="contact")

    return LoadLimits(
        told(ends.ratio, ratio_question(accuracy)),
        told(ends.log_sensitivity, sensitivity_question(accuracy)),
        told(ends.gap_closure, GAP_OPEN),
        bounds.auto,
    )


def largest(rule: LoadRule, accuracy: float, promise: bool) -> LargestLoad:
    """Return the largest load at which ``auto`` uses linear elasticity: finite strain may take ``LOAD_SHARE`` of the accuracy.

    Args:
        rule: of the scene.
        accuracy: relative, on ratio, stresses and stiffness.
        promise: whether the log-sensitivity is promised too, to five times that.
    """
    return rule.largest(LOAD_SHARE * accuracy, promise)
