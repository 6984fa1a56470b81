"""Compute what the page shows at once: one design, curves around it and a map of detection, by the closed form on arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import InputError
from geometry.scenes.scene import Scene
from probe_design.explorer.formats import EVALUATOR, Reading
from probe_design.explorer.variables import Variable, get_value
from probe_design.maps.sphere_effects import Thresholds
from probe_design.maps.target_grid import choose_sizes, compute_free_radii
from solver import evaluate
from solver.closed_form.evaluator import ClosedForm, ClosedFormForces
from solver.linalg.workspace import Workspace, use_workspace
from solver.results.film_forces import FilmForces, compute_ratio_fields
from solver.results.result import Result

ACCURACY = 0.01  # relative, as for `evaluate`; the closed form does not depend on it
CURVE_POINTS = 7  # of each curve; the middle one is the present design, so that it is odd
CURVE_REACH = 1.6  # relative: a curve reaches this factor to both sides of the present value
OFFSET_REACH_RADII = 0.5  # outer radii: a curve over a lateral offset reaches so far to both sides
MAP_POINTS = 12  # depths and diameters of the map


@dataclass(frozen=True)
class Curve:
    """Outputs along one variable; refused designs are NaN.

    Attributes
    ----------
    variable
        What varies.
    x
        Its values, SI, shape (n,).
    outputs
        Values and errors of each output, shape (n, 2), by its name.
    """

    variable: Variable
    x: Floats
    outputs: dict[str, Floats]


@dataclass(frozen=True)
class DetectionMap:
    """Which tumours are detected over depth (rows) and diameter (columns).

    Attributes
    ----------
    depths, diameters
        m, shapes (k,) and (m,).
    verdicts
        1 detected, 0 not, 0.5 where the error of the formulas leaves it open; NaN where the tumour does not fit or is refused.
    """

    depths: Floats
    diameters: Floats
    verdicts: Floats


def evaluate_outputs(scene: Scene) -> dict[str, Reading]:
    """Return the outputs of the closed form with absolute errors: those of ``evaluate_with_limits``. Raises ``InputError``."""
    with use_workspace(Workspace()):  # the process's would keep what belongs to each of thousands of designs
        return list_readings(ClosedForm().evaluate(scene, ACCURACY), compute_sensitivity_error(scene))


def evaluate_with_limits(scene: Scene) -> Result:
    """Return ``evaluate(scene, "closed-form")``, whose limits of the load take five times as long as the outputs."""
    with use_workspace(Workspace()):
        return evaluate(scene, EVALUATOR, ACCURACY)


def list_readings(result: Result, sensitivity_error: float | None) -> dict[str, Reading]:
    """Return the outputs of a result with absolute errors, by name; charges only where the scene has films."""

    def scale(value: float | None, relative: float | None) -> Reading:
        """Return a value with the absolute error that follows from its relative one."""
        return Reading(value, None if value is None or relative is None else abs(value) * relative)

    readings = {
        "ratio": scale(result.ratio, result.error_estimate),
        "log_sensitivity": Reading(result.log_sensitivity, sensitivity_error),
        "stiffness": scale(result.stiffness, result.stiffness_error),
    }
    if result.charge_inner is not None:
        readings["charge_ratio"] = scale(result.charge_ratio, result.charge_ratio_error)
        readings["charge_inner"] = scale(result.charge_inner, result.charge_inner_error)
        readings["charge_outer"] = scale(result.charge_outer, result.charge_outer_error)
    return readings


def compute_sensitivity_error(scene: Scene) -> float | None:
    """Return the absolute error of the closed form's log-sensitivity; None where there is none."""
    solution = ClosedForm().compute_films([scene])[0]
    return None if isinstance(solution, InputError) else solution.films.sensitivity_error


def compute_curves(scene: Scene, variables: Sequence[Variable]) -> list[Curve]:
    """Return ratio, log-sensitivity, stiffness and charge ratio around a design along each variable; one evaluation for all."""
    grids = [_choose_grid(scene, variable) for variable in variables]
    designs = [
        _replace_or_none(scene, variable.key, x) for variable, grid in zip(variables, grids, strict=True) for x in grid.tolist()
    ]
    rows = iter(_compute_rows([design for design in designs if design is not None]))
    missing = dict.fromkeys(("ratio", "log_sensitivity", "stiffness", "charge_ratio"), (np.nan, np.nan))
    table = [missing if design is None else next(rows) for design in designs]
    curves = []
    for k, (variable, grid) in enumerate(zip(variables, grids, strict=True)):
        part = table[k * CURVE_POINTS : (k + 1) * CURVE_POINTS]
        curves.append(Curve(variable, grid, {name: np.array([row[name] for row in part]) for name in missing}))
    return curves


