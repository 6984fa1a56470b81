"""Compute readings under load over tumours anywhere: the linear ones, and what the load changes of first-order effects.

With a_j(F) the change of the logarithm of output j by a set of tumours at the force F, and a_j(0) its linear limit with all
reflections,

    a_j(F) = a_j(0) + f sum_t [s_j,t(F) - s_j,t(0)]                                           (CT.10)

where s_j,t is the first-order effect of tumour t, eq. CT.9 with Eshelby's strengths of eq. IN.2: dK/K = k_v / K and
dmu/mu = k_d / (2 mu). The factor f is what reflections make, at rest, of the tumours' effect on the stiffness, which never passes
zero. Outputs are the film forces, the charges that are modelled, and the stiffness; derivatives by ln E of the target follow from
those of the strengths.

Each s_j is the mean of two meshes. Contact of the folding tissue with a wall begins at one point of a mesh, where s_j jumps by
some per cent, at another load on each mesh; in truth the contact grows from the corner on, and s_j lies between.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from geometry.common.arrays import Bools, Floats
from solver.contact.loaded_scene import LoadedForces, LoadedScene
from solver.contact.tabulated_response import TabulatedResponse
from solver.contact.tumour_effects import TumourResponse
from solver.equivalent_inclusion.probe_on_tissue import Undisturbed
from solver.equivalent_inclusion.readings import Readings
from solver.inclusions.eshelby import compute_strength
from solver.inclusions.tumours import Tumours
from solver.results.film_forces import FilmForces

MAX_REFLECTION_FACTOR = 1.5  # of f and of its inverse: beyond it tumours of opposite contrast nearly cancel in the stiffness
# of a change, per indentation in outer radii: benchmarks/contact/tumours_under_load.py; values, and derivatives by ln E
MODEL_ERRORS_PER_X = np.array([0.25, 0.5, 0.5])
# likewise, of what the load adds, where that is most of the change: the log-sensitivity of an outer charge between tape and glue
# grew ninefold from a small value at rest, and half of what the load added was wrong
GROWTH_ERROR_SHARES = np.array([0.3, 0.6, 0.6])
STIFFNESS_ERROR_PER_X = 0.02  # likewise, of the stiffness' change: where an output's own passes zero
LOG_DERIVATIVES = "youngs_modulus", "diameter"  # of the target, by whose logarithms readings have derivatives under load
DIAMETER_STEP = 1e-3  # relative, downwards as a tumour may touch the surface: of the derivative by ln diameter
MESH_SAFETY_FACTOR = 1.0  # times the difference of two meshes, of whose results the mean is used


@dataclass(frozen=True)
class LoadedChanges:
    """Changes of the outputs' logarithms by n sets of tumours at one force, and their derivatives by ln E of the target.

    The first axis, d, has the changes and after them their derivatives, by ln diameter too if the linear readings have that one;
    the last the inner and the outer film force, both charges where they are modelled, and the secant stiffness, k + 1 in all.
    Of ratios it has that of the forces and, where they are modelled, of the charges.

    Attributes
    ----------
    changes
        Eq. CT.10, at constant force, shape (d, n, k + 1).
    errors
        Bounds on the errors of what the load adds to them, shape (d, n, k + 1).
    ratio_errors
        The same of the logarithms of ratios, inner over outer, shape (d, n, k / 2).
    spreads
        Differences of the two meshes, shape (d, n, k + 1).
    """

    changes: Floats
    errors: Floats
    ratio_errors: Floats
    spreads: Floats

    @property
    def ratios(self) -> Floats:
        """Changes of the logarithms of ratios, inner over outer, shape (d, n, k / 2)."""
        return _subtract_outer(self.changes)

    @property
    def ratio_spreads(self) -> Floats:
        """Differences of the two meshes in the logarithms of ratios, shape (d, n, k / 2)."""
        return _subtract_outer(self.spreads)


@dataclass(frozen=True)
class Growths:
    """First-order effects of n sets of tumours on the stiffness at rest, and what the load adds to all effects.

    Attributes
    ----------
    at_rest
        Of the stiffness on the finer mesh, shape (d, n, 1).
    coarse, fine
        What the load adds on both meshes, shape (d, n, k + 1).
    """

    at_rest: Floats
    coarse: Floats
    fine: Floats

    @property
    def mean(self) -> Floats:
        """What the load adds, the mean of both meshes, shape (d, n, k + 1)."""
        return (self.coarse + self.fine) / 2

    def compute_factor(self, linear: Floats) -> Floats:
        """Return f of eq. CT.10, (d, n, 1), for the linear changes, (d, n, k + 1); see ``compute_linear_changes``."""
        factor = np.divide(linear[..., -1:], self.at_rest, out=np.ones_like(self.at_rest), where=self.at_rest != 0)
        return np.where(np.abs(np.log(np.maximum(factor, 1e-300))) < np.log(MAX_REFLECTION_FACTOR), factor, 1.0)


@dataclass(frozen=True)
class PressedTissue:
    """A probe pressed on tissue without tumours, on two meshes, with what tumours anywhere change about that state.

    Attributes
    ----------
    base
        The linear solution.
    loaded
        The load paths.
    bare
        Film forces without tumours under the load.
    responses
        At rest and under the load, of the coarser and of the finer mesh.
    """

    base: Undisturbed
    loaded: LoadedScene
    bare: LoadedForces
    responses: tuple[tuple[TumourResponse | TabulatedResponse, TumourResponse | TabulatedResponse], ...]

    @classmethod
    def from_loaded(cls, base: Undisturbed, loaded: LoadedScene, force: float) -> PressedTissue:
        """Press to a force, N, above zero; for errors see ``LoadedScene.press_to_force``."""
        bare = loaded.press_to_force(force)
        responses = [
            (
                TumourResponse.from_equilibrium(path.model, path.light),
                TumourResponse.from_equilibrium(path.model, path.press_to_force(force).equilibrium),
            )
            for path in loaded.paths
        ]
        return cls(base, loaded, bare, tuple(responses))

    def tabulate(self, tumours: Tumours) -> PressedTissue:
        """Return the same with tabulated responses, for tumours within the distances and depths of these."""
        radius, offset, depth = tumours.diameter / 2, tumours.offset, tumours.depth
        reach = float((offset + radius).max()), float((depth - radius).min()), float((depth + radius).max())
        faces = self.base.strata.interfaces

        def build(response: TumourResponse | TabulatedResponse) -> TabulatedResponse:
            """Return a response with tables for these tumours."""
            bare = response.response if isinstance(response, TabulatedResponse) else response
            return TabulatedResponse(bare, *reach, faces)

        return replace(self, responses=tuple((build(light), build(pressed)) for light, pressed in self.responses))

    def compute_readings(self, linear: Readings, tumours: Tumours, target: int = 0, *, shape_error: float = 0.0) -> Readings:
        """Return the readings at the force, per indentation, from the ``linear`` ones; parameters as of ``compute_changes``."""
        changes = self.compute_changes(linear, tumours, target, shape_error=shape_error)
        rise, rise_error = changes.changes[0, :, -1:], changes.errors[0, :, -1:]
        parts = []
        for number, (films, bare, part) in enumerate(
            zip(list_films(self.base.films), list_films(self.bare.films), linear.parts, strict=True)
        ):
            columns = slice(2 * number, 2 * number + 2)
            totals = bare.totals * np.exp(changes.changes[0, :, columns] + rise)
            if number == 0:  # the forces add up to the force, not only to first order
                totals *= bare.totals.sum() * np.exp(rise) / totals.sum(axis=1, keepdims=True)
            effect_errors = bound_effects(part, films) / np.abs(part.totals)
            errors = bare.relative_errors + effect_errors + changes.errors[0, :, columns] + rise_error
            log_ratio = bare.bound.log_ratio + part.log_ratio_bound - films.bound.log_ratio + changes.ratio_errors[0, :, number]
            loaded = replace_totals(part, totals, errors, log_ratio)
            if linear.derivatives:
                # derivatives at constant indentation, as those of linear readings are
                slopes = changes.changes[1:, :, columns] + changes.changes[1:, :, -1:]
                loaded = replace_derivatives(loaded, part, slopes, part.sensitivity_error + changes.ratio_errors[1, :, number])
            parts.append(loaded)
        return replace(parts[0], charges=parts[1]) if len(parts) > 1 else parts[0]

    def compute_growths(self, tumours: Tumours, target: int = 0, *, by_diameter: bool = False) -> Growths:
        """Compute first-order effects of n sets of t tumours at rest, and what the load adds to them."""
        inside, left_out = self.base.move_inside(tumours)
        (coarse_light, coarse), (light, fine) = (
            [
                compute_first_order_changes(response, self.base, inside, left_out, target, by_diameter=by_diameter)
                for response in pair
            ]
            for pair in self.responses
        )
        return Growths(light[..., -1:], coarse - coarse_light, fine - light)

    @property
    def x(self) -> float:
        """Indentation without tumours, in outer radii."""
        return float(self.bare.point.indentation / self.base.scene.probe.tube_radius)

    def compute_changes(
        self,
        readings: Readings,
        tumours: Tumours,
        target: int = 0,
        *,
        shape_error: float = 0.0,
        growths: Growths | None = None,
    ) -> LoadedChanges:
        """Compute what n sets of t tumours change at the force: the linear changes, and what the load adds to them, its growth.

        Parameters
        ----------
        readings
            Linear readings of the sets.
        tumours
            The spheres, relative to the probe's axis, arrays of shape (n, t).
        target
            Number of the tumour among the t to which the derivatives refer.
        shape_error
            Error of what the load adds, relative, where spheres stand for other shapes.
        growths
            Result of ``compute_growths``, where it is known.
        """
        linear = compute_linear_changes(self.base, readings)
        if not tumours.shape[1]:
            return LoadedChanges(linear, np.zeros_like(linear), np.zeros_like(_subtract_outer(linear)), np.zeros_like(linear))
        if growths is None:
            growths = self.compute_growths(tumours, target, by_diameter=len(linear) > 2)
        linear = linear[: len(growths.fine)]
        factor = growths.compute_factor(linear)
        coarse, fine = factor * growths.coarse, factor * growths.fine
        growth, spread = (coarse + fine) / 2, coarse - fine
        model_errors = self.x * MODEL_ERRORS_PER_X[: len(linear), None, None]
        growth_errors = GROWTH_ERROR_SHARES[: len(linear), None, None]
        stiffening = np.abs(linear[..., -1:])  # change of ln stiffness, by which a given force indents less

        def bound(linear: Floats, growth: Floats, spread: Floats) -> Floats:
            """Bound the errors of growths."""
            size = np.abs(linear) + np.abs(growth) + STIFFNESS_ERROR_PER_X * stiffening
            model_error = np.maximum(model_errors * size, growth_errors * np.abs(growth))
            return np.asarray(model_error + MESH_SAFETY_FACTOR * np.abs(spread) + shape_error * np.abs(growth))

        parts = linear, growth, spread
        return LoadedChanges(linear + growth, bound(*parts), bound(*(_subtract_outer(part) for part in parts)), spread)


def _subtract_outer(changes: Floats) -> Floats:
    """Return the changes of ratios' logarithms, (..., k / 2), from those of the outputs and the stiffness, (..., k + 1)."""
    return np.asarray(changes[..., 0:-1:2] - changes[..., 1:-1:2])


