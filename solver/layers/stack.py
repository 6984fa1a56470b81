"""Compute waves in bonded layers, one wave number at a time: reflections, the surface's compliance, waves that reach a layer.

A field of wave number k along the surface consists in each layer of a downward part, with tractions a = (p, q) on a horizontal
plane, normal and tangential, and an upward part with tractions b. The displacements are (w, u) = (H a - H' b) / (2 mu k), with
the shear modulus mu, Poisson's ratio nu, H = [2 (1-nu), 2 nu - 1; 2 nu - 1, 2 (1-nu)], and H' the same with mixed terms of the
other sign. Over a thickness h, with x = k h, both parts decay,

    a -> e^-x F a,     b -> e^-x F' b,     F = [1+x, -x; x, 1-x],     F' = F^T                      (LY.1)

for any Poisson's ratio. A body below, of compliance C / (2 mu k), reflects a as b = r a. N is the same reflection at the layer's
top, and C on the right the compliance there:

    r = 4 (1-nu) (C + H')^-1 - 1,     N = e^-2x F^T r F,     C = H - 4 (1-nu) N (1+N)^-1            (LY.2)

From that C, with the other mu, the next layer's r follows: upwards from the bottom (C = 0) or from a half-space (N = 0). No term
grows with x, and C and H' are both positive: neither thick layers nor contrasts lose digits. Loads t at the surface become

    a = (1+N)^-1 t,     and at the next interface     t' = (1+r) e^-x F a                            (LY.3)

Waves of shear about the vertical do the same with numbers in place of the matrices: H = H' = F = 1, 2 for 4 (1-nu), mu for 2 mu.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from solver.materials.linear import Isotropic

Array = Any  # numpy array of floats, or of complex numbers on the way to a derivative
Symmetric = tuple[Array, Array, Array]  # the elements pp, qq and pq of matrices, arrays that fit (n, q)
Matrix = tuple[Array, Array, Array, Array]  # pp, pq, qp, qq
LAYER_WAVE_REACH, PROBE_WAVE_REACH = 6.0, 80.0  # maximum wave number times the first layer's thickness, times the probe's radius
FREE_SURFACE: Symmetric = (-1.0, -1.0, 0.0)  # r of a free surface


@dataclass(frozen=True)
class TissueLayer:
    """One layer of each design: thickness (None: a half-space), modulus, Poisson's ratio; arrays of shape (n,), SI."""

    thickness: Any
    E: Array
    nu: Array

    @property
    def mu(self) -> Array:
        """Shear modulus, shape (n, 1)."""
        return Isotropic(self.E, self.nu).shear_modulus[:, None]

    @property
    def half_space(self) -> Symmetric:
        """H of eq. LY.1, shapes (n, 1)."""
        nu = self.nu[:, None]
        return 2 - 2 * nu, 2 - 2 * nu, 2 * nu - 1


@dataclass(frozen=True)
class Echo:
    """Echo in a layer from what is beyond its far face: r at that face and N at the near face (eq. LY.2), None without echo.

    ``path`` is x, shape (n, q); it has no meaning in a half-space.
    """

    far_echo: Symmetric | None
    near_echo: Symmetric | None
    path: Array


def compute_echoes(k: Array, layers: Sequence[TissueLayer], rigid: bool) -> list[Echo]:
    """Return the echo from below in each layer, the first layer first.

    Parameters
    ----------
    k
        Wave numbers, 1/m, shape (n, q).
    layers
        From the surface downwards; the last has a thickness if ``rigid``.
    rigid
        Whether the last layer lies on a rigid bottom; it is a half-space otherwise.
    """
    last = layers[-1]
    results = [compute_echo(k, last, _compute_rigid_reflection(last)) if rigid else Echo(None, None, k)]
    for layer, lower in zip(layers[-2::-1], layers[:0:-1], strict=True):
        results.append(compute_echo(k, layer, compute_reflection(layer, lower, results[-1].near_echo)))
    return results[::-1]


def compute_echo(k: Array, layer: TissueLayer, far: Symmetric) -> Echo:
    """Return the echo in a layer for waves k (n, q), where r = ``far`` is the reflection at the layer's far face."""
    x = k * layer.thickness[:, None]
    return Echo(far, _compute_returned(far, x), x)


