"""Solve many scenes together if they differ only in the inclusion's Young's modulus and the load.

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
from geometry.common.resources import get_limits, start_clock, use_limits
from geometry.scenes.scene import Scene
from geometry.scenes.scene_tables import Load
from solver.axisymmetric.converged_forces import Converged
from solver.results.evaluator import FilmSolution
from solver.results.film_forces import find_shortfalls
from solver.results.warnings import Note, select_notes

MIN_CURVE_MODULI = 6  # moduli from which a curve costs less than each alone; a curve takes three to seven times as long as one
Converge = Callable[[Scene, float, Floats | None], Converged]
SolutionOrError = FilmSolution | InputError


def get_design(scene: Scene) -> Scene:
    """Return the scene with the inclusions' moduli set to 1 Pa and no load: equal for all scenes that share a curve."""
    load = Load(indentation=0.0) if scene.load.indentation is not None else Load(force=0.0)
    bodies = tuple(body.model_copy(update={"youngs_modulus": 1.0}) for body in scene.inclusion)
    return scene.model_copy(update={"load": load, "inclusion": bodies})


def solve_shared_designs(
    converge: Converge,
    solve_alone: Callable[[Scene, float], SolutionOrError],
    scenes: Sequence[Scene],
    accuracies: Sequence[float],
) -> list[SolutionOrError]:
    """Solve each scene at its accuracy, or return its refusal; scenes that share a design are solved together.

    Parameters
    ----------
    converge
        Computes film forces of a scene, at an accuracy, for moduli, Pa, shape (k,); used where scenes differ in the modulus of
        their only inclusion.
    solve_alone
        Solves one scene at an accuracy, or returns its refusal.
    scenes
        Scenes of any kind; those that the evaluator does not take are refused.
    accuracies
        One for each; scenes that share a design are solved to the finest.
    """
    groups: dict[Scene, list[int]] = defaultdict(list)
    for place, scene in enumerate(scenes):
        groups[get_design(scene)].append(place)
    solutions: dict[int, SolutionOrError] = {}
    for places in groups.values():
        finest = min(accuracies[place] for place in places)
        by_modulus: dict[float, list[int]] = defaultdict(list)
        for place in places:
            by_modulus[_get_modulus(scenes[place])].append(place)
        firsts = {modulus: scenes[same_modulus[0]] for modulus, same_modulus in by_modulus.items()}
        curve = _solve_curve(converge, firsts, finest, len(places)) if len(firsts) >= MIN_CURVE_MODULI else {}
        for modulus, same_modulus in by_modulus.items():
            solution = curve.get(modulus) or solve_alone(firsts[modulus], finest)
            solutions |= dict.fromkeys(same_modulus, solution)
    return [solutions[place] for place in range(len(scenes))]


def _get_modulus(scene: Scene) -> float:
    """Return Young's modulus of the only inclusion, Pa; 0 without one or with several."""
    return scene.inclusion[0].youngs_modulus if len(scene.inclusion) == 1 else 0.0


def _solve_curve(converge: Converge, scenes: Mapping[float, Scene], accuracy: float, count: int) -> dict[float, FilmSolution]:
    """Return solutions by modulus for scenes that share a design, from one curve, within ``count`` times the time limit.

    Moduli at which the curve is not accurate enough are left out if a scene solved alone may be; all are if it is refused.

    Parameters
    ----------
    converge
        See ``solve_shared_designs``.
    scenes
        One scene for each modulus of the inclusion, Pa.
    accuracy
        Relative.
    count
        Number of scenes that the curve replaces.
    """
    moduli = np.array(sorted(scenes))
    try:
        with use_limits(replace(get_limits(), seconds=count * get_limits().seconds)), start_clock():
            converged = converge(scenes[moduli[0]], accuracy, moduli)
    except InputError:
        return {}
    return dict(_select_accurate(converged, scenes, moduli, accuracy))


def _select_accurate(
    converged: Converged, scenes: Mapping[float, Scene], moduli: Floats, accuracy: float
) -> Iterator[tuple[float, FilmSolution]]:
    """Yield moduli, Pa, with solutions: where the curve is accurate enough, or where no finer mesh would have helped.

    Left out are moduli that are not accurate enough because refinement was stopped (``Converged.stopped``): solved alone,
    such a scene may become accurate.
    """
    residual, details = converged.sample.states.residual, select_notes(converged.notes, "left_out")
    for modulus, films in zip(moduli.tolist(), converged.films, strict=True):
        short: list[Note] = find_shortfalls(films, films.compute_max_error(scenes[modulus]), accuracy)
        if not (short and converged.stopped):
            yield modulus, FilmSolution((films,), residual, converged.plan, (*details, *short))
