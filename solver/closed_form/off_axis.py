"""Spheres off the probe's axis: waves about the sphere's own axis, and tractions that are not symmetrical about the probe's.

Graf's addition theorem (DLMF 10.23.7) expands a wave J_m(kr) cos(m phi) about the probe's axis in waves about the sphere's axis
at a distance d,

    J_m(kd) J_0 + [J_m-1 - J_m+1](kd) J_1 cos psi + [J_m-2 + J_m+2](kd) J_2 cos 2 psi + ...        (CF.17)

and J_m(kr) sin(m phi) is [J_m-1 + J_m+1](kd) J_1 sin psi + [J_m-2 - J_m+2](kd) J_2 sin 2 psi + ...

The blocks hold the surface for every m. Beyond the symmetrical tractions, which are solved for, they are taken as one disc of the
outer radius a that responds with pressure and shear, one independent of the other. Pressures on a disc have the transforms
j_l(ka), l = m, m+2, ..., whose waves cancel beyond it, and which are orthogonal in energy: Int j_l j_l' dk is zero and, for
l = l', pi / (2 a (2l+1)). With c the compliance in w = c p / k, of tissue and ends together, and h(k) the moments of the sphere
under the wave of a unit load, the disc responds with

    S = sum 2 a (2l+1) / (pi^2 c) v v^T,    v = Int h j_l(ka) k dk                                  (CF.18)

Shear along one direction has transforms of the same kind; waves n = 1, 2, ... of pressure's plane less those about the vertical
have m = n + 1, both added m = n - 1. Each counts half, and the compliance is the mean of both planes'.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from geometry.common.arrays import Ints
from solver.closed_form.bessel import Array, bessel, compute_spherical_bessel
from solver.closed_form.sphere_moments import ALL_MOMENTS, AXIAL_MOMENTS, SphereArray, SphereWaves

MAX_ORDER, MAX_DEGREE = 6, 8  # maximum n and l: two less change the log-sensitivity of a sphere under the rim by up to 8 %


@dataclass(frozen=True)
class Disc:
    """The probe's end: outer radius, m, shape (n,), and c of eq. CF.18, tissue's and ends', under pressure and shear, m^2/N.

    On layers c has a value for each degree l, shape (n, degrees).
    """

    radius: Array
    pressed: Array
    sheared: Array


def shift_waves(k: Array, offset: Array) -> Array:
    """Return the amplitudes, about the sphere's axis, of a wave J_0 about the probe's axis, eq. CF.17, shape (n, moments, q).

    There is a row for each moment of ``SphereWaves``: the factor by which that moment counts.

    Parameters
    ----------
    k
        Wave numbers, shape (n, q).
    offset
        d, shape (n,).
    """
    J = bessel(k * offset[:, None], 3)
    return _repeat_for_moments(J[0], -2 * J[1], 2 * J[2])


def compute_off_axis_response(
    sphere: SphereArray,
    sphere_waves: SphereWaves,
    k: Array,
    weights: Array,
    *,
    disc: Disc,
    mu: Array,
    bonded: bool,
    orders: int = MAX_ORDER,
    degree: int = MAX_DEGREE,
) -> Array:
    """Compute the response S of the blocks to an off-axis sphere, eq. CF.18, shape (n, moments, moments).

    Parameters
    ----------
    sphere
        Off the probe's axis.
    sphere_waves
        Its moments under waves about its own axis.
    k
        Wave numbers, shape (n, q).
    weights
        k dk, shape (n, q).
    disc
        The probe's end.
    mu
        Shear modulus of the tissue, shape (n, 1).
    bonded
        Whether the disc takes shear, too.
    orders
        The largest azimuthal order n of the waves about the probe's axis.
    degree
        The largest degree l of the pressures j_l.
    """
    J = bessel(k * sphere.offset[:, None], orders + 3)
    j = compute_spherical_bessel(k * disc.radius[:, None], degree + 1) * (weights / (2 * mu))  # the moments are times 2 mu
    j *= np.sqrt((2 * np.arange(degree + 1) + 1) / np.pi**2)[:, None, None]
    pairs = _build_pairs(orders, degree)
    # rows of moments by the parity of m + l of the products that they need
    p, (difference_waves, sum_waves) = sphere_waves.moments[0], _combine_shear(sphere_waves)
    even_rows = np.concatenate(
        [p[:, :AXIAL_MOMENTS], p[:, -1:], difference_waves[:, AXIAL_MOMENTS:-1], sum_waves[:, AXIAL_MOMENTS:-1]], axis=1
    )
    odd_rows = np.concatenate(
        [sphere_waves.moments[1][:, :AXIAL_MOMENTS], p[:, AXIAL_MOMENTS:-1], difference_waves[:, -1:], sum_waves[:, -1:]], axis=1
    )
    v = _assemble_responses(
        pairs,
        *(rows @ pairs.compute_products(J, j, parity).transpose(1, 2, 0) for parity, rows in enumerate((even_rows, odd_rows))),
    )
    # the weights 2 a (2l+1) / (pi^2 c) of eq. CF.18, (2l+1) / pi^2 being in j; shear counts half
    factors = np.concatenate(
        [
            (2 * disc.radius)[:, None] / _select_degrees(disc.pressed, pairs.pressed),
            disc.radius[:, None] / _select_degrees(disc.sheared, pairs.sheared),
        ],
        axis=1,
    )
    if not bonded:
        v, factors = v[:, :, : len(pairs.pressed)], factors[:, : len(pairs.pressed)]
    return (v * factors[:, None]) @ v.swapaxes(1, 2)


def _combine_shear(sphere_waves: SphereWaves) -> tuple[Array, Array]:
    """Return the moments under waves of shear along the wave minus, and plus, those under shear about the vertical."""
    turned = sphere_waves.turned
    return sphere_waves.moments[1] - turned, sphere_waves.moments[1] + turned


@dataclass(frozen=True)
class Pairs:
    """Which products J_m(kd) j_l(ka) the columns of v are sums of: those with m + l even, and odd, each in their order.

    Attributes
    ----------
    degrees
        For each parity and m, the first l, and the slice of its products.
    pressed, sheared
        l of each column of v, under pressure, and under shear with n + 1 before n - 1, shapes (columns,).
    positions
        For each column, the indices of the products of j_l with J_n, J_n-1, J_n+1, J_n-2 and J_n+2 among those of their parity,
        shape (5, columns).
    sign
        Of J_n-2, shape (columns,).
    added
        Whether a column of shear has m = n - 1 rather than n + 1, shape (columns of shear,).
    """

    degrees: tuple[tuple[tuple[int, slice], ...], ...]
    pressed: Any
    sheared: Any
    positions: Any
    sign: Any
    added: Any

    def compute_products(self, J: Array, j: Array, parity: int) -> Array:
        """Return the products J_m j_l of one parity (0: m + l even, 1: odd), shape (products, n, q).

        ``J`` are J_0, J_1, ... of k d and ``j`` are j_0, j_1, ... of k a, shapes (orders, n, q) and (degrees, n, q).
        """
        degrees = self.degrees[parity]
        table = np.empty((degrees[-1][1].stop, *J.shape[1:]), dtype=np.result_type(J, j))
        for wave, (first, place) in zip(J, degrees, strict=True):
            np.multiply(wave, j[first::2], out=table[place])
        return table


@lru_cache(maxsize=4)
def _build_pairs(orders: int, degree: int) -> Pairs:
    """Build the list of products for n up to ``orders`` and l up to ``degree``."""
    degrees = tuple(tuple(_iterate_degrees(orders, degree, parity)) for parity in (0, 1))
    places = {
        (m, first + 2 * position): place.start + position
        for parity_degrees in degrees
        for m, (first, place) in enumerate(parity_degrees)
        for position in range(place.stop - place.start)
    }

    def list_columns(step: int) -> list[tuple[int, int]]:
        """Return the (n, l) of all columns whose pressures or shears have m = n + step; l = m, m + 2, ... (eq. CF.18)."""
        return [(n, ell) for n in range(1, orders + 1) for ell in range(n + step, degree + 1, 2)]

    pressed, difference_columns, sum_columns = list_columns(0), list_columns(1), list_columns(-1)
    all_columns = pressed + difference_columns + sum_columns
    return Pairs(
        degrees,
        np.array([ell for _, ell in pressed]),
        np.array([ell for _, ell in difference_columns + sum_columns]),
        positions=np.array([[places[abs(n + step), ell] for n, ell in all_columns] for step in (0, -1, 1, -2, 2)]),
        sign=np.where([n == 1 for n, _ in all_columns], -1.0, 1.0),  # J_-1 = -J_1
        added=np.arange(len(difference_columns + sum_columns)) >= len(difference_columns),
    )


def _iterate_degrees(orders: int, degree: int, parity: int) -> Iterator[tuple[int, slice]]:
    """Yield for m = 0, 1, ... the first l that a column needs, with m + l of the given parity, and the slice of its products.

    Columns for the order n and l >= n - 1 need J_m with m up to n + 2, hence l from m - 3.
    """
    start = 0
    for m in range(orders + 3):
        first = max(m - 3, 0)
        first += (first + m + parity) % 2
        count = len(range(first, degree + 1, 2))
        yield first, slice(start, start + count)
        start += count


def _assemble_responses(pairs: Pairs, even_rows: Array, odd_rows: Array) -> Array:
    """Assemble v of eq. CF.18, shape (n, moments, columns), from the moments' integrals with the products J_m j_l.

    ``even_rows`` and ``odd_rows`` hold integrals with the products of m + l even and odd, shape (n, rows, products), in the order
    of rows of ``compute_off_axis_response``. Each block below is one bracket of eq. CF.17.
    """
    # columns: p of pressures, then of shears, first those with m = n + 1, then those with m = n - 1
    count, plus_one_end = len(pairs.pressed), len(pairs.pressed) + int(np.sum(~pairs.added))
    p, shear_columns, plus_one_columns, minus_one_columns = (
        slice(0, count),
        slice(count, None),
        slice(count, plus_one_end),
        slice(plus_one_end, None),
    )
    same_order, order_below, order_above, two_below, two_above = pairs.positions
    # moments: symmetric about the sphere's axis, ``once`` as cos of the angle; the last goes as cos of twice the angle
    symmetric_rows, once = slice(0, AXIAL_MOMENTS), slice(AXIAL_MOMENTS, 2 * AXIAL_MOMENTS)
    difference_rows, sum_rows = even_rows[:, AXIAL_MOMENTS + 1 : 2 * AXIAL_MOMENTS + 1], even_rows[:, 2 * AXIAL_MOMENTS + 1 :]
    v = np.empty((len(even_rows), ALL_MOMENTS, len(same_order)), dtype=even_rows.dtype)
    v[:, symmetric_rows, p], v[:, symmetric_rows, shear_columns] = (
        even_rows[:, symmetric_rows].take(same_order[p], axis=2),
        odd_rows[:, symmetric_rows].take(same_order[shear_columns], axis=2),
    )
    v[:, once, p] = odd_rows[:, once].take(order_below[p], axis=2) - odd_rows[:, once].take(order_above[p], axis=2)
    v[:, once, plus_one_columns] = difference_rows.take(order_below[plus_one_columns], axis=2) - sum_rows.take(
        order_above[plus_one_columns], axis=2
    )
    v[:, once, minus_one_columns] = sum_rows.take(order_below[minus_one_columns], axis=2) - difference_rows.take(
        order_above[minus_one_columns], axis=2
    )
    twice = (
        (p, even_rows[:, AXIAL_MOMENTS], even_rows[:, AXIAL_MOMENTS]),
        (plus_one_columns, odd_rows[:, -2], odd_rows[:, -1]),
        (minus_one_columns, odd_rows[:, -1], odd_rows[:, -2]),
    )
    for columns, lower_part, upper_part in twice:
        v[:, -1, columns] = pairs.sign[columns] * lower_part.take(two_below[columns], axis=1) + upper_part.take(
            two_above[columns], axis=1
        )
    return v


def _select_degrees(compliance: Array, degrees: Ints) -> Array:
    """Return the compliance c of each column's degree l, shape (n, columns).

    ``compliance`` is the same for all degrees, shape (n,), or has a value for each, shape (n, degrees).
    """
    return np.repeat(compliance[:, None], len(degrees), axis=1) if compliance.ndim == 1 else compliance[:, degrees]


def _repeat_for_moments(symmetrical: Array, once: Array, twice: Array) -> Array:
    """Return one row for each moment, shape (n, moments, q), from arrays (n, q).

    Five moments are symmetrical about the sphere's axis, five go as cos of the angle, one as cos of twice the angle.
    """
    return np.stack([symmetrical] * AXIAL_MOMENTS + [once] * AXIAL_MOMENTS + [twice], axis=1)