def compute_map(scene: Scene, thresholds: Thresholds) -> DetectionMap:
    """Return which spheres in the target's place are detected (eq. MA.1); the errors of both ratios count in full.

    Raises
    ------
    InputError
        The scene has no target, the noise is not allowed, or the formulas do not cover the scene without its target.
    """
    depths, diameters = choose_sizes(scene, MAP_POINTS)
    depth, diameter = (grid.ravel() for grid in np.meshgrid(depths, diameters, indexing="ij"))
    fits = diameter / 2 < compute_free_radii(scene, depth)
    index = scene.target or 0
    body, others = scene.inclusion[index], [item for k, item in enumerate(scene.inclusion) if k != index]
    places = np.flatnonzero(fits).tolist()
    bodies = [body.model_copy(update={"depth": float(depth[k]), "diameter": float(diameter[k])}) for k in places]
    scenes = [scene.model_copy(update={"inclusion": (*others, item)}) for item in bodies]
    solutions = ClosedForm().compute_films([scene.model_copy(update={"inclusion": tuple(others)}), *scenes])
    without, *spheres = [_find_log_ratio(scene, item) for item in solutions]
    verdicts = np.full(len(depth), np.nan)
    for k, (log_ratio, error) in zip(places, spheres, strict=True):
        change, total = abs(np.expm1(log_ratio - without[0])), error + without[1]
        low, high = change - total * (1 + change), change + total * (1 + change)
        if np.isfinite(change):
            verdicts[k] = 1.0 if low >= thresholds.min_change else 0.0 if high < thresholds.min_change else 0.5
    return DetectionMap(depths, diameters, verdicts.reshape(len(depths), len(diameters)))


def _choose_grid(scene: Scene, variable: Variable) -> Floats:
    """Return the values of a variable along its curve, SI, the present one in the middle."""
    value = get_value(scene, variable.key) or 0.0
    if variable.is_linear:
        reach = OFFSET_REACH_RADII * scene.probe.tube_radius
        return np.linspace(value - reach, value + reach, CURVE_POINTS)
    return np.asarray(value * np.geomspace(1 / CURVE_REACH, CURVE_REACH, CURVE_POINTS))


def _replace_or_none(scene: Scene, key: str, value: float) -> Scene | None:
    """Return the scene with another value, or None where it is refused."""
    try:
        return scene.replace({key: value})
    except InputError:
        return None


def _compute_rows(scenes: Sequence[Scene]) -> list[dict[str, tuple[float, float]]]:
    """Return values and absolute errors of each scene's outputs, NaN where the formulas refuse it."""
    rows = []
    for scene, solution in zip(scenes, ClosedForm().compute_films(scenes), strict=True):
        row = dict.fromkeys(("ratio", "log_sensitivity", "stiffness", "charge_ratio"), (np.nan, np.nan))
        if isinstance(solution, ClosedFormForces):
            films, charges = solution.films, solution.films.find_charges(scene)
            total = float(films.totals.sum())
            row |= {"ratio": _find_ratio(scene, films), "stiffness": (total, total * films.stiffness_error)}
            if films.log_sensitivity is not None:
                row["log_sensitivity"] = (films.log_sensitivity, films.sensitivity_error)
            if charges is not None:
                row["charge_ratio"] = _find_ratio(scene, charges)
        rows.append(row)
    return rows


def _find_ratio(scene: Scene, films: FilmForces) -> tuple[float, float]:
    """Return the ratio of stresses or charges and its absolute error, NaN where it is not known."""
    fields = compute_ratio_fields(scene, films)
    if fields["ratio"] is None:
        return np.nan, np.nan
    return float(fields["ratio"]), float(fields["ratio"]) * films.ratio_error


def _find_log_ratio(scene: Scene, solution: ClosedFormForces | InputError) -> tuple[float, float]:
    """Return ln of the ratio that the scene reads, and the bound on its error; NaN where it is not known."""
    if isinstance(solution, InputError):
        return np.nan, np.nan
    films = solution.films.get_observable(scene)
    ratio, _ = _find_ratio(scene, films)
    return (float(np.log(ratio)), films.bound.log_ratio) if ratio > 0 else (np.nan, np.nan)
