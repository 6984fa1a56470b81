"""Solve multiple scattering between tumours and boundary: the second tier of the equivalent-inclusion evaluator.

With c0 the coefficients of the states' regular modes at the spheres, S and T the spheres' scattering and work matrices
(``solver/inclusions/sphere_scattering.py``) and R the reflection by the boundary, the whole incident field at the spheres is
c = c0 + R S c, and the change of the states' energy products, which are film forces and charges, is

    dF = c0^T T c = c0^T T (1 - R S)^-1 c0                                                         (MS.7)

Reflections c_k+1 = R S c_k span a small space; as T and T R S are symmetric, c follows from Galerkin's method in it,

    mu_i+j = c_i^T T c_j,   A_ij = mu_i+j - mu_i+j+1,   B_i = mu_i,   a = A^-1 B,   c = sum_i c_i a_i   (MS.8)

The c_k are the fields after k reflections, mu their moments, A and B blocks of these, and a the weights of the fields. The
remainder after the last reflection, r = c0 - (1 - R S) c, is added once more: dF = B^T a + r^T T r + ..., and the next term is
smaller by the factor rho, the fraction of a field that is reflected back (MS.9). rho is estimated by ratios of successive moments
mu. The derivative of dF with respect to ln E of a sphere is c^T (dT / d ln E) c.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from time import perf_counter
from typing import Literal

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.resources import check_time
from geometry.meridian.section import Section
from geometry.scenes.probe import Material
from solver.axisymmetric.refinement import compute_total_change
from solver.axisymmetric.tissue_field import TissueField
from solver.inclusions.projection import build_projection
from solver.inclusions.tumours import Strata, Tumours
from solver.inclusions.vector_modes import Modes
from solver.linalg.workspace import keep_table
from solver.multiple_scattering.close_exchange import CloseExchange
from solver.multiple_scattering.exchange import Exchange, Reflector
from solver.multiple_scattering.lockstep import Steps
from solver.multiple_scattering.reflection_series import Reflections
from solver.multiple_scattering.rings import AzimuthalGrid
from solver.multiple_scattering.shape_derivatives import compute_shape_derivatives
from solver.multiple_scattering.spheres import DEGREE_LIMITS, ScatteringSphere, SphereSet, compute_degrees, estimate_unresolved

MAX_MODE_ORDER = 16  # maximum azimuthal order of the modes
ANGLE_LIMITS = (10, 40)  # minimum and maximum number of angles if a sphere lies off the axis
MAX_REFLECTIONS = 6  # each costs one solution per azimuthal order
_find_projection = keep_table(build_projection)
SLOPE_TOLERANCE_FACTOR = 5.0  # derivatives with respect to the modulus are this much more sensitive to omitted terms
MIN_TIMED_TUMOURS = 4  # tumours after which the time for the rest can be estimated
TIME_SHARE = 0.5  # of that time: the machine may be busier now than later
MIN_STATE_WORK_SHARE = 1e-12  # of the larger base state: smaller film states hardly matter
ORDER_TOLERANCE_SHARE = 0.3  # of the tolerance: two azimuthal orders with less effect end the sum


@dataclass(frozen=True)
class Scattered:
    """Change of the energy products of the s states by a set of spheres.

    Attributes
    ----------
    products
        dF_ij, symmetric, shape (s, s).
    by_log_modulus
        d products / d ln E of each sphere, shape (t, s, s).
    error
        Estimated error of each film's force and charge by omitted reflections, degrees and orders, shape (s,).
    slope_error
        The same for ``by_log_modulus``, shape (t, s, s).
    shape_derivatives
        Derivatives of each sphere, by ``compute_shape_derivatives``; none unless requested.
    steps
        Number of reflections.
    orders
        Number of azimuthal orders.
    """

    products: Floats
    by_log_modulus: Floats
    error: Floats
    slope_error: Floats
    shape_derivatives: tuple[dict[str, Floats], ...]
    steps: int
    orders: int


def iterate_scattering(
    field: TissueField,
    reflector: Reflector,
    strata: Strata,
    tumours: Tumours,
    tolerance: float,
    *,
    places: bool = False,
    sensitive: bool = False,
) -> Steps[Scattered]:
    """Solve eq. MS.8 for a set of t spheres until the remainder is below ``tolerance`` of each film's force and charge.

    These are steps for ``lockstep``: ``run_in_lockstep`` carries them out.

    Parameters
    ----------
    field
        The strains of the s states.
    reflector
        Reflecting boundary; its mesh may be coarser than that of ``field``.
    strata
        The tissue's materials by depth.
    tumours
        The t spheres, relative to the probe's axis.
    tolerance
        Relative tolerance.
    places
        Whether to compute derivatives with respect to the spheres' positions, sizes and Poisson's ratios.
    sensitive
        Whether derivatives with respect to moduli must be accurate to ``SLOPE_TOLERANCE_FACTOR`` times the tolerance, which takes
        one more reflection.

    Raises
    ------
    SolveError
        The reflections could not be solved.
    LimitReached
        They would exceed the limits of memory or time.
    """
    section = reflector.states.model.section
    spheres, rounds = arrange_spheres(section, strata, tumours)
    sphere_set = SphereSet.from_spheres(spheres, tumours)
    exchange = reflector.build_exchange(spheres, rounds)
    c = np.concatenate([compute_incident(field, sphere) for sphere in spheres])
    work = sphere_set.compute_work(c)
    unit = _choose_units(c, work)
    c, unit_pairs = c / unit, np.outer(unit, unit)
    series, orders, previous_energy = Reflections.begin(c, work / unit), rounds.orders, np.inf
    min_work = ORDER_TOLERANCE_SHARE * tolerance * float(np.abs(series.moments[0]).max())
    baseline = np.concatenate([reflector.states.forces, field.states.products[2:]])
    derivatives = sphere_set.compute_slopes(c)
    for _ in range(MAX_REFLECTIONS):
        c, orders = yield from _reflect(exchange, sphere_set.scatter(series.fields[-1]), min_work, orders)
        series = series.append(c, sphere_set.compute_work(c))
        change = series.rho / (1 - series.rho) * series.correction
        energy = float(np.linalg.norm(series.correction))
        # all further changes of the derivatives, in terms of the last one
        decay, previous_energy = _estimate_decay(previous_energy, energy, series.rho), energy
        total = series.sum_fields(series.galerkin_weights + series.remainder_weights)
        last, derivatives = derivatives, sphere_set.compute_slopes(total)
        slope_change = np.maximum(
            np.abs(derivatives - sphere_set.compute_slopes(series.sum_fields(series.galerkin_weights))),
            decay * np.abs(derivatives - last),
        )
        totals = np.abs((baseline + unit_pairs[:, :2] * series.products[:, :2]).sum(axis=1))
        settled = np.all(_compute_size(change * unit_pairs) <= tolerance * totals)
        if settled and (
            not sensitive or np.all(slope_change <= SLOPE_TOLERANCE_FACTOR * tolerance * np.max(np.abs(derivatives)))
        ):
            break
    left_out = estimate_unresolved(section, strata, tumours, spheres) + 2 * ORDER_TOLERANCE_SHARE * tolerance
    tail = _estimate_tail(section, spheres, sphere_set, series=series, fields=total)
    error = sum(_compute_size(part * unit_pairs) for part in (change, tail, left_out * series.products))
    slope_error = slope_change + SLOPE_TOLERANCE_FACTOR * left_out * np.abs(derivatives)
    moves = tuple(_list_shape_derivatives(tumours, spheres, sphere_set, total * unit)) if places else ()
    return Scattered(
        series.products * unit_pairs,
        derivatives * unit_pairs,
        error=np.asarray(error),
        slope_error=slope_error * unit_pairs,
        shape_derivatives=moves,
        steps=series.count,
        orders=orders,
    )


def _choose_units(incident: Floats, works: Floats) -> Floats:
    """Return the unit of each state in which its work at the spheres is that of the larger base state, shape (s,).

    Film states may be far smaller than base states at the spheres. In these units they count alike where the series is truncated.

    Parameters
    ----------
    incident
        Regular coefficients of the s states, (modes of all spheres, s).
    works
        The work matrices times these.
    """
    size = np.abs(incident * works).sum(axis=0)  # absolute: works of opposite signs may cancel
    largest, unit = max(float(size[:2].max()), 1e-300), np.ones(len(size))  # 1e-300: no division by zero
    np.divide(size[2:], largest, out=unit[2:], where=size[2:] > MIN_STATE_WORK_SHARE * largest)
    return np.sqrt(unit)


def _compute_size(change: Floats) -> Floats:
    """Return a size of the change of each film's force and charge from the change of the energy products, (s, s) to (s,)."""
    return np.asarray(compute_total_change(change[None, :, :2])[0])


