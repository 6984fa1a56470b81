"""What a sphere in the tissue changes of the compliance under the blocks' tractions: equivalent inclusion with its own image.

By Betti and Eshelby a sphere of volume V with strengths k_v, k_d (eq. (E2) of ``eshelby``) changes the work of two loads by

    dC_ij = -Int [(k_v - k_d/3) tr(eps_i) tr(eps_j) + k_d eps_i : eps_j] dV                       (I1)

over the tissue's strains without it. Near the surface it answers to the image of its own polarisation too. Let e be the
moments of the strain that matter: about the sphere's vertical axis the mean and the first moment along the vertical of
xx+yy and zz and the first moment of the radial shear, and the means of xx-yy and xz; V e.K e is what (I1) makes of them. With
g(k) the moments under a wave of pressure or of shear on a half-space, the image in the free surface is

    G = V / (2 pi) Int 2 mu k / (4 (1-nu)) (g_p g_p + g_s g_s) k dk,     K~ = K (1 + G K)^-1        (I2)

as the field that the sphere sends up meets the compliance of the half-spaces above and below, together 4 (1-nu) / (2 mu k) for
both kinds of wave, where below the surface only one is left. For the means of xx-yy and xz, with t = R/d,

    G_dd = t^3 / (12 (1-nu) mu) [3/4 - nu/2 + nu^2 - 0.6 (1/2 + nu) t^2 + 0.225 t^4],
    G_xz = t^3 / (12 (1-nu) mu) [5/8 - nu/8 - 0.6 t^2 + 0.225 t^4]                                 (I3)

which is Mindlin's solution (Physics 7 (1936) 195), differentiated twice and averaged over the sphere.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from solver.bessel import Array, bessel
from solver.closed_layer import Waves, amplitudes
from solver.eshelby import strengths

MOMENTS, ALL = 5, 11  # about the sphere's vertical axis: a, z, a zeta, z zeta, rz rho; and xz, xz zeta, a x, z x, tau; xx - yy


@dataclass(frozen=True)
class Sphere:
    """Spheres: radius, depth of the centre, distance from the probe's axis, modulus, Poisson's ratio; arrays of shape (n,).

    ``reach`` is the probe's outer radius.
    """

    radius: Array
    depth: Array
    offset: Array
    E: Array
    nu: Array
    reach: Array
    on_axis: bool = True


@dataclass(frozen=True)
class Change:
    """What a sphere changes of the loads' works, shapes (n, m, m), each with its derivative by ln E of the sphere.

    Attributes:
        main, main_slope: by the moments of eq. (I2).
        rest, rest_slope: by what eq. (I1) has beyond them, to first order.
    """

    main: Array
    main_slope: Array
    rest: Array
    rest_slope: Array


def change(sphere: Sphere, waves: Waves, loads: tuple[Array, Array], weights: Array, E: Array, nu: Array) -> Change:
    """Return what spheres in tissue of modulus E and Poisson's ratio nu change under loads.

    Args:
        sphere: where and what.
        waves: of the tissue.
        loads: transforms of pressures and of shears, shapes (n, q, m) each; m loads have one or the other.
        weights: k dk of the waves, shape (n, q).
        E: of the tissue, shape (n,).
        nu: of the tissue, shape (n,).
    """
    parts = amplitudes(waves, sphere.depth[:, None] - sphere.radius[:, None] * _NEAR.z)
    near = _wavelets(waves.k, sphere.radius[:, None] * _RHO, _WHICH)
    G = _image(sphere, waves, parts, near, weights, E / (2 * (1 + nu)), nu)
    scaled = (weights * ((1 + nu) / E)[:, None])[:, :, None]
    weighed = loads[0] * scaled, loads[1] * scaled
    if sphere.on_axis:
        strain = _strains(_fields(parts, near), weighed)
        moments = _MOMENTS @ strain
    else:
        strain, moments = _aside(sphere, waves, parts, weighed)
    return _change(sphere, strain, moments, G, E, nu)


@dataclass(frozen=True)
class _Points:
    """Quadrature of the unit ball: place (x, y across, z up) and weight of each point; weights add up to 1."""

    x: Any
    y: Any
    z: Any
    weight: Any


def _points(turns: Any) -> _Points:
    """Gauss in the cube of the radius and the cosine of the polar angle, midpoints in the azimuth."""
    cubes, cube_weights = np.polynomial.legendre.leggauss(2)
    cosines, cosine_weights = np.polynomial.legendre.leggauss(4)
    turn, rho, c = np.meshgrid(turns, np.cbrt((cubes + 1) / 2), cosines, indexing="ij")
    weight = cube_weights[:, None] * cosine_weights / 4 / len(turns) + 0 * rho
    across = rho * np.sqrt(1 - c**2)
    return _Points((across * np.cos(turn)).ravel(), (across * np.sin(turn)).ravel(), (rho * c).ravel(), weight.ravel())


TURNS = 3
_NEAR, _ASIDE = _points(np.zeros(1)), _points((np.arange(TURNS) + 0.5) * np.pi / TURNS)


@dataclass(frozen=True)
class Wavelets:
    """J0, J0 - 2 J1/x and J1 at some points, shape (n, points, q)."""

    zero: Array
    turn: Array
    one: Array


def _wavelets(k: Array, r: Array, which: Any = slice(None)) -> Wavelets:
    """Return them at x = k r for distances r (n, p) from the waves' axis, some of them repeated."""
    x = k[:, None, :] * r[:, :, None]
    zero, one = bessel(x)
    return Wavelets(zero[:, which], (zero - 2 * one / x)[:, which], one[:, which])


