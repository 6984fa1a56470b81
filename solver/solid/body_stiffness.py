"""Compute the stiffness of a mesh of tetrahedra, body by body: integrated once, then combined for any linear laws."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from geometry.common.arrays import Floats, Ints
from solver.materials.linear import VOIGT_INDEX, LinearLaw
from solver.solid.tetrahedron import compute_grams, compute_mean_dilation, iterate_quadrature

BATCH_PAIRS = 1 << 15  # pairs at once, which limits the working memory
LOWER_NODES, UPPER_NODES = np.tril_indices(10)  # pairs of an element's nodes


@dataclass(frozen=True)
class Coefficients:
    """Factors of a linear law for the integrals of a body's ``Part``, eq. SO.2.

    Attributes
    ----------
    gram_factors
        Matrix that gives the nine numbers of a pair's stiffness from the nine of its G, without lambda's part, Pa, shape (9, 9).
    dilation_factor
        Lambda of eq. SO.2, Pa.
    """

    gram_factors: Floats
    dilation_factor: float

    @classmethod
    def from_law(cls, law: LinearLaw) -> Coefficients:
        """Return the coefficients of a linear law: lambda, and C minus lambda's part as a matrix between pairs of axes."""
        C = law.build_stiffness()
        C[:3, :3] -= law.dilation_modulus
        whole = C[VOIGT_INDEX[:, :, None, None], VOIGT_INDEX]  # C_ikjl
        return cls(whole.transpose(1, 3, 0, 2).reshape(9, 9), law.dilation_modulus)


@dataclass(frozen=True)
class Part:
    """One body's stiffness, lower triangle of blocks by pairs of nodes.

    Attributes
    ----------
    rows, columns
        The pairs' nodes, columns <= rows, shape (n,).
    gram
        G of eq. SO.1, assembled, shape (n, 3, 3), m.
    dilation
        The matrix that lambda of eq. SO.2 multiplies: the same array, unless each element's dilation is averaged.
    """

    rows: Ints
    columns: Ints
    gram: Floats
    dilation: Floats

    def compute_blocks(self, coefficients: Coefficients) -> Floats:
        """Return the stiffness of eq. SO.2 for each pair of nodes; shape (n, 3, 3), N/m."""
        blocks = np.empty(self.gram.shape)  # in the layout of sparse block matrices, which then need no copy
        for low in range(0, len(blocks), BATCH_PAIRS):
            batch = slice(low, low + BATCH_PAIRS)
            flat = self.gram[batch].reshape(-1, 9) @ coefficients.gram_factors
            np.add(flat.reshape(-1, 3, 3), coefficients.dilation_factor * self.dilation[batch], out=blocks[batch])
        return blocks

    def compute_forces(self, law: LinearLaw, u: Floats) -> Floats:
        """Return the nodal forces (3 n, k), N, for displacements u (3 n, k) of all nodes, m."""
        blocks, count = self.compute_blocks(Coefficients.from_law(law)), len(u) // 3
        starts = np.searchsorted(self.rows, np.arange(count + 1))
        lower = sp.bsr_array((blocks, self.columns, starts), shape=(len(u), len(u)))
        is_diagonal = self.rows == self.columns
        starts = np.searchsorted(self.rows[is_diagonal], np.arange(count + 1))
        diagonal = sp.bsr_array((blocks[is_diagonal], self.rows[is_diagonal], starts), shape=lower.shape)
        return np.asarray(lower @ u + lower.T @ u - diagonal @ u)


