"""A measure of how much blocks squeeze a soft layer, which formulas with few pressures cannot resolve."""

from __future__ import annotations

import numpy as np

from geometry.scenes.scene import Scene
from solver.layers.materials import material_layers
from solver.layers.stack import TissueLayer, change, echoes, shortest

WAVES = 12  # wave numbers at which the surface's compliance is computed


def squeezed(scene: Scene) -> float:
    """Return the relative increase of k times compliance from waves k = 2 / outer radius to shorter ones; 0 or more.

    It is large under a block that squeezes a thin soft film: pressures there have all details, and small ones matter.
    """
    layers = material_layers(scene.tissue)
    if not layers:
        return 0.0
    radius = scene.probe.tube_radius
    last = float(shortest(np.array(radius), np.array(layers[0][0])))
    k = np.geomspace(2 / radius, max(4 / radius, last), WAVES)[None]
    own, rigid = np.array([scene.tissue.youngs_modulus]), scene.tissue.shape != "half-space"
    stack = [TissueLayer(*(np.array([value]) for value in layer)) for layer in layers]
    left = np.array([scene.tissue.depth - sum(layer[0] for layer in layers)]) if scene.tissue.shape != "half-space" else None
    stack.append(TissueLayer(left, own, np.array([scene.tissue.poisson_ratio])))
    near = echoes(k, stack, rigid)[0].near
    assert near is not None
    sunk = [(own + part)[0] for own, part in zip(stack[0].half_space[:2], change(stack[0], near)[:2], strict=True)]
    return max(float(part.max() / part[0] - 1) for part in sunk)
