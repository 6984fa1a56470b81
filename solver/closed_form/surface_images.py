"""The image of a sphere's own polarisation in the tissue's free surface, in moments of the strain.

Near the surface a sphere answers to the image of its own polarisation too. Let e be the moments of the strain that matter: about
the sphere's vertical axis the means of a = xx+yy and of zz, their first moments along the vertical, that of the radial shear rz;
beside the probe's axis also the mean of xz and its moment along the vertical, the moments of a, zz and the shear in the plane
along x, and the mean of xx-yy. With g(k) the moments under a wave of pressure or of shear on a half-space, V the sphere's volume
and K the form that eq. CF.13 becomes on e, V e.K e, the image in the free surface is

    G = V / (2 pi) Int 2 mu k / (4 (1-nu)) (g_p g_p + g_s g_s) k dk,     K~ = K (1 + G K)^-1        (CF.15)

as the field that the sphere sends up meets the compliance of the half-spaces above and below, together 4 (1-nu) / (2 mu k) for
both kinds of wave, where below the surface only one is left. For the moments with xz waves go as cos, with 1 / pi in place of
1 / (2 pi), and there is a third kind, of shear about the vertical, with 2 / (mu k). For the mean of xx-yy, with t = R/d,

    G = t^3 / (12 (1-nu) mu) [3/4 - nu/2 + nu^2 - 0.6 (1/2 + nu) t^2 + 0.225 t^4]                   (CF.16)

which is Mindlin's solution (Physics 7 (1936) 195), differentiated twice and averaged over the sphere; so are those of eq. CF.15.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from solver.closed_form.bessel import Array, bessel
from solver.closed_form.layer import Waves, strain_amplitudes

MOMENTS, ALL = 5, 11  # about the sphere's vertical axis: a, z, a zeta, z zeta, rz rho; and xz, xz zeta, a x, z x, tau; xx - yy


@dataclass(frozen=True)
class SphereArray:
    """Spheres: radius, depth of the centre, distance from the probe's axis, modulus, Poisson's ratio; arrays of shape (n,).

    ``layer`` counts the tissue's layers down to the one that holds them.
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


def points(turns: Any) -> BallQuadrature:
    """Build a quadrature of the unit ball: Gauss in radius cubed and cosine of the polar angle, midpoints in the azimuth.

    The order is: above before below the centre, the pairs of ``PAIR_RADII`` and ``PAIR_HEIGHTS``, the azimuths ``turns`` (rad).
    """
    x, z, weight = (one[:, None] for one in (ACROSS, RISE, WEIGHT))
    sign, turn = np.array([1.0, -1.0])[:, None, None], np.asarray(turns)
    kinds = np.broadcast_arrays(x * np.cos(turn) + 0 * sign, x * np.sin(turn) + 0 * sign, z * sign, weight / len(turns))
    return BallQuadrature(*(kind.ravel() for kind in kinds))


def _pairs() -> tuple[Any, Any, Any]:
    """Return distances from the vertical axis, heights above and below the centre, and weights of pairs of points (4,)."""
    cubes, cube_weights = np.polynomial.legendre.leggauss(2)
    cosines, cosine_weights = (part[2:] for part in np.polynomial.legendre.leggauss(4))
    rho, c = np.meshgrid(np.cbrt((cubes + 1) / 2), cosines, indexing="ij")
    return (rho * np.sqrt(1 - c**2)).ravel(), (rho * c).ravel(), np.outer(cube_weights, cosine_weights).ravel() / 4


TURNS = 3
ACROSS, RISE, WEIGHT = _pairs()
NEAR, ASIDE = points(np.zeros(1)), points((np.arange(TURNS) + 0.5) * np.pi / TURNS)


def _moment_weights() -> Any:
    """Build the matrix from strains in a vertical half-plane to the five moments about the sphere's axis, shape (5, 4 points)."""
    w, none = NEAR.weight, 0 * NEAR.weight
    rows = [(w, 0), (w, 2), (5 * w * NEAR.z, 0), (5 * w * NEAR.z, 2), (2.5 * w * NEAR.x, 3)]
    return np.array([np.concatenate([weight if i == which else none for i in range(4)]) for weight, which in rows])


