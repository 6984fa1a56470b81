"""Assemble tangent matrices of elements and contact with one sparsity pattern.

The pattern holds every entry that contact may ever need: each point of a line may touch the whole of the other line.
PARDISO therefore analyses the pattern once. Lines have few unknowns, so the pattern grows little.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from geometry.common.arrays import Floats, Ints
from solver.axisymmetric.dofs import Numbering
from solver.contact.pairs import Pair
from solver.linalg.cholesky import Pattern


@dataclass(frozen=True)
class Assembly:
    """Assembles elements and contact into one sparse matrix.

    Attributes
    ----------
    numbering
        Numbering of the unknowns.
    keys
        Column times number of unknowns plus row, for all entries, in rising order.
    places
        Indices of the elements' entries in ``keys``.
    rows, starts
        Row numbers of the entries, shape (entries,), and column starts of the matrix in compressed columns, (unknowns + 1,).
    pattern
        The solver's analysis of the sparsity pattern.
    """

    numbering: Numbering
    keys: Ints
    places: Ints
    rows: NDArray[np.int32]
    starts: NDArray[np.int32]
    pattern: Pattern

    @classmethod
    def from_pairs(cls, numbering: Numbering, pairs: Sequence[Pair]) -> Assembly:
        """Build the assembly with every matrix entry that the elements and these pairs of lines may need."""
        n = numbering.unknowns
        # the elements' entries are stored by columns: starts gives each column's first entry, rows the row of each
        element_keys = np.repeat(np.arange(n), np.diff(numbering.starts)) * n + numbering.rows
        if not pairs:  # the same entries as without contact, whose pattern may be analysed already
            places = np.arange(len(element_keys))
            rows, starts = (x.astype(np.int32) for x in (numbering.rows, numbering.starts))
            return cls(numbering, element_keys, places, rows, starts, numbering.pattern)
        keys = [element_keys]
        for pair in pairs:
            free = _find_unknowns(numbering, pair)
            keys.append((free[:, None] * n + free).ravel())
        all_keys = np.sort(np.concatenate(keys))  # np.unique hashes millions of numbers: 50 times slower with NumPy 2.3 and 2.4
        all_keys = all_keys[np.diff(all_keys, prepend=-1) > 0]
        rows, starts = (x.astype(np.int32) for x in (all_keys % n, np.searchsorted(all_keys, np.arange(n + 1) * n)))
        return cls(numbering, all_keys, np.searchsorted(all_keys, element_keys), rows, starts, Pattern())

    @cached_property
    def value_unknowns(self) -> tuple[Ints, Floats]:
        """The unknown of each of the elements' values, -1 where it is fixed, and its sign, shape (n (8 p),) each."""
        gather = self.numbering.gather
        free = np.diff(gather.indptr) > 0
        unknowns, signs = np.full(len(free), -1), np.zeros(len(free))
        unknowns[free], signs[free] = gather.indices, gather.data
        return unknowns, signs

    def assemble_tangent(self, stiffness: Floats, contact: sp.coo_array | None) -> sp.csc_array:
        """Return the tangent matrix on the unknowns, sparse by columns: the elements' stiffness plus that of contact.

        Parameters
        ----------
        stiffness
            Stiffness of the elements on corners and edges, shape (elements, 8 p, 8 p).
        contact
            Stiffness of all pairs on the elements' values, shape (elements (8 p), elements (8 p)); None where nothing touches.
        """
        n, data = self.numbering.unknowns, np.zeros(len(self.keys))
        data[self.places] = self.numbering.assemble(stiffness).data
        if contact is not None:
            unknowns, signs = self.value_unknowns
            free = np.all([unknowns[index] >= 0 for index in contact.coords], axis=0)
            rows, columns = (index[free] for index in contact.coords)
            places = np.searchsorted(self.keys, unknowns[columns] * n + unknowns[rows])
            np.add.at(data, places, signs[rows] * signs[columns] * contact.data[free])
        return sp.csc_array((data, self.rows, self.starts), shape=(n, n))


def join_entries(parts: Sequence[sp.coo_array]) -> sp.coo_array:
    """Return the sum of sparse matrices of one shape as a list of all their entries."""
    coords = tuple(np.concatenate(index) for index in zip(*(part.coords for part in parts), strict=True))
    return sp.coo_array((np.concatenate([part.data for part in parts]), coords), shape=parts[0].shape)


def _find_unknowns(numbering: Numbering, pair: Pair) -> Ints:
    """Return the numbers of the unknowns that move the two lines of a pair, in rising order."""
    width = numbering.signs.shape[1]  # values of one element, 8 p
    values = np.concatenate([(line.element[:, None, None] * width + line.values).ravel() for line in (pair.slave, pair.master)])
    return np.unique(numbering.gather[np.unique(values)].indices).astype(np.int64)