def _estimate_decay(previous_energy: float, energy: float, rho: float) -> float:
    """Estimate the sum of all further changes of the derivatives, as a multiple of the last change.

    ``energy`` and ``previous_energy`` are the sizes of the correction by reflections after this and the previous one (infinite
    before the first, where rho takes the place of their ratio).

    Derivatives converge like fields: with the square root of the energy.
    """
    factor = min(0.9, np.sqrt(energy / previous_energy)) if np.isfinite(previous_energy) and previous_energy > 0 else rho
    return factor / (1 - factor)


def _list_shape_derivatives(
    tumours: Tumours, spheres: Sequence[ScatteringSphere], sphere_set: SphereSet, total: Floats
) -> Iterator[dict[str, Floats]]:
    """Yield the shape derivatives of each sphere in the whole incident field ``total``, (modes of all spheres, s)."""
    for k, (sphere, scattering, part) in enumerate(zip(spheres, sphere_set.scatterings, sphere_set.parts, strict=True)):
        material = Material(youngs_modulus=float(tumours.youngs_modulus[k]), poisson_ratio=float(tumours.poisson_ratio[k]))
        yield compute_shape_derivatives(sphere, scattering, sphere.matrix, material, total[part])


def arrange_spheres(section: Section, strata: Strata, tumours: Tumours) -> tuple[list[ScatteringSphere], AzimuthalGrid]:
    """Rotate spheres about the probe's axis, if possible into the plane y = 0, and choose modes and angles that resolve them."""
    offset, radius = tumours.offset, tumours.diameter / 2
    far = int(np.argmax(offset))  # the sphere furthest from the axis is rotated to y = 0, x > 0
    angle = float(np.arctan2(tumours.y[far], tumours.x[far])) if offset[far] > 0 else 0.0
    x, y = np.cos(angle) * tumours.x + np.sin(angle) * tumours.y, np.cos(angle) * tumours.y - np.sin(angle) * tumours.x
    plane = bool(np.all(np.abs(y) <= 1e-9 * radius))
    axis = bool(np.all(offset <= 1e-9 * radius))
    layers = strata.find_layer(tumours.depth).tolist()
    parity: Literal["even", "both"] = "even" if plane else "both"
    required = np.clip(np.ceil(np.maximum(*compute_degrees(section, strata, tumours))), *DEGREE_LIMITS).astype(int).tolist()
    modes = [
        _share_modes(Modes(degree, strata.materials[layer].poisson_ratio, 0 if axis else min(degree, MAX_MODE_ORDER), parity))
        for degree, layer in zip(required, layers, strict=True)
    ]
    centres = np.stack([x * (not axis), 0 * y if plane else y, -tumours.depth], axis=1)
    spheres = [
        ScatteringSphere(centre, float(size), sphere_modes, _find_projection(sphere_modes), strata.materials[layer], layer)
        for centre, size, sphere_modes, layer in zip(centres, radius, modes, layers, strict=True)
    ]
    distance = np.minimum(tumours.cover, strata.compute_gap(tumours))
    # more angles where a sphere lies far off the axis and close to a face, as its field there is narrow
    angles = int(np.clip(np.ceil(np.max(3 * offset / (distance + 0.2 * radius))) + 6, *ANGLE_LIMITS))
    return spheres, AzimuthalGrid(1 if axis else angles * (1 if plane else 2), plane)


