"""Finalists for loads beyond linear elasticity, judged by ``contact``.

A limit of the load that took part in choosing them would make other ones of a wider limit, and these might do worse. So they are
those of searches that know no limit but linear elasticity's own: the best ``PRESSED_CANDIDATES`` within the design space,
and the best within each radius of ``OUTER_RADII_M`` that is smaller, as a narrower probe is pressed deeper by the same force.
Designs that could not become better
than the best so far if their log-sensitivity grew ``MAX_SENSITIVITY_GROWTH`` times are not pressed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace

from geometry.common.errors import InputError, Refusal
from geometry.scenes.scene import Load, Scene
from probe_design.optimisation.candidate import Candidate, evaluate_candidate
from probe_design.optimisation.design_space import Space, build_space
from probe_design.optimisation.global_search import search_designs
from probe_design.optimisation.loaded_candidate import needs_contact, optimize_load
from probe_design.optimisation.objective import Noise

PRESSED_CANDIDATES = 3  # of the best candidates within the room
OUTER_RADII_M = (1e-3, 1.6e-3, 2.5e-3, 4e-3, 6.3e-3, 10e-3, 16e-3, 25e-3)  # m: preferred numbers, R5 of ISO 3
IPOPT_STARTS = 2  # of the search within each
MAX_SENSITIVITY_GROWTH = 2.5  # of the log-sensitivity by load; 1.3 to 2 were seen
UNLIMITED_FORCE_N = 1e9  # N: the most that a scene may ask for
Progress = Callable[[str, int, int], None]


def remove_load_limit(scene: Scene) -> Scene:
    """Return a scene under more load than linear elasticity answers for, whatever its probe is."""
    return scene.model_copy(update={"load": Load(force=UNLIMITED_FORCE_N)})


def restore_load(unlimited_candidate: Candidate, scene: Scene, noise: Noise, judge: str) -> Candidate:
    """Return a candidate of an unlimited scene under the scene's load, or as much of that as linear elasticity answers for.

    Raises:
        Refusal: see ``candidate``.
    """
    loaded_scene = unlimited_candidate.scene.model_copy(update={"load": scene.load})
    if scene.load.force is None or scene.load.force < unlimited_candidate.pressing.force:
        return evaluate_candidate(loaded_scene, noise, judge)
    return replace(unlimited_candidate, scene=loaded_scene)


def evaluate_loaded_candidates(
    scene: Scene, candidates: tuple[Candidate, ...], design_space: Space, noise: Noise, *, judge: str, progress: Progress
) -> Iterator[Candidate]:
    """Yield finalists under the best of the loads up to the scene's.

    Args:
        scene: the start.
        candidates: of a search that knows no limit of the load, best first.
        design_space: that was searched.
        noise: of a reading.
        judge: of their linear range.
        progress: called with a stage's name, the steps done and their number.
    """
    stage, best = "pressing finalists by contact", float("inf")
    radii = [radius for radius in OUTER_RADII_M[::-1] if radius < design_space.outer_radius]
    steps = PRESSED_CANDIDATES + len(radii)
    finalists: tuple[Candidate | float, ...] = (*candidates[:PRESSED_CANDIDATES], *radii)
    for k, source in enumerate(finalists):
        progress(stage, k, steps)
        with suppress(Refusal, InputError):  # no room within a radius, or a design that cannot be judged
            evaluated = source if isinstance(source, Candidate) else _find_best_within(scene, source, noise, judge)
            evaluated = restore_load(evaluated, scene, noise, judge)
            evaluated = (
                optimize_load(evaluated, noise)
                if needs_contact(evaluated) and _can_improve(evaluated, noise, best)
                else evaluated
            )
            best = min(best, evaluated.judged_objective)
            yield evaluated
    progress(stage, steps, steps)


def _find_best_within(scene: Scene, radius: float, noise: Noise, judge: str) -> Candidate:
    """The best design no wider than a radius, by a search that knows no limit of the load."""
    design_space = build_space(remove_load_limit(scene), radius)
    for design in search_designs(design_space, noise, IPOPT_STARTS, lambda done, total: None).T:
        made = design_space.build_scene(design)
        if made is not None:
            return evaluate_candidate(made, noise, judge)
    raise InputError("outer-radius", radius, "room for a design")


def _can_improve(candidate: Candidate, noise: Noise, best: float) -> bool:
    """Whether a design could become better than the best so far by more load."""
    size = abs(candidate.judged.log_sensitivity or 0.0)
    return size > 0 and noise.ratio / (MAX_SENSITIVITY_GROWTH * size) < best