def _fields(parts: tuple[Array, Array], at: Wavelets) -> tuple[Array, Array]:
    """Strains rr + hoop, rr - hoop, zz, rz at all points under waves of pressure and of shear, times 2 mu; (n, 4 points, q)."""
    return tuple(  # type: ignore[return-value]
        np.concatenate([part[:, 0] * at.zero, part[:, 0] * at.turn, part[:, 1] * at.zero, part[:, 2] * at.one], axis=1)
        for part in parts
    )


def _strains(fields: tuple[Array, Array], weighed: tuple[Array, Array]) -> Array:
    """The same under the loads, shape (n, 4 points, m)."""
    return np.concatenate([field @ load for field, load in zip(fields, weighed, strict=True)], axis=2)


def _moment_weights() -> Any:
    """The matrix from strains on the sphere's own axis to the first five moments, shape (5, 4 points)."""
    w, none = _NEAR.weight, 0 * _NEAR.weight
    rows = [(w, 0), (w, 2), (5 * w * _NEAR.z, 0), (5 * w * _NEAR.z, 2), (2.5 * w * _NEAR.x, 3)]
    return np.array([np.concatenate([weight if i == which else none for i in range(4)]) for weight, which in rows])


_MOMENTS = _moment_weights()
_RHO, _WHICH = np.unique(np.round(_NEAR.x, 12), return_inverse=True)


def image(sphere: Sphere, waves: Waves, weights: Array, mu: Array, nu: Array) -> Array:
    """Eqs. (I2), (I3): G for spheres in tissue of shear modulus mu and Poisson's ratio nu (n,), shape (n, moments, moments).

    ``weights`` are k dk of the waves, shape (n, q).
    """
    parts = amplitudes(waves, sphere.depth[:, None] - sphere.radius[:, None] * _NEAR.z)
    return _image(sphere, waves, parts, _wavelets(waves.k, sphere.radius[:, None] * _RHO, _WHICH), weights, mu, nu)


def _image(
    sphere: Sphere, waves: Waves, parts: tuple[Array, Array], near: Wavelets, weights: Array, mu: Array, nu: Array
) -> Array:
    """Eqs. (I2), (I3): G, shape (n, moments, moments)."""
    volume = 4 * np.pi / 3 * sphere.radius**3
    up = weights * waves.k * (_uncovered(sphere) * volume / (16 * np.pi * (1 - nu) * mu))[:, None]  # the fields are times 2 mu
    size = MOMENTS if sphere.on_axis else ALL
    G = np.zeros((len(mu), size, size), dtype=up.dtype)
    for g in (_MOMENTS @ field for field in _fields(parts, near)):
        G[:, :MOMENTS, :MOMENTS] = G[:, :MOMENTS, :MOMENTS] + _gram(g, up)
    if not sphere.on_axis:
        for part in parts:
            G[:, MOMENTS:-1, MOMENTS:-1] = G[:, MOMENTS:-1, MOMENTS:-1] + _gram(_sideways(part, near), 2 * up)
        g = _sheared(waves, sphere, near)
        G[:, MOMENTS:-1, MOMENTS:-1] = G[:, MOMENTS:-1, MOMENTS:-1] + _gram(g, 4 * (1 - nu)[:, None] * up / 2)
        share = (sphere.radius / sphere.depth) ** 2
        turned = 0.75 - nu / 2 + nu**2 - 0.6 * (0.5 + nu) * share + 0.225 * share**2
        G[:, -1, -1] = _uncovered(sphere) * share**1.5 / (12 * (1 - nu) * mu) * turned
    return G


def _uncovered(sphere: Sphere) -> Array:
    """Share of the image that is left, eq. (I4): 1 - 0.55 * 16 y / (1 + 4 y)^2 with y = (offset / outer radius)^2.

    The blocks answer a sphere beside the axis with tractions that are not symmetrical about it, too; they take back part of the
    free surface's image. The tractions solved for are symmetrical: this stands for the others.
    """
    y = (sphere.offset / sphere.reach) ** 2
    return 1 - 8.8 * y / (1 + 4 * y) ** 2


def _gram(g: Array, weight: Array) -> Array:
    return (g * weight[:, None, :]) @ np.swapaxes(g, 1, 2)


