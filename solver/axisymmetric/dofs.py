"""Number the unknowns of a mesh and find its sparsity pattern, once for all sections of a kind."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal

import numpy as np
import scipy.sparse as sp

from geometry.common.arrays import Bools, Floats, Ints
from geometry.meridian.mesh import Topology, compute_labels, label_line
from geometry.meridian.section import TISSUES, Body
from solver.linalg.cholesky import Factor, Pattern, factorise
from solver.linalg.workspace import keep_result

Interface = Literal["bonded", "frictionless", "apart"]  # apart: no ties; solver/contact handles contact
# what vanishes on the axis of u_r, u_z (m = 0), else of u_r + u_theta, u_r - u_theta, u_z: only a translation (m = 1) does not
FIXED_ON_AXIS = {0: (True, False), 1: (True, False, True)}


@dataclass(frozen=True, eq=False)
class Numbering:
    """Unknowns of a condensed system: u_r and u_z of the functions on corners and edges, 8 p for each element.

    For fields of azimuthal order m > 0 (``solver/multiple_scattering/azimuthal_systems.py``) there are three components and 12 p
    values for each element.

    Attributes
    ----------
    gather
        From unknowns to the elements' own values, shape (8 p n, unknowns). Odd functions of an edge change their sign in elements
        that run along the edge in the opposite direction. The transpose sums elements' forces.
    lift
        The elements' own values of each state's rigid shift of a block, for the tissue's elements alone, shape (n, 8 p, 2); for
        blocks it is zero, as their shift causes no strain.
    rows, starts
        Row numbers and column starts of the system's matrix in compressed columns.
    sums
        Sparse matrix that sums the entries of the elements' matrices, with their signs, to those of the system's matrix; shape
        (entries, n (8 p)^2).
    signs
        Of the elements' own values, shape (n, 8 p).
    degrees
        Of the unknowns' functions, 1 at corners, shape (unknowns,).
    vertical
        The elements' own values that a shift along z sets to 1, shape (8 p,); none where m > 0.
    pattern
        Sparsity pattern, shared by the matrices of systems that are used one after the other.
    """

    gather: sp.csr_array
    lift: Floats
    rows: Ints
    starts: Ints
    sums: sp.csr_array
    signs: Floats
    degrees: Ints
    vertical: Floats
    pattern: Pattern = field(default_factory=Pattern)

    def take_gather_rows(self, elements: Ints) -> Any:
        """Return the rows of ``gather`` for some elements, by their numbers: sparse, (8 p elements, unknowns), 12 p if m > 0."""
        size = self.signs.shape[1]
        return self.gather[(elements[:, None] * size + np.arange(size)).ravel()]

    @property
    def unknowns(self) -> int:
        """Size of the system."""
        return len(self.starts) - 1

    def assemble(self, stiffness: Floats) -> sp.csc_array:
        """Return the system's matrix, assembled from the elements' matrices, shape (n, 8 p, 8 p)."""
        matrix = copy(self._empty_matrix)  # a copy: SciPy checks the rows only once
        matrix.data = self.sums @ stiffness.ravel()
        return matrix

    @cached_property
    def scatter(self) -> sp.csr_array:
        """The transpose of ``gather``: from the elements' forces to those of the unknowns."""
        return self.gather.T.tocsr()

    @cached_property
    def unsigned_scatter(self) -> sp.csr_array:
        """``scatter`` without signs, which sums magnitudes."""
        return abs(self.scatter)

    @cached_property
    def _empty_matrix(self) -> sp.csc_array:
        """The system's matrix with its sparsity pattern and zeros as entries."""
        return sp.csc_array((np.zeros(len(self.rows)), self.rows, self.starts), shape=(self.unknowns,) * 2)


@keep_result
def number_unknowns(mesh: Topology, order: int, interface: Interface, m: int = 0) -> Numbering:
    """Return the numbering of a mesh's unknowns at one polynomial order, for fields of azimuthal order m (m = 0: axisymmetric).

    Functions are the shape functions on corners and edges; each has one degree of freedom ("dof") per displacement component.
    Dofs that are fixed have no unknown (number -1); dofs that are tied by the contact share one.
    """
    probe = ~np.isin(mesh.body, (*TISSUES, Body.INCLUSION))
    functions, signs, ends = number_functions(compute_labels(mesh), probe, order)
    owner, fixed, unit_shift = _find_ties(mesh, ends, interface, FIXED_ON_AXIS.get(m, (True, True, True)))
    components = owner.shape[1]
    number = np.full(owner.max() + 1, -1)  # the unknown of each dof, -1 where fixed
    free = np.setdiff1d(np.unique(owner), owner[fixed])
    number[free] = np.arange(len(free))
    dofs = number[owner[functions]].transpose(0, 2, 1).reshape(len(functions), -1)
    lift = np.zeros((len(functions), components, functions.shape[1], 2))
    vertical = np.zeros((components, functions.shape[1]))
    if m == 0:
        # minus: the block shifts into the tissue, along -z; the unknowns at the contact are counted from there
        lift[:, 1] = np.where(probe[:, None, None], 0.0, -unit_shift[functions])
        vertical[1, :4] = 1.0
    all_signs = np.tile(signs, components)
    degrees = np.repeat(ends[:, 5], components).astype(int)[free]  # ties are between functions of one degree
    pattern = build_pattern(dofs, all_signs, len(free))
    return Numbering(
        build_gather(dofs, all_signs, len(free)),
        lift.reshape(len(functions), -1, 2),
        *pattern,
        all_signs,
        degrees,
        vertical.ravel(),
    )


