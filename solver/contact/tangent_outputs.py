"""Compute the tangent response of films about a preload: what a film answers to a small change of the force.

With the film's force or charge f(F, E) at the force F on the base and the target's Young's modulus E, the tangent response is
t = df/dF, and its derivative at one preload is that of f S with respect to F, S = d ln f / d ln E being known at every force:

    d t / d ln E = d (f S) / dF                                                                      (CT.8)

by central differences between two forces about the preload. The same differences of f itself, whose tangent is known exactly,
state their error.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Floats
from solver.contact.loaded_outputs import MESH_SAFETY_FACTOR, LoadedOutputs, MeshDifferences
from solver.contact.path import Path
from solver.contact.states import PathPoint
from solver.results.film_forces import FilmForces

STEP_RELATIVE = 0.04  # of the preload: the two forces' distances; the error of second order is about its square


@dataclass(frozen=True)
class _Tangent:
    """The tangent response on one mesh.

    Attributes
    ----------
    totals
        Derivatives of both outputs with respect to the indentation, shape (2,).
    log_sensitivities
        D ln t / d ln E at one preload, shape (2,).
    error
        Relative error of the differences.
    """

    totals: Floats
    log_sensitivities: Floats
    error: float

    @property
    def log_sensitivity(self) -> float:
        """Log-sensitivity of the tangent ratio."""
        return float(self.log_sensitivities[0] - self.log_sensitivities[1])


def build_tangent_films(outputs: LoadedOutputs, point: PathPoint) -> FilmForces:
    """Return the tangent response per indentation, with bounds, at the preload's point on the finer path.

    Raises
    ------
    StoppedError
        No step converges a little beyond the preload.
    LimitReached
        The time limit is reached.
    """
    coarse, fine = (_compute_tangent(outputs, path, point.force) for path in outputs.paths)
    log_ratios = np.log(np.abs(coarse.totals / fine.totals))
    values = [outputs.correct_sensitivity(path, x.log_sensitivity) for path, x in zip(outputs.paths, (coarse, fine), strict=True)]
    if outputs.linear.modulus_derivative is None:
        values, size = [0.0, 0.0], 0.0
    else:
        size = max(abs(values[1]), outputs.find_max_sensitivity(point.indentation))
    spread = abs(values[0] - values[1]) / size if size else 0.0
    differences = outputs.compute_differences(point.indentation) | MeshDifferences(
        np.abs(log_ratios), float(np.abs(log_ratios[0] - log_ratios[1])), spread + fine.error / MESH_SAFETY_FACTOR
    )
    return outputs.assemble(fine.totals, fine.log_sensitivities, values[1], differences, size)


def _compute_tangent(outputs: LoadedOutputs, path: Path, force: float) -> _Tangent:
    """Return the tangent response at a force, N, on one mesh."""
    point, *sides = (path.press_to_force(force * (1 + k * STEP_RELATIVE)) for k in (0, -1, 1))
    span = sides[1].force - sides[0].force
    low, high = (outputs.select(side) for side in sides)
    tangent = outputs.select(point).tangent
    per_force = tangent / point.tangent.sum()
    change = (high.values * high.log_sensitivities - low.values * low.log_sensitivities) / span
    error = float(np.abs((high.values - low.values) / span / per_force - 1).max())
    return _Tangent(tangent, change / per_force, error)
