"""Families of scenes that differ in one number: a few are solved, and the others are interpolated.

Within a kind of meridian section the finite elements' results are smooth functions of every length and material
(``geometry/meridian/mesh_lines.py``), so that a polynomial through few of them in the number's logarithm meets the others;
for 40 gaps over a factor of 1.6 five solved scenes give the film forces to 2e-8, seven to 6e-12. Two more solved scenes,
where the polynomial's error is largest, give the error bound:

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

INITIAL_NODES = 4  # refined to 7 and 13, which contain them
MIN_FAMILY_SIZE = 10  # scenes: the first nodes and both checks are then little more than half of them
ERROR_MARGIN_FACTOR = 10.0  # factor of the formula above
EXCLUDED_NUMBERS = {
    ("load", "force"),
    ("load", "indentation"),
    ("inclusion", 0, "youngs_modulus"),
}  # these share one solution anyway


@dataclass(frozen=True)
class Family:
    """Scenes in the order of the number that differs.

    Attributes
    ----------
    places
        Indices of the scenes in the list they come from, shape (n,).
    x
        Logarithm of the number, rising, shape (n,).
    nodes
        Indices of the members that the polynomial goes through, shape (m,).
    checks
        Indices of the members at which its error is measured, shape (2,).
    """

    places: Ints
    x: Floats
    nodes: Ints
    checks: Ints

    @classmethod
    def from_numbers(cls, places: Sequence[int] | Ints, x: Floats, count: int = INITIAL_NODES) -> Family:
        """Choose nodes near Chebyshev's points, and checks where the product of distances to the nodes is largest."""
        order = np.argsort(x)
        x = x[order]
        wanted = x[0] + (x[-1] - x[0]) * (1 - np.cos(np.pi * np.arange(count) / (count - 1))) / 2
        nodes = np.unique(np.abs(x[:, None] - wanted).argmin(axis=0))
        size = np.abs(x[:, None] - x[nodes]).prod(axis=1)
        middle = len(x) // 2
        checks = np.array([size[:middle].argmax(), middle + size[middle:].argmax()])
        return cls(np.asarray(places)[order], x, nodes, checks)

    @property
    def solved(self) -> Ints:
        """Indices of all members that have to be solved, rising."""
        return np.union1d(self.nodes, self.checks)

    @property
    def finer_family(self) -> Family | None:
        """The family with nodes added in between; None where more than half of the members would have to be solved."""
        count = 2 * len(self.nodes) - 1
        return Family.from_numbers(self.places, self.x, count) if len(self.x) >= 2 * (count + 2) else None

    def interpolate(self, values: Floats) -> tuple[Floats, Floats]:
        """Interpolate values at the ``solved`` members, shape (f, k), to all members; return these and error bounds, (n, k)."""
        solved = self.solved
        all_nodes, nodes = self._compute_weights(solved), self._compute_weights(self.nodes)
        whole, part = all_nodes @ values, nodes @ values[np.searchsorted(solved, self.nodes)]
        missed = np.abs(part[self.checks] - values[np.searchsorted(solved, self.checks)]).max(axis=0)
        return whole, ERROR_MARGIN_FACTOR * missed + np.abs(whole - part)

    def extend_bounds(self, values: Floats) -> Floats:
        """Extend error bounds of the ``solved`` members, shape (f, k), to all members, shape (n, k).

        Each member gets the larger bound of its two solved neighbours, plus the difference between them.
        """
        right = np.clip(np.searchsorted(self.solved, np.arange(len(self.x))), 0, len(self.solved) - 1)
        high, low = values[right], values[np.maximum(right - 1, 0)]
        return np.asarray(np.maximum(high, low) + np.abs(high - low))

    def _compute_weights(self, nodes: Ints) -> Floats:
        """Return Lagrange's polynomials of some nodes at all members, shape (n, nodes)."""
        node_x = self.x[nodes]
        spacing = np.where(np.eye(len(node_x), dtype=bool), 1.0, node_x[:, None] - node_x)
        from_nodes = self.x[:, None] - node_x
        factors = np.where(np.eye(len(node_x), dtype=bool), 1.0, from_nodes[:, None, :] / spacing)
        return np.asarray(factors.prod(axis=2))


def find_families(scenes: Sequence[Scene], kind: Callable[[Scene], Any]) -> Iterator[Family]:
    """Yield families of at least ``MIN_FAMILY_SIZE`` scenes, none in two, the largest first.

    Parameters
    ----------
    scenes
        Any.
    kind
        Returns what all members of a family have to share.
    """
    tables = [dict(iterate_leaves(scene.model_dump())) for scene in scenes] if len(scenes) >= MIN_FAMILY_SIZE else []
    names = {name for table in tables for name in table}
    differing = {name for name in names if len({table.get(name) for table in tables}) > 1}
    candidates = [
        group for name in sorted(differing - EXCLUDED_NUMBERS, key=str) for group in _find_groups(tables, name, differing)
    ]
    used_places: set[int] = set()
    for places, x in sorted(candidates, key=lambda group: -len(group[0])):
        if used_places.isdisjoint(places):
            kinds: dict[Any, list[int]] = defaultdict(list)
            for k, place in enumerate(places):
                kinds[kind(scenes[place])].append(k)
            for members in kinds.values():
                if len(members) >= MIN_FAMILY_SIZE:
                    used_places |= {places[k] for k in members}
                    yield Family.from_numbers([places[k] for k in members], x[members])


def _find_groups(tables: Sequence[Mapping[Any, Any]], name: Any, differing: set[Any]) -> Iterator[tuple[list[int], Floats]]:
    """Yield indices of scenes that differ in one number alone, with its logarithms; equal scenes are counted once."""
    others = sorted(differing - {name}, key=str)
    groups: dict[Any, dict[float, int]] = defaultdict(dict)
    for place, table in enumerate(tables):
        value = table.get(name)
        if isinstance(value, float) and value > 0:
            groups[tuple(table.get(other) for other in others)].setdefault(value, place)
    for group in groups.values():
        if len(group) >= MIN_FAMILY_SIZE:
            yield [*group.values()], np.log(np.array([*group]))


def iterate_leaves(value: object, path: tuple[Any, ...] = ()) -> Iterator[tuple[tuple[Any, ...], Any]]:
    """Yield paths and values of all numbers and words of nested mappings and sequences."""
    if isinstance(value, Mapping):
        for key, item in value.items():
            yield from iterate_leaves(item, (*path, key))
    elif isinstance(value, list | tuple):
        for k, item in enumerate(value):
            yield from iterate_leaves(item, (*path, k))
    else:
        yield path, value
