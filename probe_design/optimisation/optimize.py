"""The design loop: search on the closed form, re-rank by finite elements, polish with their derivatives, export what won."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import Literal

from geometry.common.arrays import Floats
from geometry.common.errors import InputError, Refusal, SolveError
from geometry.scenes.scene import Scene
from probe_design.optimisation.design_space import Space, space
from probe_design.optimisation.global_search import search
from probe_design.optimisation.local_search import polish
from probe_design.optimisation.objective import objective_of
from solver import Result, evaluate, evaluator

CANDIDATES = 10
JUDGES = ("axisymmetric", "equivalent-inclusion")
POLISHED = 3  # of the best candidates
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
        judge: the evaluator that ranked the designs.
        baseline: the start.
        candidates: the re-ranked designs, best first.
    """

    status: Literal["improved", "no-gain"]
    judge: str
    baseline: Candidate
    candidates: tuple[Candidate, ...]

    @property
    def best(self) -> Candidate:
        """The design to build: the start itself where nothing beats it."""
        return self.candidates[0] if self.status == "improved" else self.baseline


def optimize(
    scene: Scene, progress: Progress, outer_radius: float | None = None, starts: int = 8, judge: str | None = None
) -> Optimum:
    """Find a better probe for a scene with a target.

    Args:
        scene: the start; its tissue, inclusion, contact and load stay.
        progress: called with a stage's name, the steps done and their number.
        outer_radius: limit of the outer radius in m; 1.4 times the start's by default.
        starts: how many local searches IPOPT makes.
        judge: one of ``JUDGES``, which ranks and polishes; by default the first that can take the scene.

    Raises:
        InputError: the scene has no target, or leaves no room for a design; no such judge.
        Refusal: closed form or judge cannot take the scene.
    """
    if scene.target is None:
        raise InputError(
            "inclusion.target", "none", "one inclusion, or one of several marked target = true: its modulus is to be told"
        )
    level = _judge(scene, judge)
    room = space(scene, outer_radius)
    progress("judging the start", 0, 1)
    baseline = _candidate(scene, level)
    progress("judging the start", 1, 1)
    designs = search(room, starts, lambda done, total: progress("searching with the closed form", done, total))
    candidates = _judged(_workshop_scenes(room, designs), level, progress)
    candidates = _ranked((*candidates, *_polished(room, candidates[:POLISHED], level, progress)))
    gained = bool(candidates) and candidates[0].judged_objective < baseline.judged_objective * (1 - 5 * ACCURACY) / (
        1 + 5 * ACCURACY
    )
    return Optimum("improved" if gained else "no-gain", level, baseline, candidates)


def _judge(scene: Scene, name: str | None) -> str:
    if name is None:
        return next((level for level in JUDGES if evaluator(level).refusal(scene) is None), JUDGES[0])
    if name not in JUDGES:
        raise InputError("evaluator", name, f"{' or '.join(JUDGES)} to judge designs")
    return name


def _workshop_scenes(room: Space, designs: Floats) -> list[Scene]:
    scenes: list[Scene] = []
    for design in designs.T:
        scene = room.scene_of(design)
        if scene is not None and scene not in scenes:
            scenes.append(scene)
        if len(scenes) == CANDIDATES:
            break
    return scenes


def _judged(scenes: list[Scene], judge: str, progress: Progress) -> tuple[Candidate, ...]:
    judged = []
    for k, scene in enumerate(scenes):
        progress(f"judging candidates by {judge}", k, len(scenes))
        with suppress(Refusal):  # a design that cannot be judged is no candidate
            judged.append(_candidate(scene, judge))
    progress(f"judging candidates by {judge}", len(scenes), len(scenes))
    return _ranked(judged)


def _ranked(candidates: Iterable[Candidate]) -> tuple[Candidate, ...]:
    return tuple(sorted(candidates, key=lambda candidate: candidate.judged_objective))


def _polished(room: Space, best: tuple[Candidate, ...], judge: str, progress: Progress) -> Iterator[Candidate]:
    stage = f"polishing by {judge}"
    for k, candidate in enumerate(best):
        progress(stage, k, len(best))
        with suppress(Refusal, SolveError):  # what cannot be differentiated stays as it is
            scene = room.scene_of(polish(room, candidate.scene, judge))
            if scene is not None and scene != candidate.scene:
                yield _candidate(scene, judge)
    progress(stage, len(best), len(best))


def _candidate(scene: Scene, judge: str) -> Candidate:
    searched, judged = _searched(scene), evaluate(scene, judge, ACCURACY)
    return Candidate(
        scene, searched, judged, math.inf if searched is None else objective_of(scene, searched), objective_of(scene, judged)
    )


def _searched(scene: Scene) -> Result | None:
    try:
        return evaluate(scene, "closed-form", ACCURACY)
    except Refusal:
        return None
