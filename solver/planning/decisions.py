"""Decisions on nonlinear effects at the scene's load, on layers of tissue, and on the skin that living tissue would have."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from geometry.common.limits import format_maximum
from geometry.common.percent import format_percent
from geometry.scenes.scene import Scene
from geometry.scenes.scene_tables import Layer
from solver.planning.coarse_model import CoarseModel
from solver.planning.loads import MAX_X, LoadRule, bound_ratio_change
from solver.results.result import Decision, Effect
from solver.results.warnings import Note

UNREMARKED_STRAIN_RATIO = 1.1  # times the indentation over the outer radius: smaller strains are not mentioned
BREAST_SKIN = Layer(thickness=1.4e-3, youngs_modulus=56e3, poisson_ratio=0.45)
"""Of the breast: 1.44 +- 0.25 mm (137 breasts, Med. Phys. 2013, OSTI 22130565), 56.3 +- 16.4 kPa in vivo (Briot et al. 2022)."""
SOFT_TISSUE_MODULUS_PA = 20e3  # Pa: softer tissue without layers may be living tissue whose skin was forgotten


def decide_nonlinear_effects(scene: Scene, coarse: CoarseModel, accuracy: float, contact: bool) -> Iterator[Decision]:
    """Yield decisions on gap contact, finite strain and lift-off at the scene's load, by the rule of ``loads.py``.

    ``contact`` says that the evaluator of that name is used, which models the first two.
    """
    rule = coarse.build_rule(scene)
    force = rule.compute_force(scene)
    evaluator = "contact" if contact else "no linear evaluator"
    yield replace(_decide_gap_contact(rule, force, accuracy, evaluator), modelled=contact)
    yield replace(_decide_finite_strain(scene, rule, force, accuracy, evaluator), modelled=contact)
    yield _decide_lift_off(scene, coarse, force / rule.stiffness, accuracy)


def _describe_indentation(scene: Scene, rule: LoadRule, force: float, evaluator: str) -> str:
    """Describe how deep a force, N, presses the probe, and the equivalent indentation under stiff blocks on deep tissue.

    The latter is given only where it is noticeably larger.
    """
    depth, x = force / rule.stiffness, rule.compute_x(force)
    depth_ratio = depth / scene.probe.tube_radius
    text = f"{evaluator}: indented by {1e3 * depth:.2g} mm, {format_percent(depth_ratio)} of the outer radius"
    if x < UNREMARKED_STRAIN_RATIO * depth_ratio:
        return text
    return f"{text}, equivalent to {format_percent(x)} of it under stiff blocks on deep tissue"


def _decide_finite_strain(scene: Scene, rule: LoadRule, force: float, accuracy: float, evaluator: str) -> Decision:
    """Decide on finite strain under a force, N, by the strain alone: whether the gap may close is a decision of its own."""
    description, x = _describe_indentation(scene, rule, force, evaluator), rule.compute_x(force)
    if x > MAX_X:
        return _build_decision(
            "finite strain", math.inf, accuracy, f"{description}; beyond {format_percent(MAX_X)} the effect is unknown"
        )
    changes = replace(rule, closure=math.inf).describe_changes(force, scene.target is not None)  # with a gap that never closes
    return _build_decision(
        "finite strain", bound_ratio_change(x, rule.covered), accuracy, f"{description}, which changes {changes}"
    )


def _decide_gap_contact(rule: LoadRule, force: float, accuracy: float, evaluator: str) -> Decision:
    """Decide on contact in the gap under a force, N: none where the rule knows that the gap stays open, else unknown."""
    text = f"{evaluator}: the gap stays open up to {format_maximum(rule.largest_open_load.force, 3)} N at least"
    if rule.is_known(force):
        return _build_decision("gap contact", 0.0, accuracy, text)
    return _build_decision("gap contact", math.inf, accuracy, f"{text}; at {force:.2g} N it may close")


def _decide_lift_off(scene: Scene, coarse: CoarseModel, indentation: float, accuracy: float) -> Decision:
    """Decide on lift-off: the fraction of contact forces that pull, and how far a tilt raises one side."""
    # height by which a tilt raises one side of the probe, m, and the fraction of it that the indentation does not close
    tilted = math.tan(abs(scene.placement.tilt)) * scene.probe.tube_radius
    raised = max(0.0, 1 - indentation / tilted) if tilted > 0 else 0.0
    pulled = coarse.pulled_share
    tie = "" if scene.contact.interface == "unilateral" else f" (interface = '{scene.contact.interface}' ties them)"
    reason = f"no evaluator: about {format_percent(pulled)} of the contact's force would pull the surfaces apart{tie}"
    if raised > 0:
        reason += f"; the tilt raises one side by {1e3 * tilted:.2g} mm at an indentation of {1e3 * indentation:.2g} mm"
    return _build_decision("lift-off", max(pulled, raised), accuracy, reason)


def _build_decision(feature: str, effect: float, accuracy: float, reason: str) -> Decision:
    """Return the line of a feature that is not modelled, with one effect on ratio, stresses and stiffness."""
    return Decision.from_effect(feature, False, Effect(effect, effect, effect), accuracy, reason)


def decide_layers(coarse: CoarseModel, accuracy: float) -> Iterator[Decision]:
    """Yield the effect of each layer, compared with the material below it in its place.

    All layers are modelled, as that costs almost nothing.
    """
    layers = coarse.scene.tissue.layer
    for k, layer in enumerate(layers):
        lower_material = layers[k + 1] if k + 1 < len(layers) else coarse.scene.tissue
        replaced_layer = layer.model_copy(
            update={"youngs_modulus": lower_material.youngs_modulus, "poisson_ratio": lower_material.poisson_ratio}
        )
        effect = _compute_effect(
            CoarseModel.from_scene(replace_layers(coarse.scene, (*layers[:k], replaced_layer, *layers[k + 1 :])), details=False),
            coarse,
        )
        reason = f"modelled: it changes the ratio by about {format_percent(effect.ratio)}"
        yield Decision.from_effect(f"tissue.layer[{k}]", True, effect, accuracy, reason)


def warn_of_missing_skin(scene: Scene, coarse: CoarseModel) -> Iterator[Note]:
    """Warn how much a skin would change the result on soft tissue without layers."""
    tissue = scene.tissue
    shallow = tissue.bottom <= 2 * BREAST_SKIN.thickness
    if tissue.layer or tissue.youngs_modulus >= SOFT_TISSUE_MODULUS_PA or shallow:
        return
    effect = _compute_effect(coarse, CoarseModel.from_scene(replace_layers(coarse.scene, (BREAST_SKIN,)), details=False))
    skin = f"{1e3 * BREAST_SKIN.thickness:g} mm and {1e-3 * BREAST_SKIN.youngs_modulus:g} kPa"
    yield Note(
        "skin", f"no layers: a skin of {skin}, as on a breast, would change the ratio by about {format_percent(effect.ratio)}"
    )


def replace_layers(scene: Scene, layers: tuple[Layer, ...]) -> Scene:
    """Return the scene with other layers of tissue."""
    return scene.model_copy(update={"tissue": scene.tissue.model_copy(update={"layer": layers})})


def _compute_effect(reference: CoarseModel, changed: CoarseModel) -> Effect:
    """Return relative changes of ratio, stresses and stiffness between two models at one indentation."""
    reference_totals, changed_totals = (model.forces.sum(axis=1) for model in (reference, changed))
    logs = np.log(np.abs(changed_totals / reference_totals))
    return Effect(
        float(abs(np.expm1(logs[0] - logs[1]))),
        float(np.abs(np.expm1(logs)).max()),
        abs(float(changed_totals.sum() / reference_totals.sum()) - 1),
    )