def integrate_part(nodes: Floats, elements: Ints, averaged: bool = False) -> Part:
    """Integrate the stiffness of one body, pair by pair of its nodes.

    Parameters
    ----------
    nodes
        Positions of all nodes, m, shape (nodes, 3).
    elements
        Nodes of the body's elements, shape (t, 10).
    averaged
        Whether each element's dilation is replaced by its mean, which avoids locking.

    Raises
    ------
    SolveError
        An element is turned inside out.
    """
    high, low = (pick(elements[:, LOWER_NODES], elements[:, UPPER_NODES]) for pick in (np.maximum, np.minimum))
    # each pair of nodes has one key; slots are the places of the elements' pairs among the different keys
    keys, slots = np.unique((high * len(nodes) + low).ravel(), return_inverse=True)
    slots = slots.reshape(high.shape)
    flipped = elements[:, LOWER_NODES] < elements[:, UPPER_NODES]
    gram = np.zeros((9, len(keys)))
    dilation = np.zeros((9, len(keys))) if averaged else gram
    for selection, _, g, weight in iterate_quadrature(nodes[elements]):
        _add_matrices(gram, compute_grams(g, weight), slots[selection], flipped[selection])
        if averaged:
            _add_matrices(dilation, compute_mean_dilation(g, weight), slots[selection], flipped[selection])
    by_block = gram.T.reshape(-1, 3, 3)
    return Part(keys // len(nodes), keys % len(nodes), by_block, dilation.T.reshape(-1, 3, 3) if averaged else by_block)


def _add_matrices(sums: Floats, matrices: Floats, slots: Ints, flipped: NDArray[np.bool_]) -> None:
    """Add elements' matrices to the sums of their pairs of nodes, in place.

    Parameters
    ----------
    sums
        Sums of the nine numbers of each pair's block, shape (9, pairs).
    matrices
        Matrices of n elements, 10 nodes times 3 axes, shape (n, 30, 30).
    slots
        Place of each element's pairs in the sums, shape (n, 55).
    flipped
        Where the pair's first node has the lower number, so that its block is transposed, shape (n, 55).
    """
    low, high = int(slots.min()), int(slots.max()) + 1
    place = (slots - low).ravel()
    split = matrices.reshape(-1, 10, 3, 10, 3)
    for k in range(9):
        i, j = divmod(k, 3)
        values = split[:, :, i, :, j][:, LOWER_NODES, UPPER_NODES]
        if i != j:
            values = np.where(flipped, split[:, :, j, :, i][:, LOWER_NODES, UPPER_NODES], values)
        sums[k, low:high] += np.bincount(place, weights=values.ravel(), minlength=high - low)


def assemble(body_parts: Mapping[int, Part], laws: Mapping[int, LinearLaw], number: Ints) -> sp.csc_array:
    """Assemble the lower triangle of the stiffness of all bodies that have a law.

    Parameters
    ----------
    body_parts
        Integrated stiffness of the bodies.
    laws
        Laws of the bodies that are present.
    number
        Unknown of each displacement, shape (nodes, 3); < 0 for none.
    """
    size, number = int(number.max()) + 1, number.astype(np.int32)
    pieces = [
        _list_entries(part, part.compute_blocks(Coefficients.from_law(laws[body])), number)
        for body, part in body_parts.items()
        if body in laws
    ]
    values, high, low = (np.concatenate(kind) for kind in zip(*pieces, strict=True))
    del pieces  # as large as the arrays made of them, and as those made next
    rows = sp.coo_array((values, (low, high)), shape=(size, size)).tocsr()  # the upper triangle by rows is the lower by columns
    rows.sort_indices()
    return sp.csc_array((rows.data, rows.indices, rows.indptr), shape=rows.shape)


def _list_entries(part: Part, blocks: Floats, number: Ints) -> tuple[Floats, Ints, Ints]:
    """List the values, rows and columns of a body's stiffness in the lower triangle of the whole matrix.

    Parameters
    ----------
    part, blocks
        The body and its stiffness for each pair of nodes, N/m, shape (n, 3, 3).
    number
        Unknown of each displacement, shape (nodes, 3); < 0 for none.
    """
    row = np.broadcast_to(number[part.rows][:, :, None], blocks.shape)
    column = np.broadcast_to(number[part.columns][:, None], blocks.shape)
    # the block of a node with itself is symmetric: only its lower triangle counts
    counted = (part.rows != part.columns)[:, None, None] | (np.arange(3)[:, None] >= np.arange(3))
    inside = (row >= 0) & (column >= 0) & counted
    row, column, values = row[inside], column[inside], blocks[inside]
    # sliding nodes share u_z: their one entry stands for two
    values = np.where((row == column) & (part.rows != part.columns)[np.nonzero(inside)[0]], 2 * values, values)
    return values, np.maximum(row, column), np.minimum(row, column)
