"""A film as a membrane on shear springs: its displacement where it is driven as an actuator, by scaled Bessel functions.

Of a film (E, nu, thickness t) that a bond holds on the base, radial displacements v obey

    D (v' + v/r)' = k v,   D = E t / (1 - nu^2),   1/k = t_b / G_b + t / (3 G),   l = sqrt(D / k)                       (CF.25)

with t_b and G_b the bond's thickness and shear modulus, G the film's. Glue between block and film stretches with the film: its
own E t / (1 - nu^2) counts in D, and film and glue together widen only by the film's share of D. An actuator widens freely by 1
where its electrode is: v and v' + nu v/r - (1 + nu) chi are continuous at the electrode's edges, chi = 1 under it, else 0; the
latter is 0 at free edges. An edge of the electrode at x_0 = r_0 / l is thus a ring load. With signs + where the electrode ends,
- where it begins,

    v / ((1 + nu) l) = sum +-x_0 I1(min(x, x_0)) K1(max(x, x_0)) + A I1(x) + B K1(x),   x = r / l                       (CF.26)

with A and B from v' + nu v/r = 0 at the free edges; B = 0 of a disc. All products are formed of functions scaled by exp(-x) and
exp(x), so that none overflows: v goes to 0 as l does, and to r for an l far above the radius.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from geometry.common.arrays import Ints
from solver.closed_form.bessel import Array

FILM_PARAMETERS = (
    "thickness", "modulus", "poisson", "lateral_charge", "normal_charge", "inset",
    "base_bond_thickness", "base_bond_modulus", "base_bond_poisson",
    "block_bond_thickness", "block_bond_modulus", "block_bond_poisson",
)  # fmt: skip

MIN_GLUE_MODULUS = 1e7  # Pa: softer bonds are tape, whose own stiffness is below 1 % of the film's but for the thinnest films


@dataclass(frozen=True)
class FilmArray:
    """The films of one block of n designs, with their bonds; arrays of shape (n,), SI.

    Attributes
    ----------
    thickness, modulus, poisson
        Of the film.
    lateral_charge, normal_charge
        (d31 + d32) / 2 and d33, C/N.
    inset
        How far the electrode ends within each free edge, m.
    base_bond_thickness, base_bond_modulus, base_bond_poisson
        Of the bond to the base; a rigid one has no thickness, and any modulus.
    block_bond_thickness, block_bond_modulus, block_bond_poisson
        Of the bond to the block.
    """

    thickness: Array
    modulus: Array
    poisson: Array
    lateral_charge: Array
    normal_charge: Array
    inset: Array
    base_bond_thickness: Array
    base_bond_modulus: Array
    base_bond_poisson: Array
    block_bond_thickness: Array
    block_bond_modulus: Array
    block_bond_poisson: Array

    def take(self, which: Ints) -> FilmArray:
        """Return the films of the designs with indices ``which``."""
        return FilmArray(*(getattr(self, part.name)[which] for part in fields(self)))

    @property
    def membrane_stiffness(self) -> Array:
        """D of eq. CF.25, of the film and of the bond between block and film, N/m."""
        bond = self.block_bond_modulus * self.block_bond_thickness / (1 - self.block_bond_poisson * self.block_bond_poisson)
        return self._own_stiffness + np.where(self.block_bond_modulus.real < MIN_GLUE_MODULUS, 0, bond)

    @property
    def _own_stiffness(self) -> Array:
        """The film's part of D, N/m."""
        return self.modulus * self.thickness / (1 - self.poisson * self.poisson)

    @property
    def stiffness_share(self) -> Array:
        """The film's part of D, relative to D."""
        return self._own_stiffness / self.membrane_stiffness

    @property
    def own_slip(self) -> Array:
        """Shear compliance t / G of the film itself, m/Pa."""
        return self.thickness * 2 * (1 + self.poisson) / self.modulus

    @property
    def base_slip(self) -> Array:
        """1/k of eq. CF.25: how far the film slips on the base per shear traction, m/Pa."""
        return self.base_bond_thickness * 2 * (1 + self.base_bond_poisson) / self.base_bond_modulus + self.own_slip / 3

    @property
    def block_slip(self) -> Array:
        """The same between block and film, m/Pa."""
        return self.block_bond_thickness * 2 * (1 + self.block_bond_poisson) / self.block_bond_modulus + self.own_slip / 3

    @property
    def decay_length(self) -> Array:
        """L of eq. CF.25, m."""
        return np.sqrt(self.membrane_stiffness * self.base_slip)


