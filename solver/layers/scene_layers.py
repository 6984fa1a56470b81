"""The layers of a scene: with neighbours of one material merged, and how much blocks squeeze a soft one."""

from __future__ import annotations

import numpy as np

from geometry.scenes.scene import Scene, Tissue
from solver.layers.stack import TissueLayer, compute_compliance_change, compute_echoes, compute_last_wave

WAVE_COUNT = 12  # wave numbers at which the surface's compliance is computed


def list_material_layers(tissue: Tissue, merged: bool = True) -> list[list[float]]:
    """Return thickness, modulus and Poisson's ratio of layers above the tissue's own material; equal neighbours are merged."""
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
    """Return the relative increase of k times compliance from waves k = 2 / outer radius to shorter ones; 0 or more.

    It is large under a block that squeezes a thin soft film: pressures there have all details, and small ones matter.
    """
    layers = list_material_layers(scene.tissue)
    if not layers:
        return 0.0
    radius = scene.probe.tube_radius
    last = float(compute_last_wave(np.array(radius), np.array(layers[0][0])))
    k = np.geomspace(2 / radius, max(4 / radius, last), WAVE_COUNT)[None]
    tissue_modulus, rigid = np.array([scene.tissue.youngs_modulus]), scene.tissue.shape != "half-space"
    stack = [TissueLayer(*(np.array([value]) for value in layer)) for layer in layers]
    left = np.array([scene.tissue.depth - sum(layer[0] for layer in layers)]) if scene.tissue.shape != "half-space" else None
    stack.append(TissueLayer(left, tissue_modulus, np.array([scene.tissue.poisson_ratio])))
    near_echo = compute_echoes(k, stack, rigid)[0].near_echo
    assert near_echo is not None
    sunk = [
        (tissue_modulus + part)[0]
        for tissue_modulus, part in zip(stack[0].half_space[:2], compute_compliance_change(stack[0], near_echo)[:2], strict=True)
    ]
    return max(float(part.max() / part[0] - 1) for part in sunk)
