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

from dataclasses import dataclass
from typing import Any

import numpy as np

from solver.closed_form.bessel import Array, bessel
from solver.closed_form.layer import Waves, amplitudes

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
    """Gauss in the cube of the radius and the cosine of the polar angle, midpoints in the azimuth."""
    cubes, cube_weights = np.polynomial.legendre.leggauss(2)
    cosines, cosine_weights = np.polynomial.legendre.leggauss(4)
    turn, rho, c = np.meshgrid(turns, np.cbrt((cubes + 1) / 2), cosines, indexing="ij")
    weight = cube_weights[:, None] * cosine_weights / 4 / len(turns) + 0 * rho
    across = rho * np.sqrt(1 - c**2)
    return BallQuadrature((across * np.cos(turn)).ravel(), (across * np.sin(turn)).ravel(), (rho * c).ravel(), weight.ravel())


TURNS = 3
NEAR, ASIDE = points(np.zeros(1)), points((np.arange(TURNS) + 0.5) * np.pi / TURNS)


@dataclass(frozen=True)
class Wavelets:
    """J0, J0 - 2 J1/x and J1 at some points, shape (n, points, q)."""

    zero: Array
    turn: Array
    one: Array


def wavelets(k: Array, r: Array, which: Any = slice(None)) -> Wavelets:
    """Return them at x = k r for distances r (n, p) from the waves' axis, some of them repeated."""
    x = k[:, None, :] * r[:, :, None]
    zero, one = bessel(x)
    return Wavelets(zero[:, which], (zero - 2 * one / x)[:, which], one[:, which])


def fields(parts: tuple[Array, Array], at: Wavelets) -> tuple[Array, Array]:
    """Strains rr + hoop, rr - hoop, zz, rz at all points under waves of pressure and of shear, times 2 mu; (n, 4 points, q)."""
    strains = []
    for part in parts:
        strain = np.empty((len(part), 4, *at.zero.shape[1:]), dtype=part.dtype)
        for row, (which, wave) in enumerate(((0, at.zero), (0, at.turn), (1, at.zero), (2, at.one))):
            np.multiply(part[:, which], wave, out=strain[:, row])
        strains.append(strain.reshape(len(part), -1, part.shape[-1]))
    return strains[0], strains[1]


def _moment_weights() -> Any:
    """The matrix from strains on the sphere's own axis to the first five moments, shape (5, 4 points)."""
    w, none = NEAR.weight, 0 * NEAR.weight
    rows = [(w, 0), (w, 2), (5 * w * NEAR.z, 0), (5 * w * NEAR.z, 2), (2.5 * w * NEAR.x, 3)]
    return np.array([np.concatenate([weight if i == which else none for i in range(4)]) for weight, which in rows])


TO_MOMENTS = _moment_weights()
RHO, WHICH = np.unique(np.round(NEAR.x, 12), return_inverse=True)


@dataclass(frozen=True)
class Nearby:
    """What waves do to a sphere: strains at the points of ``NEAR`` and moments, under waves of pressure and of shear, times 2 mu.

    Attributes:
        at: the waves at the points.
        parts: ``layer.amplitudes`` at the points' depths, under waves of pressure and of shear.
        strain: under waves about the sphere's vertical axis, two arrays (n, 4 points, q).
        moments: the first five under the same; the next five under waves that go as cos about that axis, and the last as cos of
            twice the angle, from half-spaces or layers; two arrays (n, moments, q).
        turned: all under waves of shear about the vertical, sin and sin of twice the angle, on a half-space, (n, moments, q), the
            first five zero; None on the probe's axis.
    """

    at: Wavelets
    parts: tuple[Array, Array]
    strain: tuple[Array, Array]
    moments: tuple[Array, Array]
    turned: Array | None


def nearby(sphere: SphereArray, waves: Waves) -> Nearby:
    """Return strains and moments of spheres under waves of the tissue."""
    parts = amplitudes(waves, sphere.depth[:, None] - sphere.radius[:, None] * NEAR.z)
    near = wavelets(waves.k, sphere.radius[:, None] * RHO, WHICH)
    strain = fields(parts, near)
    first = tuple(TO_MOMENTS @ field for field in strain)
    if sphere.on_axis:
        return Nearby(near, parts, strain, first, None)
    moments = (np.concatenate([one, _sideways(part, near)], axis=1) for one, part in zip(first, parts, strict=True))
    return Nearby(near, parts, strain, tuple(moments), _turned(waves, sphere, near))  # type: ignore[arg-type]