def list_films(films: FilmForces) -> list[FilmForces]:
    """Return the film forces and, where they are modelled, the charges."""
    return [films, *([] if films.charges is None else [films.charges])]


def bound_effects(readings: Readings, films: FilmForces) -> Floats:
    """Return the bounds on the errors of the tumours' effects alone, (n, 2), from bounds with those of the bare ``films``."""
    return np.asarray(np.maximum(readings.bound - films.bound.totals, 0.0))


def replace_totals(linear: Readings, totals: Floats, errors: Floats, log_ratio: Floats) -> Readings:
    """Return readings with other totals, (n, 2), errors relative to these, and bounds on ln ratio; without derivatives."""
    return replace(
        linear,
        forces=_build_diagonals(totals),
        bound=errors * np.abs(totals),
        log_ratio_bound=log_ratio,
        first_share=log_ratio,
        first_totals=totals,
        derivatives={},
    )


def replace_derivatives(loaded: Readings, linear: Readings, slopes: Floats, sensitivity_error: Floats) -> Readings:
    """Return loaded readings with those of ``LOG_DERIVATIVES`` that the linear ones have, from derivatives of ln totals."""
    totals = loaded.first_totals
    derivatives = {
        key: _build_diagonals(totals * slope)
        for key, slope in zip(LOG_DERIVATIVES, slopes, strict=False)
        if key in linear.derivatives
    }
    return replace(loaded, slope_bound=sensitivity_error[:, None] / 2 * np.abs(totals), derivatives=derivatives)