TO_MOMENTS = _moment_weights()


def _average_weights() -> Any:
    """Build the matrix from even and odd parts times J0 and J1 at the pairs of points to the averages of ``BallWaves``."""
    w, x, z, none = WEIGHT, ACROSS, RISE, 0 * WEIGHT
    even = [(w, none, none, none), (none, 5 * w * z, none, none), (none, none, 2.5 * w * x, none)]
    odd = [(none, w * z, none, none), (5 * w * z * z, none, none, none), (none, none, none, 2.5 * w * x * z)]
    return np.array([np.concatenate(row) for row in even + odd])


_AVERAGES = _average_weights()


@dataclass(frozen=True)
class BallWaves:
    """Waves about the vertical axis of spheres, in whatever depth; with s = k R, all but J0 and J1 times e^-s.

    Attributes:
        J0, J1: Bessel functions at ``PAIR_RADII``, shape (n, 4, q).
        raised, sunk: e^(s z) and e^(-s z) at the heights z of ``PAIR_HEIGHTS``, shape (n, 4, q).
        even_averages: mean and vertical moment of J0 e^(s z), and radial moment of J1 e^(s z), shape (n, 3, q).
        odd_averages: the same of J0 and J1 times s z e^(s z).
        size: s, shape (n, q).
    """

    zero: Array
    one: Array
    raised: Array
    sunk: Array
    even: Array
    odd: Array
    size: Array

    def down(self, way: Array) -> tuple[Array, Array]:
        """Return averages of e^-t and t e^-t, where t is ``way`` (n, q) at the centre and decreases upwards; two (n, 3, q)."""
        fade, way = np.exp(self.size - way)[:, None], way[:, None]
        plain = fade * self.even
        return plain, way * plain - fade * self.odd

    def up(self, way: Array, across: Array) -> tuple[Array, Array]:
        """Return averages of e^(t - 2x) and t e^(t - 2x), t as for downward waves, x = ``across`` = k times thickness (n, q)."""
        fade, way = MIRROR * np.exp(self.size + way - 2 * across)[:, None], way[:, None]
        plain = fade * self.even
        return plain, way * plain + fade * self.odd


MIRROR = np.array([1.0, -1.0, 1.0])[:, None]


def ball_waves(sphere: SphereArray, k: Array) -> BallWaves:
    """Compute the waves about the spheres for wave numbers k (n, q), 1/m."""
    s = k * sphere.radius[:, None]
    zero, one = bessel(s[:, None] * ACROSS[:, None])
    raised, sunk = np.exp(s[:, None] * (RISE - 1)[:, None]), np.exp(s[:, None] * (-RISE - 1)[:, None])
    even, odd = raised + sunk, raised - sunk
    averages = _AVERAGES @ np.concatenate([even * zero, odd * zero, even * one, odd * one], axis=1)
    return BallWaves(zero, one, raised, sunk, averages[:, :3], s[:, None] * averages[:, 3:], s)


@dataclass(frozen=True)
class Nearby:
    """Moments of the strain about a sphere under waves of pressure and of shear, times 2 mu.

    Attributes:
        ball: the waves at the sphere.
        waves: as they fade in its layer.
        depth: of its centre below its layer's top, shape (n,).
        moments: the first five under waves about the sphere's vertical axis; the next five under waves that go as cos about
            that axis, and the last as cos of twice the angle, from half-spaces or layers; two arrays (n, moments, q).
        turned: all under waves of shear about the vertical, sin and sin of twice the angle, on a half-space, (n, moments, q), the
            first five zero; None on the probe's axis.
    """

    ball: BallWaves
    waves: Waves
    depth: Array
    moments: tuple[Array, Array]
    turned: Array | None


def nearby(sphere: SphereArray, waves: Waves) -> Nearby:
    """Compute the moments about spheres under waves of the tissue."""
    k, ball = waves.k, ball_waves(sphere, waves.k)
    way = k * sphere.depth[:, None]
    down, up = ball.down(way), None if waves.depth is None else ball.up(way, k * waves.depth)
    even, moments = (2 * waves.nu - 1)[:, :, None], []
    for load in (waves.by_pressure, waves.by_shear):
        rows = strain_amplitudes([(k * part)[:, None] for part in load], down, up, even)
        moments.append(_moments(rows, sphere.on_axis))
    return Nearby(ball, waves, sphere.depth, (moments[0], moments[1]), None if sphere.on_axis else _turned(down[0]))


