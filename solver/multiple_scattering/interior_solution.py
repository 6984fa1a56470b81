"""What one azimuthal order answers inside the tissue to data on the elements' edges: eq. MS.4 of ``boundary_compliance.py``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from geometry.common.arrays import Floats, Ints
from solver.multiple_scattering.azimuthal_systems import Harmonic
from solver.multiple_scattering.boundary_edges import Boundary, Edges


@dataclass(frozen=True)
class BoundaryAmplitudes:
    """Amplitudes of one order on the boundary, U, V, W last but one: displacements on ends and floor, tractions elsewhere.

    Attributes:
        surface, side: tractions t_r, t_theta, t_z, outward normal, shapes (e, q, 3, k), Pa.
        ends, floor: displacements, shapes (e, q, 3, k).
    """

    surface: Floats
    side: Floats
    ends: Floats
    floor: Floats


@dataclass(frozen=True)
class Interior:
    """What one azimuthal order answers to data on the boundary.

    Attributes:
        harmonic: the order's system.
        boundary: the edges.
        recovery: what gives the values inside elements, ``AzimuthalSystems.recovery`` of the order.
    """

    harmonic: Harmonic
    boundary: Boundary
    recovery: Callable[[Ints], Floats]
    _recovered: dict[bytes, Floats] = field(default_factory=dict, repr=False)

    @cached_property
    def _add_up(self) -> Any:
        """Adds forces on the own values of those elements up, a sparse matrix (unknowns, 4 c p elements)."""
        return self.harmonic.gathered(self.harmonic.boundary).T.tocsr()

    @cached_property
    def _tables(self) -> dict[str, tuple[Ints, Ints, Floats]]:
        """For each set of edges: where its elements and their functions are, and what makes their own values of data."""
        round_axis, amplitudes, b = 2 * np.pi if self.harmonic.m == 0 else np.pi, self.harmonic.amplitudes, self.boundary
        loads = {"surface": b.surface, "side": b.side}
        tables = {
            name: np.einsum("eq,qs,ac->ecsqa", round_axis * edges.weight, edges.values, amplitudes)
            for name, edges in loads.items()
        }
        inverse = np.linalg.pinv(amplitudes)
        for name, edges in {"ends": b.ends, "floor": b.floor}.items():
            tables[name] = np.broadcast_to(
                np.einsum("sq,ca->csqa", edges.coefficients, inverse),
                (len(edges.element), len(inverse), *edges.coefficients.shape[:1], edges.coefficients.shape[1], 3),
            )
        return {name: self._table(getattr(b, name), table) for name, table in tables.items()}

    def _table(self, edges: Edges, table: Floats) -> tuple[Ints, Ints, Floats]:
        e, c, s = table.shape[:3]
        functions = np.arange(c)[:, None] * 4 * self.harmonic.model.shapes.order + edges.local[:, None]  # (e, c, p + 1)
        return (
            np.searchsorted(self.harmonic.boundary, edges.element)[:, None],
            functions.reshape(e, c * s),
            table.reshape(e, c * s, -1),
        )

    def _placed(self, name: str, data: Floats) -> Floats:
        """Data (e, q, 3, k) as own values of the boundary's elements, (elements, 4 c p, k)."""
        row, column, table = self._tables[name]
        out = np.zeros((len(self.harmonic.boundary), self.harmonic.stiffness.shape[1], data.shape[-1]))
        out[row, column] = table @ data.reshape(len(data), -1, data.shape[-1])
        return out

    def to(self, data: BoundaryAmplitudes, elements: Ints) -> Floats:
        """Solve eq. MS.4; values U, V, W of w in some of the tissue's elements, (e, 3, s, k).

        Args:
            data: amplitudes of this order.
            elements: which.

        Raises:
            SolveError: see ``Harmonic.solve``.
        """
        imposed = -self._placed("floor", data.floor)
        forces = self._placed("surface", data.surface) + self._placed("side", data.side)
        forces += self.harmonic.stiffness @ (imposed + self._placed("ends", data.ends))
        k = forces.shape[-1]
        v = self.harmonic.solve(-(self._add_up @ forces.reshape(-1, k)))
        edge = (self.harmonic.gathered(elements) @ v).reshape(len(elements), -1, k)
        low = np.isin(elements, self.boundary.floor.element)
        edge[low] += imposed[np.searchsorted(self.harmonic.boundary, elements[low])]
        return self.harmonic.whole(edge, self._inside(elements))

    def _inside(self, elements: Ints) -> Floats:
        """The recovery of the elements asked for last: one exchange asks for the same again and again."""
        key = elements.tobytes()
        if key not in self._recovered:
            self._recovered.clear()
            self._recovered[key] = self.recovery(elements)
        return self._recovered[key]