def _build_diagonals(totals: Floats) -> Floats:
    """Return matrices with the totals, shape (n, 2), on their diagonals, shape (n, 2, 2)."""
    return np.asarray(totals[:, :, None] * np.eye(2))


def compute_linear_changes(base: Undisturbed, readings: Readings) -> Floats:
    """Return the linear changes by n sets, as in ``LoadedChanges``; derivatives are zero without a target."""
    totals, bare = (
        np.concatenate([part.totals for part in parts], axis=-1) for parts in (readings.parts, list_films(base.films))
    )
    stiffness = readings.stiffness[:, None]
    rise = np.log(stiffness / bare[:2].sum())
    values = np.hstack([np.log(np.abs(totals / bare)) - rise, rise])
    rows = [values]
    for key in LOG_DERIVATIVES if "diameter" in readings.derivatives else LOG_DERIVATIVES[:1]:
        if key not in readings.derivatives:
            rows.append(np.zeros_like(values))
            continue
        slopes = np.concatenate([part.derivatives[key].sum(axis=2) for part in readings.parts], axis=1)
        stiffening = slopes[:, :2].sum(axis=1, keepdims=True) / stiffness
        rows.append(np.hstack([slopes / totals - stiffening, stiffening]))
    return np.stack(rows)


def _integrate(response: TumourResponse | TabulatedResponse, tumours: Tumours) -> Floats:
    """Integrate the densities over each of t spheres, see ``TumourResponse.integrate``; spheres of one place and size once."""
    places = np.stack([np.round(tumours.offset, 12), tumours.depth, tumours.diameter], axis=-1)
    _, first, indices = np.unique(places, axis=0, return_index=True, return_inverse=True)
    return response.integrate(tumours.select(first))[..., indices.ravel()]


