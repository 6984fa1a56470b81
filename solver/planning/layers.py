"""Effects of layers of tissue: those of the scene, and the skin that living tissue would have."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from geometry.scenes.scene import Layer, Scene
from solver.planning.coarse_model import CoarseModel
from solver.results.result import Decision, Effect
from solver.results.warnings import Note

BREAST_SKIN = Layer(thickness=1.4e-3, youngs_modulus=56e3, poisson_ratio=0.45)
"""Of the breast: 1.44 +- 0.25 mm (137 breasts, Med. Phys. 2013, OSTI 22130565), 56.3 +- 16.4 kPa in vivo (Briot et al. 2022)."""
SOFT_TISSUE_MODULUS_PA = 20e3  # Pa: softer tissue without layers may be living tissue whose skin was forgotten


def decide_layers(rough: CoarseModel, accuracy: float) -> Iterator[Decision]:
    """Yield each layer's effect against the material below it in its place; all layers are modelled, at almost no cost."""
    layers = rough.scene.tissue.layer
    for k, layer in enumerate(layers):
        lower_material = layers[k + 1] if k + 1 < len(layers) else rough.scene.tissue
        replaced_layer = layer.model_copy(
            update={"youngs_modulus": lower_material.youngs_modulus, "poisson_ratio": lower_material.poisson_ratio}
        )
        effect = _compute_effect(
            CoarseModel.from_scene(replace_layers(rough.scene, (*layers[:k], replaced_layer, *layers[k + 1 :])), details=False),
            rough,
        )
        reason = f"modelled: it changes the ratio by about {effect.ratio:.2g}"
        yield Decision.from_effect(f"tissue.layer[{k}]", True, effect, accuracy, reason)


def warn_of_missing_skin(scene: Scene, rough: CoarseModel) -> Iterator[Note]:
    """Warn how much a skin would change the result on soft tissue without layers."""
    tissue = scene.tissue
    deep = tissue.shape == "half-space" or tissue.depth > 2 * BREAST_SKIN.thickness
    if tissue.layer or tissue.youngs_modulus >= SOFT_TISSUE_MODULUS_PA or not deep:
        return
    effect = _compute_effect(rough, CoarseModel.from_scene(replace_layers(rough.scene, (BREAST_SKIN,)), details=False))
    skin = f"{1e3 * BREAST_SKIN.thickness:g} mm and {1e-3 * BREAST_SKIN.youngs_modulus:g} kPa"
    yield Note("skin", f"no layers: a skin of {skin}, as on a breast, would change the ratio by about {effect.ratio:.2g}")


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