@lru_cache(maxsize=64)
def _share_modes(modes: Modes) -> Modes:
    """Return the first object of equal modes, whose cached labels may be computed already."""
    return modes


def compute_incident(field: TissueField, sphere: ScatteringSphere) -> Floats:
    """Compute the regular coefficients of the s states at a sphere, (modes, s), m per unit of each."""
    x, y, z = sphere.points.T
    r = np.hypot(x, y)
    strains = field.evaluate(r, z)
    u = strains.displacement
    radial = np.stack([np.divide(part, r, out=np.zeros_like(r), where=r > 0) for part in (x, y)], axis=1)
    return sphere.compute_coefficients(np.concatenate([radial[:, :, None] * u[:, :1], u[:, 1:]], axis=1), strains.dilation)


def _reflect(
    exchange: Exchange | CloseExchange, outgoing: Sequence[Floats], min_work: float, orders: int
) -> Steps[tuple[Floats, int]]:
    """Compute one more reflection of outgoing fields: by the other spheres and, order by order, by the boundary.

    Returns the regular coefficients at all spheres, (modes of all, s), and the number of azimuthal orders that mattered.
    """
    sent = _exchange_between_spheres(exchange.spheres, outgoing)  # first, because it estimates its time early
    returned, orders = yield from exchange.iterate_reflection(outgoing, min_work, orders)
    return np.concatenate([a + b for a, b in zip(returned, sent, strict=True)]), orders


