"""One point of a path of loads, and the end of a path."""

from __future__ import annotations

from dataclasses import dataclass

from geometry.common.arrays import Floats
from geometry.common.errors import SolveError
from solver.contact.newton import Equilibrium


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

    @property
    def force(self) -> float:
        """Of the base, N."""
        return float(self.films.sum())


class StoppedError(SolveError):
    """No further step converges.

    Attributes:
        last: the point reached.
        why: what stands in the way.
    """

    def __init__(self, last: Pressed, why: str) -> None:
        self.last, self.why = last, why
        super().__init__(f"beyond {1e3 * last.indentation:.3g} mm, {last.force:.3g} N, {why}")
