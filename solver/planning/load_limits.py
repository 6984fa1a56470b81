"""The largest load at which linear elasticity holds on a scene; all commands use these functions.

A rule (``loads.py``) bounds what a load changes. It follows from the coarsest mesh of the probe on its tissue and from what the
scene's tumours change there, so it does not depend on the evaluator. The evaluator ``contact`` computes the loads themselves.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from geometry.scenes.scene import Scene
from solver.linalg.workspace import get_workspace, keep_result
from solver.planning.loads import LoadRule
from solver.results.load_limits import (
    GAP_OPEN,
    Basis,
    LargestLoad,
    LoadLimits,
    describe_auto_limit,
    describe_ratio_limit,
    describe_sensitivity_limit,
)

if TYPE_CHECKING:
    from solver.contact.load_curve import LoadEnds
    from solver.planning.coarse_model import CoarseModel

LOAD_SHARE = 0.8  # fraction of the accuracy for the load's effect; the rest is for the evaluator's error


def build_load_rule(scene: Scene) -> LoadRule:
    """Build the rule for loads on a scene from the coarsest mesh and its tumours' first-order effects.

    Raises
    ------
    InputError
        A surface file that cannot be used.
    Refusal
        So extreme that not even the coarsest mesh can be solved in double precision.
    """
    from solver.planning.coarse_model import remove_tumours

    get_workspace().begin()  # of earlier probes' models, those beyond its limit may go: not every evaluator begins by itself
    return _solve_coarse_model(remove_tumours(scene)).build_rule(scene)


@keep_result
def _solve_coarse_model(scene: Scene) -> CoarseModel:
    """Solve the coarse model of a scene without tumours; it is cached, as many tumours may follow."""
    from solver.planning.coarse_model import CoarseModel

    return CoarseModel.from_scene(scene, details=False)


def compute_load_limits(scene: Scene, accuracy: float) -> LoadLimits:
    """Return the loads up to which linear elasticity holds on a scene, by its load rule (see ``LoadRule`` in ``loads.py``).

    Parameters
    ----------
    scene
        The scene; its own load does not matter.
    accuracy
        Relative, on ratio, stresses and stiffness; the log-sensitivity of a target has five times that.

    Raises
    ------
    InputError, Refusal
        See ``build_load_rule``.
    """
    return build_limits(build_load_rule(scene), accuracy, scene.target is not None)


def build_limits(rule: LoadRule, accuracy: float, promise: bool, known: Basis = "bound") -> LoadLimits:
    """Build the load limits that a rule sets.

    Parameters
    ----------
    rule
        The rule for loads on the scene.
    accuracy
        See ``compute_load_limits``.
    promise
        Whether the log-sensitivity has to be accurate too; it has no limit otherwise.
    known
        How the rule's numbers were determined, see ``LargestLoad``.
    """
    sensitivity_limit = rule.find_sensitivity_limit(accuracy) if promise else None
    return LoadLimits(
        ratio=replace(rule.find_ratio_limit(accuracy), question=describe_ratio_limit(accuracy), known=known),
        # None stays None
        log_sensitivity=sensitivity_limit
        and replace(sensitivity_limit, question=describe_sensitivity_limit(accuracy), known=known),
        gap_closure=replace(rule.largest_open_load, question=GAP_OPEN, known=known),
        auto=replace(find_largest_load(rule, accuracy, promise), question=describe_auto_limit(accuracy), known=known),
    )


def combine_computed_limits(ends: LoadEnds, bounds: LoadLimits, accuracy: float) -> LoadLimits:
    """Return the limits that ``contact`` computed; the linear limit of ``auto`` still follows from the rule.

    Parameters
    ----------
    ends
        Loads at which ``contact`` found that each statement ends to be true.
    bounds
        The limits by the rule.
    accuracy
        See ``compute_load_limits``.
    """

    def restate(end: LargestLoad | None, question: str) -> LargestLoad | None:
        """Return a limit with its statement in words, as computed by ``contact``."""
        return None if end is None else replace(end, question=question, known="contact")

    return LoadLimits(
        restate(ends.ratio, describe_ratio_limit(accuracy)),
        restate(ends.log_sensitivity, describe_sensitivity_limit(accuracy)),
        restate(ends.gap_closure, GAP_OPEN),
        bounds.auto,
    )


def find_largest_load(rule: LoadRule, accuracy: float, promise: bool) -> LargestLoad:
    """Return the largest load at which ``auto`` uses linear elasticity: its effect may be ``LOAD_SHARE`` of the accuracy.

    Parameters
    ----------
    rule
        The rule for loads on the scene.
    accuracy
        Relative, on ratio, stresses and stiffness.
    promise
        Whether the log-sensitivity has to be accurate too, to five times that.
    """
    return rule.find_largest_load(LOAD_SHARE * accuracy, promise)
