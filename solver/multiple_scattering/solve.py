"""Solve multiple scattering between tumours and boundary: the second tier of the equivalent-inclusion evaluator.

With c0 the regular modes of the base states at the spheres, S and T their scattering and work
(``solver/inclusions/sphere_scattering.py``) and R the reflection by the boundary, the whole incident field at the spheres is
c = c0 + R S c, and the change of the film forces is

    dF = c0^T T c = c0^T T (1 - R S)^-1 c0                                                         (MS.7)

Reflections c_k+1 = R S c_k span a small space; as T and T R S are symmetric, c follows from Galerkin's method in it,

    mu_i+j = c_i^T T c_j,   A_ij = mu_i+j - mu_i+j+1,   B_i = mu_i,   a = A^-1 B,   c = sum_i c_i a_i   (MS.8)

The remainder after the last reflection, r = c0 - (1 - R S) c, is added once more: dF = B^T a + r^T T r + ..., and the next
term is smaller by rho, the share of a field that comes back (MS.9). The derivative by ln E of a sphere is c^T (dT / d ln E) c.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from time import perf_counter
from typing import Literal

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.resources import check_memory, check_time
from geometry.meridian.section import Section
from geometry.scenes.probe import Material
from solver.axisymmetric.refinement import total_change
from solver.axisymmetric.tissue_field import TissueField
from solver.inclusions.projection import Projection, held_bytes, projection
from solver.inclusions.strata import Strata
from solver.inclusions.tumours import Tumours
from solver.inclusions.vector_modes import Modes
from solver.linalg.workspace import kept_table
from solver.multiple_scattering.exchange import LESS, Exchange, Reflector
from solver.multiple_scattering.lockstep import Steps, alone
from solver.multiple_scattering.near_exchange import CloseExchange
from solver.multiple_scattering.reflection_series import Reflections
from solver.multiple_scattering.resolution import DEGREES, apart, degrees, unresolved
from solver.multiple_scattering.rings import AzimuthalGrid
from solver.multiple_scattering.shape_derivatives import Moved, moved
from solver.multiple_scattering.spheres import ScatteringSphere, SphereSet

ORDERS = 16  # maximum azimuthal order of the modes
ANGLES = (10, 40)  # minimum and maximum number of angles if a sphere lies off the axis
SMALL = 20  # maximum degree of off-axis modes with cached projections: 1 to 30 MB each
STEPS = 6  # each costs one solution per azimuthal order
_kept_projection = kept_table(projection)
SENSITIVE = 5.0  # derivatives with respect to the modulus are this much more sensitive to omitted terms
ROWS = 4  # tumours after which the time for the rest can be estimated
SURE = 0.5  # of that time: the machine may be busier now than later
ENOUGH = 0.3  # of the tolerance: two azimuthal orders with less effect end the sum


@dataclass(frozen=True)
class Scattered:
    """Change of the film forces by a set of spheres.

    Attributes:
        forces: dF_ij, N/m, shape (2, 2).
        by_log_modulus: d forces / d ln E of each sphere, shape (t, 2, 2).
        error: estimated error of each film's total by omitted reflections, degrees and orders, N/m, shape (2,).
        slope_error: the same for ``by_log_modulus``, shape (t, 2, 2).
        shape_derivatives: derivatives with respect to depth, offset and diameter of each sphere.
        steps: number of reflections.
        orders: number of azimuthal orders.
    """

    forces: Floats
    by_log_modulus: Floats
    error: Floats
    slope_error: Floats
    moved: tuple[Moved, ...]
    steps: int
    orders: int


def solve_scattering(
    field: TissueField,
    reflector: Reflector,
    strata: Strata,
    tumours: Tumours,
    tolerance: float,
    *,
    places: bool = False,
    sensitive: bool = False,
    often: bool = False,
) -> Scattered:
    """Solve eq. MS.8 for a set of t spheres until the remainder is below ``tolerance`` of each film's total.

    Args:
        field: the base states' strains.
        reflector: reflecting boundary; its mesh may be coarser than that of ``field``.
        strata: the tissue's materials by depth.
        tumours: the t spheres, relative to the probe's axis.
        tolerance: relative tolerance.
        places: whether to compute derivatives with respect to the spheres' positions, sizes and Poisson's ratios.
        sensitive: whether derivatives with respect to moduli must be accurate to ``SLOPE_TOLERANCE_FACTOR`` times the tolerance,
            which takes one more reflection.
        often: whether so many sets are solved under this probe that forming each order's matrix pays even without PARDISO.

    Raises:
        SolveError: the reflections could not be solved.
        LimitReached: they would exceed the limits of memory or time.
    """
    return alone(scattering_steps(field, reflector, strata, tumours, tolerance, places=places, sensitive=sensitive), often)


def scattering_steps(
    field: TissueField,
    reflector: Reflector,
    strata: Strata,
    tumours: Tumours,
    tolerance: float,
    *,
    places: bool = False,
    sensitive: bool = False,
) -> Steps[Scattered]:
    """Iterate ``solve_scattering`` as steps for ``lockstep``; arguments and errors are the same."""
    section = reflector.states.model.section
    spheres, rounds = arranged(section, strata, tumours)
    sphere_set = SphereSet.of(spheres, tumours)
    exchange, c = reflector.exchange(spheres, rounds), np.concatenate([incident(field, one) for one in spheres])
    series, orders, previous_energy = Reflections.first(c, sphere_set.work(c)), rounds.orders, np.inf
    enough = ENOUGH * tolerance * float(np.abs(series.moments[0]).max())
    slopes = sphere_set.slopes(c)
    for _ in range(STEPS):
        c, orders = yield from _reflected(exchange, sphere_set.scattered(series.fields[-1]), enough, orders)
        series = series.followed(c, sphere_set.work(c))
        change = series.rho / (1 - series.rho) * series.correction
        previous_energy, decay = _decay(previous_energy, float(np.linalg.norm(series.correction)), series.rho)
        total = series.whole(series.galerkin + series.remainder)
        last, slopes = slopes, sphere_set.slopes(total)
        slope_change = np.maximum(
            np.abs(slopes - sphere_set.slopes(series.whole(series.galerkin))), decay * np.abs(slopes - last)
        )
        totals = np.abs((reflector.states.forces + series.forces).sum(axis=1))
        settled = np.all(total_change(change[None])[0] <= tolerance * totals)
        if settled and (not sensitive or np.all(slope_change <= SENSITIVE * tolerance * np.max(np.abs(slopes)))):
            break
    forces, left_out = series.forces, unresolved(section, strata, tumours, spheres) + 2 * ENOUGH * tolerance
    error = total_change(
        np.array([change, _tail(section, spheres, sphere_set, series=series, fields=total), left_out * forces])
    ).sum(axis=0)
    slope_error = slope_change + SENSITIVE * left_out * np.abs(slopes)
    moves = tuple(_moves(tumours, spheres, sphere_set, total)) if places else ()
    return Scattered(forces, slopes, error=error, slope_error=slope_error, moved=moves, steps=series.count, orders=orders)


def _decay(previous_energy: float, energy: float, rho: float) -> tuple[float, float]:
    """Return the energy and the sum of all further changes of the derivatives as a multiple of the last change.

    Derivatives converge like fields: with the square root of the energy.
    """
    share = min(0.9, np.sqrt(energy / previous_energy)) if np.isfinite(previous_energy) and previous_energy > 0 else rho
    return energy, share / (1 - share)


def _moves(tumours: Tumours, spheres: Sequence[ScatteringSphere], sphere_set: SphereSet, total: Floats) -> Iterator[Moved]:
    """Yield the shape derivatives of each sphere in the whole field."""
    for k, (sphere, one, part) in enumerate(zip(spheres, sphere_set.scatterings, sphere_set.parts, strict=True)):
        own = Material(youngs_modulus=float(tumours.youngs_modulus[k]), poisson_ratio=float(tumours.poisson_ratio[k]))
        yield moved(sphere, one, sphere.matrix, own, total[part])


def arranged(section: Section, strata: Strata, tumours: Tumours) -> tuple[list[ScatteringSphere], AzimuthalGrid]:
    """Rotate spheres about the probe's axis, if possible into the plane y = 0, and choose modes and angles that resolve them.

    Raises:
        LimitReached: their projections would exceed the memory limit.
    """
    offset, radius = tumours.offset, tumours.diameter / 2
    far = int(np.argmax(offset))
    turn = float(np.arctan2(tumours.y[far], tumours.x[far])) if offset[far] > 0 else 0.0
    x, y = np.cos(turn) * tumours.x + np.sin(turn) * tumours.y, np.cos(turn) * tumours.y - np.sin(turn) * tumours.x
    plane = bool(np.all(np.abs(y) <= 1e-9 * radius))
    axis = bool(np.all(offset <= 1e-9 * radius))
    layers = strata.number(tumours.depth).tolist()
    parity: Literal["even", "both"] = "even" if plane else "both"
    required = np.clip(np.ceil(np.maximum(*degrees(section, tumours))), *DEGREES).astype(int).tolist()
    modes = [
        _same(Modes(degree, strata.materials[layer].poisson_ratio, 0 if axis else min(degree, ORDERS), parity))
        for degree, layer in zip(required, layers, strict=True)
    ]
    projections = _projections(modes)
    centres = np.stack([x * (not axis), 0 * y if plane else y, -tumours.depth], axis=1)
    spheres = [
        ScatteringSphere(centre, float(size), own, projections[own], strata.materials[layer], layer)
        for centre, size, own, layer in zip(centres, radius, modes, layers, strict=True)
    ]
    angles = int(np.clip(np.ceil(np.max(3 * offset / (apart(section, tumours) + 0.2 * radius))) + 6, *ANGLES))
    return spheres, AzimuthalGrid(1 if axis else angles * (1 if plane else 2), plane)


def _projections(modes: Sequence[Modes]) -> dict[Modes, Projection]:
    """Return the projections on all modes; small ones are cached, as they take half of the time of a tumour on the axis.

    Raises:
        LimitReached: they would exceed the memory limit.
    """
    every = set(modes)
    check_memory(f"reflections of {len(modes)} tumours ({LESS})", sum(held_bytes(one) for one in every))
    return {one: (_kept_projection if one.order == 0 or one.degree <= SMALL else projection)(one) for one in every}


@lru_cache(maxsize=64)
def _same(modes: Modes) -> Modes:
    """Return the first of equal modes, whose labels may be computed already."""
    return modes


def incident(field: TissueField, sphere: ScatteringSphere) -> Floats:
    """Compute regular coefficients of the base states at a sphere, (modes, 2), m per m."""
    x, y, z = sphere.points.T
    r = np.hypot(x, y)
    strains = field.at(r, z)
    u = strains.displacement
    away = np.stack([np.divide(part, r, out=np.zeros_like(r), where=r > 0) for part in (x, y)], axis=1)
    return sphere.coefficients(np.concatenate([away[:, :, None] * u[:, :1], u[:, 1:]], axis=1), strains.dilation)


def _reflected(
    exchange: Exchange | CloseExchange, outgoing: Sequence[Floats], enough: float, orders: int
) -> Steps[tuple[Floats, int]]:
    """Compute one more reflection: by the other spheres and, order by order, by the boundary."""
    sent = _neighbours(exchange.spheres, outgoing)  # first, because it estimates its time early
    if isinstance(exchange, CloseExchange):
        came, orders = exchange.reflect(outgoing, enough, orders)
    else:
        came, orders = yield from exchange.reflecting(outgoing, enough, orders)
    return np.concatenate([a + b for a, b in zip(came, sent, strict=True)]), orders


def _neighbours(spheres: Sequence[ScatteringSphere], outgoing: Sequence[Floats]) -> list[Floats]:
    """Compute the fields scattered to each sphere by the others in its layer, as regular coefficients."""
    total, start = [np.zeros_like(c) for c in outgoing], perf_counter()
    for k, here in enumerate(spheres):
        left = SURE * (perf_counter() - start) / k * (len(spheres) - k) if k >= ROWS else 0.0
        check_time(f"reflections of {len(spheres)} tumours (fewer take less)", left)
        for other, c in zip(spheres, outgoing, strict=True):
            if other is not here and other.layer == here.layer:  # from other layers it comes through the interfaces
                local = (here.points - other.centre) / other.radius
                total[k] += here.coefficients(other.modes.displacement(local, c, "outgoing"))
    return total


def _tail(
    section: Section, spheres: Sequence[ScatteringSphere], sphere_set: SphereSet, *, series: Reflections, fields: Floats
) -> Floats:
    """Estimate the contribution of degrees beyond the largest, N/m, shape (2, 2).

    A field from the surface or an interface decays as (R / distance)^l with degree l on a sphere of radius R: a geometric series
    from the last degrees.
    """
    total = np.zeros((2, 2))
    for sphere, part in zip(spheres, sphere_set.parts, strict=True):
        last = sphere.modes.ell >= sphere.modes.degree - 1
        nearest = min(abs(sphere.centre[2] + depth) for depth in (0.0, *section.interfaces))
        decay = min(0.9, float((sphere.radius / nearest) ** 4))  # of two degrees' work
        total += series.works[0][part][last].T @ fields[part][last] * (decay / (1 - decay))
    return (total + total.T) / 2