@dataclass(frozen=True, eq=False)
class Subspace:
    """The unknowns of functions up to a degree.

    Attributes
    ----------
    unknowns
        Numbers of the subspace's unknowns among all.
    entries
        Indices of the whole matrix's entries whose row and column both belong to these unknowns.
    rows, starts
        Row numbers and column starts of their matrix in compressed columns.
    pattern
        Sparsity pattern, shared by their matrices.
    """

    unknowns: Ints
    entries: Ints
    rows: Ints
    starts: Ints
    pattern: Pattern = field(default_factory=Pattern)

    def factor(self, matrix: sp.csc_array) -> Factor:
        """Factorise a matrix of all unknowns restricted to these."""
        restricted = (matrix.data[self.entries], self.rows, self.starts)
        return factorise(sp.csc_array(restricted, shape=(len(self.unknowns),) * 2), self.pattern)


@keep_result
def select_subspace(numbering: Numbering, degree: int) -> Subspace:
    """Return the subspace of functions of at most the given degree."""
    # ``number``: of each unknown in the subspace, where it is inside
    inside = numbering.degrees <= degree
    number: Any = np.cumsum(inside, dtype=np.int32) - 1
    columns = np.repeat(np.arange(numbering.unknowns), np.diff(numbering.starts))
    entries = np.flatnonzero(inside[numbering.rows] & inside[columns])
    starts: Any = np.concatenate([[0], np.cumsum(np.bincount(number[columns[entries]]))]).astype(np.int32)
    return Subspace(np.flatnonzero(inside), entries, number[numbering.rows[entries]], starts)


def number_functions(corners: Floats, probe: Bools, order: int) -> tuple[Ints, Floats, Floats]:
    """Assign numbers to the functions on corners and edges, separately for probe and tissue.

    Returns the numbers and signs of each element's functions, shape (n, 4 p) both, and a row for each function: the two ends of
    its edge, or its corner twice, then 0 (tissue) or 1 (probe), then its degree, that is (r, z, r, z, probe, degree).

    Parameters
    ----------
    corners
        Labels of the elements' corners, which serve as coordinates (r, z), shape (n, 4, 2).
    probe
        Whether each element belongs to the probe, shape (n,).
    order
        Polynomial order p.
    """
    n = len(corners)
    points = np.concatenate([corners, np.broadcast_to(probe[:, None, None], (n, 4, 1))], axis=2).reshape(-1, 3)
    _, first, vertex = np.unique(points, axis=0, return_index=True, return_inverse=True)
    points, vertex = points[first], vertex.reshape(n, 4)
    start, end = (vertex[:, list(ends)] for ends in ((0, 1, 3, 0), (1, 2, 2, 3)))  # bottom, right, top, left, along u and v
    pairs, edge = np.unique(np.sort(np.stack([start, end], axis=-1).reshape(-1, 2), axis=1), axis=0, return_inverse=True)
    degree = np.arange(2, order + 1)
    edge_functions = len(points) + edge.reshape(n, 4, 1) * (order - 1) + degree - 2
    # odd functions change their sign in elements that run along the edge from its higher to its lower vertex
    turned = np.where((start > end)[:, :, None] & (degree % 2 == 1), -1.0, 1.0)
    functions = np.concatenate([vertex, edge_functions.reshape(n, -1)], axis=1)
    signs = np.concatenate([np.ones((n, 4)), turned.reshape(n, -1)], axis=1)
    at_vertex = np.concatenate([points[:, :2], points[:, :2], points[:, 2:], np.ones((len(points), 1))], axis=1)
    at_edge = np.repeat(
        np.concatenate([points[pairs[:, 0], :2], points[pairs[:, 1], :2], points[pairs[:, 0], 2:]], axis=1), order - 1, axis=0
    )
    return functions, signs, np.concatenate([at_vertex, np.column_stack([at_edge, np.tile(degree, len(pairs))])])


