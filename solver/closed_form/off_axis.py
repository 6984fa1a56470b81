"""Spheres beside the probe's axis: waves seen from there, and the blocks' tractions that are not symmetrical about the axis.

Graf's addition theorem (DLMF 10.23.7) tells what a wave J_m(kr) cos(m phi) about the probe's axis is about the sphere's, at a
distance d,

    J_m(kd) J_0 + [J_m-1 - J_m+1](kd) J_1 cos psi + [J_m-2 + J_m+2](kd) J_2 cos 2 psi + ...        (CF.17)

and J_m(kr) sin(m phi) is [J_m-1 + J_m+1](kd) J_1 sin psi + [J_m-2 - J_m+2](kd) J_2 sin 2 psi + ...

The blocks hold the surface for every m. Beyond the symmetrical tractions, which are solved for, they are taken as one disc of the
outer radius a that answers with pressure and shear, one independent of the other. Pressures on a disc have the transforms
j_l(ka), l = m, m+2, ..., whose waves cancel beyond it, and which are orthogonal in energy: Int j_l j_l' dk is zero and, for
l = l', pi / (2 a (2l+1)). With c the compliance in w = c p / k, of tissue and ends together, and h(k) the moments of the sphere
under the wave of a unit load, the disc answers with

    S = sum 2 a (2l+1) / (pi^2 c) v v^T,    v = Int h j_l(ka) k dk                                  (CF.18)

Shear along one direction has transforms of the same kind; waves n = 1, 2, ... of pressure's plane less those about the vertical
have m = n + 1, both added m = n - 1. Each counts half, and the compliance is the mean of both planes'.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver.closed_form.bessel import Array, bessel, spherical
from solver.closed_form.surface_images import MOMENTS, Nearby, SphereArray

ORDERS, DEGREE = 6, 8  # the largest n and l: fewer by two change the log-sensitivity of a sphere under the rim by up to 8 %


@dataclass(frozen=True)
class Disc:
    """The probe's end: outer radius, m, shape (n,), and c of eq. CF.18, tissue's and ends', under pressure and shear, m^2/N.

    On layers c has a value for each degree l, shape (n, degrees).
    """

    radius: Array
    pressed: Array
    sheared: Array


def shifted_waves(k: Array, offset: Array) -> Array:
    """By how much a wave Y_0 about the probe's axis is one of each moment of ``Nearby`` about the sphere's; (n, moments, q).

    Args:
        k: wave numbers, shape (n, q).
        offset: d, shape (n,).
    """
    J = bessel(k * offset[:, None], 3)
    return _rows(J[0], -2 * J[1], 2 * J[2])


def off_axis_response(
    sphere: SphereArray,
    near: Nearby,
    k: Array,
    weights: Array,
    *,
    disc: Disc,
    mu: Array,
    bonded: bool,
    orders: int = ORDERS,
    degree: int = DEGREE,
) -> Array:
    """Eq. CF.18: S, shape (n, moments, moments).

    Args:
        sphere: beside the axis.
        near: its moments under waves about its own axis.
        k: wave numbers, shape (n, q).
        weights: k dk, shape (n, q).
        disc: the probe's end.
        mu: shear modulus of the tissue, shape (n,).
        bonded: whether the disc takes shear, too.
        orders: the largest n.
        degree: the largest l.
    """
    J = bessel(k * sphere.offset[:, None], orders + 3)
    j = spherical(k * disc.radius[:, None], degree + 1) * (weights / (2 * mu)[:, None])  # the moments are times 2 mu
    j = np.moveaxis(j, 0, 2) * np.sqrt((2 * np.arange(degree + 1) + 1) / np.pi**2)
    columns = []
    for n in range(1, orders + 1):
        less = -J[1] if n == 1 else J[n - 2]  # J_-1 = -J_1
        along = _rows(J[n], J[n - 1] - J[n + 1], less + J[n + 2])
        pressed = along * near.moments[0]
        columns.append((pressed @ j[:, :, n::2]) * np.sqrt(_share(2 * disc.radius, disc.pressed, n)))
        if bonded:
            sunk, turned = along * near.moments[1], _rows(0 * J[n], J[n - 1] + J[n + 1], less - J[n + 2]) * near.turned
            for wave, m in ((sunk - turned, n + 1), (sunk + turned, n - 1)):
                columns.append((wave @ j[:, :, m::2]) * np.sqrt(_share(disc.radius, disc.sheared, m)))
    v = np.concatenate(columns, axis=2)
    return v @ np.swapaxes(v, 1, 2)


def _share(radius: Array, compliance: Array, least: int) -> Array:
    """Radius over compliance for degrees ``least``, ``least`` + 2, ..., or one for all; shape (n, 1, degrees or 1)."""
    return (radius[:, None] / (compliance[:, None] if compliance.ndim == 1 else compliance[:, least::2]))[:, None]


def _rows(symmetrical: Array, once: Array, twice: Array) -> Array:
    """One row for each moment: five are symmetrical about the sphere's axis, five go with the angle, one with twice the angle."""
    return np.stack([symmetrical] * MOMENTS + [once] * MOMENTS + [twice], axis=1)
