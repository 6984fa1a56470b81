"""The layers of a scene: with neighbours of one material merged, and how much blocks squeeze a soft one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from geometry.common.arrays import Floats
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
    """Return how much blocks squeeze a soft layer, see ``compute_squeezes``; 0 in tissue of one material."""
    tissue, layers = scene.tissue, list_material_layers(scene.tissue)
    if not layers:
        return 0.0
    left = None if tissue.shape == "half-space" else np.array([tissue.depth - sum(layer[0] for layer in layers)])
    stack = [TissueLayer(*(np.array([value]) for value in layer)) for layer in layers]
    stack.append(TissueLayer(left, np.array([tissue.youngs_modulus]), np.array([tissue.poisson_ratio])))
    return float(compute_squeezes(np.array([scene.probe.tube_radius]), stack)[0])


def compute_squeezes(radius: Floats, stack: Sequence[TissueLayer]) -> Floats:
    """Return how much blocks squeeze a soft layer: by how much the surface is softer under shorter waves, relative; 0 or more.

    Compared is k times the surface's compliance, which is constant on a half-space, at the wave number k = 2 / outer radius and
    at larger ones. The result is large where the first layer is thin and softer than those below: there the pressures under
    the blocks have fine details, and small ones matter.

    Parameters
    ----------
    radius
        The probe's outer radius, m, shape (n,).
    stack
        The layers from the surface downwards, two or more; the last has no thickness on half-spaces.
    """
    last_wave = np.maximum(4 / radius, compute_last_wave(radius, stack[0].thickness))
    k = np.geomspace(2 / radius, last_wave, WAVE_COUNT, axis=1)
    near_echo = compute_echoes(k, stack, stack[-1].thickness is not None)[0].near_echo
    assert near_echo is not None
    changes = compute_compliance_change(stack[0], near_echo)
    # H + (C - H) of eq. LY.2, the compliance times 2 mu k, under pressure and under shear
    compliances = [alone + change for alone, change in zip(stack[0].half_space[:2], changes[:2], strict=True)]
    squeezes: Floats = np.max([part.max(axis=1) / part[:, 0] - 1 for part in compliances], axis=0)
    return squeezes