def _find_ties(mesh: Topology, ends: Floats, interface: Interface, axis: tuple[bool, ...]) -> tuple[Ints, Bools, Floats]:
    """Find the constraints at supports, on the axis and between blocks and tissue; u_z is the last component.

    Returns for each component of each function the dof that represents it and whether it is fixed, shape (functions, components),
    and the value of each function in a unit shift of the inner and the outer block, shape (functions, 2).

    Parameters
    ----------
    mesh
        The mesh, whose layout gives the lines of surface, blocks and supports.
    ends
        A row (r, z, r, z, probe, degree) for each function, see ``number_functions``.
    interface
        How blocks and tissue touch.
    axis
        Which components vanish on the axis.
    """
    layout, (r0, z0, r1, z1, probe, degree) = mesh.layout, ends.T
    surface = label_line(layout.row["surface"])
    spans = [(label_line(low), label_line(high)) for low, high in layout.faces]
    under_blocks = [
        (z0 == surface) & (z1 == surface) & (low <= r0) & (r0 <= high) & (low <= r1) & (r1 <= high) for low, high in spans
    ]
    in_contact = under_blocks[0] | under_blocks[1]
    owner = np.arange(len(axis) * len(ends)).reshape(-1, len(axis))
    keys, (tissue_functions, probe_functions) = (
        ends[:, [0, 2, 5]],
        (np.flatnonzero(in_contact & (probe == side)) for side in (0, 1)),
    )
    tissue = dict(zip(map(tuple, keys[tissue_functions].tolist()), tissue_functions, strict=True))
    for k, key in zip(probe_functions, map(tuple, keys[probe_functions].tolist()), strict=True):
        partner = tissue[key]
        if interface == "bonded":
            owner[k] = owner[partner]
        elif interface == "frictionless":
            owner[k, -1] = owner[partner, -1]
    fixed = ((r0 == 0) & (r1 == 0))[:, None] & np.array(axis)
    tops = {layout.inner[-1], layout.outer[-1]} if layout.kind.base is None else {layout.base[-1]}
    edge_levels = [0.0, *(label_line(top) for top in tops)]
    fixed[np.isin(z0, edge_levels) & np.isin(z1, edge_levels) & (z0 == z1)] = True
    fixed[(r0 == r1) & (z0 == z1) & (degree > 1)] = True  # edges that are points
    shifted = [mask & (degree == 1) & (interface != "apart") for mask in under_blocks]
    return owner, fixed, np.stack(shifted, axis=-1).astype(float)


def build_gather(dofs: Ints, signs: Floats, unknowns: int) -> sp.csr_array:
    """Return the sparse matrix that gives the elements' own values from the unknowns.

    ``dofs`` are the unknowns of these values, negative where fixed, and ``signs`` their signs; shape (n, values) both.
    """
    free = dofs.ravel() >= 0
    starts = np.concatenate([[0], np.cumsum(free)])
    return sp.csr_array((signs.ravel()[free], dofs.ravel()[free], starts), shape=(dofs.size, unknowns))


def build_pattern(dofs: Ints, signs: Floats, unknowns: int) -> tuple[Ints, Ints, sp.csr_array]:
    """Return rows and column starts of the system's matrix, and the sparse matrix that sums elements' entries to its entries.

    ``dofs`` are the unknowns of the elements' own values, negative where fixed, and ``signs`` their signs; shape (n, values)
    both.
    """
    size = dofs.shape[1]
    # entries of all elements' matrices, sorted by column, then row: first by row, then stably by column
    dofs_int32: Any = dofs.astype(np.int32)
    row, column = (
        np.broadcast_to(index, (*dofs.shape, size)).ravel() for index in (dofs_int32[:, :, None], dofs_int32[:, None, :])
    )
    entries = np.flatnonzero((row >= 0) & (column >= 0))
    entries = entries[_find_order(row.take(entries), unknowns)]
    entries = entries[_find_order(column.take(entries), unknowns)]
    row, column = row.take(entries), column.take(entries)
    begins = np.flatnonzero(np.append(True, (row[1:] != row[:-1]) | (column[1:] != column[:-1])))
    # runs of equal row and column are one entry of the system's matrix
    row, column, ends = row.take(begins), column.take(begins), np.append(begins, len(entries)).astype(np.int32)
    products = (signs[:, :, None] * signs[:, None]).ravel().take(entries)
    sums = sp.csr_array((products, entries.astype(np.int32), ends), shape=(len(begins), dofs.size * size))
    starts: Any = np.append(0, np.cumsum(np.bincount(column, minlength=unknowns))).astype(np.int32)
    return row, starts, sums


def _find_order(numbers: Ints, count: int) -> Ints:
    """Return the indices that sort numbers below ``count`` stably.

    The conversion of a sparse matrix of one row to columns does this by counting, faster than a general sort.
    """
    whole = np.array([0, len(numbers)], dtype=np.int32)
    row = sp.csr_array((np.arange(len(numbers)), numbers, whole), shape=(1, count))
    return np.asarray(row.tocsc().data)