def half_space_moments(ball: BallWaves, way: Array, nu: Array, on_axis: bool) -> tuple[tuple[Array, Array], Array | None]:
    """Compute ``moments`` and ``turned`` of ``SphereWaves`` on half-spaces; ``way`` is k times the depth, (n, q)."""
    down, even, one = ball.down(way), (1 - 2 * nu)[:, None, None], np.ones(1)
    loads = ((-even, one), (1 + even, -one))
    pressed, sheared = (_moments(strain_amplitudes(load, down, None, -even), on_axis) for load in loads)
    return (pressed, sheared), None if on_axis else _turned(down[0])


def _moments(strain: tuple[Array, Array, Array], on_axis: bool) -> Array:
    """Stack the moments from the averages (n, 3, q) of rr + hoop, zz and rz, shape (n, moments, q)."""
    a, zz, rz = strain
    rows = np.empty((len(a), MOMENTS if on_axis else ALL, a.shape[2]), dtype=a.dtype)
    rows[:, 0:4:2], rows[:, 1:4:2], rows[:, 4] = a[:, :2], zz[:, :2], rz[:, 2]
    if not on_axis:
        np.multiply(rz[:, :2], -0.5, out=rows[:, 5:7])
        rows[:, 7], rows[:, 8] = a[:, 2], zz[:, 2]
        np.multiply(a[:, 2], 0.25, out=rows[:, 9])
        np.multiply(a[:, 0], -0.5, out=rows[:, 10])
    return rows


def _turned(plain: Array) -> Array:
    """Compute all moments under waves of shear about the vertical on a half-space, as sin, the last as sin 2, times 2 mu."""
    rows = np.zeros((len(plain), ALL, plain.shape[2]), dtype=plain.dtype)
    rows[:, 5:7], rows[:, 9], rows[:, 10] = plain[:, :2] / 2, plain[:, 2] / 2, -plain[:, 0]
    return rows


def tissue_strain(near: Nearby, loads: tuple[Array, Array], beside: Array | None) -> Array:
    """Return the strains rr + hoop, rr - hoop, zz, rz at all points under l loads of pressure and of shear; (n, l, 4, points).

    At a height z above the centre, in radii, a wave has (A + A' z) e^sz of what runs down and (R + R' z) e^-sz of what runs up.

    Args:
        sphere_waves: the waves.
        loads: so much of each wave, two arrays (n, l, q); in ``waves`` inside layers, of what runs down at the top of its layer.
        axis_distance: of ``OFF_AXIS_POINTS`` from the waves' axis, m, shape (n, points); None where that is the sphere's.
    """
    even = 2 * near.waves.nu[:, :, None] - 1
    (a, slope, b), up = _running(near, loads)
    kinds = [[a, slope, b], [a, slope], [even * b - a, -slope]]
    if up is not None:
        raised, rise, other = up
        kinds = [[*kinds[0], *up], [*kinds[1], raised, rise], [*kinds[2], raised - even * other, rise]]
    n, count, _ = a.shape
    parts = []
    for waves, kind in zip(_circles(near, beside), kinds, strict=True):
        sums = np.concatenate(kind, axis=1) @ waves.swapaxes(1, 2)
        parts.append(np.moveaxis(sums.reshape(n, len(kind), count, 2, -1), 1, 0))
    z = (NEAR.z if beside is None else ASIDE.z).reshape(2, -1)
    strain = np.empty((n, count, 4, 2, z.shape[1]), dtype=a.dtype)
    for place, part in ((0, parts[0]), (1, parts[1]), (3, parts[2])):
        strain[:, :, place] = part[0] + z * part[1]
    strain[:, :, 2] = 2 * even[:, :, None] * parts[0][2] - strain[:, :, 0]
    if up is not None:
        for place, part, at in ((0, parts[0], 3), (1, parts[1], 2), (3, parts[2], 2)):
            risen = part[at, :, :, ::-1] + z * part[at + 1, :, :, ::-1]
            strain[:, :, place] += risen
            if place == 0:
                strain[:, :, 2] += 2 * even[:, :, None] * parts[0][5][:, :, ::-1] - risen
    return strain.reshape(n, count, 4, -1)


