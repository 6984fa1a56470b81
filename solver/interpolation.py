"""Interpolate finite-element solutions within a family of scenes; the interpolation error is added to the error bounds."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import ProbeError
from geometry.common.resources import start_clock
from geometry.scenes.scene import Scene
from solver.families import Family
from solver.planning.load_limits import compute_rule_numbers
from solver.planning.loads import LoadRule
from solver.results.evaluator import FilmEvaluator, FilmSolution
from solver.results.film_forces import Bound, FilmForces, compute_sensitivity_tolerance, find_shortfalls

MAX_INTERPOLATION_SHARE = 0.01  # of the accuracy: the largest error that interpolation may add
MAX_RULE_ERROR_RELATIVE = 1e-3  # on the forces without tumours; the coarsest mesh, from which they come, is accurate to 5 % only
Pair = tuple[FilmSolution, LoadRule | None]


def interpolate_family(family: Family, scenes: Sequence[Scene], evaluator: FilmEvaluator, accuracy: float) -> list[Pair | None]:
    """Return the solution of each member, with its load rule where interpolated; None where the scene has to be solved alone.

    Parameters
    ----------
    family
        Which members are solved.
    scenes
        The members in order.
    evaluator
        The evaluator that solves them.
    accuracy
        As in ``evaluate``.
    """
    if scenes[0].probe.film is not None or scenes[0].tissue.shape != "cylinder":
        return [None] * len(scenes)  # details are decided for each
    exact: dict[int, FilmSolution] = {}
    pairs: list[Pair | None] = [None] * len(scenes)
    while True:
        wanted = [k for k in family.solved.tolist() if k not in exact]
        solutions = evaluator.solve_many([scenes[k] for k in wanted], [accuracy] * len(wanted))
        exact |= {k: solution for k, solution in zip(wanted, solutions, strict=True) if isinstance(solution, FilmSolution)}
        if len(exact) < len(family.solved) or any(solution.plan or solution.notes for solution in exact.values()):
            break
        pairs = _interpolate_members(family, scenes, [exact[k] for k in family.solved.tolist()], accuracy)
        if all(pairs) or family.finer_family is None:
            break
        family = family.finer_family
    return [(exact[k], pair and pair[1]) if k in exact else pair for k, pair in enumerate(pairs)]


def _interpolate_members(
    family: Family, scenes: Sequence[Scene], solutions: Sequence[FilmSolution], accuracy: float
) -> list[Pair | None]:
    """Interpolate all members from the solved ones; None where the error would exceed the accuracy."""
    rules = _interpolate_rules(family, scenes)
    films = _interpolate_films(family, [solution.films[0] for solution in solutions], accuracy)
    residual = max(solution.residual or 0.0 for solution in solutions)
    pairs: list[Pair | None] = [None] * len(scenes)
    for k, (scene, film) in enumerate(zip(scenes, films, strict=True)):
        if rules is not None and film is not None and not find_shortfalls(film, film.compute_max_error(scene), accuracy):
            pairs[k] = FilmSolution((film,), residual), rules[k]
    return pairs


def _interpolate_films(family: Family, solved_films: Sequence[FilmForces], accuracy: float) -> list[FilmForces | None]:
    """Interpolate the film forces of all members, with interpolation errors in their bounds; None where these are too large."""
    sensitive = solved_films[0].modulus_derivative is not None
    slopes = np.array(
        [np.zeros(4) if film.modulus_derivative is None else film.modulus_derivative.ravel() for film in solved_films]
    )
    sensitivity = np.array([[film.log_sensitivity or 0.0] for film in solved_films])
    totals = np.array([film.totals for film in solved_films])
    columns = [np.array([film.forces.ravel() for film in solved_films]), slopes, totals, sensitivity]
    values, errors = family.interpolate(np.hstack(columns))
    forces, slopes, totals, size = (part.T for part in np.split(values.T, [4, 8, 10]))
    total_errors = errors[:, 8:10] / np.abs(totals)
    max_sensitivity_error = MAX_INTERPOLATION_SHARE * compute_sensitivity_tolerance(accuracy, size)
    accurate = np.all(total_errors <= MAX_INTERPOLATION_SHARE * accuracy, axis=1) & np.all(
        errors[:, 10:] <= max_sensitivity_error, axis=1
    )
    bounds = family.extend_bounds(
        np.array([[*film.relative_errors, film.bound.log_ratio, film.sensitivity_error] for film in solved_films])
    )
    bounds += np.column_stack([total_errors, total_errors.sum(axis=1), errors[:, 10]])
    return [
        _build_film(forces[k], slopes[k] if sensitive else None, bounds[k], totals[k]) if accurate[k] else None
        for k in range(len(forces))
    ]


def _build_film(forces: Floats, slope: Floats | None, bounds: Floats, totals: Floats) -> FilmForces:
    bound = Bound(bounds[:2] * np.abs(totals), float(bounds[2]))
    return FilmForces(forces.reshape(2, 2), bound, None if slope is None else slope.reshape(2, 2), float(bounds[3]))


def _interpolate_rules(family: Family, scenes: Sequence[Scene]) -> list[LoadRule] | None:
    """Interpolate the load rule of each member; None where the rules are not smooth enough, or one is refused."""
    numbers = []
    try:
        for k in family.solved:
            with start_clock():
                totals, closure = compute_rule_numbers(scenes[k])
            numbers.append([*totals, closure])
    except ProbeError:
        return None
    if not (np.all(np.isfinite(numbers)) and np.all(np.array(numbers) > 0)):
        return None
    values, errors = family.interpolate(np.log(numbers))
    if np.max(errors) > MAX_RULE_ERROR_RELATIVE:
        return None
    return [
        LoadRule.from_totals(scene, np.exp(row[:2]), float(np.exp(row[2]))) for scene, row in zip(scenes, values, strict=True)
    ]