def _exchange_between_spheres(spheres: Sequence[ScatteringSphere], outgoing: Sequence[Floats]) -> list[Floats]:
    """Compute the fields scattered to each sphere by the others in its layer, as regular coefficients."""
    total, start = [np.zeros_like(c) for c in outgoing], perf_counter()
    for k, sphere in enumerate(spheres):
        remaining_time = TIME_SHARE * (perf_counter() - start) / k * (len(spheres) - k) if k >= MIN_TIMED_TUMOURS else 0.0
        check_time(f"reflections of {len(spheres)} tumours (fewer take less)", remaining_time)
        for neighbour, c in zip(spheres, outgoing, strict=True):
            if neighbour is not sphere and neighbour.layer == sphere.layer:  # from other layers it comes through the interfaces
                local = (sphere.points - neighbour.centre) / neighbour.radius
                total[k] += sphere.compute_coefficients(neighbour.modes.evaluate_displacement(local, c, "outgoing"))
    return total


def _estimate_tail(
    section: Section, spheres: Sequence[ScatteringSphere], sphere_set: SphereSet, *, series: Reflections, fields: Floats
) -> Floats:
    """Estimate the contribution to the energy products of degrees beyond the largest of the modes, shape (s, s).

    ``fields`` is the whole incident field, (modes of all spheres, s).

    A field from the surface or an interface decays as (R / distance)^l with degree l on a sphere of radius R: a geometric series
    from the last degrees.
    """
    total = np.zeros((series.states,) * 2)
    for sphere, part in zip(spheres, sphere_set.parts, strict=True):
        last = sphere.modes.ell >= sphere.modes.degree - 1
        nearest = min(abs(sphere.centre[2] + depth) for depth in (0.0, *section.interfaces))
        decay = min(0.9, float((sphere.radius / nearest) ** 4))  # of two degrees' work
        total += series.works[0][part][last].T @ fields[part][last] * (decay / (1 - decay))
    return (total + total.T) / 2