def compute_reflection(layer: TissueLayer, next_layer: TissueLayer, near_echo: Symmetric | None) -> Symmetric:
    """Return the reflection r (eq. LY.2) at the face between a layer and the next, whose own echo is N = ``near_echo``.

    N is None where the next layer is a half-space, which returns nothing. With C = V W^-1, W = 1 + N and V = H - H' N of the next
    layer, (C + H')^-1 is computed as W (V + H' W)^-1, which is finite where W vanishes: for long waves on free plates.
    """
    size = 2 * layer.half_space[0]
    pp, _, pq = layer.half_space
    ratio = layer.mu / next_layer.mu
    a, _, b = (ratio * part for part in next_layer.half_space)
    if near_echo is None:
        return _scale_minus_one(size, _invert_symmetric((a + pp, a + pp, b - pq)))
    w = 1 + near_echo[0], near_echo[2], near_echo[2], 1 + near_echo[1]
    full = (
        a - a * near_echo[0] + b * near_echo[2] + pp * w[0] - pq * w[2],
        b - a * near_echo[2] + b * near_echo[1] + pp * w[1] - pq * w[3],
        b + b * near_echo[0] - a * near_echo[2] - pq * w[0] + pp * w[2],
        a + b * near_echo[2] - a * near_echo[1] - pq * w[1] + pp * w[3],
    )
    inverse = multiply_matrices(w, invert_matrix(full))
    return _scale_minus_one(size, (inverse[0], inverse[3], (inverse[1] + inverse[2]) / 2))


def _scale_minus_one(size: Array, inverse: Symmetric) -> Symmetric:
    """Return size times the symmetric matrices ``inverse``, less the identity: r of eq. LY.2."""
    return size * inverse[0] - 1, size * inverse[1] - 1, size * inverse[2]


def _compute_rigid_reflection(layer: TissueLayer) -> Symmetric:
    """Return the reflection r of a rigid bottom below a layer: eq. LY.2 with C = 0."""
    pp, _, pq = layer.half_space
    return _scale_minus_one(2 * pp, _invert_symmetric((pp, pp, -pq)))


def _invert_symmetric(m: Symmetric) -> Symmetric:
    """Return the inverse of symmetric matrices."""
    determinant = m[0] * m[1] - m[2] * m[2]
    return m[1] / determinant, m[0] / determinant, -m[2] / determinant


def invert_matrix(m: Matrix) -> Matrix:
    """Return the inverse of 2 x 2 matrices."""
    determinant = m[0] * m[3] - m[1] * m[2]
    return m[3] / determinant, -m[1] / determinant, -m[2] / determinant, m[0] / determinant


def multiply_matrices(a: Matrix, b: Matrix) -> Matrix:
    """Return the product a b of 2 x 2 matrices."""
    return (
        a[0] * b[0] + a[1] * b[2],
        a[0] * b[1] + a[1] * b[3],
        a[2] * b[0] + a[3] * b[2],
        a[2] * b[1] + a[3] * b[3],
    )


def _compute_returned(r: Symmetric, x: Array) -> Symmetric:
    """Return the echo N of eq. LY.2 at the near face, from r at the far face and x = k h."""
    rp, rq = (r[0] * (1 + x) + r[2] * x, r[2] * (1 + x) + r[1] * x), (r[2] * (1 - x) - r[0] * x, r[1] * (1 - x) - r[2] * x)
    fade = np.exp(-2 * x)
    return (
        fade * ((1 + x) * rp[0] + x * rp[1]),
        fade * ((1 - x) * rq[1] - x * rq[0]),
        fade * ((1 + x) * rq[0] + x * rq[1]),
    )


def compute_compliance_change(layer: TissueLayer, near_echo: Symmetric) -> Symmetric:
    """Return C - H of eq. LY.2: by how much the echo N changes the compliance at a layer's top, times 2 mu k of the layer.

    The three elements are w under p, u under q and w under q.
    """
    w = 1 + near_echo[0], 1 + near_echo[1]
    mixed = near_echo[2] * near_echo[2]
    scale = -2 * layer.half_space[0] / (w[0] * w[1] - mixed)
    return scale * (near_echo[0] * w[1] - mixed), scale * (near_echo[1] * w[0] - mixed), scale * near_echo[2]


def compute_floor_change(k: Array, layer: TissueLayer) -> Symmetric:
    """Return by how much a rigid bottom below one layer changes the surface's compliance, times 2 mu k of the layer.

    The elements are those of ``compute_compliance_change``, for waves k (n, q).
    """
    near_echo = compute_echo(k, layer, _compute_rigid_reflection(layer)).near_echo
    assert near_echo is not None
    return compute_compliance_change(layer, near_echo)


def compute_arriving(echo: Sequence[Echo], place: int) -> Matrix:
    """Return a of eq. LY.3 at the top of the layer with index ``place``, under unit loads p and q at the surface.

    ``echo`` are the echoes of all layers, as from ``compute_echoes``.
    """
    a = _compute_surface_transmission(echo[0].near_echo)
    for upper, lower in pairwise(echo[: place + 1]):
        assert upper.far_echo is not None
        size = 1 + upper.far_echo[0], upper.far_echo[2], upper.far_echo[2], 1 + upper.far_echo[1]
        a = multiply_matrices(
            _compute_surface_transmission(lower.near_echo),
            multiply_matrices(size, multiply_matrices(compute_fading(upper.path), a)),
        )
    return a


