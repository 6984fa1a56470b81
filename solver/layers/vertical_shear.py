"""Compute waves of shear about the vertical in layers: reflections of each face, numbers where ``stack`` has matrices."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from solver.layers.stack import Array, TissueLayer


@dataclass(frozen=True)
class ShearEchoes:
    """In one layer: r and e^-x of eq. LY.2, -R / (1 - R N) of eq. CF.21, and a of eq. LY.3; arrays that fit (n, q)."""

    far: Array
    fade: Array
    returning: Array
    arriving: Array


def compute_shear_echoes(k: Array, layers: Sequence[TissueLayer], place: int, rigid: bool) -> ShearEchoes:
    """Compute the echoes in the layer with index ``place``; arguments as of ``stack.compute_echoes``."""
    fades = [np.exp(-k * layer.thickness[:, None]) for layer in layers[:-1]]
    fades.append(np.exp(-k * layers[-1].thickness[:, None]) if rigid else 0 * k)
    far = _chain_reflections(layers[::-1], fades[::-1], 1.0 + 0 * k if rigid else 0 * k)[::-1]
    top = _chain_reflections(layers, fades, -1.0 + 0 * k)[place]
    a = 1 / (1 + far[0] * fades[0] ** 2)
    for layer in range(place):
        a = a * (1 + far[layer]) * fades[layer] / (1 + far[layer + 1] * fades[layer + 1] ** 2)
    return ShearEchoes(far[place], fades[place], -top / (1 - top * far[place] * fades[place] ** 2), a)


def compute_shear_compliance(k: Array, layers: Sequence[TissueLayer]) -> Array:
    """Return k times the surface's compliance for shear about the vertical on layers above a half-space, shape (n, q)."""
    fades = [np.exp(-k * layer.thickness[:, None]) for layer in layers[:-1]]
    near_echo = _chain_reflections(layers[::-1], [0 * k, *fades[::-1]], 0 * k)[-1] * fades[0] ** 2
    return (1 - near_echo) / (1 + near_echo) / layers[0].mu


def _chain_reflections(layers: Sequence[TissueLayer], fades: Iterable[Array], first: Array) -> list[Array]:
    """Return r in each layer, where ``first`` is the reflection beyond the first of them."""
    reflections = [first]
    for layer, next_layer, fade in zip(layers, layers[1:], fades, strict=False):
        near_echo = reflections[-1] * fade**2
        reflections.append(2 * (1 + near_echo) / (next_layer.mu / layer.mu * (1 - near_echo) + 1 + near_echo) - 1)
    return reflections