def _running(near: Nearby, loads: tuple[Array, Array]) -> tuple[tuple[Array, ...], tuple[Array, ...] | None]:
    """Return A, A' and the part of c2 e^-t alone of downward waves, and R, R' and the part of c4 of upward ones, (n, l, q)."""
    waves, size = near.waves, near.ball.size
    way = waves.k * near.depth[:, None]
    sums = [
        (waves.k * p)[:, None] * loads[0] + (waves.k * q)[:, None] * loads[1]
        for p, q in zip(waves.by_pressure, waves.by_shear, strict=True)
    ]
    fade, way = np.exp(size - way)[:, None], way[:, None]
    b, size = fade * sums[1], size[:, None]
    down = fade * sums[0] + way * b, -size * b, b
    if waves.depth is None:
        return down, None
    back = np.exp(near.ball.size - waves.k * (2 * waves.depth - near.depth[:, None]))[:, None]
    other = back * sums[3]
    return down, (back * sums[2] - way * other, size * other, other)


def _circles(near: Nearby, beside: Array | None) -> Iterator[Array]:
    """Yield J0, J0 - 2 J1/x and J1 at the points' distances from the waves' axis, times e^(s z - s), shapes (n, points, q)."""
    ball = near.ball
    if beside is None:
        zero, one, x = ball.zero[:, :, None], ball.one[:, :, None], (ball.size[:, None] * ACROSS[:, None])[:, :, None]
    else:
        r = beside[:, : beside.shape[1] // 2]  # the same above and below
        x = near.waves.k[:, None] * r[:, :, None]
        zero, one, x = (part.reshape(len(r), len(ACROSS), -1, x.shape[2]) for part in (*bessel(x), x))
    for kind in (zero, zero - 2 * one / x, one):
        found = np.empty((len(x), 2, *x.shape[1:]), dtype=x.dtype)
        np.multiply(kind, ball.raised[:, :, None], out=found[:, 0])
        np.multiply(kind, ball.sunk[:, :, None], out=found[:, 1])
        yield found.reshape(len(x), -1, x.shape[3])


def image(sphere: SphereArray, waves: Waves, near: Nearby, weights: Array, *, mu: Array, nu: Array) -> Array:
    """Compute the image G (eqs. CF.15, CF.16) for spheres in half-spaces of shear modulus mu and Poisson's ratio nu (n,).

    Its shape is (n, moments, moments). ``weights`` are k dk of the waves, shape (n, q).
    """
    volume = 4 * np.pi / 3 * sphere.radius**3
    up = weights * waves.k * (volume / (16 * np.pi * (1 - nu) * mu))[:, None]  # the fields are times 2 mu
    if near.turned is None:
        return _gram(near.moments[0], up) + _gram(near.moments[1], up)
    G = np.zeros((len(mu), ALL, ALL), dtype=up.dtype)
    beside = slice(MOMENTS, ALL - 1)
    for g in near.moments:
        G[:, :MOMENTS, :MOMENTS] = G[:, :MOMENTS, :MOMENTS] + _gram(g[:, :MOMENTS], up)
        G[:, beside, beside] = G[:, beside, beside] + _gram(g[:, beside], 2 * up)
    G[:, beside, beside] = G[:, beside, beside] + _gram(near.turned[:, beside], 4 * (1 - nu)[:, None] * up / 2)
    G[:, -1, -1] = crossed_image(sphere, mu, nu)
    return G


def crossed_image(sphere: SphereArray, mu: Array, nu: Array) -> Array:
    """Compute the image of the mean of xx-yy, eq. CF.16, shape (n,)."""
    share = (sphere.radius / sphere.depth) ** 2
    crossed = 0.75 - nu / 2 + nu**2 - 0.6 * (0.5 + nu) * share + 0.225 * share**2
    return share**1.5 / (12 * (1 - nu) * mu) * crossed


def _gram(g: Array, weight: Array) -> Array:
    return (g * weight[:, None, :]) @ g.swapaxes(1, 2)
