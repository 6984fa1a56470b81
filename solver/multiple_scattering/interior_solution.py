"""Solve for the field of one azimuthal order inside the tissue under data on its boundary, eq. MS.4.

The equation is in ``boundary_compliance.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from geometry.common.arrays import Floats, Ints
from solver.multiple_scattering.azimuthal_systems import Harmonic
from solver.multiple_scattering.boundary_edges import Boundary, Edges

FORCE_EDGES, LIFTED_EDGES = ("surface", "side", "above", "below"), ("ends", "floor", "above", "below")  # by kind of data


EdgeData = Mapping[tuple[str, str], Floats]
"""Amplitudes of one order on a layer's boundary, (e, q, 3, k) with U, V, W along the third axis, by edges' name and kind.

The kind "forces" is of tractions t_r, t_theta, t_z by the outward normal, Pa, on ``FORCE_EDGES``; "lifted" is of displacements,
m, on ``LIFTED_EDGES``.
"""


@dataclass(frozen=True)
class Interior:
    """Response inside the tissue of one azimuthal order to data on one layer's boundary.

    Attributes
    ----------
    harmonic
        The order's system.
    boundary
        The edges.
    recovery
        Computes the recovery of values inside elements, ``AzimuthalSystems.compute_recovery`` of the order.
    """

    harmonic: Harmonic
    boundary: Boundary
    recovery: Callable[[Ints], Floats]
    _recovered: dict[int, Floats] = field(default_factory=dict, repr=False)

    @cached_property
    def _force_assembly(self) -> Any:
        """Sparse matrix that assembles forces on the boundary elements' values, (unknowns, 4 c p elements)."""
        return self.harmonic.numbering.take_gather_rows(self.harmonic.boundary).T.tocsr()

    @cached_property
    def _tables(self) -> dict[tuple[str, str], tuple[Ints, Ints, Floats]]:
        """Tables for each set of edges and kind of data: indices of elements and functions, and the matrix from data to them.

        The indices and letters: e edges, q points of each, s functions of each, c components, a = r, theta, z.
        """
        azimuthal_integral, amplitudes, b = 2 * np.pi if self.harmonic.m == 0 else np.pi, self.harmonic.amplitudes, self.boundary
        edges_of = {name: edges for name, edges in vars(b).items() if len(edges.element)}
        tables = {
            (name, "forces"): np.einsum("eq,qs,ac->ecsqa", azimuthal_integral * edges.weight, edges.values, amplitudes)
            for name, edges in edges_of.items()
            if name in FORCE_EDGES
        }
        inverse = np.linalg.pinv(amplitudes)
        for name, edges in edges_of.items():
            if name in LIFTED_EDGES:
                tables[name, "lifted"] = np.broadcast_to(
                    np.einsum("sq,ca->csqa", edges.coefficients, inverse),
                    (len(edges.element), len(inverse), *edges.coefficients.shape[:1], edges.coefficients.shape[1], 3),
                )
        return {key: self._build_table(edges_of[key[0]], table) for key, table in tables.items()}

    def _build_table(self, edges: Edges, table: Floats) -> tuple[Ints, Ints, Floats]:
        """Return the indices of elements (e, 1) and functions (e, c s), and the table (e, c, s, ...) as (e, c s, data)."""
        e, c, s = table.shape[:3]
        functions = np.arange(c)[:, None] * 4 * self.harmonic.model.shapes.order + edges.local[:, None]  # (e, c, p + 1)
        return (
            np.searchsorted(self.harmonic.boundary, edges.element)[:, None],
            functions.reshape(e, c * s),
            table.reshape(e, c * s, -1),
        )

    def _place_data(self, data: EdgeData) -> Floats:
        """Convert data on the edges to values or forces of the boundary's elements, and add them up, (elements, 4 c p, k)."""
        k = next((values.shape[-1] for values in data.values()), 1)
        element_values = np.zeros((len(self.harmonic.boundary), self.harmonic.stiffness.shape[1], k))
        for key, values in data.items():
            row, column, table = self._tables[key]
            element_values[row, column] += table @ values.reshape(len(values), -1, k)
        return element_values

    def compute_loads(self, data: EdgeData) -> tuple[Floats, Floats]:
        """Compute imposed values of the boundary's elements, (elements, 4 c p, k), and forces -F, (unknowns, k), from data.

        Imposed values are -u_s on bottom and interfaces; F = t_s + K Y u_s is that of eq. MS.5, where Y also lifts the ends.
        """
        tractions = {key: values for key, values in data.items() if key[1] == "forces"}
        ends = {key: values for key, values in data.items() if key == ("ends", "lifted")}
        lifted = {key: values for key, values in data.items() if key not in tractions and key not in ends}
        imposed = -self._place_data(lifted)
        forces = self._place_data(tractions) + self.harmonic.stiffness @ (imposed + self._place_data(ends))
        return imposed, -(self._force_assembly @ forces.reshape(-1, forces.shape[-1]))

    def compute_values(self, v: Floats, imposed: Floats, elements: Ints) -> Floats:
        """Return values U, V, W of the reflection w, eq. MS.4, in some of the tissue's elements, (e, 3, s, k).

        Values on the elements' edges are the unknowns plus what the boundary imposes; those inside elements follow from them.

        Parameters
        ----------
        v
            The unknowns, ``Harmonic.solve`` of the forces.
        imposed
            Imposed values of the boundary's elements, by all layers' data, see ``compute_loads``.
        elements
            The elements.
        """
        edge_values = (self.harmonic.numbering.take_gather_rows(elements) @ v).reshape(len(elements), -1, v.shape[-1])
        on_boundary = np.isin(elements, self.harmonic.boundary)
        edge_values[on_boundary] += imposed[np.searchsorted(self.harmonic.boundary, elements[on_boundary])]
        return self.harmonic.compute_values(edge_values, self._find_recovery(elements))

    def _find_recovery(self, elements: Ints) -> Floats:
        """Return the recovery of some elements; it is cached, as exchanges use it repeatedly."""
        missing = [element for element in elements.tolist() if element not in self._recovered]
        if missing:
            self._recovered.update(zip(missing, self.recovery(np.array(missing)), strict=True))
        return np.stack([self._recovered[element] for element in elements.tolist()])
