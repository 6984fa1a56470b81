"""Nonlinear effects at the scene's load: finite strain, contact in the gap, lift-off of surfaces."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

from geometry.common.limits import most
from geometry.scenes.scene import Scene
from solver.planning.coarse_model import CoarseModel
from solver.planning.loads import LARGEST_X, LoadRule, ratio_change
from solver.results.result import Decision, Effect

NOBODY = "no linear evaluator"
ALIKE = 1.1  # times the indentation over the outer radius: smaller strains are not mentioned


def unmodelled(scene: Scene, rough: CoarseModel, accuracy: float, contact: bool) -> Iterator[Decision]:
    """Yield decisions on nonlinear effects at the scene's load, by the rule of ``loads.py``; ``contact`` models the first two."""
    rule = rough.rule(scene)
    force = rule.force(scene)
    if contact:
        yield from (
            replace(one, modelled=True, reason=one.reason.replace(NOBODY, "contact"))
            for one in _strained(scene, rule, force, accuracy)
        )
    else:
        yield from _strained(scene, rule, force, accuracy)
    yield _lift_off(scene, rough, force / rule.stiffness, accuracy)


def _strained(scene: Scene, rule: LoadRule, force: float, accuracy: float) -> Iterator[Decision]:
    yield _gap_contact(force, rule, accuracy)
    yield _finite_strain(scene, rule, force, accuracy)


def _indented(scene: Scene, rule: LoadRule, force: float) -> str:
    """Describe how deep the probe is pressed, and the equivalent indentation under stiff blocks on deep tissue."""
    depth, x = force / rule.stiffness, rule.x(force)
    share = depth / scene.probe.tube_radius
    at = f"{NOBODY}: indented by {1e3 * depth:.2g} mm, {share:.2g} of the outer radius"
    return at if x < ALIKE * share else f"{at}, equivalent to {x:.2g} of it under stiff blocks on deep tissue"


def _finite_strain(scene: Scene, rule: LoadRule, force: float, accuracy: float) -> Decision:
    """Decide on finite strain under a force, N; where the rule knows nothing because of the gap, by the strain alone."""
    at, x = _indented(scene, rule, force), rule.x(force)
    if x > LARGEST_X:
        return _decision("finite strain", math.inf, accuracy, f"{at}; beyond {LARGEST_X:g} the effect is unknown")
    changes = replace(rule, closure=math.inf).describe_changes(force, scene.target is not None)
    return _decision("finite strain", ratio_change(x, rule.covered), accuracy, f"{at}, which changes {changes}")


def _gap_contact(force: float, rule: LoadRule, accuracy: float) -> Decision:
    """Decide on contact in the gap: in all references it is open up to 1/14 of the linear closing force, or to x = 0.3."""
    known = f"{NOBODY}: the gap stays open up to {most(rule.largest_open.force, 3)} N at least"
    if rule.knows(force):
        return _decision("gap contact", 0.0, accuracy, known)
    return _decision("gap contact", math.inf, accuracy, f"{known}; at {force:.2g} N it may close")


def _lift_off(scene: Scene, rough: CoarseModel, indentation: float, accuracy: float) -> Decision:
    """Decide on lift-off: the fraction of contact forces that pull, and how far a tilt raises one side."""
    tilted = math.tan(abs(scene.placement.tilt)) * scene.probe.tube_radius
    raised = max(0.0, 1 - indentation / tilted) if tilted > 0 else 0.0
    pulled = rough.pulled
    tie = "" if scene.contact.interface == "unilateral" else f" (interface = '{scene.contact.interface}' ties them)"
    reason = f"no evaluator: about {pulled:.2g} of the contact's force would pull the surfaces apart{tie}"
    if raised > 0:
        reason += f"; the tilt raises one side by {1e3 * tilted:.2g} mm at an indentation of {1e3 * indentation:.2g} mm"
    return _decision("lift-off", max(pulled, raised), accuracy, reason)


def _decision(feature: str, effect: float, accuracy: float, reason: str) -> Decision:
    return Decision.of(feature, False, Effect(effect, effect, effect), accuracy, reason)
