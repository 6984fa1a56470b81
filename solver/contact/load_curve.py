"""Compute the film forces' ratio, log-sensitivity and other results against load."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from time import perf_counter

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import Refusal, SolveError, Words
from geometry.common.json_types import JsonObject
from geometry.common.percent import format_percent
from geometry.common.resources import LimitReached, start_clock
from geometry.scenes.probe import format_mm
from geometry.scenes.scene import Scene
from solver.contact.evaluator import ContactEvaluator
from solver.contact.limits import find_change_load, find_gap_closure_load, is_gap_closed
from solver.contact.loaded_scene import LoadedForces, LoadedScene, press_with_enough_points
from solver.contact.path import Path
from solver.contact.states import PathPoint, StoppedError
from solver.contact.tumours_anywhere import TumoursUnderLoad
from solver.contact.tumours_at_loads import WITHOUT_TUMOURS, find_changes, press_tumours
from solver.linalg.threads import limit_to_one_thread
from solver.results.evaluator import ProgressCallback, ignore_progress
from solver.results.film_charges import RATIO_FIELDS, compute_charge_ratio_fields, explain_null_charges
from solver.results.film_forces import compute_sensitivity_tolerance
from solver.results.load_limits import LargestLoad
from solver.results.refusals import is_round
from solver.results.result import LoadCurve, LoadRange
from solver.results.warnings import Note, explain_null_sensitivity

CHARGE_FIELDS = ("charge_inner", "charge_outer", "charge_inner_error", "charge_outer_error", *RATIO_FIELDS)
FINER_PATH_FACTOR = (
    1.2  # the finer mesh is pressed this much further than the limit on the coarser one, so that its own limit lies within
)


def compute_load_curve(
    scene: Scene, loads: Floats, accuracy: float, *, by_force: bool, progress: ProgressCallback = ignore_progress
) -> LoadCurve:
    """Press a scene to each of several loads and return the curve; see ``solver.evaluation.press``.

    Parameters
    ----------
    scene
        A scene that evaluator ``contact`` supports; its own load does not matter.
    loads
        Loads in rising order, N or m, shape (k,).
    accuracy
        Relative accuracy.
    by_force
        Whether loads are forces.
    progress
        Called with a line of text before each load.

    Raises
    ------
    Refusal
        The scene is not supported or too extreme, or the first load does not converge.
    LimitReached
        The first load exceeds the limits of memory or time.
    """
    start = perf_counter()
    evaluator, points, stopped = ContactEvaluator(), [], None
    with start_clock(), limit_to_one_thread():
        press = _prepare_press(evaluator, scene, accuracy, by_force)
        try:
            for k, load in enumerate(loads):
                progress(f"load {k + 1} of {len(loads)}, {load:.3g} {'N' if by_force else 'm'}")
                points.append(press(float(load)))
        except (StoppedError, LimitReached, Refusal) as fault:
            if not points:
                if not isinstance(fault, StoppedError):
                    raise
                load_entry = ("force", Words(f"{load:g} N")) if by_force else ("indentation", format_mm(float(load)))
                raise evaluator.build_stop_refusal(load_entry, fault, scene.contact.interface) from fault
            stopped = fault.allowed if isinstance(fault, Refusal) else str(fault)
    return _build_curve(scene, points, stopped=stopped, accuracy=accuracy, seconds=perf_counter() - start)


def _prepare_press(evaluator: ContactEvaluator, scene: Scene, accuracy: float, by_force: bool) -> Callable[[float], LoadedForces]:
    """Return a function that presses a scene to a force, N, or an indentation, m; loads have to rise."""
    if not is_round(scene):
        evaluator.check(scene)
        return partial(press_tumours, TumoursUnderLoad.from_scene(scene, accuracy), by_force=by_force)
    loaded = evaluator.prepare_scene(scene, accuracy)

    def press(load: float) -> LoadedForces:
        """Press the scene, with more contact points from a load on that needs them."""
        nonlocal loaded
        point, loaded = press_with_enough_points(loaded, partial(_press, load=load, by_force=by_force))
        return point

    return press


def _press(loaded: LoadedScene, load: float, by_force: bool) -> LoadedForces:
    """Press to a force, N, or to an indentation, m."""
    return loaded.press_to_force(load, "force") if by_force else loaded.press_to_indentation(load)


@dataclass(frozen=True)
class LoadEnds:
    """Loads at which the ratio and the log-sensitivity leave linear elasticity and the gap closes; None where unknown.

    See ``LoadLimits``; ``notes`` explain the unknown ones.
    """

    ratio: LargestLoad | None
    log_sensitivity: LargestLoad | None
    gap_closure: LargestLoad | None
    notes: tuple[Note, ...]


def find_load_ends(scene: Scene, accuracy: float) -> LoadEnds:
    """Find the load limits of a scene that evaluator ``contact`` supports, whatever its own load is.

    They are computed on the coarser of two meshes; the lowest limit of linear elasticity is computed on the finer one too.

    Raises
    ------
    Refusal
        See ``compute_load_curve``.
    """
    with start_clock(), limit_to_one_thread():
        if not is_round(scene):
            return _find_ends_off_axis(scene, accuracy)
        loaded = ContactEvaluator().prepare_scene(scene, accuracy)
        closure, notes = _find_closure(loaded)
        changes = list(_list_changes(loaded, scene, accuracy))
        limits = {change.quantity: change.find_load(loaded.paths[0]) for change in changes}
        first = min(changes, key=lambda change: getattr(limits[change.quantity], "force", math.inf))
        limits[first.quantity] = _refine_limit(loaded, first, limits[first.quantity])
    for change in changes:
        if limits[change.quantity] is None:
            reached = f"up to {loaded.paths[0].last.force:.3g} N, as far as is known"
            notes.append(
                Note("linear", f"{change.quantity} stays within {format_percent(change.allowed)} of linear elasticity {reached}")
            )
    return LoadEnds(limits["ratio"], limits.get("log_sensitivity"), closure, tuple(notes))


def _find_ends_off_axis(scene: Scene, accuracy: float) -> LoadEnds:
    """Find the load limits of a scene with tumours off the axis; the gap closes as it does without them."""
    ContactEvaluator().check(scene)
    under_load = TumoursUnderLoad.from_scene(scene, accuracy)
    limits, notes = find_changes(under_load, accuracy)
    closure, closure_notes = _find_closure(under_load.tissue.loaded)
    note = Note("linear", "gap_closure_load is that without tumours")
    return LoadEnds(limits["ratio"], limits.get("log_sensitivity"), closure, (*notes, *(closure_notes or [note])))


@dataclass(frozen=True)
class _LimitChange:
    """A value that the load may change by a relative amount before linear elasticity counts as exceeded.

    Attributes
    ----------
    quantity
        Name of the value.
    value
        Function that returns it at a point of a path.
    allowed
        Allowed relative change.
    """

    quantity: str
    value: Callable[[Path, PathPoint], float]
    allowed: float

    def find_load(self, path: Path) -> LargestLoad | None:
        """Find the load on a path at which the value has changed by the allowed amount.

        None if there is no such load, or if it cannot be narrowed down.
        """
        with suppress(SolveError, LimitReached):
            return find_change_load(path, partial(self.value, path), self.allowed, self.quantity)
        return None


def _list_changes(loaded: LoadedScene, scene: Scene, accuracy: float) -> Iterator[_LimitChange]:
    """Yield the values that limit linear elasticity: the ratio, and the log-sensitivity of a scene with a target."""
    read = loaded.read_outputs
    yield _LimitChange("ratio", lambda path, point: read.compute_ratio(point), accuracy)
    fine = loaded.paths[1]  # the finer of two meshes
    rest_sensitivity = abs(read.compute_sensitivity(fine, fine.points[0])) if scene.target is not None else 0.0
    if rest_sensitivity:
        tolerance = float(compute_sensitivity_tolerance(accuracy, rest_sensitivity))
        yield _LimitChange("log_sensitivity", read.compute_sensitivity, tolerance / rest_sensitivity)


def _refine_limit(loaded: LoadedScene, change: _LimitChange, coarse: LargestLoad | None) -> LargestLoad | None:
    """Find a limit again on the finer mesh, pressed somewhat further than ``coarse``, the limit on the coarser mesh.

    Where the finer mesh shows none, the limit on the coarser mesh is returned.
    """
    if coarse is None:
        return None
    with suppress(SolveError, LimitReached):
        loaded.paths[1].press_to_indentation(FINER_PATH_FACTOR * coarse.indentation)
    return change.find_load(loaded.paths[1]) or coarse


def _find_closure(loaded: LoadedScene) -> tuple[LargestLoad | None, list[Note]]:
    """Find the load that closes the gap, or explain in a note why none is known."""
    path = loaded.paths[0]
    reason = "where the indentation is the probe's outer radius"
    try:
        limit = find_gap_closure_load(path)
        if limit is not None:
            return limit, []
    except (SolveError, LimitReached) as fault:
        reason = str(fault)
    state = "touch, but no step before that converges" if is_gap_closed(path) else f"are apart up to {path.last.force:.3g} N"
    return None, [Note("linear", f"gap_closure_load is null: the walls {state}, {reason}")]


def _build_curve(scene: Scene, points: list[LoadedForces], *, stopped: str | None, accuracy: float, seconds: float) -> LoadCurve:
    """Build the curve from the results at each load; ``stopped`` is the reason why it ends early, or None."""
    probe = scene.probe
    areas = np.array([probe.inner_area, probe.outer_area])
    stiffness = [float(point.films.totals.sum()) for point in points]
    depth = [point.point.indentation for point in points]
    stress = np.array([point.films.totals * d / areas for point, d in zip(points, depth, strict=True)])
    ratio = [float(point.films.totals[0] / point.films.totals[1] * areas[1] / areas[0]) for point in points]
    force = [k * d for k, d in zip(stiffness, depth, strict=True)]
    warnings = [] if scene.target is not None else [explain_null_sensitivity(len(scene.inclusion))]
    observable = scene.observable
    charges, notes = _build_charge_columns(scene, points, depth)
    warnings += notes
    error = tuple(point.films.ratio_error for point in points)
    read, read_errors = (charges["charge_ratio"], charges["charge_ratio_error"]) if observable == "charge" else (ratio, error)
    worst = max((value for value in read_errors or () if value is not None), default=0.0)
    if worst > accuracy:
        warnings.append(
            Note(
                "accuracy",
                f"error bounds reach {format_percent(worst)}, above the requested accuracy of {format_percent(accuracy, 6)}",
            )
        )
    if scene.load.preload:
        warnings.append(Note("linear", "load.preload is left out: the curve is of presses from zero to each load"))
    if not is_round(scene):
        warnings.append(Note("linear", WITHOUT_TUMOURS))
    if stopped is not None:
        warnings.append(Note("limit", f"the curve ends early: {stopped}"))

    def collect(name: str) -> tuple[float, ...]:
        """Return one quantity of the path's points at all loads."""
        return tuple(float(getattr(point.point, name)) for point in points)

    return LoadCurve(
        "contact",
        seconds,
        tuple(force),
        tuple(depth),
        tuple(ratio),
        tuple(point.films.log_sensitivity for point in points),
        stiffness=tuple(stiffness),
        tangent_stiffness=tuple(float(point.point.tangent.sum()) for point in points),
        stress_inner=tuple(stress[:, 0].tolist()),
        stress_outer=tuple(stress[:, 1].tolist()),
        closest_walls=collect("walls"),
        contact_radius=collect("contact_radius"),
        largest_strain=collect("strain"),
        error_estimate=error,
        constant_ratio=_find_constant_range(np.array(force), read or (), accuracy),
        accuracy=accuracy,
        stopped=stopped,
        **charges,
        observable=observable,
        warnings=tuple(warnings),
    )


