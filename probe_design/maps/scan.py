"""Compute readings of a probe along a line over the tissue."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from time import perf_counter

import numpy as np

from geometry.common.arrays import Bools, Floats
from geometry.common.json_types import JsonObject
from geometry.common.percent import format_percent
from geometry.provenance.block import Provenance, build_provenance
from geometry.scenes.scene import Scene
from geometry.scenes.scene_tables import Observable
from probe_design.maps.scan_line import ScanLine
from probe_design.maps.target_grid import check_spheres
from solver.contact.evaluator import ContactEvaluator
from solver.equivalent_inclusion.evaluator import REFLECTIONS_FEATURE, EquivalentInclusion
from solver.equivalent_inclusion.probe_on_tissue import ProbeAlone, Undisturbed
from solver.equivalent_inclusion.readings import Readings, compute_readings
from solver.evaluators import choose_accuracy
from solver.planning.load_check import LoadChanges, build_load_notes, compute_budget, is_load_linear, refuse_load
from solver.planning.load_limits import build_limits, build_load_rule
from solver.results.film_charges import compute_charge_ratio_fields, warn_of_read_bonds
from solver.results.film_forces import FilmForces, compute_ratio_fields, compute_sensitivity_tolerance
from solver.results.load_limits import LoadedRecord, LoadLimits
from solver.results.result import Column, Decision, ReadRatio

Progress = Callable[[int, int], None]


@dataclass(frozen=True, repr=False)
class Scan(LoadedRecord):
    """Readings at positions along a line, at the scene's load; None where a warning gives the reason.

    Attributes
    ----------
    along
        "x" or "y", the axis along which the probe moves.
    at
        Coordinate of the line along the other axis, m.
    position
        Positions of the probe's axis along the line, m.
    ratio, stiffness, stress_inner, stress_outer, log_sensitivity, error_estimate
        See ``Result``, one per position.
    ratio_without
        The ratio without any inclusion.
    charge_inner, charge_outer, charge_ratio, charge_ratio_error, charge_log_sensitivity, charge_ratio_without
        The same of the films' charges, see ``Result``; None without charges.
    observable
        What readings are the ratio of: "charge" or "stress".
    evaluator, seconds, load_limits, plan, warnings
        See ``Result``.
    scene
        The scene with its inclusions.
    provenance
        See ``geometry.provenance.block``.
    """

    INTERNAL = ("scene",)
    DIMENSIONS = ("position",)
    along: str
    at: float
    position: tuple[float, ...]
    ratio: Column
    stiffness: tuple[float, ...]
    stress_inner: tuple[float, ...]
    stress_outer: tuple[float, ...]
    log_sensitivity: Column
    error_estimate: Column
    ratio_without: float | None
    evaluator: str
    seconds: float
    charge_inner: tuple[float, ...] | None = None
    charge_outer: tuple[float, ...] | None = None
    charge_ratio: Column | None = None
    charge_ratio_error: Column | None = None
    charge_log_sensitivity: Column | None = None
    charge_ratio_without: float | None = None
    observable: Observable = "stress"
    response: str | None = None
    load_limits: LoadLimits | None = None
    plan: tuple[Decision, ...] = ()
    warnings: tuple[str, ...] = ()
    scene: Scene | None = field(default=None, compare=False, repr=False)
    provenance: Provenance | None = field(default=None, compare=False, repr=False)

    @property
    def reading(self) -> ReadRatio[Column]:
        """The ratio that readings of the scene are, at each position."""
        if self.observable == "stress":
            return ReadRatio(self.ratio, self.error_estimate, self.log_sensitivity)
        null: Column = (None,) * len(self.position)
        return ReadRatio(self.charge_ratio or null, self.charge_ratio_error or null, self.charge_log_sensitivity or null)

    @property
    def reading_without(self) -> float | None:
        """The ratio that a reading is without any inclusion."""
        return self.ratio_without if self.observable == "stress" else self.charge_ratio_without


def scan(
    scene: Scene, along: str, positions: Floats, offset: float | None = None, *, accuracy: float | None = None,
    linear: bool = False, progress: Progress | None = None,
) -> Scan:  # fmt: skip
    """Compute readings of the scene's probe along a line over its tissue; the tumours stay in place.

    Parameters
    ----------
    scene
        Spheres, bonded or frictionless, no tilt.
    along
        "x" or "y".
    positions
        Of the probe's axis along the line, m, shape (n,).
    offset
        Coordinate of the line along the other axis, m; default: the scene's placement.
    accuracy
        As in ``solver.evaluate``.
    linear
        Whether to use linear elasticity at any load, see ``solver.evaluate``.
    progress
        Called with the number of positions done and their total, for positions that need reflections.

    Raises
    ------
    InputError
        The probe would leave the tissue.
    Refusal
        The evaluator cannot model the scene, or it is too extreme for double precision, or its load is beyond what ``contact``
        knows of tumours off the axis.
    """
    start = perf_counter()
    accuracy = choose_accuracy(scene, accuracy)
    check_spheres(scene, "scan")
    cross_axis = "y" if along == "x" else "x"
    rule, promise = build_load_rule(scene), scene.target is not None
    model_accuracy = compute_budget(rule, rule.compute_force(scene), accuracy, promise)
    line = ScanLine(scene, along, float(getattr(scene.placement, cross_axis) if offset is None else offset), model_accuracy)
    positions = np.asarray(positions, dtype=float)
    line.check_positions(positions)
    nearest_scene = line.place_probe(float(np.abs(positions).min()))
    base = EquivalentInclusion().prepare(
        nearest_scene, model_accuracy
    )  # used for all positions: only the bounds differ elsewhere
    tumours = line.build_tumours(positions)
    plain_readings = compute_readings(base, tumours, scene.target or 0, progress=progress, sensitive=scene.target is not None)
    film_readings = line.add_bounds(base, plain_readings, positions)
    farthest = line.solve_alone(float(np.abs(positions).max()))
    is_outside = base.move_inside(tumours)[1]  # whether each tumour lies outside the modelled tissue, shape (n, inclusions)
    load, films, evaluator = (
        LoadChanges.from_stiffness(scene, rule, film_readings.stiffness),
        base.films,
        EquivalentInclusion().name,
    )
    is_linear = linear or is_load_linear(scene, load.weakest, accuracy, promise)
    if not is_linear:
        reason = ContactEvaluator().refusal_off_axis(nearest_scene)
        if reason is not None:
            refuse_load(scene, load.weakest, accuracy, promise, reason)
        pressed = ContactEvaluator().press_tissue(nearest_scene, model_accuracy)
        film_readings = pressed.compute_readings(film_readings, tumours, scene.target or 0)
        load, films, evaluator = LoadChanges.from_contact(load), pressed.bare.films, ContactEvaluator().name
    stress = film_readings.totals * _compute_indentations(scene, film_readings)[:, None] / film_readings.areas
    return Scan(
        along=along,
        at=line.offset,
        position=tuple(positions.tolist()),
        ratio=_build_column(film_readings.ratio, film_readings.resolved),
        stiffness=tuple(film_readings.stiffness.tolist()),
        stress_inner=tuple(stress[:, 0].tolist()),
        stress_outer=tuple(stress[:, 1].tolist()),
        log_sensitivity=_build_log_sensitivities(scene, film_readings, is_outside),
        error_estimate=_build_column(load.add_to_errors(film_readings.error_estimate), film_readings.resolved & load.is_known),
        ratio_without=compute_ratio_fields(scene, films)["ratio"],
        **_build_charge_columns(scene, films, film_readings, load, is_outside=is_outside),
        observable=scene.observable,
        response=scene.load.response,
        evaluator=evaluator,
        seconds=perf_counter() - start,
        load_limits=build_limits(rule, accuracy, promise),
        plan=(*farthest.plan, *_list_reflection_decisions(base, film_readings)),
        warnings=(
            *dict.fromkeys(_iterate_warnings(scene, farthest, film_readings, is_outside, accuracy)),
            *(build_load_notes(scene, load.weakest, accuracy, promise) if is_linear else ()),
        ),
        scene=scene,
        provenance=build_provenance(scene, evaluator=evaluator, accuracy=accuracy),
    )


def _compute_indentations(scene: Scene, film_readings: Readings) -> Floats:
    """Return the indentations at the scene's load, m, shape (n,)."""
    return np.asarray(scene.load.find_indentation(film_readings.stiffness))


