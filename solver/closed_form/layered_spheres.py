"""A sphere in a layer, above a floor or others: the field that reaches it from the surface, and its own field as reflected.

With m the moments of ``surface_images`` under a unit wave that runs down from the top of the sphere's layer, and m' under one
that runs up from its bottom, both as on half-spaces, g = m + m' r e^-x F are those under a wave with its echo from below; under
the surface's loads they are g a, a of eq. LY.3. The sphere's polarisation sends k' m^T up and k' m'^T down, with
k' = 2 mu k / (4 (1-nu)). With R the reflection of the layer's top, -1 if it is the surface, the image of eq. CF.15 becomes

    G = V / (2 pi) Int k' (g [-(1 - R N)^-1 R] g^T - m' r m'^T) k dk                              (CF.21)

the floor's image among it. Waves that go as cos about the sphere's axis count twice; those of shear about the vertical do the
same with k' = mu k / 2 and numbers for matrices. The moment of xx-yy, eq. CF.16, has integrals of all three kinds.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from solver.closed_form.bessel import Array
from solver.closed_form.layer import waves_inside
from solver.closed_form.surface_images import (
    ALL,
    MOMENTS,
    Nearby,
    SphereArray,
    crossed_image,
    half_space_moments,
    nearby,
)
from solver.layers.stack import (
    FREE,
    Echo,
    Matrix,
    Symmetric,
    TissueLayer,
    arriving,
    echo,
    echoes,
    inverted,
    product,
    reflected,
)
from solver.layers.vertical_shear import ShearEchoes, shear_echoes

# signs of the moments seen in a horizontal mirror
MIRRORED = np.array([1, 1, -1, -1, -1, -1, 1, 1, 1, 1, 1])
BESIDE = slice(MOMENTS, ALL - 1)


@dataclass(frozen=True)
class Inside:
    """A sphere in its layer.

    Attributes:
        sphere_waves: strains under a unit wave a at the layer's top, moments under unit loads at the surface.
        arriving: a of eq. LY.3 by pressure and shear at the surface.
        image: G of eq. CF.21, shape (n, moments, moments).
    """

    near: Nearby
    arriving: Matrix
    image: Array


def inside(sphere: SphereArray, k: Array, weights: Array, layers: Sequence[TissueLayer], rigid: bool) -> Inside:
    """Build a sphere in the layer ``sphere.layer``, for waves k with weights k dk, shapes (n, q)."""
    layer, above = layers[sphere.layer], layers[: sphere.layer]
    below = echoes(k, layers, rigid)
    a, own = arriving(below, sphere.layer), below[sphere.layer]
    local = replace(sphere, depth=sphere.depth - sum(one.thickness for one in above))
    down = nearby(local, waves_inside(k, layer, own))
    up, turned_up = (None, None) if own.far is None else _from_below(local, layer, down)
    top = _thrown_back(k, layers[: sphere.layer + 1])
    scale = weights * k * ((4 * np.pi / 3 * sphere.radius**3) / (16 * np.pi * (1 - layer.nu) * layer.mu[:, 0]))[:, None]
    G, turned = _image(down.moments, up, own, top, scale), None
    if not sphere.on_axis:
        shear = shear_echoes(k, layers, sphere.layer, rigid)
        turned = down.turned if turned_up is None else down.turned + turned_up * (shear.far * shear.fade)[:, None, :]
        G = G + _turned_image(turned, turned_up, shear, (1 - layer.nu)[:, None] * scale)
        G[:, -1, -1] += crossed_image(sphere, layer.mu[:, 0], layer.nu) - _crossed_waves(sphere, layer, down, scale)
        turned = turned * shear.arriving[:, None, :]
    return Inside(replace(down, moments=_by_loads(down.moments, a), turned=turned), a, G)


def _from_below(local: SphereArray, layer: TissueLayer, down: Nearby) -> tuple[tuple[Array, Array], Array | None]:
    """Return moments under unit waves that run up from the layer's bottom: those of the mirrored sphere under mirrored loads."""
    way = down.waves.k * (layer.thickness - local.depth)[:, None]
    (pressed, sheared), turned = half_space_moments(down.ball, way, layer.nu, local.on_axis)
    signs = MIRRORED[: pressed.shape[1], None]
    return (signs * pressed, -signs * sheared), None if turned is None else -signs * turned


