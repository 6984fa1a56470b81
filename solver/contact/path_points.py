"""Define the results at one point of a load path, and the error that ends a path."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import SolveError
from solver.contact.newton import Equilibrium
from solver.contact.states import State
from solver.results.film_forces import FilmForces


@dataclass(frozen=True)
class PathPoint:
    """Results at one point of a load path.

    Attributes
    ----------
    indentation
        Indentation of the base, m.
    films
        Forces on both films, N, shape (2,).
    tangent
        Derivatives of the film forces with respect to indentation, N/m, shape (2,).
    log_sensitivity
        d ln(ratio of film forces) / d ln E of the target, at constant force; 0 without a target.
    walls
        Minimum distance of the gap's walls, m; 0 where they touch.
    contact_radius
        Outer radius of the contact with the tissue, m.
    strain
        Maximum |lambda - 1| of the principal stretches lambda.
    residual
        Relative residual of the equilibrium.
    equilibrium
        The state and its equations.
    rates
        Derivative of the state with respect to indentation.
    """

    indentation: float
    films: Floats
    tangent: Floats
    log_sensitivity: float
    walls: float
    contact_radius: float
    strain: float
    residual: float
    equilibrium: Equilibrium
    rates: State

    @property
    def force(self) -> float:
        """Force on the base, N."""
        return float(self.films.sum())


@dataclass(frozen=True)
class LoadedForces:
    """Film forces under one load.

    Attributes
    ----------
    point
        Point of the load path on the finest mesh.
    films
        Film forces per indentation with bounds; their derivatives are taken at constant force.
    """

    point: PathPoint
    films: FilmForces


@dataclass(frozen=True)
class MeshDifferences:
    """Differences of two meshes: in ln of the film forces, shape (2,), in ln of their ratio, and in log-sensitivity, relative."""

    films: Floats
    log_ratio: float
    sensitivity: float

    def __or__(self, other: MeshDifferences) -> MeshDifferences:
        """Return the larger of each difference."""
        films = np.maximum(self.films, other.films)
        return MeshDifferences(films, max(self.log_ratio, other.log_ratio), max(self.sensitivity, other.sensitivity))


NO_DIFFERENCES = MeshDifferences(np.zeros(2), 0.0, 0.0)


class StoppedError(SolveError):
    """No further step converges.

    Attributes
    ----------
    last
        The deepest point computed.
    reason
        Why no further step converges.
    """

    def __init__(self, last: PathPoint, reason: str) -> None:
        self.last, self.reason = last, reason
        super().__init__(f"beyond {1e3 * last.indentation:.3g} mm, {last.force:.3g} N, {reason}")