def compute_scaled_bessel(x: Array) -> tuple[Array, Array, Array, Array]:
    """Return exp(-x) I0, exp(-x) I1, exp(x) K0 and exp(x) K1 of x > 0, with relative errors below 1e-6.

    They are the polynomials of Abramowitz and Stegun, Handbook of Mathematical Functions, 9.8.1 to 9.8.8.
    """
    small, middle = x.real < 3.75, x.real < 2.0
    t = np.where(small, x / 3.75, 0)
    t *= t
    inverse = 3.75 / np.where(small, 3.75, x)
    fade, root = np.exp(-np.where(small, x, 0)), np.sqrt(np.where(small, 3.75, x))
    I0 = np.where(small, _evaluate(_I0_SMALL, t) * fade, _evaluate(_I0_LARGE, inverse) / root)
    I1 = np.where(small, x * _evaluate(_I1_SMALL, t) * fade, _evaluate(_I1_LARGE, inverse) / root)
    below = np.where(middle, x, 2.0)
    half, log, rise = below * below / 4, np.log(below / 2), np.exp(below)
    inverse, root = 2.0 / np.where(middle, 2.0, x), np.sqrt(np.where(middle, 2.0, x))
    K0 = np.where(middle, (_evaluate(_K0_SMALL, half) - log * I0 * rise) * rise, _evaluate(_K0_LARGE, inverse) / root)
    K1 = np.where(middle, (_evaluate(_K1_SMALL, half) / below + log * I1 * rise) * rise, _evaluate(_K1_LARGE, inverse) / root)
    return I0, I1, K0, K1


def _evaluate(coefficients: tuple[float, ...], x: Array) -> Array:
    """Return a polynomial, lowest power first, at x."""
    value: Array = coefficients[-1]
    for coefficient in coefficients[-2::-1]:
        value = value * x + coefficient
    return value


_I0_SMALL = 1.0, 3.5156229, 3.0899424, 1.2067492, 0.2659732, 0.0360768, 0.0045813
_I1_SMALL = 0.5, 0.87890594, 0.51498869, 0.15084934, 0.02658733, 0.00301532, 0.00032411
_I0_LARGE = (0.39894228, 0.01328592, 0.00225319, -0.00157565, 0.00916281, -0.02057706, 0.02635537, -0.01647633, 0.00392377)
_I1_LARGE = (0.39894228, -0.03988024, -0.00362018, 0.00163801, -0.01031555, 0.02282967, -0.02895312, 0.01787654, -0.00420059)
_K0_SMALL = -0.57721566, 0.42278420, 0.23069756, 0.03488590, 0.00262698, 0.00010750, 0.00000740
_K1_SMALL = 1.0, 0.15443144, -0.67278579, -0.18156897, -0.01919402, -0.00110404, -0.00004686
_K0_LARGE = 1.25331414, -0.07832358, 0.02189568, -0.01062446, 0.00587872, -0.00251540, 0.00053208
_K1_LARGE = 1.25331414, 0.23498619, -0.03655620, 0.01504268, -0.00780353, 0.00325614, -0.00068245


@dataclass(frozen=True)
class Solutions:
    """I0, I1, K0 and K1 at points x, scaled as ``compute_scaled_bessel`` returns them."""

    x: Array
    I0: Array
    I1: Array
    K0: Array
    K1: Array

    @classmethod
    def from_points(cls, x: Array) -> Solutions:
        """Return the functions at x."""
        return cls(x, *compute_scaled_bessel(x))

    def expand(self) -> Solutions:
        """Return the functions at points (n,) with one axis more, (n, 1)."""
        return Solutions(*(getattr(self, part.name)[:, None] for part in fields(self)))