def _build_charge_columns(scene: Scene, points: list[LoadedForces], depth: list[float]) -> tuple[JsonObject, list[Note]]:
    """Return the fields of a ``LoadCurve`` that concern charges, all None without charges, and notes on missing ones.

    ``depth`` holds the indentations of the points, m.
    """
    notes = dict.fromkeys(note for point in points for note in explain_null_charges("contact", scene, point.films))
    films_at_loads = [point.films.find_charges(scene) for point in points]
    charges = [
        (films.totals * d, films.relative_errors) for films, d in zip(films_at_loads, depth, strict=True) if films is not None
    ]
    if len(charges) < len(points):
        return dict.fromkeys(CHARGE_FIELDS), list(notes)
    rows = [compute_charge_ratio_fields(scene, point.films) for point in points]
    columns: JsonObject = {name: tuple(row[name] for row in rows) for name in RATIO_FIELDS}
    for k, name in enumerate(("charge_inner", "charge_outer")):
        columns[name] = tuple(float(values[k]) for values, _ in charges)
        columns[f"{name}_error"] = tuple(float(errors[k]) for _, errors in charges)
    return columns, list(notes)


def _find_constant_range(force: Floats, values: Sequence[float | None], tolerance: float) -> LoadRange | None:
    """Find the widest range between two of the forces in which a ratio stays within ``tolerance``, relative.

    None also where the ratio is not known at all loads.
    """
    best: LoadRange | None = None
    if len(values) < len(force) or any(value is None for value in values):
        return None
    ratio = np.array(values, dtype=float)
    for low in range(len(force)):
        ratios = ratio[low:]
        spread = np.maximum.accumulate(ratios) / np.minimum.accumulate(ratios)
        high = low + int(np.flatnonzero(spread <= (1 + tolerance) / (1 - tolerance))[-1])
        if high > low and (best is None or force[high] - force[low] > best.high - best.low):
            best = LoadRange(tolerance, float(force[low]), float(force[high]))
    return best
