"""The design loop: search on the closed form, re-rank by finite elements, polish by their derivatives, press harder if asked."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace

from geometry.common.arrays import Floats
from geometry.common.errors import InputError, Refusal, SolveError, one_of
from geometry.scenes.scene import Scene
from probe_design.data.noise import NOISE
from probe_design.optimisation.candidate import FINER, Candidate, by_formulas, candidate, merged
from probe_design.optimisation.design_space import Space, space
from probe_design.optimisation.global_search import search
from probe_design.optimisation.loaded_candidate import CONTACT, asks_for_contact, by_contact, under_load
from probe_design.optimisation.loaded_search import limited, pressed, unlimited
from probe_design.optimisation.local_search import polish
from probe_design.optimisation.objective import Noise
from probe_design.optimisation.optimum import Optimum
from probe_design.optimisation.pressing import check_load
from solver import evaluator

CANDIDATES = 10
JUDGES = ("axisymmetric", "equivalent-inclusion")
POLISHED = 3  # of the best candidates
Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Judging:
    """What one optimisation judges by, and whom it tells."""

    room: Space
    noise: Noise
    judge: str
    progress: Progress


def optimize(
    scene: Scene, progress: Progress, *, outer_radius: float | None = None, starts: int = 8, judge: str | None = None,
    noise: float = NOISE,
) -> Optimum:  # fmt: skip
    """Find a better probe for a scene with a target.

    Args:
        scene: the start; its tissue, inclusion, contact and load stay.
        progress: called with a stage's name, the steps done and their number.
        outer_radius: limit of the outer radius in m; 1.4 times the start's by default.
        starts: how many local searches IPOPT makes.
        judge: one of ``JUDGE_EVALUATORS``, which ranks and polishes; by default the first that can take the scene.
        noise: relative standard deviation of one reading of the ratio.

    Raises:
        InputError: the scene has no target or a load of 0, or leaves no room for a design; no such judge or noise.
        Refusal: closed form or judge cannot take the scene.
    """
    if scene.target is None:
        raise InputError(
            "inclusion.target", "none", "one inclusion, or one of several marked target = true: its modulus is to be estimated"
        )
    check_load(scene)
    run = Judging(space(scene, outer_radius), Noise.of(scene, noise), _judge(scene, judge), progress)
    progress("judging the start", 0, 1)
    baseline = candidate(scene, run.noise, run.judge)
    progress("judging the start", 1, 1)
    candidates = _candidates(run, starts)
    if any(map(asks_for_contact, (baseline, *candidates))):
        candidates = merged((*candidates, *_loaded(run, scene, starts)))
        baseline = _start_under_load(run, baseline, candidates)
    return _decided(run, baseline, candidates)


def _candidates(run: Judging, starts: int) -> tuple[Candidate, ...]:
    """Search, judge and polish under loads that linear elasticity answers for; best first."""
    stage = "searching with the closed form"
    designs = search(run.room, run.noise, starts, lambda done, total: run.progress(stage, done, total))
    candidates = merged(_judged(run, _workshop_scenes(run.room, designs)))
    return merged((*candidates, *_polished(run, candidates[:POLISHED])))


def _judge(scene: Scene, name: str | None) -> str:
    if name is None:
        return next((level for level in JUDGES if evaluator(level).refusal(scene) is None), JUDGES[0])
    if name not in JUDGES:
        raise InputError("evaluator", name, f"to judge designs {one_of(name, JUDGES)}")
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


def _judged(run: Judging, scenes: list[Scene]) -> Iterator[Candidate]:
    stage = f"judging candidates by {run.judge}"
    for k, (scene, formula) in enumerate(zip(scenes, by_formulas(scenes), strict=True)):
        run.progress(stage, k, len(scenes))
        with suppress(Refusal):  # a design that cannot be judged is no candidate
            yield candidate(scene, run.noise, run.judge, formula=formula)
    run.progress(stage, len(scenes), len(scenes))


def _polished(run: Judging, best: tuple[Candidate, ...]) -> Iterator[Candidate]:
    stage = f"polishing by {run.judge}"
    for k, one in enumerate(best):
        run.progress(stage, k, len(best))
        with suppress(Refusal, SolveError):  # what cannot be differentiated stays as it is
            scene = run.room.scene_of(polish(run.room, run.noise, one.scene, one.nearing, run.judge))
            if scene is not None:
                yield candidate(scene, run.noise, run.judge)
    run.progress(stage, len(best), len(best))


def _loaded(run: Judging, scene: Scene, starts: int) -> Iterator[Candidate]:
    """Designs for which the load is a variable: found without a limit of it, judged under the best up to the scene's."""
    every = _candidates(replace(run, room=replace(run.room, scene=unlimited(scene)), progress=_at_any_load(run.progress)), starts)
    for one in every:
        with suppress(Refusal):
            yield limited(one, scene, run.noise, run.judge)
    yield from pressed(scene, every, run.room, run.noise, judge=run.judge, progress=run.progress)


def _at_any_load(progress: Progress) -> Progress:
    return lambda stage, done, total: progress(f"{stage}, at any load", done, total)


def _start_under_load(run: Judging, baseline: Candidate, candidates: tuple[Candidate, ...]) -> Candidate:
    """The start likewise; by ``contact`` too where the best design is, so that one level judges both."""
    run.progress("pressing the start by contact", 0, 1)
    found = under_load(baseline, run.noise)
    if found is baseline and candidates and candidates[0].judged.evaluator == CONTACT:
        found = by_contact(baseline, run.noise)
    run.progress("pressing the start by contact", 1, 1)
    return found


def _decided(run: Judging, baseline: Candidate, candidates: tuple[Candidate, ...]) -> Optimum:
    """Whether a gain is beyond what errors can feign: where they hide it, start and best are judged once more, more finely."""
    hidden = candidates and candidates[0].judged_objective < baseline.judged_objective and not candidates[0].beats(baseline)
    if hidden and baseline.linear is None and candidates[0].linear is None:
        with suppress(Refusal):
            baseline, best = (candidate(one.scene, run.noise, run.judge, FINER) for one in (baseline, candidates[0]))
            candidates = merged((best, *candidates[1:]))
    return Optimum(run.judge, run.room, run.noise, baseline, candidates)
