"""Interpolate finite-element solutions within a family of scenes; the interpolation error is added to the error bounds."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import ProbeError
from geometry.common.resources import timed
from geometry.scenes.scene import Scene
from solver.families import Family
from solver.planning.load_limits import rule_numbers
from solver.planning.loads import LoadRule
from solver.results.evaluator import Answer, FilmLevel
from solver.results.film_forces import Bound, FilmForces, shortfalls

SHARE = 0.01  # of the accuracy: the largest error that interpolation may add
RULE = 1e-3  # on the forces without tumours; the coarsest mesh, from which they come, is accurate to 5 % only
Pair = tuple[Answer, LoadRule | None]


def interpolated(family: Family, scenes: Sequence[Scene], level: FilmLevel, accuracy: float) -> list[Pair | None]:
    """Return the solution of each member, with its load rule where interpolated; None where the scene has to be solved alone.

    Args:
        family: which members are solved.
        scenes: the members in order.
        evaluator: the evaluator that solves them.
        accuracy: as in ``evaluate``.
    """
    if scenes[0].probe.film is not None or scenes[0].tissue.shape != "cylinder":
        return [None] * len(scenes)  # details are decided for each
    exact: dict[int, Answer] = {}
    pairs: list[Pair | None] = [None] * len(scenes)
    while True:
        wanted = [k for k in family.found.tolist() if k not in exact]
        found = level.answers([scenes[k] for k in wanted], [accuracy] * len(wanted))
        exact |= {k: one for k, one in zip(wanted, found, strict=True) if isinstance(one, Answer)}
        if len(exact) < len(family.found) or any(one.plan or one.notes for one in exact.values()):
            break
        pairs = _between(family, scenes, [exact[k] for k in family.found.tolist()], accuracy)
        if all(pairs) or family.finer is None:
            break
        family = family.finer
    return [(exact[k], pair and pair[1]) if k in exact else pair for k, pair in enumerate(pairs)]


def _between(family: Family, scenes: Sequence[Scene], found: Sequence[Answer], accuracy: float) -> list[Pair | None]:
    """Interpolate all members from the solved ones; None where the error would exceed the accuracy."""
    rules = _rules(family, scenes)
    films = _films(family, [one.films[0] for one in found], accuracy)
    residual = max(one.residual or 0.0 for one in found)
    pairs: list[Pair | None] = [None] * len(scenes)
    for k, (scene, film) in enumerate(zip(scenes, films, strict=True)):
        if rules is not None and film is not None and not shortfalls(film, film.error_under(scene), accuracy):
            pairs[k] = Answer((film,), residual), rules[k]
    return pairs


def _films(family: Family, found: Sequence[FilmForces], accuracy: float) -> list[FilmForces | None]:
    """Interpolate the film forces of all members, with interpolation errors in their bounds; None where these are too large."""
    sensitive = found[0].slope is not None
    slopes = np.array([np.zeros(4) if one.slope is None else one.slope.ravel() for one in found])
    sensitivity = np.array([[one.log_sensitivity or 0.0] for one in found])
    totals = np.array([one.totals for one in found])
    columns = [np.array([one.forces.ravel() for one in found]), slopes, totals, sensitivity]
    values, errors = family.spread(np.hstack(columns))
    forces, slopes, totals, size = (part.T for part in np.split(values.T, [4, 8, 10]))
    off = errors[:, 8:10] / np.abs(totals)
    most = SHARE * np.maximum(5 * accuracy * np.abs(size), 1e-5)
    good = np.all(off <= SHARE * accuracy, axis=1) & np.all(errors[:, 10:] <= most, axis=1)
    bounds = family.beside(np.array([[*one.relative_errors, one.bound.log_ratio, one.sensitivity_error] for one in found]))
    bounds += np.column_stack([off, off.sum(axis=1), errors[:, 10]])
    return [
        _film(forces[k], slopes[k] if sensitive else None, bounds[k], totals[k]) if good[k] else None for k in range(len(forces))
    ]


def _film(forces: Floats, slope: Floats | None, bounds: Floats, totals: Floats) -> FilmForces:
    bound = Bound(bounds[:2] * np.abs(totals), float(bounds[2]))
    return FilmForces(forces.reshape(2, 2), bound, None if slope is None else slope.reshape(2, 2), float(bounds[3]))


def _rules(family: Family, scenes: Sequence[Scene]) -> list[LoadRule] | None:
    """Interpolate the load rule of each member; None where the rules are not smooth enough, or one is refused."""
    numbers = []
    try:
        for k in family.found:
            with timed():
                totals, closure = rule_numbers(scenes[k])
            numbers.append([*totals, closure])
    except ProbeError:
        return None
    if not (np.all(np.isfinite(numbers)) and np.all(np.array(numbers) > 0)):
        return None
    values, errors = family.spread(np.log(numbers))
    if np.max(errors) > RULE:
        return None
    return [LoadRule.of(scene, np.exp(one[:2]), float(np.exp(one[2]))) for scene, one in zip(scenes, values, strict=True)]
