"""Spheres in layers or half-spaces: the field that reaches them from the surface, and the images of their own fields.

A sphere responds to the image of its own polarisation in the surface, the interfaces and the floor, too. With e the moments of
``sphere_moments``, V the sphere's volume and K the form that eq. CF.13 becomes on e, V e.K e, an image G changes the strength:

    K~ = K (1 + G K)^-1                                                                           (CF.15)

With m the moments under a unit wave that runs down from the top of the sphere's layer, and m' under one that runs up from its
bottom, both as on half-spaces, g = m + m' r e^-x F are those under a wave with its echo from below; under the surface's loads
they are g a, a of eq. LY.3. The field that the sphere sends up meets the compliance of the half-spaces above and below, together
1 / k' for pressure and for shear, k' = 2 mu k / (4 (1-nu)): it sends k' m^T up and k' m'^T down. With R the reflection of the
layer's top, -1 if it is the surface,

    G = V / (2 pi) Int k' (g [-(1 - R N)^-1 R] g^T - m' r m'^T) k dk                              (CF.21)

the floor's image among it. Waves that go as cos about the sphere's axis count twice; those of shear about the vertical do the
same with k' = mu k / 2 and numbers for matrices. The moment of xx-yy has integrals of all three kinds; in a half-space, with
t = R/d, radius over depth,

    G = t^3 / (12 (1-nu) mu) [3/4 - nu/2 + nu^2 - 0.6 (1/2 + nu) t^2 + 0.225 t^4]                   (CF.16)

which is Mindlin's solution (Physics 7 (1936) 195), differentiated twice and averaged over the sphere; so are the others.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from solver.closed_form.bessel import Array
from solver.closed_form.layer import build_waves_in_layer
from solver.closed_form.sphere_moments import (
    ALL_MOMENTS,
    AXIAL_MOMENTS,
    SphereArray,
    SphereWaves,
    compute_ball_waves,
    compute_sphere_waves,
)
from solver.layers.stack import (
    FREE_SURFACE,
    Echo,
    Matrix,
    ShearEchoes,
    Symmetric,
    TissueLayer,
    compute_arriving,
    compute_echo,
    compute_echoes,
    compute_reflection,
    compute_shear_echoes,
    invert_matrix,
    multiply_matrices,
)

# signs of the moments seen in a horizontal mirror
MIRROR_SIGNS = np.array([1, 1, -1, -1, -1, -1, 1, 1, 1, 1, 1])
OFF_AXIS_ROWS = slice(AXIAL_MOMENTS, ALL_MOMENTS - 1)


@dataclass(frozen=True)
class SphereInLayer:
    """A sphere in its layer.

    Attributes
    ----------
    sphere_waves
        Strains under a unit wave a at the layer's top, moments under unit loads at the surface.
    arriving
        A of eq. LY.3 by pressure and shear at the surface.
    image
        G of eq. CF.21, shape (n, moments, moments).
    """

    sphere_waves: SphereWaves
    arriving: Matrix
    image: Array


def build_sphere_in_layer(
    sphere: SphereArray, k: Array, weights: Array, layers: Sequence[TissueLayer], rigid: bool
) -> SphereInLayer:
    """Build a sphere in the layer ``sphere.layer``, for waves k with weights k dk, shapes (n, q)."""
    layer, upper_layers = layers[sphere.layer], layers[: sphere.layer]
    layer_echoes = compute_echoes(k, layers, rigid)
    a, own_echo = compute_arriving(layer_echoes, sphere.layer), layer_echoes[sphere.layer]
    local = replace(sphere, depth=sphere.depth - sum(upper.thickness for upper in upper_layers))
    downward = compute_sphere_waves(local, build_waves_in_layer(k, layer, own_echo), compute_ball_waves(local, k))
    upward, turned_up = (None, None) if own_echo.far_echo is None else _compute_upward_moments(local, layer, downward)
    top = _compute_top_reflection(k, layers[: sphere.layer + 1])
    scale = weights * k * ((4 * np.pi / 3 * sphere.radius**3) / (16 * np.pi * (1 - layer.nu) * layer.mu[:, 0]))[:, None]
    G, turned = _compute_image(downward.moments, upward, own_echo, top, scale), None
    if not sphere.on_axis:
        shear = compute_shear_echoes(k, layers, sphere.layer, rigid)
        turned = downward.turned if turned_up is None else downward.turned + turned_up * (shear.far * shear.fade)[:, None, :]
        G = G + _compute_turned_image(turned, turned_up, shear, (1 - layer.nu)[:, None] * scale)
        G[:, -1, -1] += _compute_crossed_image(sphere, layer.mu[:, 0], layer.nu) - _sum_crossed_waves(
            sphere, layer, downward, scale
        )
        turned = turned * shear.arriving[:, None, :]
    return SphereInLayer(replace(downward, moments=_convert_to_loads(downward.moments, a), turned=turned), a, G)


def _compute_upward_moments(
    local: SphereArray, layer: TissueLayer, downward: SphereWaves
) -> tuple[tuple[Array, Array], Array | None]:
    """Return moments under unit waves that run up from the layer's bottom: those of the mirrored sphere under mirrored loads."""
    k, mirrored = downward.waves.k, replace(local, depth=layer.thickness - local.depth)
    waves = build_waves_in_layer(k, TissueLayer(None, layer.E, layer.nu), Echo(None, None, k))
    upward = compute_sphere_waves(mirrored, waves, downward.ball)
    (pressed, sheared), turned = upward.moments, upward.turned
    signs = MIRROR_SIGNS[: pressed.shape[1], None]
    return (signs * pressed, -signs * sheared), None if turned is None else -signs * turned


