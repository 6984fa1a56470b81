"""One pattern for all tangents of a model: elements, and pairs of lines as if every point of one could touch all of the other.

PARDISO then analyses once, and a tangent takes one factorisation; lines have few unknowns, so that the pattern grows little.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from geometry.common.arrays import Floats, Ints
from solver.axisymmetric.dofs import Numbering
from solver.contact.pairs import Pair
from solver.linalg.cholesky import Pattern


@dataclass(frozen=True)
class Assembly:
    """Adds up elements and contact.

    Attributes:
        numbering: of the unknowns.
        keys: column times unknowns plus row of all entries, rising.
        places: of the elements' entries among them.
        pattern: what is known of it.
    """

    numbering: Numbering
    keys: Ints
    places: Ints
    pattern: Pattern

    @classmethod
    def of(cls, numbering: Numbering, pairs: Sequence[Pair]) -> Assembly:
        """Find the entries."""
        n = numbering.unknowns
        own = np.repeat(np.arange(n), np.diff(numbering.starts)) * n + numbering.rows
        keys = [own]
        for pair in pairs:
            free = _unknowns(numbering, pair)
            keys.append((free[:, None] * n + free).ravel())
        every = np.unique(np.concatenate(keys))
        return cls(numbering, every, np.searchsorted(every, own), Pattern())

    def tangent(self, stiffness: Floats, contact: sp.csr_array | None) -> sp.csc_array:
        """Return the matrix of elements, (n, 8 p, 8 p), and contact on the elements' own values."""
        n, data = self.numbering.unknowns, np.zeros(len(self.keys))
        data[self.places] = self.numbering.assemble(stiffness).data
        if contact is not None:
            gather = self.numbering.gather
            more = sp.coo_array(gather.T @ contact @ gather)
            rows, columns = (index.astype(np.int64) for index in more.coords)
            np.add.at(data, np.searchsorted(self.keys, columns * n + rows), more.data)
        starts = np.searchsorted(self.keys, np.arange(n + 1) * n)
        return sp.csc_array((data, (self.keys % n).astype(np.int32), starts.astype(np.int32)), shape=(n, n))


def _unknowns(numbering: Numbering, pair: Pair) -> Ints:
    """Those that move a pair's lines."""
    width = numbering.signs.shape[1]
    own = np.concatenate([(line.element[:, None, None] * width + line.values).ravel() for line in (pair.slave, pair.master)])
    return np.unique(numbering.gather[np.unique(own)].indices).astype(np.int64)
