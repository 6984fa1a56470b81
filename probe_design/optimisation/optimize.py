"""The design loop: search on the closed form, re-rank by finite elements, polish by their derivatives, press harder if asked."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace

from geometry.common.arrays import Floats
from geometry.common.errors import InputError, Refusal, SolveError, describe_choices
from geometry.scenes.scene import Scene
from probe_design.data.noise import DEFAULT_NOISE
from probe_design.optimisation.candidate import (
    FINER_ACCURACY,
    Candidate,
    evaluate_candidate,
    evaluate_closed_form,
    merge_candidates,
)
from probe_design.optimisation.design_space import Space, build_space
from probe_design.optimisation.global_search import search_designs
from probe_design.optimisation.loaded_candidate import CONTACT_EVALUATOR, evaluate_by_contact, needs_contact, optimize_load
from probe_design.optimisation.loaded_search import evaluate_loaded_candidates, remove_load_limit, restore_load
from probe_design.optimisation.local_search import refine_by_finite_elements
from probe_design.optimisation.objective import Noise
from probe_design.optimisation.optimum import Optimum
from probe_design.optimisation.pressing import check_load
from solver import evaluator

MAX_CANDIDATES = 10
JUDGE_EVALUATORS = ("axisymmetric", "equivalent-inclusion")
REFINED_CANDIDATES = 3  # of the best candidates
Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class SearchRun:
    """What one optimisation judges by, and whom it tells."""

    design_space: Space
    noise: Noise
    judge: str
    progress: Progress


def optimize(
    scene: Scene, progress: Progress, *, outer_radius: float | None = None, starts: int = 8, judge: str | None = None,
    noise: float = DEFAULT_NOISE,
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
    run = SearchRun(build_space(scene, outer_radius), Noise.from_scene(scene, noise), _select_judge(scene, judge), progress)
    progress("judging the start", 0, 1)
    baseline = evaluate_candidate(scene, run.noise, run.judge)
    progress("judging the start", 1, 1)
    candidates = _search_candidates(run, starts)
    if any(map(needs_contact, (baseline, *candidates))):
        candidates = merge_candidates((*candidates, *_search_loaded(run, scene, starts)))
        baseline = _press_baseline(run, baseline, candidates)
    return _build_optimum(run, baseline, candidates)


def _search_candidates(run: SearchRun, starts: int) -> tuple[Candidate, ...]:
    """Search, judge and polish under loads that linear elasticity answers for; best first."""
    stage = "searching with the closed form"
    designs = search_designs(run.design_space, run.noise, starts, lambda done, total: run.progress(stage, done, total))
    candidates = merge_candidates(_evaluate_scenes(run, _build_workshop_scenes(run.design_space, designs)))
    return merge_candidates((*candidates, *_refine_candidates(run, candidates[:REFINED_CANDIDATES])))


def _select_judge(scene: Scene, name: str | None) -> str:
    if name is None:
        return next(
            (evaluator_name for evaluator_name in JUDGE_EVALUATORS if evaluator(evaluator_name).refusal(scene) is None),
            JUDGE_EVALUATORS[0],
        )
    if name not in JUDGE_EVALUATORS:
        raise InputError("evaluator", name, f"to judge designs {describe_choices(name, JUDGE_EVALUATORS)}")
    return name


def _build_workshop_scenes(design_space: Space, designs: Floats) -> list[Scene]:
    scenes: list[Scene] = []
    for design in designs.T:
        scene = design_space.build_scene(design)
        if scene is not None and scene not in scenes:
            scenes.append(scene)
        if len(scenes) == MAX_CANDIDATES:
            break
    return scenes


def _evaluate_scenes(run: SearchRun, scenes: list[Scene]) -> Iterator[Candidate]:
    stage = f"judging candidates by {run.judge}"
    for k, (scene, formula) in enumerate(zip(scenes, evaluate_closed_form(scenes), strict=True)):
        run.progress(stage, k, len(scenes))
        with suppress(Refusal):  # a design that cannot be judged is no candidate
            yield evaluate_candidate(scene, run.noise, run.judge, formula=formula)
    run.progress(stage, len(scenes), len(scenes))


def _refine_candidates(run: SearchRun, best: tuple[Candidate, ...]) -> Iterator[Candidate]:
    stage = f"polishing by {run.judge}"
    for k, item in enumerate(best):
        run.progress(stage, k, len(best))
        with suppress(Refusal, SolveError):  # what cannot be differentiated stays as it is
            scene = run.design_space.build_scene(
                refine_by_finite_elements(run.design_space, run.noise, item.scene, item.wall_approach, run.judge)
            )
            if scene is not None:
                yield evaluate_candidate(scene, run.noise, run.judge)
    run.progress(stage, len(best), len(best))


def _search_loaded(run: SearchRun, scene: Scene, starts: int) -> Iterator[Candidate]:
    """Designs for which the load is a variable: found without a limit of it, judged under the best up to the scene's."""
    found_candidates = _search_candidates(
        replace(
            run, design_space=replace(run.design_space, scene=remove_load_limit(scene)), progress=_label_progress(run.progress)
        ),
        starts,
    )
    for item in found_candidates:
        with suppress(Refusal):
            yield restore_load(item, scene, run.noise, run.judge)
    yield from evaluate_loaded_candidates(
        scene, found_candidates, run.design_space, run.noise, judge=run.judge, progress=run.progress
    )


def _label_progress(progress: Progress) -> Progress:
    return lambda stage, done, total: progress(f"{stage}, at any load", done, total)


def _press_baseline(run: SearchRun, baseline: Candidate, candidates: tuple[Candidate, ...]) -> Candidate:
    """Return the initial design under its best load up to the scene's.

    Where the best candidate is evaluated by ``contact``, so is the initial design: both then have errors of the same model.
    """
    run.progress("pressing the start by contact", 0, 1)
    loaded = optimize_load(baseline, run.noise)
    if loaded is baseline and candidates and candidates[0].judged.evaluator == CONTACT_EVALUATOR:
        loaded = evaluate_by_contact(baseline, run.noise)
    run.progress("pressing the start by contact", 1, 1)
    return loaded


def _build_optimum(run: SearchRun, baseline: Candidate, candidates: tuple[Candidate, ...]) -> Optimum:
    """Whether a gain is beyond what errors can feign: where they hide it, start and best are judged once more, more finely."""
    hidden = (
        candidates and candidates[0].judged_objective < baseline.judged_objective and not candidates[0].is_better_than(baseline)
    )
    if hidden and baseline.linear is None and candidates[0].linear is None:
        with suppress(Refusal):
            baseline, best = (
                evaluate_candidate(item.scene, run.noise, run.judge, FINER_ACCURACY) for item in (baseline, candidates[0])
            )
            candidates = merge_candidates((best, *candidates[1:]))
    return Optimum(run.judge, run.design_space, run.noise, baseline, candidates)
