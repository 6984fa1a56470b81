"""Compute the finite elements' response to a field on the tissue's boundary: one symmetric matrix per azimuthal order.

A scattered field u_s, in equilibrium in the tissue, has tractions t_s on the tissue's boundary. The reflected field w must be
added to satisfy the boundary conditions. The unknown is w in the tissue, and the whole displacement in the blocks, w + u_s on
their ends. With v any test displacement, w follows from

    forces -Int t_s . v on the tissue's surface and side; the blocks strained by u_s on their ends; w = -u_s on the bottom (MS.4)

With Y the matrix that lifts u_s of the ends into the blocks and -u_s of the bottom into the tissue, Y_bottom its second part, and
t_s now the nodal forces of the tractions,

    w = v + Y_bottom u_s,   K v = -F (t_s, u_s),   F = t_s + K Y u_s                                       (MS.5)

where K is the stiffness, v the unknowns and F the forces. Only the work of w on other fields u_1 from spheres, with tractions
t_1, is needed. By Betti's theorem it is an integral over the boundary, where t(w) are the tractions of w and indices 1 and 2 are
fields:

    Int t_1 . w_2 - t(w_2) . u_1 = -F_1^T K^-1 F_2 + (Y u_1)^T K Y u_2 + t_1^T Y_bottom u_2
                                   + Int_surface,side u_1 . t_2 - Int_bottom t_1 . u_2                     (MS.6)

In tissue of layers, the boundary is that of the sphere's own layer: top, side and bottom. u_s ends at an interface to another
layer, so that w and its traction jump there by u_s and t_s. With v the whole displacement, such an interface is like surface and
bottom together: t_s are forces on it, and -u_s is lifted into the layer's own elements. Y_bottom then contains both, and the last
line has no term of the interface. For spheres in two different layers only v matters, and -F_1^T K^-1 F_2 is the whole work.

The work is symmetric in both fields. All data are interpolated by the elements' functions on the boundary, so that all terms
neglect the same part of them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.linalg.blas import dsymv

from geometry.common.arrays import Floats, Ints
from solver.axisymmetric.base_states import MeridianModel
from solver.axisymmetric.dofs import Interface
from solver.linalg.cholesky import Factor, has_pardiso
from solver.linalg.schur_complements import SchurComplements
from solver.multiple_scattering.azimuthal_systems import COMPONENT_MATRICES, Harmonic
from solver.multiple_scattering.boundary_edges import Boundary, Edges
from solver.multiple_scattering.rings import PanelLine, Panels


@dataclass(frozen=True)
class BoundaryData:
    """Matrices from data at the panels' points to elements on the boundary, for orders with the same components.

    Data are the amplitudes t_r, t_theta, t_z, u_r, u_theta, u_z (tractions by the outward normal) of all n points, one below the
    other: 6 n rows. Those of several layers stand one below the other.

    Attributes
    ----------
    forces
        Forces on the values of the e elements with an edge on the boundary, by the tractions on surface, side and interfaces,
        sparse (4 c p e, 6 n), c components.
    values
        Lifted values of the elements: displacements of the blocks' ends, and minus those of bottom and interfaces.
    direct
        The last line of eq. MS.6, sparse (6 n, 6 n), symmetric.
    """

    forces: Any
    values: Any
    direct: Any

    @classmethod
    def from_layer(
        cls, model: MeridianModel, boundary: Boundary, elements: Ints, panels: Panels, *, interface: Interface, m: int
    ) -> BoundaryData:
        """Build the data matrices of one layer, for order 0 or for all orders above; ``elements`` are those of all boundaries."""
        amplitudes = COMPONENT_MATRICES[min(m, 1)]  # from components to r, theta and z
        azimuthal_integral = 2 * np.pi if m == 0 else np.pi  # of cos^2 m theta
        to_components = np.linalg.pinv(amplitudes)
        # displacements of the blocks' ends that are tied to the tissue: a frictionless end transmits only z
        tied = np.diag([0.0, 0.0, 1.0]) if interface == "frictionless" else np.eye(3)
        entries = _EntryPlaces(elements, 4 * model.shapes.order, len(amplitudes.T), len(panels.r))
        surface, side, floor = panels.parts

        def build_matrices(edges: Edges, places: Floats, line: PanelLine, part: slice) -> tuple[Any, Any]:
            """Build the matrices from tractions to forces and from displacements to values, on one line's edges.

            ``places`` are the positions of the edges' points along the line, m; ``part`` is the slice of the line's data points.
            """
            interpolation = line.build_interpolation(places)
            loads = np.einsum("eq,qs,eqn->esn", azimuthal_integral * edges.weight, edges.values, interpolation)
            forces = entries.build_sparse(edges, loads, amplitudes.T, 0, part.start)
            lifted = np.einsum("sq,eqn->esn", edges.coefficients, interpolation)
            return forces, entries.build_sparse(edges, lifted, to_components, 3, part.start)

        surface_forces, surface_values = build_matrices(boundary.surface, boundary.surface.r, panels.surface, surface)
        side_forces, side_values = build_matrices(boundary.side, -boundary.side.z - panels.top, panels.side, side)
        floor_forces, floor_values = build_matrices(boundary.floor, boundary.floor.r, panels.floor, floor)
        direct = surface_forces.T @ surface_values + side_forces.T @ side_values - floor_forces.T @ floor_values
        ends = np.einsum("sq,eqn->esn", boundary.ends.coefficients, panels.surface.build_interpolation(boundary.ends.r))
        forces = surface_forces + side_forces
        values = entries.build_sparse(boundary.ends, ends, to_components @ tied, 3, surface.start) - floor_values
        for edges, line, part in ((boundary.above, panels.surface, surface), (boundary.below, panels.floor, floor)):
            if len(edges.element):  # an interface to another layer
                face_forces, face_values = build_matrices(edges, edges.r, line, part)
                forces, values = forces + face_forces, values - face_values
        return cls(forces, values, ((direct + direct.T) / 2).tocsr())

    @classmethod
    def stack(cls, parts: Sequence[BoundaryData]) -> BoundaryData:
        """Stack the data matrices of several layers."""
        if len(parts) == 1:
            return parts[0]
        forces, values = (sp.hstack([getattr(part, name) for part in parts], format="csr") for name in ("forces", "values"))
        return cls(forces, values, sp.block_diag([part.direct for part in parts], format="csr"))


@dataclass(frozen=True)
class _EntryPlaces:
    """Numbering of the rows (values of the boundary's elements) and columns (data at the panels' points).

    Attributes
    ----------
    elements
        Elements with an edge on the boundary, rising.
    functions, components
        Numbers of functions on corners and edges of an element, and of components, 2 or 3.
    points
        Number of the panels' points.
    """

    elements: Ints
    functions: int
    components: int
    points: int

    def build_sparse(self, edges: Edges, table: Floats, transformation: Floats, first: int, start: int) -> Any:
        """Build a sparse matrix from points of a line to functions of its edges.

        ``table``, (e, s, n), maps n points to s functions of e edges; ``transformation``, (c, 3), maps r, theta, z to components.
        ``first`` is 0 for tractions and 3 for displacements, ``start`` the index of the line's first point.
        """
        row = np.searchsorted(self.elements, edges.element)[:, None] * self.components
        triplets = []
        for c, component in enumerate(transformation):
            rows = (row + c) * self.functions + edges.local
            for a, factor in enumerate(component):
                if factor:
                    e, s, n = np.nonzero(table)
                    triplets.append((rows[e, s], (first + a) * self.points + start + n, factor * table[e, s, n]))
        rows_, columns, entries = (np.concatenate(part) for part in zip(*triplets, strict=True))
        size = len(self.elements) * self.components * self.functions, 6 * self.points
        return sp.csr_array((entries, (rows_, columns)), shape=size)


@dataclass(frozen=True)
class BoundaryResponse:
    """Response of one azimuthal order to data on the boundary: the symmetric matrix of eq. MS.6.

    Attributes
    ----------
    assemble
        Assembles the order's system.
    boundary
        Matrices from data to the elements.
    complements
        Computes the matrix at the cost of a factor, if PARDISO is installed.
    """

    assemble: Callable[[], Harmonic]
    boundary: BoundaryData
    complements: SchurComplements

    def apply(self, data: Floats, often: bool) -> Floats:
        """Return the matrix times data, shape (6 n, k) both.

        ``often`` says that many calls will follow. Without PARDISO the matrix is formed only then, else the system is solved.

        Raises
        ------
        SolveError
            See ``Harmonic.solve``.
        """
        product = np.asarray(self.boundary.direct @ data)
        if not often and not has_pardiso():
            return product + self._system.compute_work(data)
        product[self._active_data] += _multiply_symmetric(self._matrix, data[self._active_data])
        return product

    @cached_property
    def _system(self) -> _System:
        """The order's system; ``_matrix`` deletes it from the cache once it has been used."""
        return _System.from_boundary(self.assemble(), self.boundary)

    @cached_property
    def _active_data(self) -> Ints:
        """Indices of the data that act on the elements."""
        entries = np.diff(self.boundary.values.tocsc().indptr) + np.diff(self.boundary.forces.tocsc().indptr)
        return np.flatnonzero(entries)

    @cached_property
    def _matrix(self) -> Floats:
        """Matrix of eq. MS.6 without ``boundary.direct``, for the active data; the system, ten times as large, is freed."""
        matrix = self._system.compute_matrix(self._active_data, self.complements)
        vars(self).pop("_system")  # where cached_property keeps it
        return matrix


