"""Families of scenes that differ in one number: what is smooth in it is found for a few and interpolated between them.

Within a kind of meridian section the finite elements' results are smooth functions of every length and material
(``geometry/meridian/frame.py``), so that a polynomial through few of them in the number's logarithm meets the others; of 40 gaps
over a factor of 1.6 five give the film forces to 2e-8, seven to 6e-12. Two more, where the polynomial's error is largest, tell
what is left:

    10 max over both of |p - f| + |p_all(x) - p(x)|

with p through the nodes, p_all through all that were found. Where that is more than is allowed, nothing is interpolated.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from geometry.common.arrays import Floats, Ints
from geometry.scenes.scene import Scene

NODES = 4  # at first; then 7 and 13, among which these are
LEAST = 10  # scenes, of which the first nodes and both others are little more than half
MARGIN = 10.0  # of the formula above
NO_FAMILY = {("load", "force"), ("load", "indentation"), ("inclusion", 0, "youngs_modulus")}  # found at once anyway


@dataclass(frozen=True)
class Family:
    """Scenes in the order of the number that differs.

    Attributes:
        places: of the scenes, shape (n,).
        x: logarithm of the number, rising, shape (n,).
        nodes: indices of those that a polynomial goes through, shape (m,).
        others: of those that tell its error, shape (2,).
    """

    places: Ints
    x: Floats
    nodes: Ints
    others: Ints

    @classmethod
    def of(cls, places: Sequence[int] | Ints, x: Floats, count: int = NODES) -> Family:
        """Choose nodes near Chebyshev's points, and the others where the product of distances to them is largest."""
        order = np.argsort(x)
        x = x[order]
        wanted = x[0] + (x[-1] - x[0]) * (1 - np.cos(np.pi * np.arange(count) / (count - 1))) / 2
        nodes = np.unique(np.abs(x[:, None] - wanted).argmin(axis=0))
        size = np.abs(x[:, None] - x[nodes]).prod(axis=1)
        middle = len(x) // 2
        others = np.array([size[:middle].argmax(), middle + size[middle:].argmax()])
        return cls(np.asarray(places)[order], x, nodes, others)

    @property
    def found(self) -> Ints:
        """Indices of all that have to be found, rising."""
        return np.union1d(self.nodes, self.others)

    @property
    def finer(self) -> Family | None:
        """The same with nodes between, where half of the members may be left; None else."""
        more = 2 * len(self.nodes) - 1
        return Family.of(self.places, self.x, more) if len(self.x) >= 2 * (more + 2) else None

    def spread(self, values: Floats) -> tuple[Floats, Floats]:
        """Return values for all members, (n, k), from those of ``found``, (f, k), and what they may miss, (n, k)."""
        found = self.found
        all_nodes, nodes = self._weights(found), self._weights(self.nodes)
        whole, part = all_nodes @ values, nodes @ values[np.searchsorted(found, self.nodes)]
        missed = np.abs(part[self.others] - values[np.searchsorted(found, self.others)]).max(axis=0)
        return whole, MARGIN * missed + np.abs(whole - part)

    def beside(self, values: Floats) -> Floats:
        """Return for all members the larger of the values of ``found``, (f, k), on either side, and by how much it is larger."""
        after = np.clip(np.searchsorted(self.found, np.arange(len(self.x))), 0, len(self.found) - 1)
        high, low = values[after], values[np.maximum(after - 1, 0)]
        return np.asarray(np.maximum(high, low) + np.abs(high - low))

    def _weights(self, nodes: Ints) -> Floats:
        """Lagrange's polynomials of some nodes at all members, shape (n, nodes)."""
        at = self.x[nodes]
        apart = np.where(np.eye(len(at), dtype=bool), 1.0, at[:, None] - at)
        from_nodes = self.x[:, None] - at
        factors = np.where(np.eye(len(at), dtype=bool), 1.0, from_nodes[:, None, :] / apart)
        return np.asarray(factors.prod(axis=2))


def families(scenes: Sequence[Scene], kind: Callable[[Scene], Any]) -> Iterator[Family]:
    """Yield families of at least ``LEAST`` scenes, none in two, the largest first.

    Args:
        scenes: any.
        kind: what all of a family have to share.
    """
    tables = [dict(leaves(scene.model_dump())) for scene in scenes] if len(scenes) >= LEAST else []
    names = {name for table in tables for name in table}
    differing = {name for name in names if len({table.get(name) for table in tables}) > 1}
    several = [group for name in sorted(differing - NO_FAMILY, key=str) for group in _groups(tables, name, differing)]
    taken: set[int] = set()
    for places, x in sorted(several, key=lambda group: -len(group[0])):
        if taken.isdisjoint(places):
            kinds: dict[Any, list[int]] = defaultdict(list)
            for k, place in enumerate(places):
                kinds[kind(scenes[place])].append(k)
            for some in kinds.values():
                if len(some) >= LEAST:
                    taken |= {places[k] for k in some}
                    yield Family.of([places[k] for k in some], x[some])


def _groups(tables: Sequence[Mapping[Any, Any]], name: Any, differing: set[Any]) -> Iterator[tuple[list[int], Floats]]:
    """Scenes that differ in a number alone, with its logarithms, each once."""
    others = sorted(differing - {name}, key=str)
    groups: dict[Any, dict[float, int]] = defaultdict(dict)
    for place, table in enumerate(tables):
        value = table.get(name)
        if isinstance(value, float) and value > 0:
            groups[tuple(table.get(other) for other in others)].setdefault(value, place)
    for group in groups.values():
        if len(group) >= LEAST:
            yield [*group.values()], np.log(np.array([*group]))


def leaves(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[tuple[Any, ...], Any]]:
    """Yield paths and values of all numbers and words of nested mappings and sequences."""
    if isinstance(value, Mapping):
        for key, one in value.items():
            yield from leaves(one, (*path, key))
    elif isinstance(value, list | tuple):
        for k, one in enumerate(value):
            yield from leaves(one, (*path, k))
    else:
        yield path, value
