"""Fronts: the objective against what it costs, the outer radius, the force or the number of positions."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from geometry.common.errors import InputError, Refusal, one_of
from geometry.scenes.scene import Load
from probe_design.design_search.choices import Progress, choose
from probe_design.design_search.judging import judge
from probe_design.design_search.room import room
from probe_design.design_search.steered_population import SteeredDesigns
from probe_design.populations.design_file import Design

AGAINST = ("outer_radius", "force", "positions")
LABELS = {"outer_radius": "limit of the outer radius, mm", "force": "limit of the force, N", "positions": "positions of a scan"}
POINTS = 5
STEERED = 32  # tumours of a front's searches
LEAST = 0.5  # of the limit: where the front of radii begins


@dataclass(frozen=True)
class Point:
    """The best design at one cost: the cost in SI, the objective by the closed form and, of some, judged with its error."""

    at: float
    value: float
    judged: tuple[float, float] | None = None


@dataclass(frozen=True)
class Front:
    """The best that each cost brings; never less for more of it."""

    against: str
    points: tuple[Point, ...]

    @property
    def label(self) -> str:
        """The axis."""
        return LABELS[self.against]

    @property
    def shown(self) -> list[float]:
        """The costs in the label's unit."""
        return [one.at * (1e3 if self.against == "outer_radius" else 1.0) for one in self.points]

    def as_dict(self) -> dict[str, Any]:
        """Return the points as JSON has them."""
        return {"against": self.against, "points": [vars(one) for one in self.points]}


def front(design: Design, against: str, progress: Progress) -> Front:
    """Return a Pareto front; its ends are judged.

    Raises:
        InputError: there is no such cost.
    """
    if against not in AGAINST:
        raise InputError("pareto", against, one_of(against, AGAINST))
    points: list[Point] = []
    asked = list(_asked(design, against))
    for k, (at, one) in enumerate(asked):
        progress(k, len(asked))
        try:
            found = room(one)
            steered = SteeredDesigns.of(one, max(found.space.outer_radius, one.scene.probe.tube_radius), STEERED)
            best = choose(steered, found, lambda done, total: None).choices[0]
        except InputError:  # no room for a probe
            continue
        value = max([best.value, *(point.value for point in points)]) if against != "positions" else best.value
        points.append(Point(at, value))
        if k in (0, len(asked) - 1):
            points[-1] = _judged(one, steered, found.scene_of(best.design, best.combination), points[-1])
    progress(len(asked), len(asked))
    return Front(against, tuple(points))


def _asked(design: Design, against: str) -> Any:
    """Yield each cost, the smallest first, with the design file limited to it."""
    if against == "outer_radius":
        most = room(design).space.outer_radius
        for limit in np.linspace(LEAST * most, most, POINTS).tolist():
            yield limit, design.model_copy(update={"limits": design.limits.model_copy(update={"outer_radius": limit})})
    elif against == "force":
        most = design.limits.force or design.scene.load.force or 0.5
        for limit in np.geomspace(most / 100, most, POINTS).tolist():
            limits, scene = (
                design.limits.model_copy(update={"force": limit}),
                design.scene.model_copy(update={"load": Load(force=limit)}),
            )
            yield limit, design.model_copy(update={"limits": limits, "scene": scene})
    else:
        places = design.protocol.places
        most = len(places) - (len(places) + 1) % 2  # odd ones, which have one in the middle
        for count in sorted({1 + 2 * int(half) for half in np.linspace(0, (most - 1) // 2, POINTS).round()}):
            some = np.linspace(places.min(), places.max(), count) if count > 1 else np.array([places.mean()])
            protocol = design.protocol.model_copy(update={"positions": tuple(some.tolist())})
            yield float(count), design.model_copy(update={"protocol": protocol})


def _judged(design: Design, steered: SteeredDesigns, scene: Any, point: Point) -> Point:
    if scene is None:
        return point
    try:
        return replace(point, judged=judge(design, steered.rule, scene, progress=lambda done, total: None).value(design))
    except Refusal:
        return point
