"""The design loop: search on the closed form, re-rank by finite elements, export what won."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Literal

from geometry.errors import InputError, Refusal
from geometry.grading import Floats
from geometry.scene import Scene
from probe_design.objective import objective_of
from probe_design.search import search
from probe_design.space import Space, space
from solver import Result, evaluate

CANDIDATES = 10
JUDGE = "axisymmetric"
ACCURACY = 0.01  # of the judge; its log-sensitivity, and so the objective, is good to 5 times that
Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Candidate:
    """A design with what two levels say of it.

    Attributes:
        scene: the scene with this probe.
        searched, judged: the closed form's and the judge's results; the former is None where the formulas refuse.
        searched_objective, judged_objective: standard deviations of ln E_object, smaller is better.
    """

    scene: Scene
    searched: Result | None
    judged: Result
    searched_objective: float
    judged_objective: float


@dataclass(frozen=True)
class Optimum:
    """What an optimisation found.

    Attributes:
        status: ``improved``, or ``no-gain`` if the judge does not see the gain beyond its own error.
        baseline: the start.
        candidates: the re-ranked designs, best first.
    """

    status: Literal["improved", "no-gain"]
    baseline: Candidate
    candidates: tuple[Candidate, ...]

    @property
    def best(self) -> Candidate:
        """The design to build: the start itself where nothing beats it."""
        return self.candidates[0] if self.status == "improved" else self.baseline


def optimize(scene: Scene, progress: Progress, outer_radius: float | None = None, starts: int = 8) -> Optimum:
    """Find a better probe for a scene with one target on the probe's axis.

    Args:
        scene: the start; its tissue, inclusion, contact and load stay.
        progress: called with a stage's name, the steps done and their number.
        outer_radius: limit of the outer radius in m; 1.4 times the start's by default.
        starts: how many local searches IPOPT makes.

    Raises:
        InputError: the scene has no target, or leaves no room for a design.
        Refusal: closed form or judge cannot take the scene.
    """
    if scene.target is None:
        raise InputError(
            "inclusion.target", "none", "one inclusion, or one of several marked target = true: its modulus is to be told"
        )
    room = space(scene, outer_radius)
    progress("judging the start", 0, 1)
    baseline = _candidate(scene)
    progress("judging the start", 1, 1)
    designs = search(room, starts, lambda done, total: progress("searching with the closed form", done, total))
    candidates = _judged(_workshop_scenes(room, designs), progress)
    gained = bool(candidates) and candidates[0].judged_objective < baseline.judged_objective * (1 - 5 * ACCURACY) / (
        1 + 5 * ACCURACY
    )
    return Optimum("improved" if gained else "no-gain", baseline, candidates)


def _workshop_scenes(room: Space, designs: Floats) -> list[Scene]:
    scenes: list[Scene] = []
    for design in designs.T:
        scene = room.scene_of(design)
        if scene is not None and scene not in scenes:
            scenes.append(scene)
        if len(scenes) == CANDIDATES:
            break
    return scenes


def _judged(scenes: list[Scene], progress: Progress) -> tuple[Candidate, ...]:
    judged = []
    for k, scene in enumerate(scenes):
        progress(f"judging candidates by {JUDGE}", k, len(scenes))
        with suppress(Refusal):  # a design that cannot be judged is no candidate
            judged.append(_candidate(scene))
    progress(f"judging candidates by {JUDGE}", len(scenes), len(scenes))
    return tuple(sorted(judged, key=lambda candidate: candidate.judged_objective))


def _candidate(scene: Scene) -> Candidate:
    searched, judged = _searched(scene), evaluate(scene, JUDGE, ACCURACY)
    return Candidate(
        scene, searched, judged, math.inf if searched is None else objective_of(scene, searched), objective_of(scene, judged)
    )


def _searched(scene: Scene) -> Result | None:
    try:
        return evaluate(scene, "closed-form", ACCURACY)
    except Refusal:
        return None
