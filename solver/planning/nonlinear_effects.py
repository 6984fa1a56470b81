"""Nonlinear effects at the scene's load: finite strain, contact in the gap, lift-off of surfaces."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

from geometry.common.limits import format_maximum
from geometry.scenes.scene import Scene
from solver.planning.coarse_model import CoarseModel
from solver.planning.loads import MAX_X, LoadRule, bound_ratio_change
from solver.results.result import Decision, Effect

NO_LINEAR_EVALUATOR = "no linear evaluator"
UNREMARKED_STRAIN_RATIO = 1.1  # times the indentation over the outer radius: smaller strains are not mentioned


def decide_nonlinear_effects(scene: Scene, rough: CoarseModel, accuracy: float, contact: bool) -> Iterator[Decision]:
    """Yield decisions on nonlinear effects at the scene's load, by the rule of ``loads.py``; ``contact`` models the first two."""
    rule = rough.build_rule(scene)
    force = rule.compute_force(scene)
    if contact:
        yield from (
            replace(decision, modelled=True, reason=decision.reason.replace(NO_LINEAR_EVALUATOR, "contact"))
            for decision in _decide_strain_effects(scene, rule, force, accuracy)
        )
    else:
        yield from _decide_strain_effects(scene, rule, force, accuracy)
    yield _decide_lift_off(scene, rough, force / rule.stiffness, accuracy)


def _decide_strain_effects(scene: Scene, rule: LoadRule, force: float, accuracy: float) -> Iterator[Decision]:
    yield _decide_gap_contact(force, rule, accuracy)
    yield _decide_finite_strain(scene, rule, force, accuracy)


def _describe_indentation(scene: Scene, rule: LoadRule, force: float) -> str:
    """Describe how deep the probe is pressed, and the equivalent indentation under stiff blocks on deep tissue."""
    depth, x = force / rule.stiffness, rule.compute_x(force)
    share = depth / scene.probe.tube_radius
    text = f"{NO_LINEAR_EVALUATOR}: indented by {1e3 * depth:.2g} mm, {share:.2g} of the outer radius"
    return (
        text if x < UNREMARKED_STRAIN_RATIO * share else f"{text}, equivalent to {x:.2g} of it under stiff blocks on deep tissue"
    )


def _decide_finite_strain(scene: Scene, rule: LoadRule, force: float, accuracy: float) -> Decision:
    """Decide on finite strain under a force, N; where the rule knows nothing because of the gap, by the strain alone."""
    description, x = _describe_indentation(scene, rule, force), rule.compute_x(force)
    if x > MAX_X:
        return _build_decision("finite strain", math.inf, accuracy, f"{description}; beyond {MAX_X:g} the effect is unknown")
    changes = replace(rule, closure=math.inf).describe_changes(force, scene.target is not None)
    return _build_decision(
        "finite strain", bound_ratio_change(x, rule.covered), accuracy, f"{description}, which changes {changes}"
    )


def _decide_gap_contact(force: float, rule: LoadRule, accuracy: float) -> Decision:
    """Decide on contact in the gap: in all references it is open up to 1/14 of the linear closing force, or to x = 0.3."""
    known = f"{NO_LINEAR_EVALUATOR}: the gap stays open up to {format_maximum(rule.largest_open_load.force, 3)} N at least"
    if rule.is_known(force):
        return _build_decision("gap contact", 0.0, accuracy, known)
    return _build_decision("gap contact", math.inf, accuracy, f"{known}; at {force:.2g} N it may close")


def _decide_lift_off(scene: Scene, rough: CoarseModel, indentation: float, accuracy: float) -> Decision:
    """Decide on lift-off: the fraction of contact forces that pull, and how far a tilt raises one side."""
    tilted = math.tan(abs(scene.placement.tilt)) * scene.probe.tube_radius
    raised = max(0.0, 1 - indentation / tilted) if tilted > 0 else 0.0
    pulled = rough.pulled_share
    tie = "" if scene.contact.interface == "unilateral" else f" (interface = '{scene.contact.interface}' ties them)"
    reason = f"no evaluator: about {pulled:.2g} of the contact's force would pull the surfaces apart{tie}"
    if raised > 0:
        reason += f"; the tilt raises one side by {1e3 * tilted:.2g} mm at an indentation of {1e3 * indentation:.2g} mm"
    return _build_decision("lift-off", max(pulled, raised), accuracy, reason)


def _build_decision(feature: str, effect: float, accuracy: float, reason: str) -> Decision:
    return Decision.from_effect(feature, False, Effect(effect, effect, effect), accuracy, reason)
