"""Check whether linear elasticity holds at a scene's load, and compute the load's contribution to a result's error."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from geometry.common.arrays import Bools, Floats
from geometry.common.errors import Refusal, Words
from geometry.common.limits import format_maximum
from geometry.common.percent import format_percent
from geometry.scenes.scene import Scene
from solver.planning.charge_changes import SOFT_BOND_FACTOR, add_charges, has_soft_bond
from solver.planning.load_limits import LOAD_SHARE, build_limits, build_load_rule, find_largest_load
from solver.planning.loads import CLOSURE_FORCE_SHARE, MAX_X, SENSITIVITY_GROWTH, LoadRule, bound_closure_force
from solver.planning.strains import RATIO_CHANGE_PER_X
from solver.planning.tumour_effects import adjust_rule
from solver.results.film_forces import compute_indentation
from solver.results.load_limits import Basis, LargestLoad, describe_load
from solver.results.result import Result
from solver.results.warnings import Note

FORMULAS_MARGIN = 0.9  # of the stiffness by formulas, which is off by some per cent, and counts tumours that stiffen
LIMIT_REASONS = {
    "ratio": "beyond it finite strain may change ratio and stresses by more than {accuracy}",
    "log_sensitivity": "beyond it finite strain may change log_sensitivity by more than {promise} of its value",
    "strain limit": "the effect of larger strains is unknown",
    "gap closure": "at larger loads the gap may close",
}
LINEAR_REMEDY = "or --linear (linear=True)"


def check_load(scene: Scene, rule: LoadRule, accuracy: float, promise: bool) -> None:
    """Raise ``Refusal`` where linear elasticity is not accurate enough at the scene's load.

    Parameters
    ----------
    scene
        The scene, of which only load and tilt are used.
    rule
        The rule for loads on it; its stiffness converts force to indentation.
    accuracy
        See ``find_largest_load``.
    promise
        Whether the log-sensitivity has to be accurate too, see ``find_largest_load``.
    """
    if is_load_linear(scene, rule, accuracy, promise):
        return
    limit = find_largest_load(rule, accuracy, promise)
    if limit.force == 0:  # the tilt alone is too much
        raise Refusal("placement.tilt", Words(f"{math.degrees(scene.placement.tilt):.3g} deg"), f"a smaller one, {LINEAR_REMEDY}")
    raise Refusal(
        *describe_load(scene), f"up to {_format_limit(scene, limit)} ({explain_limit(limit, accuracy)}), {LINEAR_REMEDY}"
    )


def refuse_load(scene: Scene, rule: LoadRule, accuracy: float, promise: bool, reason: str) -> None:
    """Raise ``Refusal`` as ``check_load`` does where ``contact`` does not take the scene either, and say what it takes."""
    try:
        check_load(scene, rule, accuracy, promise)
    except Refusal as fault:
        raise Refusal(fault.key, fault.value, f"{fault.allowed}; contact, for larger loads, takes {reason}") from None


def is_load_linear(scene: Scene, rule: LoadRule, accuracy: float, promise: bool) -> bool:
    """Return whether linear elasticity is accurate enough at the scene's load; parameters as of ``check_load``."""
    return _is_within(rule.compute_force(scene), find_largest_load(rule, accuracy, promise))


def check_known_load(scene: Scene, rule: LoadRule) -> None:
    """Raise ``Refusal`` where the effect of the scene's load is unknown, so that no error of a linear result can be given.

    Parameters
    ----------
    scene
        The scene, for its load.
    rule
        The rule for loads on the scene.
    """
    if rule.is_known(rule.compute_force(scene)):
        return
    text = f"up to {_format_limit(scene, rule.largest_open_load)}; larger loads have unknown effects, also with --linear"
    raise Refusal(*describe_load(scene), text)