def _compute_top_reflection(k: Array, layers: Sequence[TissueLayer]) -> Symmetric:
    """Return R of eq. CF.21 at the top of the last of the layers: eq. LY.2 in a mirror, from the free surface on."""
    far = FREE_SURFACE
    for layer, lower in pairwise(layers):
        far = compute_reflection(lower, layer, compute_echo(k, layer, far).near_echo)
    return far[0], far[1], -far[2]


def _compute_image(
    downward: tuple[Array, Array], upward: tuple[Array, Array] | None, own_echo: Echo, top: Symmetric, scale: Array
) -> Array:
    """Return the image G of eq. CF.21 for pressures and shears."""
    G = _sum_quadratic_form(downward, _compute_returning(own_echo.near_echo, top), scale)
    return G if upward is None or own_echo.far_echo is None else G - _sum_quadratic_form(upward, own_echo.far_echo, scale)


def _compute_returning(near_echo: Symmetric | None, top: Symmetric) -> Symmetric:
    """Return -(1 - R N)^-1 R of eq. CF.21: the waves that come back down from the layer's top."""
    if near_echo is None:
        return -top[0], -top[1], -top[2]
    R = top[0], top[2], top[2], top[1]
    RN = multiply_matrices(R, (near_echo[0], near_echo[2], near_echo[2], near_echo[1]))
    pp, pq, qp, qq = multiply_matrices(invert_matrix((1 - RN[0], -RN[1], -RN[2], 1 - RN[3])), R)
    return -pp, -qq, -(pq + qp) / 2


def _sum_quadratic_form(moments: tuple[Array, Array], form: Symmetric, scale: Array) -> Array:
    """Return the sum over waves of scale times m form m^T, moments m of different angles apart; shape (n, moments, moments)."""
    pp, qq, pq = (np.broadcast_to(scale * part, scale.shape)[:, None, :] for part in form)
    p, q = moments
    left = p * pp + q * pq, p * pq + q * qq
    return _assemble_by_angle(
        lambda rows: sum(a[:, rows] @ b[:, rows].swapaxes(1, 2) for a, b in zip(left, moments, strict=True)), p
    )


def _assemble_by_angle(block: Callable[[slice], Array], like: Array) -> Array:
    """Assemble blocks by angle: axisymmetric moments once, those as cos and as cos of twice the angle twice."""
    size = like.shape[1]
    if size == AXIAL_MOMENTS:
        return block(slice(0, AXIAL_MOMENTS))
    G = np.zeros((len(like), size, size), dtype=like.dtype)
    G[:, :AXIAL_MOMENTS, :AXIAL_MOMENTS] = block(slice(0, AXIAL_MOMENTS))
    for rows in (OFF_AXIS_ROWS, slice(ALL_MOMENTS - 1, ALL_MOMENTS)):
        G[:, rows, rows] = 2 * block(rows)
    return G


def _compute_turned_image(downward: Array, upward: Array | None, shear: ShearEchoes, scale: Array) -> Array:
    """Return the image G of eq. CF.21 for shear about the vertical."""

    def compute_block(rows: slice) -> Array:
        image = (downward[:, rows] * (scale * shear.returning)[:, None, :]) @ downward[:, rows].swapaxes(1, 2)
        if upward is None:
            return image
        return image - (upward[:, rows] * (scale * shear.far)[:, None, :]) @ upward[:, rows].swapaxes(1, 2)

    return _assemble_by_angle(compute_block, downward)


def _compute_crossed_image(sphere: SphereArray, mu: Array, nu: Array) -> Array:
    """Compute the image of the mean of xx-yy in a half-space, eq. CF.16, shape (n,)."""
    t_squared = (sphere.radius / sphere.depth) ** 2
    crossed = 0.75 - nu / 2 + nu**2 - 0.6 * (0.5 + nu) * t_squared + 0.225 * t_squared**2
    return t_squared**1.5 / (12 * (1 - nu) * mu) * crossed


def _sum_crossed_waves(sphere: SphereArray, layer: TissueLayer, downward: SphereWaves, scale: Array) -> Array:
    """Return eq. CF.16 as the sum over the waves, for the layer's material alone: layers do not change the sum's error."""
    nu = layer.nu[:, None]
    plain, times = (part[:, 0] for part in downward.ball.average_downward(downward.waves.k * sphere.depth[:, None]))
    pressed, sheared = (times + (2 * nu - 1) * plain) / 2, ((2 - 2 * nu) * plain - times) / 2
    return 2 * (scale * (pressed**2 + sheared**2 + (1 - nu) * plain**2)).sum(axis=1)


def _convert_to_loads(moments: tuple[Array, Array], a: Matrix) -> tuple[Array, Array]:
    """Convert moments under unit waves a into moments under unit loads at the surface."""
    pp, pq, qp, qq = (part if np.ndim(part) == 0 else part[:, None, :] for part in a)
    return moments[0] * pp + moments[1] * qp, moments[0] * pq + moments[1] * qq
