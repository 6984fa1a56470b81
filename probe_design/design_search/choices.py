"""Search over discrete variables: try every combination if they are few, otherwise round designs of a continuous search."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import InputError, Words
from probe_design.design_search.closed_search import STARTS, FoundDesigns, search
from probe_design.design_search.room import Combination, Room
from probe_design.design_search.steered_population import SteeredDesigns

MOST_ENUMERATED = 200
FEW = 1  # combinations that are each searched from several starts at once
BRANCHES = 3  # designs of the relaxed search that are rounded
ROUNDS = 4  # of looking at neighbours
AGAIN = 3  # of many combinations, so many of the best are searched once more from several starts

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Choice:
    """A design of one combination of discrete values, with its closed-form objective."""

    combination: Combination
    design: Floats
    value: float


@dataclass(frozen=True)
class Chosen:
    """The designs that a search over all combinations returns.

    Attributes:
        choices: designs, best first.
        how: how discrete variables and materials were treated, one sentence.
        exhaustive: whether every combination was tried.
        best: the best objective of each combination tried, by ``Combination.description``.
    """

    choices: tuple[Choice, ...]
    how: str
    exhaustive: bool
    best: dict[str, float]


def choose(steered: SteeredDesigns, room: Room, progress: Progress) -> Chosen:
    """Search the combinations of discrete values and return the designs, best first.

    Raises:
        InputError: no combination gives a probe with a finite objective.
    """
    if room.combinations <= MOST_ENUMERATED:
        every = list(room.every())
        choices = _enumerated(steered, room, every, progress)
        how = f"all {len(every)} combinations of choices tried" if len(every) > 1 else "all variables continuous"
        return _ordered(choices, how, True)
    choices, count = _branched(steered, room, progress)
    how = (
        f"{room.combinations} combinations of choices, more than {MOST_ENUMERATED}: not all tried but {count} near what a "
        "search without steps found, until none beside the best was better"
    )
    return _ordered(choices, how, False)


def searched(steered: SteeredDesigns, room: Room, one: Combination, *, thorough: bool) -> list[Choice]:
    """Return the designs of one combination, best first."""
    how = {} if thorough else {"starts": 1, "screened": 16, "steps": 12}
    found = search(steered, room.pinned(one), one.poisson, **how)
    return _choices(one, found)


def _choices(one: Combination, found: FoundDesigns) -> list[Choice]:
    pairs = zip(found.designs.T, found.values.tolist(), strict=True)
    return [Choice(one, design, value) for design, value in pairs if np.isfinite(value)][:50]


def _enumerated(steered: SteeredDesigns, room: Room, every: list[Combination], progress: Progress) -> list[Choice]:
    thorough = len(every) <= FEW or not room.free(every[0])
    choices: list[Choice] = []
    for k, one in enumerate(every):
        progress(k, len(every))
        choices += searched(steered, room, one, thorough=thorough)
    progress(len(every), len(every))
    return choices if thorough else choices + _again(steered, room, choices)


def _again(steered: SteeredDesigns, room: Room, choices: list[Choice]) -> list[Choice]:
    """Search the best combinations once more, from several starts."""
    order = sorted(choices, key=lambda one: -one.value)
    best = list({one.combination.told: one.combination for one in order}.values())[:AGAIN]
    return [found for one in best for found in searched(steered, room, one, thorough=True)]


def _branched(steered: SteeredDesigns, room: Room, progress: Progress) -> tuple[list[Choice], int]:
    """Search with continuous variables, round the best designs, then move to the best neighbour until none is better."""
    relaxed = search(steered, room.space, _middle_poisson(room), starts=STARTS)
    progress(1, 2 + ROUNDS)
    tried: dict[str, list[Choice]] = {}
    for design in relaxed.designs.T[:BRANCHES]:
        _try(steered, room, room.near(design), tried)
    progress(2, 2 + ROUNDS)
    for turn in range(ROUNDS):
        found = [one for choices in tried.values() for one in choices]
        if not found:
            break
        best = max(found, key=lambda one: one.value)
        _try(steered, room, _beside(room, best), tried)
        progress(3 + turn, 2 + ROUNDS)
        if max(one.value for choices in tried.values() for one in choices) <= best.value:
            break
    progress(2 + ROUNDS, 2 + ROUNDS)
    choices = [one for found in tried.values() for one in found]
    return choices + (_again(steered, room, choices) if choices else []), len(tried)


def _try(steered: SteeredDesigns, room: Room, combinations: Iterable[Combination], tried: dict[str, list[Choice]]) -> None:
    for one in combinations:
        if one.told not in tried and len(tried) < MOST_ENUMERATED:
            tried[one.told] = searched(steered, room, one, thorough=False)


def _beside(room: Room, best: Choice) -> Iterator[Combination]:
    """Yield the combinations that differ from the best by one step of one variable or by one block's material."""
    held = {k: best.combination.pinned[k] for k in room.grids}
    for k, values in room.grids.items():
        at = values.index(held[k])
        for other in values[max(0, at - 1) : at + 2]:
            if other != held[k]:
                yield replace(best.combination, pinned={**best.combination.pinned, k: other})
    if room.shelf:
        names = best.combination.materials
        for one in room.every_material(held):
            if sum(name != mine for name, mine in zip(one.materials, names, strict=True)) == 1:
                yield one


def _middle_poisson(room: Room) -> tuple[float, float]:
    if not room.shelf:
        return room.start_poisson
    mean = float(np.mean(room.shelf_poisson))
    return mean, mean


def _ordered(choices: list[Choice], how: str, exhaustive: bool) -> Chosen:
    if not choices:
        raise InputError("variables", Words("no design with a finite objective"), "a wider choice, or wider limits")
    order = sorted(choices, key=lambda one: -one.value)
    best: dict[str, float] = {}
    for one in order:
        best.setdefault(one.combination.told, one.value)
    return Chosen(tuple(order), how, exhaustive, best)
