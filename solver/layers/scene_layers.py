"""The layers of a scene: with neighbours of one material merged, and how much blocks squeeze a soft one."""

from __future__ import annotations

import numpy as np

from geometry.scenes.scene import Scene
from geometry.scenes.scene_tables import Tissue
from solver.layers.stack import TissueLayer, compute_compliance_change, compute_echoes, compute_last_wave

WAVE_COUNT = 12  # wave numbers at which the surface's compliance is computed


def list_material_layers(tissue: Tissue, merged: bool = True) -> list[list[float]]:
    """Return [thickness, modulus, Poisson's ratio] (SI) of each layer above the tissue's own material, from the surface down.

    If ``merged``, neighbours of equal material are one layer, and lowest layers of the tissue's own material are none.
    """
    own_material, layers = [tissue.youngs_modulus, tissue.poisson_ratio], list[list[float]]()
    for layer in tissue.layer:
        material = [layer.youngs_modulus, layer.poisson_ratio]
        if merged and layers and layers[-1][1:] == material:
            layers[-1][0] += layer.thickness
        else:
            layers.append([layer.thickness, *material])
    while merged and layers and layers[-1][1:] == own_material:
        layers.pop()
    return layers


def compute_squeeze(scene: Scene) -> float:
    """Return how much blocks squeeze a soft layer: by how much the surface is softer under shorter waves, relative; 0 or more.

    Compared is k times the surface's compliance, which is constant on a half-space, at the wave number k = 2 / outer radius and
    at larger ones. The result is large where the first layer is thin and softer than those below: there the pressures under
    the blocks have fine details, and small ones matter.
    """
    layers = list_material_layers(scene.tissue)
    if not layers:
        return 0.0
    radius = scene.probe.tube_radius
    last_wave = float(compute_last_wave(np.array(radius), np.array(layers[0][0])))
    k = np.geomspace(2 / radius, max(4 / radius, last_wave), WAVE_COUNT)[None]
    tissue_modulus, rigid = np.array([scene.tissue.youngs_modulus]), scene.tissue.shape != "half-space"
    stack = [TissueLayer(*(np.array([value]) for value in layer)) for layer in layers]
    left = np.array([scene.tissue.depth - sum(layer[0] for layer in layers)]) if scene.tissue.shape != "half-space" else None
    stack.append(TissueLayer(left, tissue_modulus, np.array([scene.tissue.poisson_ratio])))
    near_echo = compute_echoes(k, stack, rigid)[0].near_echo
    assert near_echo is not None
    # H + (C - H) of eq. LY.2, the compliance times 2 mu k, under pressure and under shear; [0]: there is one design
    compliances = [
        (tissue_modulus + change)[0]
        for tissue_modulus, change in zip(
            stack[0].half_space[:2], compute_compliance_change(stack[0], near_echo)[:2], strict=True
        )
    ]
    return max(float(change.max() / change[0] - 1) for change in compliances)
