"""Compute Pareto fronts: the best objective against a cost, which is outer radius, force or number of positions."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from geometry.common.errors import InputError, Refusal
from geometry.common.json_types import JsonObject
from geometry.scenes.scene_tables import Load
from probe_design.design_search.choices import Progress, search_combinations
from probe_design.design_search.population_study import PopulationStudy
from probe_design.design_search.search_space import build_search_space
from probe_design.populations.design_file import Design

COST_LABELS = {
    "outer_radius": "limit of the outer radius, mm",
    "force": "limit of the force, N",
    "positions": "positions of a scan",
}
POINTS_PER_FRONT = 5
SEARCH_TUMOURS = 32  # tumours in the searches for a front
MIN_RADIUS_FRACTION = 0.5  # of the limit: smallest radius of a front


@dataclass(frozen=True)
class Point:
    """The best design at one cost: the cost in SI, the objective by the closed form and, for some, verified with its error."""

    cost: float
    value: float
    verified: tuple[float, float] | None = None


@dataclass(frozen=True)
class Front:
    """The best objective at each cost, which is never worse at a larger one."""

    against: str
    points: tuple[Point, ...]

    @property
    def label(self) -> str:
        """Label of the axis."""
        return COST_LABELS[self.against]

    @property
    def costs(self) -> list[float]:
        """The costs in the label's unit."""
        return [point.cost * (1e3 if self.against == "outer_radius" else 1.0) for point in self.points]

    def as_dict(self) -> JsonObject:
        """Return the points as a JSON object."""
        points = [{"at": point.cost, "value": point.value, "judged": point.verified} for point in self.points]
        return {"against": self.against, "points": points}


def compute_front(design: Design, against: str, progress: Progress) -> Front:
    """Compute the best objective at several values of a cost; the first and the last are verified.

    Parameters
    ----------
    design
        The design file, of which one limit is varied.
    against
        The cost, a key of ``COST_LABELS``.
    progress
        Called with the number of costs done and of all.
    """
    points: list[Point] = []
    designs = list(_list_designs(design, against))
    for k, (cost, limited_design) in enumerate(designs):
        progress(k, len(designs))
        try:
            study = PopulationStudy.from_design(limited_design, lambda stage, done, total: None, SEARCH_TUMOURS)
            best = search_combinations(study.objective, study.search_space, _ignore).choices[0]
        except InputError:  # no probe fits
            continue
        # a design for a smaller limit is allowed within a larger one; scans at other positions are not comparable so
        value, sign = design.objective.convert_searched(best.value), design.objective.sign
        if against != "positions":
            value = sign * max([sign * value, *(sign * point.value for point in points)])
        points.append(Point(cost, value))
        if k in (0, len(designs) - 1):
            scene = study.search_space.build_scene(best.design, best.combination)
            with suppress(Refusal):
                verified = None if scene is None else study.verify(scene, _ignore, best).objective
                points[-1] = replace(points[-1], verified=verified)
    progress(len(designs), len(designs))
    return Front(against, tuple(points))


def _list_designs(design: Design, against: str) -> Iterator[tuple[float, Design]]:
    """Yield each cost, the smallest first, with the design file limited to it."""
    if against == "outer_radius":
        max_cost = build_search_space(design).outer_radius
        for limit in np.linspace(MIN_RADIUS_FRACTION * max_cost, max_cost, POINTS_PER_FRONT).tolist():
            yield limit, design.model_copy(update={"limits": design.limits.model_copy(update={"outer_radius": limit})})
    elif against == "force":
        max_cost = design.limits.force or design.scene.load.force or 0.5
        for limit in np.geomspace(max_cost / 100, max_cost, POINTS_PER_FRONT).tolist():
            limits = design.limits.model_copy(update={"force": limit})
            scene = design.scene.model_copy(update={"load": Load(force=limit)})
            yield limit, design.model_copy(update={"limits": limits, "scene": scene})
    else:
        places = design.protocol.places
        max_cost = len(places) - (len(places) + 1) % 2  # odd numbers, so that one position is in the middle
        for count in sorted({1 + 2 * int(half) for half in np.linspace(0, (max_cost - 1) // 2, POINTS_PER_FRONT).round()}):
            positions = np.linspace(places.min(), places.max(), count) if count > 1 else np.array([places.mean()])
            protocol = design.protocol.model_copy(update={"positions": tuple(positions.tolist())})
            yield float(protocol.count), design.model_copy(update={"protocol": protocol})


def _ignore(done: int, total: int) -> None:
    """Report no progress."""
