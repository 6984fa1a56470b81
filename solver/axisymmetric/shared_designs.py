"""Solve many scenes, of which some differ only in the inclusion's Young's modulus and the load.

The film forces of such scenes per unit indentation are one curve: a load scales them, and all moduli come from one
factorisation (``modulus_response.py``), each with its own error bound. Where a curve is not accurate enough, each modulus is
solved alone. Further loads take no time in either case.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import InputError
from geometry.common.resources import limited, limits, timed
from geometry.meridian.frame import Kind
from geometry.meridian.frame import kind as kind_of
from geometry.scenes.scene import Load, Scene
from solver.axisymmetric.converged_forces import Converged
from solver.axisymmetric.sections import sections
from solver.results.evaluator import Answer
from solver.results.film_forces import shortfalls
from solver.results.warnings import Note, of_kind

FEWEST = 6  # moduli from which a curve costs less than each alone; a curve takes three to seven times as long as one
Converge = Callable[[Scene, float, Floats | None], Converged]
Found = Answer | InputError


def design(scene: Scene) -> Scene:
    """Return the scene with a standard modulus of the inclusion and a zero load of its kind: the key of scenes on one curve."""
    load = Load(indentation=0.0) if scene.load.indentation is not None else Load(force=0.0)
    bodies = tuple(body.model_copy(update={"youngs_modulus": 1.0}) for body in scene.inclusion)
    return scene.model_copy(update={"load": load, "inclusion": bodies})


def smooth_kind(scene: Scene) -> tuple[Kind, Kind] | None:
    """Return a key that scenes share if their results are smooth functions of their numbers; None for a refused scene."""
    try:
        section = sections(scene).section
        return kind_of(section), kind_of(section, lean=True)
    except InputError:
        return None


def answers(
    converge: Converge, alone: Callable[[Scene, float], Found], scenes: Sequence[Scene], accuracies: Sequence[float]
) -> list[Found]:
    """Solve each scene at its accuracy, or return its refusal; scenes that share a design are solved together.

    Args:
        converge: computes film forces at moduli, Pa, shape (k,); used for scenes with exactly one inclusion.
        solve_alone: solves one scene.
        scenes: scenes of any kind; those that the evaluator does not take are refused.
        accuracies: one for each; scenes that share a design are solved to the finest.
    """
    groups: dict[Scene, list[int]] = defaultdict(list)
    for place, scene in enumerate(scenes):
        groups[design(scene)].append(place)
    every: dict[int, Found] = {}
    for places in groups.values():
        finest = min(accuracies[place] for place in places)
        by_modulus: dict[float, list[int]] = defaultdict(list)
        for place in places:
            by_modulus[_modulus(scenes[place])].append(place)
        firsts = {modulus: scenes[some[0]] for modulus, some in by_modulus.items()}
        curve = _curve(converge, firsts, finest, len(places)) if len(firsts) >= FEWEST else {}
        for modulus, some in by_modulus.items():
            found = curve.get(modulus) or alone(firsts[modulus], finest)
            every |= dict.fromkeys(some, found)
    return [every[place] for place in range(len(scenes))]


def _modulus(scene: Scene) -> float:
    return scene.inclusion[0].youngs_modulus if len(scene.inclusion) == 1 else 0.0


def _curve(converge: Converge, scenes: Mapping[float, Scene], accuracy: float, count: int) -> dict[float, Answer]:
    """Solve a curve for scenes by their moduli, within ``count`` times the time limit.

    Moduli at which the curve is not accurate enough, and their own mesh may be, are left out.
    """
    moduli = np.array(sorted(scenes))
    try:
        with limited(replace(limits(), seconds=count * limits().seconds)), timed():
            found = converge(scenes[moduli[0]], accuracy, moduli)
    except InputError:
        return {}
    return dict(_by_modulus(found, scenes, moduli, accuracy))


def _by_modulus(
    found: Converged, scenes: Mapping[float, Scene], moduli: Floats, accuracy: float
) -> Iterator[tuple[float, Answer]]:
    residual, details = found.sample.states.residual, of_kind(found.notes, "left_out")
    for modulus, films in zip(moduli.tolist(), found.films, strict=True):
        short: list[Note] = shortfalls(films, films.error_under(scenes[modulus]), accuracy)
        if not (short and found.stopped):
            yield modulus, Answer((films,), residual, found.plan, (*details, *short))
