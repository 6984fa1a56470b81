"""Moments of the strain about a sphere under waves that reach it, and the strain at points in it.

The moments that matter are, about the sphere's vertical axis, the means of a = xx+yy and of zz, their first moments along the
vertical, and that of the radial shear rz; off the probe's axis also the mean of xz and its moment along the vertical, the moments
of a, zz and the shear in the plane along x, and the mean of xx-yy. In radii, with zeta the height above the centre and rho the
distance from the vertical axis.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from solver.closed_form.bessel import Array, bessel
from solver.closed_form.layer import Waves, compute_strain_amplitudes

AXIAL_MOMENTS = 5  # of a, zz, a zeta, zz zeta and rz rho
ALL_MOMENTS = 11  # these, then of xz, xz zeta, a x, zz x, the shear in the plane along x, and xx - yy


@dataclass(frozen=True)
class SphereArray:
    """One sphere in each of n designs; arrays of shape (n,), SI.

    Attributes
    ----------
    radius, depth
        Radius and depth of the centre, m.
    offset
        Distance of the centre from the probe's axis, m.
    E, nu
        Young's modulus, Pa, and Poisson's ratio.
    on_axis
        Whether all lie on the probe's axis, so that five moments suffice.
    layer
        Index of the tissue's layer that holds them, 0 the first.
    """

    radius: Array
    depth: Array
    offset: Array
    E: Array
    nu: Array
    on_axis: bool = True
    layer: int = 0


@dataclass(frozen=True)
class BallQuadrature:
    """Quadrature of the unit ball: place (x, y across, z up) and weight of each point; weights add up to 1."""

    x: Any
    y: Any
    z: Any
    weight: Any


def build_ball_quadrature(turns: Any) -> BallQuadrature:
    """Build a quadrature of the unit ball: Gauss in radius cubed and cosine of the polar angle, midpoints in the azimuth.

    The order is: above before below the centre, the pairs of ``PAIR_RADII`` and ``PAIR_HEIGHTS``, the azimuths ``turns`` (rad).
    """
    x, z, weight = (part[:, None] for part in (PAIR_RADII, PAIR_HEIGHTS, PAIR_WEIGHTS))
    sign, turn = np.array([1.0, -1.0])[:, None, None], np.asarray(turns)
    kinds = np.broadcast_arrays(x * np.cos(turn) + 0 * sign, x * np.sin(turn) + 0 * sign, z * sign, weight / len(turns))
    return BallQuadrature(*(kind.ravel() for kind in kinds))


def _build_point_pairs() -> tuple[Any, Any, Any]:
    """Return distances from the vertical axis, heights above and below the centre, and weights of 4 pairs of points, (4,) each.

    A pair is one point above and its mirror image below the centre; all are in sphere radii, and the weights of both add up to 1.
    """
    # the positive half of four nodes in the cosine of the polar angle; in radius cubed the ball's volume is uniform
    cubes, cube_weights = np.polynomial.legendre.leggauss(2)
    cosines, cosine_weights = (part[2:] for part in np.polynomial.legendre.leggauss(4))
    rho, c = np.meshgrid(np.cbrt((cubes + 1) / 2), cosines, indexing="ij")
    return (rho * np.sqrt(1 - c**2)).ravel(), (rho * c).ravel(), np.outer(cube_weights, cosine_weights).ravel() / 4


AZIMUTHS = 3
PAIR_RADII, PAIR_HEIGHTS, PAIR_WEIGHTS = _build_point_pairs()
ON_AXIS_POINTS, OFF_AXIS_POINTS = (
    build_ball_quadrature(np.zeros(1)),
    build_ball_quadrature((np.arange(AZIMUTHS) + 0.5) * np.pi / AZIMUTHS),
)


def _build_moment_weights() -> Any:
    """Build the matrix from strains in a vertical half-plane to the five moments about the sphere's axis, shape (5, 4 points).

    The strains are rr + hoop, rr - hoop, zz and rz at all points. First moments are divided by their own norm: the mean of zeta^2
    is 1/5, that of rho^2 is 2/5, hence the factors 5 and 2.5.
    """
    # each row: weights of the points, and the index of the strain they multiply
    w, zeros = ON_AXIS_POINTS.weight, 0 * ON_AXIS_POINTS.weight
    rows = [(w, 0), (w, 2), (5 * w * ON_AXIS_POINTS.z, 0), (5 * w * ON_AXIS_POINTS.z, 2), (2.5 * w * ON_AXIS_POINTS.x, 3)]
    return np.array([np.concatenate([weight if i == which else zeros for i in range(4)]) for weight, which in rows])


MOMENT_WEIGHTS = _build_moment_weights()


def _build_average_weights() -> Any:
    """Build the matrix from values at the pairs of points to the averages of ``BallWaves``, shape (6, 16).

    The values are sums and differences of e^(s z) above and below the centre, times J0, then both times J1. The first three rows
    give the even averages, the last three the odd ones.
    """
    w, x, z, zeros = PAIR_WEIGHTS, PAIR_RADII, PAIR_HEIGHTS, 0 * PAIR_WEIGHTS
    even_rows = [(w, zeros, zeros, zeros), (zeros, 5 * w * z, zeros, zeros), (zeros, zeros, 2.5 * w * x, zeros)]
    odd_rows = [(zeros, w * z, zeros, zeros), (5 * w * z * z, zeros, zeros, zeros), (zeros, zeros, zeros, 2.5 * w * x * z)]
    return np.array([np.concatenate(row) for row in even_rows + odd_rows])


_AVERAGE_WEIGHTS = _build_average_weights()


@dataclass(frozen=True)
class BallWaves:
    """Waves about the vertical axis of spheres, in whatever depth; with s = k R, all but J0 and J1 times e^-s.

    Attributes
    ----------
    J0, J1
        Bessel functions at ``PAIR_RADII``, shape (n, 4, q).
    raised, sunk
        e^(s z) and e^(-s z) at the heights z of ``PAIR_HEIGHTS``, shape (n, 4, q).
    even_averages
        Mean and vertical moment of J0 e^(s z), and radial moment of J1 e^(s z), shape (n, 3, q).
    odd_averages
        The same of J0 and J1 times s z e^(s z).
    size
        s, shape (n, q).
    """

    J0: Array
    J1: Array
    raised: Array
    sunk: Array
    even_averages: Array
    odd_averages: Array
    size: Array

    def average_downward(self, t: Array) -> tuple[Array, Array]:
        """Return the averages (see ``even_averages``) over the ball of e^-t and t e^-t, two arrays (n, 3, q).

        ``t``, k times the depth below the layer's top, is given at the centre, shape (n, q).
        """
        fade = np.exp(self.size - t)[:, None]
        plain = fade * self.even_averages
        return plain, t[:, None] * plain - fade * self.odd_averages

    def average_upward(self, t: Array, x: Array) -> tuple[Array, Array]:
        """Return the averages over the ball of e^(t - 2x) and t e^(t - 2x), two arrays (n, 3, q).

        ``t`` is as for downward waves, ``x`` k times the layer's thickness, shape (n, q).
        """
        fade = AVERAGE_MIRROR_SIGNS * np.exp(self.size + t - 2 * x)[:, None]
        plain = fade * self.even_averages
        return plain, t[:, None] * plain + fade * self.odd_averages


AVERAGE_MIRROR_SIGNS = np.array([1.0, -1.0, 1.0])[:, None]


def compute_ball_waves(sphere: SphereArray, k: Array) -> BallWaves:
    """Compute the waves about the spheres for wave numbers k (n, q), 1/m."""
    s = k * sphere.radius[:, None]
    J0, J1 = bessel(s[:, None] * PAIR_RADII[:, None])
    raised, sunk = np.exp(s[:, None] * (PAIR_HEIGHTS - 1)[:, None]), np.exp(s[:, None] * (-PAIR_HEIGHTS - 1)[:, None])
    sums, differences = raised + sunk, raised - sunk
    averages = _AVERAGE_WEIGHTS @ np.concatenate([sums * J0, differences * J0, sums * J1, differences * J1], axis=1)
    return BallWaves(J0, J1, raised, sunk, averages[:, :3], s[:, None] * averages[:, 3:], s)


@dataclass(frozen=True)
class SphereWaves:
    """Moments of the strain about a sphere under waves of pressure and of shear, times 2 mu.

    Attributes
    ----------
    ball
        The factors of the waves at the points in the sphere.
    waves
        The waves in the layer that holds it.
    depth
        Of its centre below its layer's top, shape (n,).
    moments
        The first five under waves about the sphere's vertical axis; the next five under waves that go as cos about that axis, and
        the last as cos of twice the angle, from half-spaces or layers; two arrays (n, moments, q).
    turned
        All under waves of shear about the vertical, sin and sin of twice the angle, on a half-space, (n, moments, q), the first
        five zero; None on the probe's axis.
    """

    ball: BallWaves
    waves: Waves
    depth: Array
    moments: tuple[Array, Array]
    turned: Array | None


def compute_sphere_waves(sphere: SphereArray, waves: Waves, ball: BallWaves) -> SphereWaves:
    """Compute the moments about spheres, whose ``depth`` counts from the top of their layer, under waves in that layer."""
    k = waves.k
    t = k * sphere.depth[:, None]
    downward, upward = ball.average_downward(t), None if waves.depth is None else ball.average_upward(t, k * waves.depth)
    two_nu_minus_1, moments = (2 * waves.nu - 1)[:, :, None], []
    for load in (waves.by_pressure, waves.by_shear):
        rows = compute_strain_amplitudes([(k * part)[:, None] for part in load], downward, upward, two_nu_minus_1)
        moments.append(_stack_moments(rows, sphere.on_axis))
    return SphereWaves(
        ball, waves, sphere.depth, (moments[0], moments[1]), None if sphere.on_axis else _compute_turned_moments(downward[0])
    )


def _stack_moments(strain: tuple[Array, Array, Array], on_axis: bool) -> Array:
    """Stack the moments, shape (n, moments, q), from the averages (n, 3, q) of rr + hoop, zz and rz.

    The averages are those of ``BallWaves``: mean, vertical moment and radial moment. Off the axis, the amplitudes of waves as cos
    of once or twice the angle follow from the same averages.
    """
    a, zz, rz = strain
    rows = np.empty((len(a), AXIAL_MOMENTS if on_axis else ALL_MOMENTS, a.shape[2]), dtype=a.dtype)
    rows[:, 0:4:2], rows[:, 1:4:2], rows[:, 4] = a[:, :2], zz[:, :2], rz[:, 2]
    if not on_axis:
        np.multiply(rz[:, :2], -0.5, out=rows[:, 5:7])
        rows[:, 7], rows[:, 8] = a[:, 2], zz[:, 2]
        np.multiply(a[:, 2], 0.25, out=rows[:, 9])
        np.multiply(a[:, 0], -0.5, out=rows[:, 10])
    return rows


def _compute_turned_moments(plain: Array) -> Array:
    """Compute all moments under waves of shear about the vertical on a half-space, times 2 mu, shape (n, moments, q).

    They go as sin of the angle about the sphere's axis, the last as sin of twice the angle. ``plain`` are averages of e^-t, shape
    (n, 3, q).
    """
    rows = np.zeros((len(plain), ALL_MOMENTS, plain.shape[2]), dtype=plain.dtype)
    rows[:, 5:7], rows[:, 9], rows[:, 10] = plain[:, :2] / 2, plain[:, 2] / 2, -plain[:, 0]
    return rows


def compute_tissue_strain(sphere_waves: SphereWaves, loads: tuple[Array, Array], axis_distance: Array | None) -> Array:
    """Return the strains rr + hoop, rr - hoop, zz, rz at all points under l loads of pressure and of shear; (n, l, 4, points).

    At a height z above the centre, in radii, a wave has (A + A' z) e^sz of what runs down and (R + R' z) e^-sz of what runs up.

    Parameters
    ----------
    sphere_waves
        The waves at the spheres.
    loads
        Amplitudes of each wave under l loads, two arrays (n, l, q): of pressure and of shear at the surface, or, in a layer among
        others, of the downward waves at the layer's top.
    axis_distance
        Of ``OFF_AXIS_POINTS`` from the waves' axis, m, shape (n, points); None where that is the sphere's.
    """
    two_nu_minus_1 = 2 * sphere_waves.waves.nu[:, :, None] - 1
    (a, derivative, b), upward = _compute_running_waves(sphere_waves, loads)
    kinds = [[a, derivative, b], [a, derivative], [two_nu_minus_1 * b - a, -derivative]]
    if upward is not None:
        raised, rise, upward_b = upward
        kinds = [[*kinds[0], *upward], [*kinds[1], raised, rise], [*kinds[2], raised - two_nu_minus_1 * upward_b, rise]]
    n, count, _ = a.shape
    parts = []
    for waves, kind in zip(_iterate_bessel_factors(sphere_waves, axis_distance), kinds, strict=True):
        sums = np.concatenate(kind, axis=1) @ waves.swapaxes(1, 2)
        parts.append(np.moveaxis(sums.reshape(n, len(kind), count, 2, -1), 1, 0))
    z = (ON_AXIS_POINTS.z if axis_distance is None else OFF_AXIS_POINTS.z).reshape(2, -1)
    strain = np.empty((n, count, 4, 2, z.shape[1]), dtype=a.dtype)
    for place, part in ((0, parts[0]), (1, parts[1]), (3, parts[2])):
        strain[:, :, place] = part[0] + z * part[1]
    strain[:, :, 2] = 2 * two_nu_minus_1[:, :, None] * parts[0][2] - strain[:, :, 0]
    if upward is not None:
        for place, part, index in ((0, parts[0], 3), (1, parts[1], 2), (3, parts[2], 2)):
            # ::-1: e^(-s z) above the centre is e^(s z) below it
            risen = part[index, :, :, ::-1] + z * part[index + 1, :, :, ::-1]
            strain[:, :, place] += risen
            if place == 0:
                strain[:, :, 2] += 2 * two_nu_minus_1[:, :, None] * parts[0][5][:, :, ::-1] - risen
    return strain.reshape(n, count, 4, -1)


def _compute_running_waves(
    sphere_waves: SphereWaves, loads: tuple[Array, Array]
) -> tuple[tuple[Array, ...], tuple[Array, ...] | None]:
    """Return the amplitudes of ``compute_tissue_strain``, each of shape (n, l, q), under l loads.

    They are A, A' and c2 e^-t of downward waves, and R, R' and c4 e^(t-2x) of upward ones (eq. CF.6), times k; None in place of
    the latter on a half-space.
    """
    waves, size = sphere_waves.waves, sphere_waves.ball.size
    t = waves.k * sphere_waves.depth[:, None]
    sums = [
        (waves.k * p)[:, None] * loads[0] + (waves.k * q)[:, None] * loads[1]
        for p, q in zip(waves.by_pressure, waves.by_shear, strict=True)
    ]
    fade, t = np.exp(size - t)[:, None], t[:, None]
    b, size = fade * sums[1], size[:, None]
    downward = fade * sums[0] + t * b, -size * b, b
    if waves.depth is None:
        return downward, None
    rising_fade = np.exp(sphere_waves.ball.size - waves.k * (2 * waves.depth - sphere_waves.depth[:, None]))[:, None]
    upward_b = rising_fade * sums[3]
    return downward, (rising_fade * sums[2] - t * upward_b, size * upward_b, upward_b)


def _iterate_bessel_factors(sphere_waves: SphereWaves, axis_distance: Array | None) -> Iterator[Array]:
    """Yield J0, J0 - 2 J1/x and J1 at the points' distances from the waves' axis, times e^(s z - s), shapes (n, points, q).

    They are the factors of the strains rr + hoop, rr - hoop and rz; s = k R, and z is the height above the centre in radii.
    """
    ball = sphere_waves.ball
    if axis_distance is None:
        J0, J1, x = ball.J0[:, :, None], ball.J1[:, :, None], (ball.size[:, None] * PAIR_RADII[:, None])[:, :, None]
    else:
        r = axis_distance[:, : axis_distance.shape[1] // 2]  # the same above and below
        x = sphere_waves.waves.k[:, None] * r[:, :, None]
        J0, J1, x = (part.reshape(len(r), len(PAIR_RADII), -1, x.shape[2]) for part in (*bessel(x), x))
    for kind in (J0, J0 - 2 * J1 / x, J1):
        values = np.empty((len(x), 2, *x.shape[1:]), dtype=x.dtype)
        np.multiply(kind, ball.raised[:, :, None], out=values[:, 0])
        np.multiply(kind, ball.sunk[:, :, None], out=values[:, 1])
        yield values.reshape(len(x), -1, x.shape[3])