def _build_charge_columns(
    scene: Scene, films: FilmForces, film_readings: Readings, load: LoadChanges, *, is_outside: Bools
) -> JsonObject:
    """Return the fields of a ``Scan`` that concern charges; none without charges.

    Parameters
    ----------
    scene
        With its inclusions.
    films
        Film forces without inclusions.
    film_readings
        At all n positions.
    load
        Effect of the load at each.
    is_outside
        Whether each tumour lies outside the modelled tissue, shape (n, inclusions).
    """
    charges = film_readings.find_charges(scene)
    if charges is None:
        return {}
    charge = charges.totals * _compute_indentations(scene, film_readings)[:, None]
    return {
        "charge_inner": tuple(charge[:, 0].tolist()),
        "charge_outer": tuple(charge[:, 1].tolist()),
        "charge_ratio": _build_column(charges.ratio, charges.resolved),
        "charge_ratio_error": _build_column(load.add_to_errors(charges.error_estimate), charges.resolved & load.is_known),
        "charge_log_sensitivity": _build_log_sensitivities(scene, charges, is_outside),
        "charge_ratio_without": compute_charge_ratio_fields(scene, films)["charge_ratio"],
    }


def _build_log_sensitivities(scene: Scene, film_readings: Readings, is_outside: Bools) -> Column:
    """Return the log-sensitivities; None without a target, or where it lies outside the modelled tissue.

    ``is_outside`` has shape (n, inclusions).
    """
    if scene.target is None or not film_readings.derivatives:
        return (None,) * len(film_readings.forces)
    return _build_column(film_readings.log_sensitivity, film_readings.resolved & ~is_outside[:, scene.target])


