"""The stiffness of a mesh of tetrahedra, body by body: K = sum_b [lambda_b V_b + mu_b S_b], recombined for any moduli."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from geometry.common.arrays import Floats, Ints
from solver.solid.tetrahedron import grams, integrated, mean_dilation

BATCH = 1 << 15  # pairs at once, which limits the working memory
LOWER, UPPER = np.tril_indices(10)  # pairs of an element's nodes


class Elastic(Protocol):
    """An isotropic material."""

    @property
    def youngs_modulus(self) -> float: ...  # noqa: D102
    @property
    def poisson_ratio(self) -> float: ...  # noqa: D102


@dataclass(frozen=True)
class Isotropic:
    """An isotropic material: Young's modulus, Pa, and Poisson's ratio."""

    youngs_modulus: float
    poisson_ratio: float


def lame(material: Elastic) -> tuple[float, float]:
    """Return Lame's constants lambda and mu, Pa."""
    e, nu = material.youngs_modulus, material.poisson_ratio
    return e * nu / ((1 + nu) * (1 - 2 * nu)), e / (2 * (1 + nu))


@dataclass(frozen=True)
class Part:
    """One body's stiffness, lower triangle of blocks by pairs of nodes.

    Attributes:
        rows, columns: the pairs' nodes, columns <= rows, shape (n,).
        gram: G of eq. SO.1, assembled, shape (n, 3, 3), m.
        dilation: the matrix that lambda multiplies: the same array, unless each element's dilation is averaged.
    """

    rows: Ints
    columns: Ints
    gram: Floats
    dilation: Floats

    def blocks(self, lam: float, mu: float) -> Floats:
        """Return the stiffness of eq. SO.2 for Lame's constants, Pa; shape (n, 3, 3), N/m."""
        out = np.empty(self.gram.shape)  # in the layout of sparse block matrices, which then need no copy
        for low in range(0, len(out), BATCH):
            some = slice(low, low + BATCH)
            out[some] = lam * self.dilation[some] + mu * self.gram[some].transpose(0, 2, 1)
            out[some] += (mu * np.trace(self.gram[some], axis1=1, axis2=2))[:, None, None] * np.eye(3)
        return out

    def forces(self, material: Elastic, u: Floats) -> Floats:
        """Return the nodal forces (3 n, k), N, for displacements u (3 n, k) of all nodes, m."""
        blocks, count = self.blocks(*lame(material)), len(u) // 3
        starts = np.searchsorted(self.rows, np.arange(count + 1))
        lower = sp.bsr_array((blocks, self.columns, starts), shape=(len(u), len(u)))
        on = self.rows == self.columns
        starts = np.searchsorted(self.rows[on], np.arange(count + 1))
        diagonal = sp.bsr_array((blocks[on], self.rows[on], starts), shape=lower.shape)
        return np.asarray(lower @ u + lower.T @ u - diagonal @ u)


def part(nodes: Floats, elements: Ints, averaged: bool = False) -> Part:
    """Integrate the stiffness of one body's elements (t, 10); with ``averaged``, each element's dilation is its mean.

    Raises:
        SolveError: an element is turned inside out.
    """
    high, low = (pick(elements[:, LOWER], elements[:, UPPER]) for pick in (np.maximum, np.minimum))
    keys, slots = np.unique((high * len(nodes) + low).ravel(), return_inverse=True)
    slots = slots.reshape(high.shape)
    flipped = elements[:, LOWER] < elements[:, UPPER]
    gram = np.zeros((9, len(keys)))
    dilation = np.zeros((9, len(keys))) if averaged else gram
    for some, _, g, weight in integrated(nodes[elements]):
        _scatter(gram, grams(g, weight), slots[some], flipped[some])
        if averaged:
            _scatter(dilation, mean_dilation(g, weight), slots[some], flipped[some])
    by_block = gram.T.reshape(-1, 3, 3)
    return Part(keys // len(nodes), keys % len(nodes), by_block, dilation.T.reshape(-1, 3, 3) if averaged else by_block)


def _scatter(out: Floats, matrices: Floats, slots: Ints, flipped: NDArray[np.bool_]) -> None:
    """Add elements' matrices (n, 30, 30) to the sums (9, pairs) of their pairs of nodes; flipped pairs are transposed."""
    low, high = int(slots.min()), int(slots.max()) + 1
    place = (slots - low).ravel()
    split = matrices.reshape(-1, 10, 3, 10, 3)
    for k in range(9):
        i, j = divmod(k, 3)
        values = split[:, :, i, :, j][:, LOWER, UPPER]
        if i != j:
            values = np.where(flipped, split[:, :, j, :, i][:, LOWER, UPPER], values)
        out[k, low:high] += np.bincount(place, weights=values.ravel(), minlength=high - low)


def assembled(some: Mapping[int, Part], materials: Mapping[int, Elastic], number: Ints) -> sp.csc_array:
    """Assemble the lower triangle of the stiffness of all bodies that have a material.

    Args:
        body_parts: integrated stiffness of the bodies.
        materials: materials of the bodies that are present.
        number: unknown of each displacement, shape (nodes, 3); < 0 for none.
    """
    return _added(((some[b], lame(materials[b])) for b in some if b in materials), number)


def assembled_changes(some: Mapping[int, Part], changes: Mapping[int, tuple[Elastic, Elastic]], number: Ints) -> sp.csc_array:
    """Assemble the change of the stiffness when bodies change from an old to a new material; see ``assemble``."""
    pieces = ((some[b], np.subtract(lame(new), lame(old))) for b, (old, new) in changes.items() if b in some)
    return _added(pieces, number)


def _added(bodies: Iterable[tuple[Part, Sequence[float] | Floats]], number: Ints) -> sp.csc_array:
    """Add the lower triangles of some bodies' stiffness, each with its Lame constants."""
    size, number = int(number.max()) + 1, number.astype(np.int32)
    pieces = [_entries(part, part.blocks(*constants), number) for part, constants in bodies]
    values, high, low = (np.concatenate(kind) for kind in zip(*pieces, strict=True))
    del pieces  # as large as the arrays made of them, and as those made next
    rows = sp.coo_array((values, (low, high)), shape=(size, size)).tocsr()  # the upper triangle by rows is the lower by columns
    rows.sort_indices()
    return sp.csc_array((rows.data, rows.indices, rows.indptr), shape=rows.shape)


def _entries(part: Part, blocks: Floats, number: Ints) -> tuple[Floats, Ints, Ints]:
    """List values, rows and columns, columns <= rows, of a body's blocks (n, 3, 3)."""
    row = np.broadcast_to(number[part.rows][:, :, None], blocks.shape)
    column = np.broadcast_to(number[part.columns][:, None], blocks.shape)
    once = (part.rows != part.columns)[:, None, None] | (np.arange(3)[:, None] >= np.arange(3))
    inside = (row >= 0) & (column >= 0) & once
    row, column, values = row[inside], column[inside], blocks[inside]
    # sliding nodes share u_z: their one entry stands for two
    values = np.where((row == column) & (part.rows != part.columns)[np.nonzero(inside)[0]], 2 * values, values)
    return values, np.maximum(row, column), np.minimum(row, column)


def parts(
    nodes: Floats, elements: Ints, body: Ints, averaged: bool = False, known: Mapping[int, Part] | None = None
) -> Mapping[int, Part]:
    """Integrate the stiffness of every body that is not in ``known``."""
    known = known or {}
    every = [int(b) for b in np.unique(body)]
    return {b: known[b] if b in known else part(nodes, elements[body == b], averaged) for b in every}
