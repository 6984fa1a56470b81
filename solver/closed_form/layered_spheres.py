"""Spheres in layers or half-spaces: the field that reaches them from the surface, and the images of their own fields.

A sphere responds to the image of its own polarisation in the surface, the interfaces and the bottom, too. With e the moments of
``sphere_moments``, V the sphere's volume and K the form that eq. CF.13 becomes on e, V e.K e, an image G changes the strength:

    K~ = K (1 + G K)^-1                                                                           (CF.15)

With m the moments under a unit wave that runs down from the top of the sphere's layer, and m' under one that runs up from its
bottom, both as on half-spaces, g = m + m' r e^-x F are those under a wave with its echo from below; under the surface's loads
they are g a, a of eq. LY.3. The field that the sphere sends up meets the compliance of the half-spaces above and below, together
1 / k' for pressure and for shear, k' = 2 mu k / (4 (1-nu)): it sends k' m^T up and k' m'^T down. With R the reflection of the
layer's top, -1 if it is the surface,

    G = V / (2 pi) Int k' (g [-(1 - R N)^-1 R] g^T - m' r m'^T) k dk                              (CF.21)

the bottom's image among it. Waves that go as cos about the sphere's axis count twice; those of shear about the vertical do the
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
        The matrix a of eq. LY.3: waves at the layer's top under unit pressure and shear at the surface.
    image
        G of eq. CF.21, shape (n, moments, moments).
    """

    sphere_waves: SphereWaves
    arriving: Matrix
    image: Array


def build_sphere_in_layer(
    sphere: SphereArray, k: Array, weights: Array, layers: Sequence[TissueLayer], rigid: bool
) -> SphereInLayer:
    """Build the waves that reach a sphere in its layer, and its image.

    Parameters
    ----------
    sphere
        One sphere in each of n designs, in the layer with index ``sphere.layer``.
    k, weights
        Wave numbers, 1/m, and weights k dk, shapes (n, q).
    layers
        From the surface downwards.
    rigid
        Whether the last layer lies on a rigid bottom; it is a half-space otherwise.
    """
    layer, upper_layers = layers[sphere.layer], layers[: sphere.layer]
    layer_echoes = compute_echoes(k, layers, rigid)
    a, own_echo = compute_arriving(layer_echoes, sphere.layer), layer_echoes[sphere.layer]
    local_sphere = replace(sphere, depth=sphere.depth - sum(upper.thickness for upper in upper_layers))
    downward = compute_sphere_waves(local_sphere, build_waves_in_layer(k, layer, own_echo), compute_ball_waves(local_sphere, k))
    upward, turned_upward = (None, None) if own_echo.far_echo is None else _compute_upward_moments(local_sphere, layer, downward)
    top_reflection = _compute_top_reflection(k, layers[: sphere.layer + 1])
    # V k' / (2 pi) of eq. CF.21 times k dk; moments are times 2 mu, so that k' = 2 mu k / (4 (1-nu)) is divided by (2 mu)^2
    scale = weights * k * ((4 * np.pi / 3 * sphere.radius**3) / (16 * np.pi * (1 - layer.nu) * layer.mu[:, 0]))[:, None]
    G, turned_moments = _compute_image(downward.moments, upward, own_echo, top_reflection, scale), None
    if not sphere.on_axis:
        shear = compute_shear_echoes(k, layers, sphere.layer, rigid)
        turned_moments = (
            downward.turned if turned_upward is None else downward.turned + turned_upward * (shear.far * shear.fade)[:, None, :]
        )
        G = G + _compute_turned_image(turned_moments, turned_upward, shear, (1 - layer.nu)[:, None] * scale)
        # of xx-yy the image in a half-space is known exactly: the sum over waves gives the change by layers only
        G[:, -1, -1] += _compute_crossed_image(sphere, layer.mu[:, 0], layer.nu) - _sum_crossed_waves(
            sphere, layer, downward, scale
        )
        turned_moments = turned_moments * shear.arriving[:, None, :]
    return SphereInLayer(replace(downward, moments=_convert_to_loads(downward.moments, a), turned=turned_moments), a, G)


def _compute_upward_moments(
    local_sphere: SphereArray, layer: TissueLayer, downward: SphereWaves
) -> tuple[tuple[Array, Array], Array | None]:
    """Return the moments under unit waves that run up from the layer's bottom.

    They are those of the mirrored sphere under mirrored loads: waves that run down from the top. First those of pressure and
    shear, then those of shear about the vertical (None on the axis).
    """
    k, mirrored = downward.waves.k, replace(local_sphere, depth=layer.thickness - local_sphere.depth)
    waves = build_waves_in_layer(k, TissueLayer(None, layer.E, layer.nu), Echo(None, None, k))
    upward = compute_sphere_waves(mirrored, waves, downward.ball)
    (pressed, sheared), turned_moments = upward.moments, upward.turned
    signs = MIRROR_SIGNS[: pressed.shape[1], None]
    return (signs * pressed, -signs * sheared), None if turned_moments is None else -signs * turned_moments


def _compute_top_reflection(k: Array, layers: Sequence[TissueLayer]) -> Symmetric:
    """Return R of eq. CF.21, the reflection at the top of the last of the layers for waves k (n, q).

    It follows from eq. LY.2 upside down, from the free surface downwards; the mixed element changes its sign in the mirror.
    """
    far = FREE_SURFACE
    for layer, lower in pairwise(layers):
        far = compute_reflection(lower, layer, compute_echo(k, layer, far).near_echo)
    return far[0], far[1], -far[2]