def compute_first_order_changes(
    response: TumourResponse | TabulatedResponse,
    base: Undisturbed,
    tumours: Tumours,
    left_out: Bools,
    target: int,
    *,
    by_diameter: bool = False,
) -> Floats:
    """Return the sums of first-order effects about one state of n sets of t tumours, (n, t), as in ``LoadedChanges``.

    Tumours that are ``left_out``, (n, t), have none. ``by_diameter`` adds the derivative by ln diameter of the target.
    """
    flat = tumours.flatten()
    hosts = base.strata.find_hosts(flat.depth)
    strength = compute_strength(hosts, flat.youngs_modulus, flat.poisson_ratio)
    volume, shear = _integrate(response, flat)

    def combine(k_v: Floats, k_d: Floats) -> Floats:
        """Return the changes of logarithms by tumours of these strengths, shape (n, t, k + 1)."""
        changes = response.convert_to_constant_force(k_v / hosts.bulk_modulus * volume + k_d / hosts.two_mu * shear)
        return np.moveaxis(np.where(left_out, 0.0, changes.reshape(-1, *tumours.shape)), 0, -1)

    effects = combine(strength.volume, strength.shear)
    changes = [effects.sum(axis=1), combine(*strength.by_log_modulus)[:, target]]
    if by_diameter:
        volume, shear = _integrate(response, replace(flat, diameter=flat.diameter * (1 - DIAMETER_STEP)))
        changes.append((effects - combine(strength.volume, strength.shear))[:, target] / -np.log1p(-DIAMETER_STEP))
    return np.stack(changes)