def explain_limit(limit: LargestLoad, accuracy: float) -> str:
    """Describe in words the reason for a limit."""
    return LIMIT_REASONS[limit.by].format(
        accuracy=format_percent(LOAD_SHARE * accuracy), promise=format_percent(5 * LOAD_SHARE * accuracy)
    )


def compute_budget(rule: LoadRule, force: float, accuracy: float, promise: bool) -> float:
    """Return the part of an accuracy that the effect of a force, N, leaves for the evaluator's own error.

    It is the whole accuracy where the load is refused anyway. ``promise`` says whether the log-sensitivity counts too.
    """
    if force > find_largest_load(rule, accuracy, promise).force:
        return accuracy
    # errors combine as (1 + change) (1 + budget) = 1 + accuracy
    change = max(rule.bound_ratio_change(force), accuracy * rule.compute_promise_share(force, accuracy) if promise else 0.0)
    return (1 + accuracy) / (1 + min(change, LOAD_SHARE * accuracy)) - 1


def add_load_effect(result: Result, scene: Scene, rule: LoadRule, accuracy: float, promise: bool) -> Result:
    """Return a linear result with the load's effect added to its errors.

    Parameters
    ----------
    result
        The linear result for the scene.
    scene
        The scene, for its load.
    rule
        The rule for loads on the scene.
    accuracy
        See ``find_largest_load``.
    promise
        Whether the log-sensitivity has to be accurate too, see ``find_largest_load``.
    """
    result = result.add_error(rule.bound_ratio_change(rule.compute_force(scene)))
    result = replace(result, load_limits=build_limits(rule, accuracy, promise))
    return _add_notes(result, build_load_notes(scene, rule, accuracy, promise))


def build_load_notes(scene: Scene, rule: LoadRule, accuracy: float, promise: bool) -> tuple[Note, ...]:
    """Return the note on a linear result whose load is beyond the limit of linear elasticity; none within the limit."""
    force, limit = rule.compute_force(scene), find_largest_load(rule, accuracy, promise)
    if _is_within(force, limit):
        return ()
    null = "" if rule.is_known(force) else "; error_estimate is null"
    return (
        Note(
            "linear",
            f"linear elasticity used beyond {_format_limit(scene, limit)}: {describe_effect(rule, force, promise)}{null}",
        ),
    )


def add_load_warning(
    result: Result, scene: Scene, accuracy: float, rule: LoadRule | None = None, known: Basis = "bound"
) -> Result:
    """Return the result of a named evaluator with load limits, and with a warning where the load is beyond the linear limit.

    The error of such a result does not include the effect of the load.

    Parameters
    ----------
    result
        The evaluator's result.
    scene
        The result's scene.
    accuracy
        See ``find_largest_load``.
    rule
        The rule for loads on the scene, where it is known; else it is built.
    known
        How the rule's numbers were determined, see ``LargestLoad``.
    """
    if result.stiffness is None:
        return result
    try:
        rule = rule or build_load_rule(scene)
    except Refusal as fault:
        return replace(result, warnings=(*result.warnings, Note("linear", f"linear_limit_load is null: {fault}")))
    promise = scene.target is not None
    limits, force = build_limits(rule, accuracy, promise, known), rule.compute_force(scene)
    result, limit = replace(result, load_limits=limits), limits.linear
    assert limit is not None  # a rule knows all of them
    if _is_within(force, limit):
        return result
    prefix = f"the load is beyond linear_limit_load, {_format_limit(scene, limit)}"
    text = f"{prefix}: error_estimate refers to linear elasticity; {describe_effect(rule, force, promise)}"
    return _add_notes(result, (Note("linear", text),))


