"""The design loop for a population: search by formulas, polish and judge by finite elements on tumours not seen before."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from time import perf_counter

import numpy as np

from geometry.common.errors import InputError, Refusal
from geometry.scenes.scene import Inclusion, Load, Scene
from probe_design.design_search.choices import Choice, ChoiceSearch, search_combinations
from probe_design.design_search.heights import drop_outer_height, get_outer_height
from probe_design.design_search.outcome import PopulationOptimum
from probe_design.design_search.refinement import refine_design
from probe_design.design_search.search_space import Combination, SearchSpace, build_search_space, is_admissible
from probe_design.design_search.steered_population import DesignObjective
from probe_design.design_search.verification import VerifiedDesign, verify_design
from probe_design.design_search.workshop import Robustness, compute_robustness
from probe_design.optimisation.design_space import SAME_DESIGN_TOLERANCE_RELATIVE, Space, is_same_design
from probe_design.optimisation.global_search import search_designs as search_single
from probe_design.optimisation.objective import Noise
from probe_design.optimisation.pressing import check_load
from probe_design.populations.design_file import Design
from probe_design.populations.population import ScenePopulation

Progress = Callable[[str, int, int], None]
MAX_CANDIDATES = 2  # designs that are judged, beside start and single-tumour optimum
MAX_TRIED = 100  # designs, the best first, of which these are taken
SINGLE_STARTS = 4
BOUNDS_WIDENING_RELATIVE = 1e-6  # relative


@dataclass(frozen=True)
class SearchCandidate:
    """A design as a workshop makes it, with what the closed form says of it as it is built."""

    scene: Scene
    choice: Choice
    robust: Robustness


def optimize(design: Design, progress: Progress | None = None) -> PopulationOptimum:
    """Find the probe that is best for a design file's population.

    Args:
        design: see ``populations.design_file.read_design``.
        progress: called with a stage's name, the steps done and their number.

    Raises:
        InputError: the file leaves no design to choose, a load of 0, or a population that does not fit the tissue.
        Refusal: the evaluators cannot take the scene.
    """
    tell = progress or (lambda stage, done, total: None)
    begin = perf_counter()
    check_load(design.scene)
    search_space = build_search_space(design)
    tell("drawing the population", 0, 1)
    steered = DesignObjective.from_design(design, max(search_space.space.outer_radius, design.scene.probe.tube_radius))
    tell("drawing the population", 1, 1)
    start = verify_design(design, steered.rule, design.scene, progress=partial(tell, "judging the start"))
    searching = perf_counter()
    chosen = search_combinations(steered, search_space, partial(tell, "searching with the closed form"))
    finalists = _select_candidates(steered, design, search_space, chosen, tell)
    searched = perf_counter()
    single, reason = _design_for_one_tumour(design, steered, search_space, tell)
    pairs = [*_verify_candidates(steered, design, finalists, tell), *([] if single is None else [single])]
    judged = sorted(pairs, key=lambda pair: -_compute_rank(design, *pair))
    end = perf_counter()
    return PopulationOptimum(
        design=design,
        search_space=search_space,
        start=start,
        single=None if single is None else single[0],
        finalists=tuple(verified for verified, _ in judged),
        robust=(compute_robustness(steered, design, design.scene, ()), *(robust for _, robust in judged)),
        how=chosen.how,
        exhaustive=chosen.exhaustive,
        best_of=chosen.best,
        seconds={"search": searched - searching, "judge": end - searched + searching - begin, "all": end - begin},
        why_no_single=reason,
    )


def _compute_rank(design: Design, verified: VerifiedDesign, robust: Robustness) -> float:
    """Return the verified objective minus the loss by workshop tolerances, the latter by the closed form."""
    return verified.get_objective(design)[0] + robust.expected - robust.nominal


def _select_candidates(
    steered: DesignObjective, design: Design, search_space: SearchSpace, chosen: ChoiceSearch, tell: Progress
) -> list[SearchCandidate]:
    """Select the best designs that differ, rounded to what a workshop makes; the first is refined before."""
    first = chosen.choices[0]
    better = refine_design(steered, design, search_space, first, partial(tell, "polishing by equivalent-inclusion"))
    order = ([] if better is None else [better]) + list(chosen.choices)
    finalists: list[SearchCandidate] = []
    for choice in order[:MAX_TRIED]:
        scene = search_space.build_scene(choice.design, choice.combination)
        if (
            scene is None
            or not is_admissible(search_space, scene)
            or any(_is_same_probe(scene, candidate.scene) for candidate in finalists)
        ):
            continue
        try:
            steered.rule.compute_pressed_design(scene)
        except Refusal:  # finite elements see a film pulled on where the formulas do not, or cannot solve it
            continue
        finalists.append(SearchCandidate(scene, choice, compute_robustness(steered, design, scene, choice.combination.materials)))
        if len(finalists) == MAX_CANDIDATES:
            break
    return finalists


def _is_same_probe(first: Scene, second: Scene) -> bool:
    heights = first.probe.tube_height, second.probe.tube_height
    poisson = first.probe.inner.poisson_ratio == second.probe.inner.poisson_ratio
    return is_same_design(first, second) and abs(heights[0] / heights[1] - 1) <= SAME_DESIGN_TOLERANCE_RELATIVE and poisson


def _verify_candidates(
    steered: DesignObjective, design: Design, finalists: list[SearchCandidate], tell: Progress
) -> Iterator[tuple[VerifiedDesign, Robustness]]:
    for k, candidate in enumerate(finalists):
        stage = f"judging finalist {k + 1} of {len(finalists)}"
        with suppress(Refusal):  # a design that cannot be judged is none
            combination = candidate.choice.combination
            judged = verify_design(
                design,
                steered.rule,
                candidate.scene,
                progress=partial(tell, stage),
                combination=combination.description,
                materials=combination.materials,
            )
            yield judged, candidate.robust


def _design_for_one_tumour(
    design: Design, steered: DesignObjective, search_space: SearchSpace, tell: Progress
) -> tuple[tuple[VerifiedDesign, Robustness] | None, str]:
    """Design and verify a probe for one tumour in the middle of the population; return it, or None and the reason.

    It is a candidate like those of the search: where it is verified to be the best, it is recommended.
    """
    stage = "designing for one tumour"
    try:
        scene = build_middle_scene(design)
        noise = Noise.from_scene(scene, max(design.noise.white, 1e-6))
        six = _widen_bounds(drop_outer_height(search_space.space))
        designs = search_single(six, noise, SINGLE_STARTS, partial(tell, stage)) if search_space.list_free_variables() else None
        made = None if designs is None else _find_nearest_scene(search_space, designs)
        if made is None:
            return None, "no variable left to choose" if designs is None else "no design for one tumour within the limits"
        scene, chosen = made
        advance = partial(tell, "judging the design for one tumour")
        judged = verify_design(
            design, steered.rule, scene, progress=advance, combination=chosen.description, materials=chosen.materials
        )  # fmt: skip
        return (judged, compute_robustness(steered, design, scene, chosen.materials)), ""
    except (Refusal, InputError) as fault:
        return None, str(fault)


def _widen_bounds(space: Space) -> Space:
    """Widen bounds that coincide by a tiny amount, as scaling a Sobol sequence needs a positive width."""
    held = space.low >= space.high * (1 - BOUNDS_WIDENING_RELATIVE)
    low, high = (
        np.where(held, space.low * (1 - BOUNDS_WIDENING_RELATIVE), space.low),
        np.where(held, space.high * (1 + BOUNDS_WIDENING_RELATIVE), space.high),
    )
    return replace(space, low=low, high=high)


def _find_nearest_scene(search_space: SearchSpace, designs: np.ndarray) -> tuple[Scene, Combination] | None:
    seventh = slice(len(designs), len(search_space.space.low))
    for six in designs.T:
        design = np.append(six, np.clip(get_outer_height(six), search_space.space.low[seventh], search_space.space.high[seventh]))
        nearest: Combination = next(iter(search_space.iterate_nearest(design, 1)))
        held = design.copy()
        held[list(nearest.pinned)] = list(nearest.pinned.values())
        scene = search_space.build_scene(held, nearest)
        if scene is not None and is_admissible(search_space, scene):
            return scene, nearest
    return None


def build_middle_scene(design: Design) -> Scene:
    """Return the scene with one tumour in the middle of the population's ranges, under the probe's axis."""
    population = ScenePopulation.from_scene(design.scene, design.population)
    middle = {key: population.ranges[key].middle for key in ("depth", "diameter", "object", "x")}
    inclusion = design.scene.inclusion[0] if design.scene.inclusion else None
    nu = inclusion.poisson_ratio if inclusion else design.scene.tissue.poisson_ratio
    placement = design.scene.placement
    body = Inclusion(
        diameter=middle["diameter"], depth=max(middle["depth"], 0.6 * middle["diameter"]), x=placement.x, y=placement.y,
        youngs_modulus=middle["object"], poisson_ratio=nu, target=True,
    )  # fmt: skip
    load = design.scene.load if design.scene.load.force or design.scene.load.indentation else Load(force=0.1)
    return design.scene.model_copy(update={"inclusion": (body,), "load": load})
