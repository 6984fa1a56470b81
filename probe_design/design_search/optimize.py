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
from probe_design.design_search.choices import Choice, Chosen, choose
from probe_design.design_search.heights import of_one_height, outer_height
from probe_design.design_search.judging import JudgedDesign, judge
from probe_design.design_search.outcome import PopulationOptimum
from probe_design.design_search.polish import polish
from probe_design.design_search.room import Combination, Room, admitted, room
from probe_design.design_search.steered_population import SteeredDesigns
from probe_design.design_search.workshop import Robustness, robustness
from probe_design.optimisation.design_space import CLOSE, Space, alike
from probe_design.optimisation.global_search import search as search_single
from probe_design.optimisation.objective import Noise
from probe_design.optimisation.pressing import check_load
from probe_design.populations.design_file import Design
from probe_design.populations.population import ScenePopulation

Progress = Callable[[str, int, int], None]
FINALISTS = 2  # designs that are judged, beside start and single-tumour optimum
MOST_TRIED = 100  # designs, the best first, of which these are taken
SINGLE_STARTS = 4
HAIR = 1e-6  # relative


@dataclass(frozen=True)
class Finalist:
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
        Refusal: the levels cannot take the scene.
    """
    tell = progress or (lambda stage, done, total: None)
    begin = perf_counter()
    check_load(design.scene)
    found = room(design)
    tell("drawing the population", 0, 1)
    steered = SteeredDesigns.of(design, max(found.space.outer_radius, design.scene.probe.tube_radius))
    tell("drawing the population", 1, 1)
    start = judge(design, steered.rule, design.scene, progress=partial(tell, "judging the start"))
    searching = perf_counter()
    chosen = choose(steered, found, partial(tell, "searching with the closed form"))
    finalists = _finalists(steered, design, found, chosen, tell)
    searched = perf_counter()
    single, why = _single(design, steered, found, tell)
    pairs = [*_judged(steered, design, finalists, tell), *([] if single is None else [single])]
    judged = sorted(pairs, key=lambda pair: -_rank(design, *pair))
    end = perf_counter()
    return PopulationOptimum(
        design=design,
        room=found,
        start=start,
        single=None if single is None else single[0],
        finalists=tuple(one for one, _ in judged),
        robust=(robustness(steered, design, design.scene, ()), *(robust for _, robust in judged)),
        how=chosen.how,
        exhaustive=chosen.exhaustive,
        best_of=chosen.best,
        seconds={"search": searched - searching, "judge": end - searched + searching - begin, "all": end - begin},
        why_no_single=why,
    )


def _rank(design: Design, one: JudgedDesign, robust: Robustness) -> float:
    """Return the verified objective minus the loss by workshop tolerances, the latter by the closed form."""
    return one.value(design)[0] + robust.expected - robust.nominal


def _finalists(steered: SteeredDesigns, design: Design, found: Room, chosen: Chosen, tell: Progress) -> list[Finalist]:
    """Select the best designs that differ, rounded to what a workshop makes; the first is refined before."""
    first = chosen.choices[0]
    better = polish(steered, design, found, first, partial(tell, "polishing by equivalent-inclusion"))
    order = ([] if better is None else [better]) + list(chosen.choices)
    finalists: list[Finalist] = []
    for one in order[:MOST_TRIED]:
        scene = found.scene_of(one.design, one.combination)
        if scene is None or not admitted(found, scene) or any(_same(scene, other.scene) for other in finalists):
            continue
        try:
            steered.rule.pressed(scene)
        except Refusal:  # finite elements see a film pulled on where the formulas do not, or cannot solve it
            continue
        finalists.append(Finalist(scene, one, robustness(steered, design, scene, one.combination.materials)))
        if len(finalists) == FINALISTS:
            break
    return finalists


def _same(one: Scene, other: Scene) -> bool:
    heights = one.probe.tube_height, other.probe.tube_height
    poisson = one.probe.inner.poisson_ratio == other.probe.inner.poisson_ratio
    return alike(one, other) and abs(heights[0] / heights[1] - 1) <= CLOSE and poisson


def _judged(
    steered: SteeredDesigns, design: Design, finalists: list[Finalist], tell: Progress
) -> Iterator[tuple[JudgedDesign, Robustness]]:
    for k, one in enumerate(finalists):
        stage = f"judging finalist {k + 1} of {len(finalists)}"
        with suppress(Refusal):  # a design that cannot be judged is none
            combination = one.choice.combination
            judged = judge(
                design,
                steered.rule,
                one.scene,
                progress=partial(tell, stage),
                combination=combination.told,
                materials=combination.materials,
            )
            yield judged, one.robust


def _single(
    design: Design, steered: SteeredDesigns, found: Room, tell: Progress
) -> tuple[tuple[JudgedDesign, Robustness] | None, str]:
    """Design and verify a probe for one tumour in the middle of the population; return it, or None and the reason.

    It is a candidate like those of the search: where it is verified to be the best, it is recommended.
    """
    stage = "designing for one tumour"
    try:
        scene = middle_scene(design)
        noise = Noise.of(scene, max(design.noise.white, 1e-6))
        six = _widened(of_one_height(found.space))
        designs = search_single(six, noise, SINGLE_STARTS, partial(tell, stage)) if found.free() else None
        made = None if designs is None else _nearest_scene(found, designs)
        if made is None:
            return None, "no variable left to choose" if designs is None else "no design for one tumour within the limits"
        scene, chosen = made
        advance = partial(tell, "judging the design for one tumour")
        judged = judge(
            design, steered.rule, scene, progress=advance, combination=chosen.told, materials=chosen.materials
        )  # fmt: skip
        return (judged, robustness(steered, design, scene, chosen.materials)), ""
    except (Refusal, InputError) as fault:
        return None, str(fault)


def _widened(space: Space) -> Space:
    """Widen bounds that coincide by a tiny amount, as scaling a Sobol sequence needs a positive width."""
    held = space.low >= space.high * (1 - HAIR)
    low, high = np.where(held, space.low * (1 - HAIR), space.low), np.where(held, space.high * (1 + HAIR), space.high)
    return replace(space, low=low, high=high)


def _nearest_scene(found: Room, designs: np.ndarray) -> tuple[Scene, Combination] | None:
    seventh = slice(len(designs), len(found.space.low))
    for six in designs.T:
        one = np.append(six, np.clip(outer_height(six), found.space.low[seventh], found.space.high[seventh]))
        nearest: Combination = next(iter(found.near(one, 1)))
        held = one.copy()
        held[list(nearest.pinned)] = list(nearest.pinned.values())
        scene = found.scene_of(held, nearest)
        if scene is not None and admitted(found, scene):
            return scene, nearest
    return None


def middle_scene(design: Design) -> Scene:
    """Return the scene with one tumour in the middle of the population's ranges, under the probe's axis."""
    population = ScenePopulation.of(design.scene, design.population)
    middle = {key: population.ranges[key].middle for key in ("depth", "diameter", "object", "x")}
    own = design.scene.inclusion[0] if design.scene.inclusion else None
    nu = own.poisson_ratio if own else design.scene.tissue.poisson_ratio
    at = design.scene.placement
    body = Inclusion(
        diameter=middle["diameter"], depth=max(middle["depth"], 0.6 * middle["diameter"]), x=at.x, y=at.y,
        youngs_modulus=middle["object"], poisson_ratio=nu, target=True,
    )  # fmt: skip
    load = design.scene.load if design.scene.load.force or design.scene.load.indentation else Load(force=0.1)
    return design.scene.model_copy(update={"inclusion": (body,), "load": load})
