"""The closed form of many scenes: those of one structure by one evaluation on arrays, each bit for bit as on its own.

What numpy and LAPACK do to one column of ``closed_form.forces`` does not depend on the columns beside it, as long as these come
in fours, the variants of one scene; ``tests/test_closed_batch.py`` holds that.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import replace
from time import perf_counter

import numpy as np

from geometry.errors import InputError, Refusal
from geometry.grading import Floats
from geometry.scene import Scene
from solver.closed_error import errors
from solver.closed_form import BROKEN, LARGEST_ERROR, ClosedForm, Shape, _variants, forces, parameters
from solver.film_forces import FilmForces, outputs, shortfalls
from solver.result import Result

LEVEL = ClosedForm()
Found = Result | InputError


def results(scenes: Sequence[Scene], accuracy: float = 0.01) -> list[Found]:
    """Evaluate scenes by ``closed-form``.

    Args:
        scenes: any; those of one ``closed_form.Shape`` are evaluated together.
        accuracy: relative, see ``ClosedForm.evaluate``.

    Returns:
        for each what ``ClosedForm.evaluate`` returns, or the refusal that it raises; what evaluating a group took is shared
        out evenly in ``seconds``.
    """
    found: dict[int, Found] = {}
    groups: dict[Shape, list[tuple[int, Floats]]] = defaultdict(list)
    for place, scene in enumerate(scenes):
        why = LEVEL.refusal(scene)
        if why is not None:
            found[place] = Refusal("evaluator", LEVEL.name, why)
            continue
        shape, values = parameters(scene)
        groups[shape].append((place, values))
    for shape, group in groups.items():
        places = [place for place, _ in group]
        found |= zip(places, _together(shape, [(scenes[place], values) for place, values in group], accuracy), strict=True)
    return [found[place] for place in range(len(scenes))]


def _together(shape: Shape, group: Sequence[tuple[Scene, Floats]], accuracy: float) -> Iterable[Found]:
    """Results of scenes of one shape, with the values of their parameters."""
    start = perf_counter()
    columns = np.concatenate([_variants(values) for _, values in group], axis=1)
    with np.errstate(all="ignore"):  # what is not finite is refused
        every = [part.reshape(len(group), -1, 2, 2) for part in forces(shape, columns)]
    made = [_result(scene, shape, a, b, accuracy) for (scene, _), a, b in zip(group, *every, strict=True)]
    share = (perf_counter() - start) / len(group)
    return [replace(one, seconds=share) if isinstance(one, Result) else one for one in made]


def _result(scene: Scene, shape: Shape, found: Floats, slopes: Floats, accuracy: float) -> Found:
    """As ``ClosedForm.films`` and ``evaluate`` go on from the forces of a scene's variants."""
    if not (np.all(np.isfinite(found)) and np.all(found.sum(axis=2) > 0)):
        return Refusal("evaluator", LEVEL.name, BROKEN)
    error = errors(scene, found, slopes, shape.side_nodes > 0)
    if error.log_ratio > LARGEST_ERROR:
        return Refusal("evaluator", LEVEL.name, BROKEN)
    slope = slopes[0] if scene.target is not None else None
    films = FilmForces(found[0], error.bound(found[0].sum(axis=1)), slope, error.sensitivity)
    told = outputs(scene, films)
    told["warnings"] += tuple(shortfalls(films, error.largest, accuracy))
    return Result(LEVEL.name, 0.0, **told)