def _compute_surface_transmission(near_echo: Symmetric | None) -> Matrix:
    """Return (1 + N)^-1, the downward waves per load at a layer's near face; N is None, for 0, in a half-space."""
    if near_echo is None:
        return 1.0, 0.0, 0.0, 1.0
    pp, qq, pq = _invert_symmetric((1 + near_echo[0], 1 + near_echo[1], near_echo[2]))
    return pp, pq, pq, qq


def compute_fading(x: Array) -> Matrix:
    """Return the elements pp, pq, qp and qq of e^-x F, eq. LY.1: how downward waves fade over a thickness h, with x = k h."""
    fade = np.exp(-x)
    return fade * (1 + x), -fade * x, fade * x, fade * (1 - x)


def compute_last_wave(radius: Array, thickness: Array) -> Array:
    """Return the wave number, 1/m, up to which waves are summed under probes of outer ``radius``, shape (n,).

    ``thickness`` is that of the first layer, m, shape (n,).

    Waves much shorter than the first layer do not reach the others; loads contain few waves beyond ``PROBE_WAVE_REACH``.
    """
    layer_limit, probe_limit = LAYER_WAVE_REACH / thickness, PROBE_WAVE_REACH / radius
    return np.where(layer_limit.real < probe_limit.real, layer_limit, probe_limit)  # .real: complex steps have no order


@dataclass(frozen=True)
class ShearEchoes:
    """Echoes of shear about the vertical in one layer; arrays that fit (n, q).

    Attributes
    ----------
    far, fade
        r at the far face, and e^-x, of eq. LY.2.
    returning
        -R / (1 - R N) of eq. CF.21.
    arriving
        a of eq. LY.3 at the layer's top under a unit load at the surface.
    """

    far: Array
    fade: Array
    returning: Array
    arriving: Array


def compute_shear_echoes(k: Array, layers: Sequence[TissueLayer], place: int, rigid: bool) -> ShearEchoes:
    """Return the echoes, for shear about the vertical, in the layer with index ``place``.

    ``k``, ``layers`` and ``rigid`` are as in ``compute_echoes``.
    """
    fades = [np.exp(-k * layer.thickness[:, None]) for layer in layers[:-1]]
    fades.append(np.exp(-k * layers[-1].thickness[:, None]) if rigid else 0 * k)
    # from the bottom, which reflects 1, or a half-space, which reflects 0, upwards: r in each layer
    far = _chain_reflections(layers[::-1], fades[::-1], 1.0 + 0 * k if rigid else 0 * k)[::-1]
    # from the free surface, which reflects -1, down to the layer's top: R
    top = _chain_reflections(layers, fades, -1.0 + 0 * k)[place]
    a = 1 / (1 + far[0] * fades[0] ** 2)
    for layer in range(place):
        a = a * (1 + far[layer]) * fades[layer] / (1 + far[layer + 1] * fades[layer + 1] ** 2)
    return ShearEchoes(far[place], fades[place], -top / (1 - top * far[place] * fades[place] ** 2), a)


def compute_shear_compliance(k: Array, layers: Sequence[TissueLayer]) -> Array:
    """Return k times the surface's compliance for shear about the vertical on layers above a half-space, 1/Pa, shape (n, q).

    ``k`` are wave numbers, 1/m, shape (n, q). On a half-space alone the result is 1 / mu.
    """
    fades = [np.exp(-k * layer.thickness[:, None]) for layer in layers[:-1]]
    near_echo = _chain_reflections(layers[::-1], [0 * k, *fades[::-1]], 0 * k)[-1] * fades[0] ** 2
    return (1 - near_echo) / (1 + near_echo) / layers[0].mu


def _chain_reflections(layers: Sequence[TissueLayer], fades: Iterable[Array], first: Array) -> list[Array]:
    """Return the reflection r in each layer from what lies behind it; for shear about the vertical (numbers, not matrices).

    Parameters
    ----------
    layers
        In the order in which the reflections follow from each other.
    fades
        e^-x of each layer.
    first
        Reflection in the first of the layers.
    """
    reflections = [first]
    for layer, next_layer, fade in zip(layers, layers[1:], fades, strict=False):
        near_echo = reflections[-1] * fade**2
        reflections.append(2 * (1 + near_echo) / (next_layer.mu / layer.mu * (1 - near_echo) + 1 + near_echo) - 1)
    return reflections