def _build_column(values: Floats, valid: Bools) -> Column:
    """Return values as a tuple for JSON, with None where they are not valid."""
    return tuple(value if is_valid else None for value, is_valid in zip(values.tolist(), valid.tolist(), strict=True))


def _list_reflection_decisions(base: Undisturbed, film_readings: Readings) -> Iterator[Decision]:
    """Yield the line of the plan about reflections of the tumours' fields, if there are tumours."""
    if not film_readings.derivatives:
        return
    count, n = int(film_readings.reflected.sum()), len(film_readings.reflected)
    effect = float(min(film_readings.first_share.max(), 1e9))
    size = f"changes the ratio by at most about {format_percent(effect)}"
    reason = f"modelled for {count} of {n}, elsewhere counted in error_estimate: {size}"
    yield Decision(REFLECTIONS_FEATURE, count > 0, effect, base.accuracy, reason)


def _iterate_warnings(
    scene: Scene, farthest: ProbeAlone, film_readings: Readings, is_outside: Bools, accuracy: float
) -> Iterator[str]:
    """Yield warnings about missing log-sensitivities and ratios, tumours left out, and errors above the accuracy.

    Parameters
    ----------
    scene
        With its inclusions.
    farthest
        The probe without tumours at the farthest position.
    film_readings
        At all n positions.
    is_outside
        Whether each tumour lies outside the modelled tissue, shape (n, inclusions).
    accuracy
        As requested, before the effect of the load is subtracted.
    """
    n = len(film_readings.forces)
    yield from (*warn_of_read_bonds(scene), *farthest.notes)
    if scene.target is None:
        cause = "several inclusions and none marked target = true" if scene.inclusion else "the scene has no inclusion"
        yield f"no log-sensitivity is given: {cause}"
    elif is_outside[:, scene.target].any():
        count = int(is_outside[:, scene.target].sum())
        yield f"no log-sensitivity is given at {count} of {n} positions: the target lies outside the modelled round tissue"
    if is_outside.any():
        left_out = f"left out at {is_outside.any(axis=1).sum()} of {n} positions, which the error counts"
        yield f"tumours outside the round tissue that is modelled are {left_out}"
    read = film_readings.get_observable(scene)
    if not read.resolved.all():
        where = f"at {(~read.resolved).sum()} of {n} positions"
        yield f"no ratio is given {where}: under one of the blocks the {scene.observable} is smaller than its own error"
    limit = f"the accuracy {format_percent(accuracy, 6)}"
    if farthest.accuracy < accuracy:
        limit = f"{format_percent(farthest.accuracy)}, which the load leaves of {limit}"
    for quantity, bounds in _compute_errors(scene, film_readings).items():
        exceeding = (bounds > farthest.accuracy).sum()
        if exceeding:
            bound = format_percent(bounds.max()) if bounds.max() < 1 else "100 % and more"
            yield f"the error of {quantity} is up to {bound} at {exceeding} of {n} positions, more than {limit}"
    if film_readings.derivatives and scene.target is not None:
        tolerance = compute_sensitivity_tolerance(farthest.accuracy, read.log_sensitivity)
        is_worse = read.resolved & (read.sensitivity_error > tolerance)
        if is_worse.any():
            bound = f"{read.sensitivity_error[is_worse].max():.1g} (absolute)"
            where = f"at {is_worse.sum()} of {n} positions"
            yield f"the error of the log-sensitivity is up to {bound} {where}, more than 5 times the accuracy"


def _compute_errors(scene: Scene, film_readings: Readings) -> dict[str, Floats]:
    """Return the relative error bounds of ratio, stiffness and, at a given indentation, stresses, shape (n,) each."""
    read = film_readings.get_observable(scene)
    bounds = {
        "the ratio": read.error_estimate[read.resolved],
        "the stiffness": film_readings.bound.sum(axis=1) / np.abs(film_readings.stiffness),
    }
    if scene.load.force is not None:  # the stresses add up to the force, so that the ratio's error bounds theirs
        return bounds
    with np.errstate(divide="ignore"):
        return bounds | {"the stresses": (film_readings.bound / np.abs(film_readings.totals)).max(axis=1)}