@dataclass(frozen=True)
class LoadChanges:
    """Effect of one load on n results.

    Attributes
    ----------
    ratio, log_sensitivity
        Bounds, relative, shape (n,); infinite where nothing is known.
    weakest
        The rule for the result that changes most.
    """

    ratio: Floats
    log_sensitivity: Floats
    weakest: LoadRule

    @classmethod
    def from_stiffness(cls, scene: Scene, rule: LoadRule, stiffness: Floats) -> LoadChanges:
        """Compute the changes at given stiffnesses, N/m, shape (n,).

        Raises
        ------
        Refusal
            The load drives the probe deeper than the tissue.
        """
        compute_indentation(scene, float(stiffness.min()))
        load = scene.load.departure
        force = stiffness * load.indentation if load.indentation is not None else np.full_like(stiffness, load.force or 0.0)
        x = rule.strain * (force / stiffness + rule.tilted)
        # as in LoadRule.is_known and its bounds, for n stiffnesses at once
        is_covered = (x <= MAX_X) & (force <= CLOSURE_FORCE_SHARE * rule.closure)
        sensitivity_changes = np.expm1(SENSITIVITY_GROWTH * np.minimum(x, MAX_X))
        ratio = np.where(is_covered, RATIO_CHANGE_PER_X * rule.covered * x, np.inf)
        stiffnesses = (rule.stiffness, *stiffness.tolist())
        # a given force presses deepest where the stiffness is lowest; a given indentation needs most force where it is highest
        weakest = min(stiffnesses) if load.indentation is None else max(stiffnesses)
        return cls(ratio, np.where(is_covered, sensitivity_changes, np.inf), replace(rule, stiffness=weakest))

    @classmethod
    def from_contact(cls, linear: LoadChanges) -> LoadChanges:
        """Return no changes in place of those of ``linear`` results: ``contact`` has computed the results under load."""
        return cls(np.zeros_like(linear.ratio), np.zeros_like(linear.log_sensitivity), linear.weakest)

    @property
    def is_known(self) -> Bools:
        """Whether the changes are known, shape (n,)."""
        return np.isfinite(self.ratio)

    def add_to_errors(self, errors: Floats) -> Floats:
        """Return bounds on relative errors of the ratio, shape (n,), increased by the load's effect on it."""
        return np.asarray((1 + errors) * (1 + self.ratio) - 1)


def build_rule_from_formulas(scene: Scene, result: Result) -> LoadRule:
    """Build the load rule of a scene from a result of formulas, without a mesh; PL.4 bounds the closing force."""
    # film forces in units of the outer film's stress; together they make up the stiffness
    inner, outer = (result.ratio or 0.0) * scene.probe.inner_area, scene.probe.outer_area
    totals = (result.stiffness or 0.0) * np.array([inner, outer]) / (inner + outer)
    rule = LoadRule.from_totals(scene, totals, bound_closure_force(scene, totals))
    rule = add_charges(rule, SOFT_BOND_FACTOR if has_soft_bond(scene) else 1.0)
    films = result.film_log_sensitivities
    return adjust_rule(rule, FORMULAS_MARGIN, None if films is None else np.array(films))


def describe_effect(rule: LoadRule, force: float, promise: bool) -> str:
    """Describe in words what a force, N, changes beyond linear elasticity."""
    if not rule.is_known(force):
        return "the effects of finite strain and of contact in the gap are unknown at this load"
    return f"finite strain may change {rule.describe_changes(force, promise)}"


def _is_within(force: float, limit: LargestLoad) -> bool:
    """Return whether a force, N, is at most the limit, up to rounding; zero force always is, even with a tilt."""
    return force == 0 or force <= limit.force * (1 + 1e-12)


def _add_notes(result: Result, notes: tuple[Note, ...]) -> Result:
    """Return a result with notes added to its warnings."""
    return replace(result, warnings=(*result.warnings, *notes))


def _format_limit(scene: Scene, limit: LargestLoad) -> str:
    """Return a limit in the unit of the scene's load, rounded down so that the printed value itself is allowed."""
    force = limit.force / 2 if scene.load.preload else limit.force  # see ``Load.departure``
    value, unit = (force, "N") if scene.load.indentation is None else (1e3 * limit.indentation, "mm")
    return f"{format_maximum(value, 3)} {unit}"
