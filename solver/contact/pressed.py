"""One point of a path of loads, and the end of a path."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import SolveError
from solver.contact.newton import Equilibrium
from solver.contact.states import State
from solver.results.film_forces import FilmForces


@dataclass(frozen=True)
class Pressed:
    """One point of a path.

    Attributes:
        indentation: of the base, m.
        films: forces on both films, N, shape (2,).
        tangent: their derivatives by indentation, N/m, shape (2,).
        log_sensitivity: of the films' ratio by E of the target, at the same force; 0 without a target.
        walls: least distance of the gap's walls, m; 0 where they touch.
        contact_radius: outer radius of what touches the tissue, m: the block's, or where its wall lies on the tissue.
        strain: the largest stretch or shortening of any line element, |lambda - 1|.
        residual: relative.
        equilibrium: behind it.
        rates: what its state changes by per indentation.
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
        """Of the base, N."""
        return float(self.films.sum())


@dataclass(frozen=True)
class Loaded:
    """Film forces under one load.

    Attributes:
        point: of the finest path.
        films: per indentation, with bounds; their slopes at the same force.
    """

    point: Pressed
    films: FilmForces


@dataclass(frozen=True)
class Differences:
    """By how much two meshes differ: in ln films, shape (2,), ln ratio, and log-sensitivity relative to its own size."""

    films: Floats
    log_ratio: float
    sensitivity: float

    def __or__(self, other: Differences) -> Differences:
        """The larger of each."""
        films = np.maximum(self.films, other.films)
        return Differences(films, max(self.log_ratio, other.log_ratio), max(self.sensitivity, other.sensitivity))


NONE = Differences(np.zeros(2), 0.0, 0.0)


class StoppedError(SolveError):
    """No further step converges.

    Attributes:
        last: the point reached.
        why: what stands in the way.
    """

    def __init__(self, last: Pressed, why: str) -> None:
        self.last, self.why = last, why
        super().__init__(f"beyond {1e3 * last.indentation:.3g} mm, {last.force:.3g} N, {why}")