def _thrown_back(k: Array, layers: Sequence[TissueLayer]) -> Symmetric:
    """Return R of eq. CF.21 at the top of the last of the layers: eq. LY.2 in a mirror, from the free surface on."""
    far = FREE
    for layer, below in pairwise(layers):
        far = reflected(below, layer, echo(k, layer, far).near)
    return far[0], far[1], -far[2]


def _image(down: tuple[Array, Array], up: tuple[Array, Array] | None, own: Echo, top: Symmetric, scale: Array) -> Array:
    """Return the image G of eq. CF.21 for pressures and shears."""
    G = _quadratic(down, _returning(own.near, top), scale)
    return G if up is None or own.far is None else G - _quadratic(up, own.far, scale)


def _returning(near: Symmetric | None, top: Symmetric) -> Symmetric:
    """Return -(1 - R N)^-1 R of eq. CF.21: the waves that come back down from the layer's top."""
    if near is None:
        return -top[0], -top[1], -top[2]
    R = top[0], top[2], top[2], top[1]
    RN = product(R, (near[0], near[2], near[2], near[1]))
    pp, pq, qp, qq = product(inverted((1 - RN[0], -RN[1], -RN[2], 1 - RN[3])), R)
    return -pp, -qq, -(pq + qp) / 2


def _quadratic(moments: tuple[Array, Array], form: Symmetric, scale: Array) -> Array:
    """Return the sum over waves of scale times m form m^T, moments m of different angles apart; shape (n, moments, moments)."""
    pp, qq, pq = (np.broadcast_to(scale * part, scale.shape)[:, None, :] for part in form)
    p, q = moments
    left = p * pp + q * pq, p * pq + q * qq
    return _apart(lambda rows: sum(a[:, rows] @ b[:, rows].swapaxes(1, 2) for a, b in zip(left, moments, strict=True)), p)


def _apart(block: Callable[[slice], Array], like: Array) -> Array:
    """Assemble blocks by angle: axisymmetric moments once, those as cos and as cos of twice the angle twice."""
    size = like.shape[1]
    if size == MOMENTS:
        return block(slice(0, MOMENTS))
    G = np.zeros((len(like), size, size), dtype=like.dtype)
    G[:, :MOMENTS, :MOMENTS] = block(slice(0, MOMENTS))
    for rows in (BESIDE, slice(ALL - 1, ALL)):
        G[:, rows, rows] = 2 * block(rows)
    return G


def _turned_image(down: Array, up: Array | None, shear: ShearEchoes, scale: Array) -> Array:
    """Return the image G of eq. CF.21 for shear about the vertical."""

    def block(rows: slice) -> Array:
        image = (down[:, rows] * (scale * shear.returning)[:, None, :]) @ down[:, rows].swapaxes(1, 2)
        if up is None:
            return image
        return image - (up[:, rows] * (scale * shear.far)[:, None, :]) @ up[:, rows].swapaxes(1, 2)

    return _apart(block, down)


def _crossed_waves(sphere: SphereArray, layer: TissueLayer, down: Nearby, scale: Array) -> Array:
    """Return eq. CF.16 as the sum over the waves, for the layer's material alone: layers do not change the sum's error."""
    nu = layer.nu[:, None]
    plain, times = (part[:, 0] for part in down.ball.down(down.waves.k * sphere.depth[:, None]))
    pressed, sheared = (times + (2 * nu - 1) * plain) / 2, ((2 - 2 * nu) * plain - times) / 2
    return 2 * (scale * (pressed**2 + sheared**2 + (1 - nu) * plain**2)).sum(axis=1)


def _by_loads(moments: tuple[Array, Array], a: Matrix) -> tuple[Array, Array]:
    """Convert moments under unit waves a into moments under unit loads at the surface."""
    pp, pq, qp, qq = (part if np.ndim(part) == 0 else part[:, None, :] for part in a)
    return moments[0] * pp + moments[1] * qp, moments[0] * pq + moments[1] * qq
