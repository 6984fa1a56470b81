"""What a sphere in the tissue changes of the compliance under the blocks' tractions: equivalent inclusion with its own image.

By Betti and Eshelby a sphere of volume V with strengths k_v, k_d (eq. (E2) of ``eshelby``) changes the work of two loads by

    dC_ij = -Int [(k_v - k_d/3) tr(eps_i) tr(eps_j) + k_d eps_i : eps_j] dV                       (I1)

over the tissue's strains without it. Near the surface it answers to its own image too. With K what (I1) makes of
the moments e of the strain, V e.K e, and G the image, both as in ``closed_images``, K gives way to K~ of eq. (I2); what (I1)
has beyond those moments counts to first order.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver.bessel import Array
from solver.closed_images import ASIDE, MOMENTS, NEAR, RHO, TO_MOMENTS, TURNS, WHICH, Sphere, fields, image_of, wavelets
from solver.closed_layer import Waves, amplitudes
from solver.closed_sides import Sides
from solver.eshelby import strengths


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


def change(
    sphere: Sphere, waves: Waves, loads: tuple[Array, Array], weights: Array, E: Array, nu: Array, sides: Sides | None = None
) -> Change:
    """Return what spheres in tissue of modulus E and Poisson's ratio nu change under loads.

    Args:
        sphere: where and what.
        waves: of the tissue.
        loads: transforms of pressures and of shears, shapes (n, q, m) each; m loads have one or the other.
        weights: k dk of the waves, shape (n, q).
        E: of the tissue, shape (n,).
        nu: of the tissue, shape (n,).
        sides: of the tissue, where they are near.
    """
    size = sphere.radius[:, None]
    parts = amplitudes(waves, sphere.depth[:, None] - size * NEAR.z)
    near = wavelets(waves.k, size * RHO, WHICH)
    alone = fields(parts, near)
    G = image_of(sphere, waves, parts, near, alone, weights, E / (2 * (1 + nu)), nu)
    scaled = (weights * ((1 + nu) / E)[:, None])[:, :, None]
    weighed = loads[0] * scaled, loads[1] * scaled
    if sphere.on_axis:
        strain = _strains(alone, weighed)
        if sides is not None:
            strain = strain + sides.strain(
                sphere.radius[:, None] * NEAR.x, sphere.depth[:, None] - sphere.radius[:, None] * NEAR.z
            )
        moments = TO_MOMENTS @ strain
    else:
        strain, moments = _aside(sphere, waves, parts, weighed, sides)
    return _change(sphere, strain, moments, G, E, nu)


def _strains(waves: tuple[Array, Array], weighed: tuple[Array, Array]) -> Array:
    """The same under the loads, shape (n, 4 points, m)."""
    return np.concatenate([field @ load for field, load in zip(waves, weighed, strict=True)], axis=2)


def _aside(
    sphere: Sphere, waves: Waves, parts: tuple[Array, Array], weighed: tuple[Array, Array], sides: Sides | None
) -> tuple[Array, Array]:
    """Strains at the points of a sphere beside the axis, shape (n, 4 points, m), and its seven moments, (n, 7, m)."""
    size = sphere.radius[:, None]
    across, aside = sphere.offset[:, None] + size * ASIDE.x, size * ASIDE.y
    r = np.sqrt(across**2 + aside**2)
    repeated = tuple(np.concatenate([part] * TURNS, axis=2) for part in parts)
    whole = _strains(fields(repeated, wavelets(waves.k, r)), weighed)  # type: ignore[arg-type]
    if sides is not None:
        whole = whole + sides.strain(r, sphere.depth[:, None] - size * ASIDE.z)
    strain = whole.reshape(len(r), 4, r.shape[1], -1)
    c, s = (across / r)[:, :, None], (aside / r)[:, :, None]
    both, zz, along = strain[:, 0], strain[:, 2], strain[:, 3] * c
    crossed, turned = strain[:, 1] * (c**2 - s**2), strain[:, 1] * 2 * c * s
    x, y, z, w = (part[:, None] for part in (ASIDE.x, ASIDE.y, ASIDE.z, ASIDE.weight))
    pairs = (
        (both, 1), (zz, 1), (both, 5 * z), (zz, 5 * z), (strain[:, 3] * (c * x + s * y), 2.5),
        (along, 1), (along, 5 * z), (both, 5 * x), (zz, 5 * x), (crossed * x + turned * y, 1.25), (crossed, 1),
    )  # fmt: skip
    return whole, np.stack([(w * times * part).sum(axis=1) for part, times in pairs], axis=1)


def _change(sphere: Sphere, strain: Array, moments: Array, G: Array, E: Array, nu: Array) -> Change:
    volume = (4 * np.pi / 3 * sphere.radius**3)[:, None, None]
    weight = (NEAR if sphere.on_axis else ASIDE).weight[:, None]
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