def _sideways(part: Array, near: Wavelets) -> Array:
    """Moments (xz, xz zeta, a x, z x, tau) under a wave J_1 cos of pressure or shear, times 2 mu; shape (n, 5, q)."""
    w, z, x = _NEAR.weight, _NEAR.z, _NEAR.x
    level, along, across = -part[:, 2] * near.zero / 2, part[:, 0] * near.one, part[:, 1] * near.one
    rows = (w @ level, (5 * w * z) @ level, (2.5 * w * x) @ along, (2.5 * w * x) @ across, (0.625 * w * x) @ along)
    return np.stack(rows, axis=1)


def _sheared(waves: Waves, sphere: Sphere, near: Wavelets) -> Array:
    """The same under a wave of shear that turns about the vertical, on a half-space."""
    w, z, x = _NEAR.weight, _NEAR.z, _NEAR.x
    down = np.exp(-waves.k[:, None, :] * (sphere.depth[:, None] - sphere.radius[:, None] * z)[:, :, None])
    level, none = -down * near.zero / 2, 0 * waves.k
    return np.stack((w @ level, (5 * w * z) @ level, none, none, -(1.25 * w * x) @ (down * near.one)), axis=1)


def _aside(sphere: Sphere, waves: Waves, parts: tuple[Array, Array], weighed: tuple[Array, Array]) -> tuple[Array, Array]:
    """Strains at the points of a sphere beside the axis, shape (n, 4 points, m), and its seven moments, (n, 7, m)."""
    size = sphere.radius[:, None]
    across, aside = sphere.offset[:, None] + size * _ASIDE.x, size * _ASIDE.y
    r = np.sqrt(across**2 + aside**2)
    repeated = tuple(np.concatenate([part] * TURNS, axis=2) for part in parts)
    whole = _strains(_fields(repeated, _wavelets(waves.k, r)), weighed)  # type: ignore[arg-type]
    strain = whole.reshape(len(r), 4, r.shape[1], -1)
    c, s = (across / r)[:, :, None], (aside / r)[:, :, None]
    both, zz, along = strain[:, 0], strain[:, 2], strain[:, 3] * c
    crossed, turned = strain[:, 1] * (c**2 - s**2), strain[:, 1] * 2 * c * s
    x, y, z, w = (part[:, None] for part in (_ASIDE.x, _ASIDE.y, _ASIDE.z, _ASIDE.weight))
    pairs = (
        (both, 1), (zz, 1), (both, 5 * z), (zz, 5 * z), (strain[:, 3] * (c * x + s * y), 2.5),
        (along, 1), (along, 5 * z), (both, 5 * x), (zz, 5 * x), (crossed * x + turned * y, 1.25), (crossed, 1),
    )  # fmt: skip
    return whole, np.stack([(w * times * part).sum(axis=1) for part, times in pairs], axis=1)


def _change(sphere: Sphere, strain: Array, moments: Array, G: Array, E: Array, nu: Array) -> Change:
    volume = (4 * np.pi / 3 * sphere.radius**3)[:, None, None]
    weight = (_NEAR if sphere.on_axis else _ASIDE).weight[:, None]
    points = len(weight)
    trace = strain[:, :points] + strain[:, 2 * points : 3 * points]
    traces = np.swapaxes(trace, 1, 2) @ (weight * trace)
    counts = np.concatenate([times * weight for times in (0.5, 0.5, 1.0, 2.0)])
    squares = np.swapaxes(strain, 1, 2) @ (counts * strain)
    turned = np.swapaxes(moments, 1, 2)
    strong, by_log = strengths(E, nu, sphere.E, sphere.nu)
    K, dK = (_forms(*k, moments.shape[1]) for k in (strong, by_log))
    right = np.linalg.solve(np.eye(K.shape[1]) + G @ K, np.eye(K.shape[1]) + 0 * K)  # (1 + G K)^-1

    def rest(k_v: Array, k_d: Array, form: Array) -> Array:
        return -volume * ((k_v - k_d / 3)[:, None, None] * traces + k_d[:, None, None] * squares - turned @ form @ moments)

    main, main_slope = K @ right, np.swapaxes(right, 1, 2) @ dK @ right
    return Change(
        -volume * (turned @ main @ moments), -volume * (turned @ main_slope @ moments), rest(*strong, K), rest(*by_log, dK)
    )


def _forms(k_v: Array, k_d: Array, size: int) -> Array:
    """K of eq. (I2): (I1) on the moments, shape (n, size, size)."""
    K = np.zeros((len(k_d), size, size), dtype=k_d.dtype)
    both = k_v - k_d / 3
    for start, times in ((0, 1.0), (2, 0.2), (7, 0.2))[: 2 if size == MOMENTS else 3]:  # the mean of zeta^2 is R^2 / 5
        K[:, start, start], K[:, start + 1, start + 1] = times * (both + k_d / 2), times * (both + k_d)
        K[:, start, start + 1] = K[:, start + 1, start] = times * both
    for i, times in ((4, 0.8), (5, 2.0), (6, 0.4), (9, 0.8), (10, 0.5))[: 1 if size == MOMENTS else 5]:
        K[:, i, i] = times * k_d
    return K