def compute_actuator(film: FilmArray, start: Array | None, radius: Array, r: Array) -> tuple[Array, Array]:
    """Return v and its dilation e = v' + v/r of a film as an actuator (eq. CF.26).

    Parameters
    ----------
    film
        The films of n designs.
    start
        Inner radii of tubes, m, shape (n,); None for discs.
    radius
        Outer radii, m, shape (n,).
    r
        Radii at which both are computed, m, shape (n, points).

    Returns
    -------
    tuple[Array, Array]
        v, m, and e, per unit of free strain, shape (n, points).
    """
    length, nu = film.decay_length, film.poisson
    places = Solutions.from_points(r / length[:, None])
    edges = [(Solutions.from_points(radius / length), Solutions.from_points((radius - film.inset) / length), 1.0)]
    if start is not None:
        edges.append((Solutions.from_points(start / length), Solutions.from_points((start + film.inset) / length), -1.0))
    sources = [(source, sign) for _, source, sign in edges]
    v: Array = 0.0
    e: Array = 0.0
    for source, sign in sources:
        value, dilation = _compute_ring_load(source.expand(), places, sign)
        v, e = v + value, e + dilation
    columns = [_compute_grown(places, edges[0][0].x[:, None])]
    if start is not None:
        columns.append(_compute_faded(places, edges[1][0].x[:, None]))
    for amplitude, (value, dilation) in zip(_balance_edges(edges, sources, nu), columns, strict=True):
        v, e = v + amplitude[:, None] * value, e + amplitude[:, None] * dilation
    drive = film.stiffness_share * (1 + nu)
    return v * (drive * length)[:, None], e * drive[:, None]


def _compute_ring_load(source: Solutions, places: Solutions, sign: float) -> tuple[Array, Array]:
    """Return the displacement of a ring load of eq. CF.26 and its dilation at places x.

    A place at the source counts as on its free side: outward of the electrode's outer edge (``sign`` 1), else inward.
    """
    inside = places.x.real < source.x.real if sign > 0 else places.x.real <= source.x.real
    weight = sign * source.x * np.exp(np.where(inside, places.x - source.x, source.x - places.x))
    value = weight * np.where(inside, places.I1 * source.K1, source.I1 * places.K1)
    return value, weight * np.where(inside, places.I0 * source.K1, -source.I1 * places.K0)


def _compute_grown(places: Solutions, end: Array) -> tuple[Array, Array]:
    """Return exp(-end) I1(x) and its dilation."""
    scale = np.exp(places.x - end)
    return scale * places.I1, scale * places.I0


def _compute_faded(places: Solutions, start: Array) -> tuple[Array, Array]:
    """Return exp(start) K1(x) and its dilation."""
    scale = np.exp(start - places.x)
    return scale * places.K1, -scale * places.K0


def _balance_edges(edges: list[Any], sources: list[tuple[Solutions, float]], nu: Array) -> list[Array]:
    """Return A, and of tubes B, of eq. CF.26, for solutions scaled to be finite at the free edges."""

    def compute_tension(edge: Solutions, value: Array, dilation: Array) -> Array:
        """Return v' + nu v / x."""
        return dilation - (1 - nu) * value / edge.x

    outer = edges[0][0]
    ends = [edge for edge, _, _ in edges]
    loads = [sum(compute_tension(end, *_compute_ring_load(source, end, sign)) for source, sign in sources) for end in ends]
    grown = [compute_tension(end, *_compute_grown(end, outer.x)) for end in ends]
    if len(ends) == 1:
        return [-loads[0] / grown[0]]
    faded = [compute_tension(end, *_compute_faded(end, ends[1].x)) for end in ends]
    determinant = grown[0] * faded[1] - grown[1] * faded[0]
    return [(loads[1] * faded[0] - loads[0] * faded[1]) / determinant, (loads[0] * grown[1] - loads[1] * grown[0]) / determinant]
