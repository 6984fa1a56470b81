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
from probe_design.optimisation.candidate import Candidate, candidate
from probe_design.optimisation.design_space import Space, space
from probe_design.optimisation.global_search import search
from probe_design.optimisation.loaded_candidate import asks_for_contact, under_load
from probe_design.optimisation.objective import Noise

PRESSED = 3  # of the best candidates within the room
RADII = (1e-3, 1.6e-3, 2.5e-3, 4e-3, 6.3e-3, 10e-3, 16e-3, 25e-3)  # m: preferred numbers, R5 of ISO 3
STARTS = 2  # of the search within each
GROWTH = 2.5  # of the log-sensitivity by load; 1.3 to 2 were seen
UNLIMITED = 1e9  # N: the most that a scene may ask for
Progress = Callable[[str, int, int], None]


def unlimited(scene: Scene) -> Scene:
    """Return a scene under more load than linear elasticity answers for, whatever its probe is."""
    return scene.model_copy(update={"load": Load(force=UNLIMITED)})


def limited(one: Candidate, scene: Scene, noise: Noise, judge: str) -> Candidate:
    """Return a candidate of an unlimited scene under the scene's load, or as much of that as linear elasticity answers for.

    Raises:
        Refusal: see ``candidate``.
    """
    own = one.scene.model_copy(update={"load": scene.load})
    if scene.load.force is None or scene.load.force < one.pressing.force:
        return candidate(own, noise, judge)
    return replace(one, scene=own)


def pressed(
    scene: Scene, candidates: tuple[Candidate, ...], room: Space, noise: Noise, *, judge: str, progress: Progress
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
    radii = [radius for radius in RADII[::-1] if radius < room.outer_radius]
    steps = PRESSED + len(radii)
    finalists: tuple[Candidate | float, ...] = (*candidates[:PRESSED], *radii)
    for k, of in enumerate(finalists):
        progress(stage, k, steps)
        with suppress(Refusal, InputError):  # no room within a radius, or a design that cannot be judged
            one = of if isinstance(of, Candidate) else _within(scene, of, noise, judge)
            one = limited(one, scene, noise, judge)
            one = under_load(one, noise) if asks_for_contact(one) and _hopeful(one, noise, best) else one
            best = min(best, one.judged_objective)
            yield one
    progress(stage, steps, steps)


def _within(scene: Scene, radius: float, noise: Noise, judge: str) -> Candidate:
    """The best design no wider than a radius, by a search that knows no limit of the load."""
    room = space(unlimited(scene), radius)
    for design in search(room, noise, STARTS, lambda done, total: None).T:
        made = room.scene_of(design)
        if made is not None:
            return candidate(made, noise, judge)
    raise InputError("outer-radius", radius, "room for a design")


def _hopeful(one: Candidate, noise: Noise, best: float) -> bool:
    """Whether a design could become better than the best so far by more load."""
    size = abs(one.judged.log_sensitivity or 0.0)
    return size > 0 and noise.ratio / (GROWTH * size) < best