@dataclass(frozen=True)
class _System:
    """The system of one order with the forces that boundary data exert on it.

    Attributes
    ----------
    harmonic
        The order's system.
    force_matrix
        Forces F on the unknowns by data, eq. MS.5, sparse by rows (unknowns, 6 n).
    lifting
        The terms of eq. MS.6 with Y, sparse (6 n, 6 n), symmetric.
    """

    harmonic: Harmonic
    force_matrix: Any
    lifting: Any

    @classmethod
    def from_boundary(cls, harmonic: Harmonic, boundary: BoundaryData) -> _System:
        """Build the matrices from data to forces and lifted terms."""
        blocks, ends = harmonic.stiffness, np.arange(len(harmonic.stiffness) + 1)
        strained = sp.bsr_array((blocks, ends[:-1], ends)).tocsr() @ boundary.values
        half = boundary.values.T @ (strained / 2 + boundary.forces / 2)
        pressed = harmonic.numbering.take_gather_rows(harmonic.boundary).T @ (boundary.forces + strained)
        return cls(harmonic, pressed.tocsr(), (half + half.T).tocsr())

    def compute_work(self, data: Floats) -> Floats:
        """Return the matrix of eq. MS.6 without ``BoundaryData.direct``, times data (6 n, k), by one solve.

        Raises
        ------
        SolveError
            See ``Harmonic.solve``.
        """
        return np.asarray(self.lifting @ data - self._transposed_forces @ self._factor.solve(self.force_matrix @ data))

    def compute_matrix(self, active_data: Ints, complements: SchurComplements) -> Floats:
        """Return the matrix of eq. MS.6 without ``BoundaryData.direct``, its rows and columns those of ``active_data``.

        Raises
        ------
        SolveError
            See ``Harmonic.solve``.
        """
        pressed, lifting = self.force_matrix[:, active_data], self.lifting[active_data][:, active_data].toarray()
        works = complements.compute_product(self.harmonic.matrix, pressed)  # F^T K^-1 F, None without PARDISO
        if works is not None:
            return np.asarray(lifting - works)
        forces, rows = pressed.toarray(), np.flatnonzero(np.diff(pressed.indptr))
        half = lifting / 2 - forces[rows].T @ self.harmonic.solve(forces)[rows] / 2
        return np.asarray(half + half.T)

    @cached_property
    def _transposed_forces(self) -> Any:
        """Transpose of ``force_matrix``, stored by rows for faster products."""
        return self.force_matrix.T.tocsr()

    @cached_property
    def _factor(self) -> Factor:
        """Factor of the order's matrix, after a check of its residual with a load that contains all data."""
        size = np.sqrt((self.force_matrix**2).sum(axis=0))
        # all data are scaled to the same force; cosines keep them from cancelling
        mix = np.divide(np.cos(np.arange(len(size))), size, out=np.zeros(len(size)), where=size > 0)
        self.harmonic.solve(np.asarray(self.force_matrix @ mix[:, None]))
        return self.harmonic.factor


def _multiply_symmetric(matrix: Floats, columns: Floats) -> Floats:
    """Multiply a symmetric matrix with columns (n, k); ``dsymv`` reads half of it, which is faster for one or two columns."""
    if columns.shape[1] > 2:
        return matrix @ columns
    return np.stack([dsymv(1.0, matrix.T, column) for column in columns.T], axis=1)
