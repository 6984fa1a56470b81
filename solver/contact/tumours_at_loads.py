"""Press scenes with tumours off the axis, several tumours or ellipsoids to many loads; see ``tumours_anywhere.py``."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from geometry.common.errors import Refusal, SolveError
from geometry.common.percent import format_percent
from solver.contact.limits import CLOSED_GAP_RELATIVE
from solver.contact.loaded_scene import LoadedForces
from solver.contact.tumours_anywhere import SEARCHED_X, TumoursUnderLoad
from solver.results.film_forces import FilmForces, compute_sensitivity_tolerance
from solver.results.load_limits import LargestLoad
from solver.results.warnings import Note

GRID_INDENTATIONS_RELATIVE = np.geomspace(0.01, SEARCHED_X, 9)  # outer radii: between two of them a change is narrowed down
BISECTIONS = 4  # of the interval between two of those, whose ends are 1.6 times apart: to 3 %
WITHOUT_TUMOURS = "closest_walls, contact_radius, largest_strain and tangent_stiffness are those without tumours"


def press_tumours(under_load: TumoursUnderLoad, load: float, by_force: bool) -> LoadedForces:
    """Press to a force, N, or to an indentation, m; return the film forces, with the tissue's state without tumours.

    For errors see ``TissueUnderLoad.press``.
    """
    force = load if by_force else under_load.convert_to_force(load, ("indentation", f"{1e3 * load:g} mm"))
    if under_load.is_light(force):
        bare, films = under_load.tissue.loaded.press_to_force(force), under_load.solution.films
    else:
        pressed, films = under_load.press(force, ("force", f"{force:g} N") if by_force else None)
        bare = pressed.bare
    return LoadedForces(replace(bare.point, indentation=force / float(films[0].totals.sum())), films[0])


def find_changes(under_load: TumoursUnderLoad, accuracy: float) -> tuple[dict[str, LargestLoad | None], list[Note]]:
    """Find the loads at which ratio and log-sensitivity leave linear elasticity; see ``load_curve.find_load_ends``."""
    scene, linear = under_load.scene, under_load.solution.films[0]
    changes = [_Change("ratio", lambda films: float(np.divide(*films.get_observable(scene).totals)), accuracy, linear)]
    sensitivity = abs(linear.get_observable(scene).log_sensitivity or 0.0)
    if sensitivity:
        allowed = float(compute_sensitivity_tolerance(accuracy, sensitivity)) / sensitivity
        get_sensitivity = lambda films: films.get_observable(scene).log_sensitivity or 0.0  # noqa: E731
        changes.append(_Change("log_sensitivity", get_sensitivity, allowed, linear))
    points = list[tuple[float, FilmForces]]()
    for point in _press_grid(under_load):
        points.append(point)
        if all(change.has_ended(point[1]) for change in changes):
            break
    limits = {change.quantity: _narrow(under_load, points, change) for change in changes}
    notes = []
    for change in changes:
        if limits[change.quantity] is None:
            reached = f"up to {points[-1][0]:.3g} N, as far as is known" if points else "at no load that contact reaches"
            notes.append(
                Note("linear", f"{change.quantity} stays within {format_percent(change.allowed)} of linear elasticity {reached}")
            )
    return limits, notes


@dataclass(frozen=True)
class _Change:
    """A quantity, the function that returns it, the relative change that is allowed, and the linear film forces."""

    quantity: str
    compute: Callable[[FilmForces], float]
    allowed: float
    linear: FilmForces

    def has_ended(self, films: FilmForces) -> bool:
        """Return whether the quantity has changed by more than is allowed."""
        return abs(self.compute(films) / self.compute(self.linear) - 1) > self.allowed


def _press_grid(under_load: TumoursUnderLoad) -> Iterator[tuple[float, FilmForces]]:
    """Yield forces, N, in rising order and the film forces there, as far as no step fails and the gap is open."""
    path = under_load.tissue.loaded.paths[0]
    with suppress(SolveError, Refusal):
        for x in GRID_INDENTATIONS_RELATIVE:
            point = path.press_to_indentation(x * path.radius)
            if point.walls <= CLOSED_GAP_RELATIVE * path.points[0].walls:
                return
            yield point.force, under_load.press(point.force)[1][0]


def _narrow(under_load: TumoursUnderLoad, points: list[tuple[float, FilmForces]], change: _Change) -> LargestLoad | None:
    """Return the largest load before the first of the points at which a quantity is changed; None if it is at none."""
    number = next((k for k, (_, films) in enumerate(points) if change.has_ended(films)), None)
    if number is None:
        return None
    low, high = points[number - 1] if number else (0.0, change.linear), points[number]
    for _ in range(BISECTIONS):
        force = (low[0] + high[0]) / 2
        middle = force, under_load.press(force)[1][0]
        low, high = (low, middle) if change.has_ended(middle[1]) else (middle, high)
    return LargestLoad(low[0], low[0] / float(low[1].totals.sum()), change.quantity)