def _compute_image(
    downward: tuple[Array, Array], upward: tuple[Array, Array] | None, own_echo: Echo, top_reflection: Symmetric, scale: Array
) -> Array:
    """Return the image G of eq. CF.21 for pressures and shears, shape (n, moments, moments).

    ``downward`` are g, ``upward`` m' (None on a half-space), ``top_reflection`` is R, ``scale`` V k' k dk / (2 pi), shape (n, q).
    """
    G = _sum_quadratic_form(downward, _compute_returning(own_echo.near_echo, top_reflection), scale)
    return G if upward is None or own_echo.far_echo is None else G - _sum_quadratic_form(upward, own_echo.far_echo, scale)


def _compute_returning(near_echo: Symmetric | None, top_reflection: Symmetric) -> Symmetric:
    """Return -(1 - R N)^-1 R of eq. CF.21: the waves that come back down from the layer's top.

    N = ``near_echo`` is None on a half-space, R = ``top_reflection``.
    """
    if near_echo is None:
        return -top_reflection[0], -top_reflection[1], -top_reflection[2]
    R = top_reflection[0], top_reflection[2], top_reflection[2], top_reflection[1]
    RN = multiply_matrices(R, (near_echo[0], near_echo[2], near_echo[2], near_echo[1]))
    pp, pq, qp, qq = multiply_matrices(invert_matrix((1 - RN[0], -RN[1], -RN[2], 1 - RN[3])), R)
    return -pp, -qq, -(pq + qp) / 2


def _sum_quadratic_form(moments: tuple[Array, Array], form: Symmetric, scale: Array) -> Array:
    """Return the sum over waves of scale times m form m^T, shape (n, moments, moments).

    Moments m of different angular dependence (symmetric, cos, cos of twice the angle) are not coupled.
    """
    pp, qq, pq = (np.broadcast_to(scale * part, scale.shape)[:, None, :] for part in form)
    p, q = moments
    left = p * pp + q * pq, p * pq + q * qq
    return _assemble_by_angle(
        lambda rows: sum(a[:, rows] @ b[:, rows].swapaxes(1, 2) for a, b in zip(left, moments, strict=True)), p
    )


def _assemble_by_angle(block: Callable[[slice], Array], like: Array) -> Array:
    """Assemble matrices (n, moments, moments) from the blocks of moments that go alike with the angle about the sphere's axis.

    ``block`` returns the block of some rows; those of cos, and of cos of twice the angle, count twice. ``like`` has the number of
    moments as its second axis, and the type of the result.
    """
    size = like.shape[1]
    if size == AXIAL_MOMENTS:
        return block(slice(0, AXIAL_MOMENTS))
    G = np.zeros((len(like), size, size), dtype=like.dtype)
    G[:, :AXIAL_MOMENTS, :AXIAL_MOMENTS] = block(slice(0, AXIAL_MOMENTS))
    for rows in (OFF_AXIS_ROWS, slice(ALL_MOMENTS - 1, ALL_MOMENTS)):
        G[:, rows, rows] = 2 * block(rows)
    return G


def _compute_turned_image(downward: Array, upward: Array | None, shear: ShearEchoes, scale: Array) -> Array:
    """Return the image G of eq. CF.21 for shear about the vertical; arguments as of ``_compute_image``."""

    def compute_block(rows: slice) -> Array:
        """Return the block of G of some rows of the moments."""
        image = (downward[:, rows] * (scale * shear.returning)[:, None, :]) @ downward[:, rows].swapaxes(1, 2)
        if upward is None:
            return image
        return image - (upward[:, rows] * (scale * shear.far)[:, None, :]) @ upward[:, rows].swapaxes(1, 2)

    return _assemble_by_angle(compute_block, downward)


def _compute_crossed_image(sphere: SphereArray, mu: Array, nu: Array) -> Array:
    """Compute the image of the mean of xx-yy in a half-space, eq. CF.16, shape (n,).

    ``mu`` and ``nu`` are the half-space's shear modulus, Pa, and Poisson's ratio, shape (n,).
    """
    t_squared = (sphere.radius / sphere.depth) ** 2
    crossed = 0.75 - nu / 2 + nu**2 - 0.6 * (0.5 + nu) * t_squared + 0.225 * t_squared**2
    return t_squared**1.5 / (12 * (1 - nu) * mu) * crossed


def _sum_crossed_waves(sphere: SphereArray, layer: TissueLayer, downward: SphereWaves, scale: Array) -> Array:
    """Return eq. CF.16 as the sum over the waves, for a half-space of the layer's material, shape (n,).

    Subtracted from the sum for layers, it removes the sum's error, which layers do not change.
    """
    nu = layer.nu[:, None]
    plain, times = (part[:, 0] for part in downward.ball.average_downward(downward.waves.k * sphere.depth[:, None]))
    pressed, sheared = (times + (2 * nu - 1) * plain) / 2, ((2 - 2 * nu) * plain - times) / 2
    return 2 * (scale * (pressed**2 + sheared**2 + (1 - nu) * plain**2)).sum(axis=1)


def _convert_to_loads(moments: tuple[Array, Array], a: Matrix) -> tuple[Array, Array]:
    """Convert moments under unit waves a at the layer's top into moments under unit loads at the surface; a of eq. LY.3."""
    pp, pq, qp, qq = (part if np.ndim(part) == 0 else part[:, None, :] for part in a)
    return moments[0] * pp + moments[1] * qp, moments[0] * pq + moments[1] * qq
