"""Families of scenes that differ in one number: a few are solved, and the others are interpolated.

Within a kind of meridian section the finite elements' results are smooth functions of every length and material
(``geometry/meridian/frame.py``), so that a polynomial through few of them in the number's logarithm meets the others; for 40 gaps
over a factor of 1.6 five solved scenes give the film forces to 2e-8, seven to 6e-12. Two more solved scenes, where the
polynomial's error is largest, give the error bound:

    10 max over both of |p - f| + |p_all(x) - p(x)|

with f the solved value at such a check, p the polynomial through the nodes and p_all the one through nodes and checks. Where the
bound is above what is allowed, nothing is interpolated.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from geometry.common.arrays import Floats, Ints
from geometry.scenes.scene import Scene

NODES = 4  # refined to 7 and 13, which contain them
LEAST = 10  # scenes: the first nodes and both checks are then little more than half of them
MARGIN = 10.0  # factor of the formula above
NO_FAMILY = {("load", "force"), ("load", "indentation"), ("inclusion", 0, "youngs_modulus")}  # these share one solution anyway


@dataclass(frozen=True)
class Family:
    """Scenes in the order of the number that differs.

    Attributes:
        places: indices of the scenes in the list they come from, shape (n,).
        x: logarithm of the number, rising, shape (n,).
        nodes: indices of the members that the polynomial goes through, shape (m,).
        checks: indices of the members at which its error is measured, shape (2,).
    """

    places: Ints
    x: Floats
    nodes: Ints
    others: Ints

    @classmethod
    def of(cls, places: Sequence[int] | Ints, x: Floats, count: int = NODES) -> Family:
        """Choose nodes near Chebyshev's points, and checks where the product of distances to the nodes is largest."""
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
        """Indices of all members that have to be solved, rising."""
        return np.union1d(self.nodes, self.others)

    @property
    def finer(self) -> Family | None:
        """The family with nodes added in between; None where more than half of the members would have to be solved."""
        more = 2 * len(self.nodes) - 1
        return Family.of(self.places, self.x, more) if len(self.x) >= 2 * (more + 2) else None

    def spread(self, values: Floats) -> tuple[Floats, Floats]:
        """Interpolate values at the ``solved`` members, shape (f, k), to all members; return these and error bounds, (n, k)."""
        found = self.found
        all_nodes, nodes = self._weights(found), self._weights(self.nodes)
        whole, part = all_nodes @ values, nodes @ values[np.searchsorted(found, self.nodes)]
        missed = np.abs(part[self.others] - values[np.searchsorted(found, self.others)]).max(axis=0)
        return whole, MARGIN * missed + np.abs(whole - part)

    def beside(self, values: Floats) -> Floats:
        """Extend error bounds of the ``solved`` members, shape (f, k), to all members, shape (n, k).

        Each member gets the larger bound of its two solved neighbours, plus the difference between them.
        """
        after = np.clip(np.searchsorted(self.found, np.arange(len(self.x))), 0, len(self.found) - 1)
        high, low = values[after], values[np.maximum(after - 1, 0)]
        return np.asarray(np.maximum(high, low) + np.abs(high - low))

    def _weights(self, nodes: Ints) -> Floats:
        """Return Lagrange's polynomials of some nodes at all members, shape (n, nodes)."""
        at = self.x[nodes]
        apart = np.where(np.eye(len(at), dtype=bool), 1.0, at[:, None] - at)
        from_nodes = self.x[:, None] - at
        factors = np.where(np.eye(len(at), dtype=bool), 1.0, from_nodes[:, None, :] / apart)
        return np.asarray(factors.prod(axis=2))


def families(scenes: Sequence[Scene], kind: Callable[[Scene], Any]) -> Iterator[Family]:
    """Yield families of at least ``MIN_FAMILY_SIZE`` scenes, none in two, the largest first.

    Args:
        scenes: any.
        kind: returns what all members of a family have to share.
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
    """Yield indices of scenes that differ in one number alone, with its logarithms; equal scenes are counted once."""
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
