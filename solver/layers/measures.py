"""How hard layers of tissue are on formulas that know few pressures, no sides of a skin and smooth fields in spheres."""

from __future__ import annotations

from itertools import accumulate, pairwise

import numpy as np

from geometry.scenes.scene import Scene
from solver.layers.materials import material_layers
from solver.layers.stack import TissueLayer, change, echoes, shortest

WAVES = 12  # at which the surface's compliance is asked


def squeezed(scene: Scene) -> float:
    """Return by what share shorter waves sink more than those of k = 2 / outer radius, of pressure or of shear; 0 or more.

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


def carried_to_the_sides(scene: Scene, side: float) -> float:
    """Return how far stiff layers carry the load to sides at that radius, 0 to 1.

    With the bending length l = h (E / 6 E')^(1/3) of each layer stiffer than the next, and the outer radius a: (a + l)^2 over its
    sum with the side's square, less that without l.
    """
    layers, radius = material_layers(scene.tissue), scene.probe.tube_radius
    below = [*(layer[1] for layer in layers[1:]), scene.tissue.youngs_modulus]
    bending = sum(h * max(E / under - 1, 0.0) ** (1 / 3) for (h, E, _), under in zip(layers, below, strict=True)) / 6 ** (1 / 3)
    near, far = (way**2 / (way**2 + side**2) for way in (radius + bending, radius))
    return near - far


def beside_interfaces(scene: Scene) -> float:
    """Return how near the nearest sphere is to an interface, (R / distance)^3 times the contrast; 0 without any."""
    layers = material_layers(scene.tissue)
    moduli = [*(layer[1] for layer in layers), scene.tissue.youngs_modulus]
    faces = zip(accumulate(layer[0] for layer in layers), pairwise(moduli), strict=True)
    contrasts = [(depth, abs(E - under) / (E + under)) for depth, (E, under) in faces]
    return max(
        (
            size * (body.diameter / 2 / abs(body.depth - at)) ** 3
            for body in scene.inclusion
            if body.diameter
            for at, size in contrasts
        ),
        default=0.0,
    )