def half_space_moments(sphere: SphereArray, k: Array, nu: Array, near: Wavelets) -> tuple[tuple[Array, Array], Array | None]:
    """Return the moments and what is ``turned`` of ``Nearby`` on half-spaces, where all strains are e^-t and t e^-t."""
    t = k[:, None, :] * (sphere.depth[:, None] - sphere.radius[:, None] * NEAR.z)[:, :, None]
    fade, even = np.exp(-t), (1 - 2 * nu)[:, None]
    plain, times = _averages(fade, near), _averages(t * fade, near)
    pressed = _combined(plain, times, ((-even, 1), (-even, -1), (0, -1)), sphere.on_axis)
    sheared = _combined(plain, times, ((1 + even, -1), (even - 1, 1), (-1, 1)), sphere.on_axis)
    if sphere.on_axis:
        return (pressed, sheared), None
    none, (mean, along, slide) = 0 * k, plain
    return (pressed, sheared), np.stack([none] * MOMENTS + [mean / 2, along / 2, none, none, slide / 2, -mean], axis=1)


def _averages(amplitude: Array, near: Wavelets) -> tuple[Array, Array, Array]:
    """Mean and moment along the vertical of what goes with J0, radial moment of what goes with J1; shapes (n, q)."""
    w, z, x = NEAR.weight, NEAR.z, NEAR.x
    even = np.stack([w, 5 * w * z]) @ (amplitude * near.zero)
    return even[:, 0], even[:, 1], (2.5 * w * x) @ (amplitude * near.one)


def _combined(plain: tuple[Array, ...], times: tuple[Array, ...], strains: Any, on_axis: bool) -> Array:
    """Moments where a, zz and rz, ``strains``, are so many e^-t and t e^-t, whose averages are given."""
    a, zz, rz = ([e * one + t * other for one, other in zip(plain, times, strict=True)] for e, t in strains)
    rows = [a[0], zz[0], a[1], zz[1], rz[2]]
    if not on_axis:
        rows += [-rz[0] / 2, -rz[1] / 2, a[2], zz[2], a[2] / 4, -a[0] / 2]
    return np.stack(rows, axis=1)


def image(sphere: SphereArray, waves: Waves, near: Nearby, weights: Array, *, mu: Array, nu: Array) -> Array:
    """Eqs. CF.15, CF.16: G for spheres in half-spaces of shear modulus mu and Poisson's ratio nu (n,).

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
    """Eq. CF.16, shape (n,)."""
    share = (sphere.radius / sphere.depth) ** 2
    crossed = 0.75 - nu / 2 + nu**2 - 0.6 * (0.5 + nu) * share + 0.225 * share**2
    return share**1.5 / (12 * (1 - nu) * mu) * crossed


def _gram(g: Array, weight: Array) -> Array:
    return (g * weight[:, None, :]) @ np.swapaxes(g, 1, 2)


def _sideways(part: Array, near: Wavelets) -> Array:
    """Moments (xz, xz zeta, a x, z x, tau) under J1 cos of pressure or shear, xx - yy under J2 cos 2, times 2 mu; (n, 6, q)."""
    w, z, x = NEAR.weight, NEAR.z, NEAR.x
    level, along, across = -part[:, 2] * near.zero / 2, part[:, 0] * near.one, part[:, 1] * near.one
    rows = (w @ level, (5 * w * z) @ level, (2.5 * w * x) @ along, (2.5 * w * x) @ across, (0.625 * w * x) @ along)
    return np.stack((*rows, -w @ (part[:, 0] * near.zero) / 2), axis=1)


def _turned(waves: Waves, sphere: SphereArray, near: Wavelets) -> Array:
    """All moments under waves of shear about the vertical on a half-space, J1 sin and, the last, J2 sin 2, times 2 mu."""
    w, z, x = NEAR.weight, NEAR.z, NEAR.x
    down = np.exp(-waves.k[:, None, :] * (sphere.depth[:, None] - sphere.radius[:, None] * z)[:, :, None])
    level, none = down * near.zero, 0 * waves.k
    rows = (w @ level / 2, (2.5 * w * z) @ level, none, none, (1.25 * w * x) @ (down * near.one), -w @ level)
    return np.stack([none] * MOMENTS + list(rows), axis=1)
