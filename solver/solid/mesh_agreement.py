"""Bound the errors of film forces by the differences of meshes: with a safety factor from two, by the convergence of three.

Two meshes may agree by chance, so that their difference is multiplied by a safety factor. With three meshes, whose errors fall
with the square of the element size or faster, the bound is the larger of the last step and most of the step before, but at least
a third of the latter. If steps grow, the last is multiplied by their growth, up to the safety factor: in nearly incompressible
tissue the first two meshes agreed by chance, and the error of the log-sensitivity was 1.3 times its bound.

The error at the blocks' rims is smaller if inclusions are so soft that little force is left, but eq. SO.4 subtracts that of the
reference. For a soft tumour that nearly filled its tissue the ratio was wrong by 8 %, the reference by 2.5 %.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from geometry.common.arrays import Floats
from geometry.scenes.scene import Scene
from solver.results.film_forces import Bound, FilmForces
from solver.solid.difference import SceneDifference
from solver.solid.symmetric_part import EDGES, SymmetricPart

SAFETY = 2.0  # times the difference of two meshes
SLOPES = 2.5  # likewise for log_sensitivity: with 2.0 a stiff tumour's error was 1.2 times its bound
EARLIER = 0.85  # of the step before: second order leaves 0.66 as rims are refined, 0.81 as growth is
LEAST = 0.3  # of the step before: what is left at third order
FLOOR = 0.02  # of the change by inclusions, groove and edges: error common to all meshes; half on the finest
ALIKE = 0.25  # of the change of film forces: minimum change of ln ratio that counts
RAW = 0.04  # of the mesh's error of the reference: what may not cancel
SOFTENED = 2.0  # likewise, times the share of force that the films lose


def films_of(
    scene: Scene,
    symmetric: SymmetricPart,
    differences: Sequence[SceneDifference],
    floor: float,
    *,
    times: tuple[float, float] = (SAFETY, SLOPES),
) -> tuple[FilmForces, ...]:
    """Return the film forces of the finest mesh, the last of two or more, with error bounds from all meshes.

    Args:
        scene: the scene.
        symmetric: its rotationally symmetric part.
        differences: scene minus reference on each mesh, coarser meshes first.
        floor: see ``ERROR_FLOOR_RELATIVE``.
        times: safety factors of the last step, for forces and for log_sensitivity.
    """
    fine, whole = differences[-1], symmetric.whole.films
    forces = [symmetric.corrected(one) for one in differences]
    slopes = [symmetric.carried(one, one.slope) for one in differences]
    plainly = whole.forces.sum(axis=1)
    raw = np.abs(np.log(fine.reference.sum(axis=1) / symmetric.exact.sum(axis=1)))
    doubt = floor + fine.lost + EDGES * symmetric.edges
    films = []
    for k, now in enumerate(forces[-1]):
        totals = [one[k].sum(axis=1) for one in forces]
        change = np.abs(totals[-1] - plainly)
        logs = [_log_ratio(one) for one in totals]
        rims = SOFTENED * raw * change * np.clip(1 - totals[-1] / plainly, 0.0, None)
        error = apart(totals, times[0]) + (doubt + RAW * raw) * change + rims + whole.bound.totals
        with np.errstate(divide="ignore", invalid="ignore"):
            share = np.nan_to_num(rims / np.abs(totals[-1]))
            every = np.abs(np.log(np.abs(totals[-1] / plainly)))
        moved = max(abs(logs[-1] - _log_ratio(plainly)), ALIKE * float(np.nan_to_num(every).max()))
        log_ratio = float(apart(logs, times[0]) + (doubt + RAW * raw.max()) * moved + share.sum()) + whole.bound.log_ratio
        bound = Bound(error, log_ratio if np.all(error < np.abs(totals[-1])) else np.inf)
        told: Floats = np.array([_sensitivities(slope[k], one[k]) for slope, one in zip(slopes, forces, strict=True)])
        sensitive = (
            apart(told @ [1.0, -1.0], times[1]) + (FLOOR + fine.lost) * abs(told[-1] @ [1.0, -1.0]) + np.abs(told[-1]) @ share
        )
        films.append(FilmForces(now, bound, slopes[-1][k] if scene.target is not None else None, float(sensitive)))
    return tuple(films)


def apart(found: Sequence[Floats | float] | Floats, times: float) -> Floats:
    """Bound the error of the last of the values on finer and finer meshes, each of shape (n,) or a number."""
    steps = np.abs(np.diff(np.array(found), axis=0))
    last = times * steps[-1]
    if len(steps) > 1:
        known = times * steps[-2] > steps[-1]
        growth = np.maximum(np.divide(steps[-1], steps[-2], out=np.full_like(steps[-1], times), where=known), 1.0)
        last = np.maximum(np.minimum(last, np.maximum(EARLIER * steps[-2], growth * steps[-1])), LEAST * steps[-2])
    return np.asarray(last)


def _log_ratio(totals: Floats) -> float:
    """Return the log of the ratio of both films' total forces."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return float(np.log(np.abs(totals)) @ [1.0, -1.0])


def _sensitivities(slope: Floats, forces: Floats) -> Floats:
    """Return d ln F / d ln E of both film forces F, with the target's modulus E; shape (2,)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.nan_to_num(slope.sum(axis=1) / forces.sum(axis=1)))
