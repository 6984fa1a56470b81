"""Bounds on film forces from what meshes differ by: from two amply, from three as far as steps between them say.

What two meshes differ by is at times nothing by chance. So it counts ample times by itself; from three meshes, whose errors fall
with the sizes' square or faster, no more than the larger of the last step and most of the step before, but at least a third of
the latter. Where steps grow, the last counts as many times as they do, up to ample again: in nearly incompressible tissue the
first two agreed by chance, and the log-sensitivity was 1.3 times outside.

A flaw of the rims weighs less where inclusions are so soft that little force is left, but what is taken off in eq. SO.4 is the
reference's. Of a soft tumour that nearly filled its tissue 8 % of the ratio were wrong so, 2.5 % of the reference.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from geometry.common.arrays import Floats
from geometry.scenes.scene import Scene
from solver.results.film_forces import Bound, FilmForces
from solver.solid.difference import SceneDifference
from solver.solid.symmetric_part import EDGES, SymmetricPart

SAFETY = 2.0  # times what two meshes differ by
SLOPES = 2.5  # likewise of log_sensitivity: on two meshes a stiff tumour's was 1.2 times outside 2.0
EARLIER = 0.85  # times the step before: of second order, 0.66 of it is left after the last as rims become finer, 0.81 as growth
LEAST = 0.3  # times the step before: what is left of it at third order
FLOOR = 0.02  # of what inclusions, groove and edges change: what all meshes may have wrong; halved by the finest
ALIKE = 0.25  # of what films' forces change: counts of their ratio where its own change is less, as changes cancel
RAW = 0.04  # of what the mesh gets wrong of the reference: what may not cancel
SOFTENED = 2.0  # likewise, times the share of their forces that films lose


def films_of(
    scene: Scene,
    symmetric: SymmetricPart,
    differences: Sequence[SceneDifference],
    floor: float,
    *,
    times: tuple[float, float] = (SAFETY, SLOPES),
) -> tuple[FilmForces, ...]:
    """Film forces of the finest mesh, the last of two or more, with bounds from all.

    Args:
        scene: what was asked.
        symmetric: its rotationally symmetric part.
        differences: what was found, on coarser meshes first.
        floor: see ``FLOOR``.
        times: what the last step counts where nothing else bounds it, of forces and of log_sensitivity.
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
    """Bound the error of the last of values on finer and finer meshes, each of shape (n,) or a number."""
    steps = np.abs(np.diff(np.array(found), axis=0))
    last = times * steps[-1]
    if len(steps) > 1:
        known = times * steps[-2] > steps[-1]
        growth = np.maximum(np.divide(steps[-1], steps[-2], out=np.full_like(steps[-1], times), where=known), 1.0)
        last = np.maximum(np.minimum(last, np.maximum(EARLIER * steps[-2], growth * steps[-1])), LEAST * steps[-2])
    return np.asarray(last)


def _log_ratio(totals: Floats) -> float:
    with np.errstate(divide="ignore", invalid="ignore"):
        return float(np.log(np.abs(totals)) @ [1.0, -1.0])


def _sensitivities(slope: Floats, forces: Floats) -> Floats:
    """Both films' d ln F / d ln E, (2,)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.nan_to_num(slope.sum(axis=1) / forces.sum(axis=1)))
