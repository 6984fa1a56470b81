"""Search over discrete variables: try every combination if they are few, otherwise round designs of a continuous search."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import InputError, Words
from geometry.scenes.scene import Scene
from probe_design.design_search.closed_search import CONSTRAINT_TOLERANCE_RELATIVE, refine_by_ipopt, search
from probe_design.design_search.combination import Combination
from probe_design.design_search.objective import SearchEffort, SearchObjective
from probe_design.design_search.search_space import SearchSpace
from probe_design.design_search.variables import is_same_design

MAX_ENUMERATED = 200
MAX_THOROUGH_COMBINATIONS = 1  # combinations that are each searched from several starts at once
QUICK_EFFORT = SearchEffort(starts=1, screened=16, steps=12)  # for each of several combinations
MAX_CHOICES = 50  # designs of one combination
ROUNDED_DESIGNS = 3  # designs of the relaxed search that are rounded
NEIGHBOUR_ROUNDS = 4  # of looking at neighbours
REPEATED_COMBINATIONS = 3  # of many combinations, so many of the best are searched once more from several starts

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Choice:
    """A design of one combination of discrete values, with its closed-form objective."""

    combination: Combination
    design: Floats
    value: float


@dataclass(frozen=True)
class ChoiceSearch:
    """The designs that a search over all combinations returns.

    Attributes
    ----------
    choices
        Designs, best first.
    how
        How discrete variables and materials were treated, one sentence.
    exhaustive
        Whether every combination was tried.
    best
        The best objective of each combination tried, by ``Combination.description``.
    seconds
        Time of the search, s.
    """

    choices: tuple[Choice, ...]
    how: str
    exhaustive: bool
    best: dict[str, float]
    seconds: float = 0.0


def iterate_distinct(choices: Iterable[Choice], search_space: SearchSpace, tolerance: float) -> Iterator[tuple[Choice, Scene]]:
    """Yield choices with their scenes as a workshop makes them, leaving out those that are nearly the same as an earlier one.

    Parameters
    ----------
    choices
        Designs of a search, best first.
    search_space
        The allowed designs; a choice that is not allowed after rounding is left out.
    tolerance
        Relative difference of every variable within which two designs count as the same.
    """
    scenes: list[Scene] = []
    for choice in choices:
        scene = search_space.build_scene(choice.design, choice.combination)
        if scene is None or not search_space.admits_scene(scene):
            continue
        if not any(is_same_design(scene, earlier, tolerance) for earlier in scenes):
            scenes.append(scene)
            yield choice, scene


def search_combinations(objective: SearchObjective, search_space: SearchSpace, progress: Progress) -> ChoiceSearch:
    """Search the combinations of discrete values and return the designs, best first.

    Raises
    ------
    InputError
        No combination gives a probe with a finite objective.
    """
    start_time = perf_counter()
    if search_space.combinations <= MAX_ENUMERATED:
        combinations = list(search_space.iterate_combinations())
        choices = _search_all(objective, search_space, combinations, progress)
        how = f"all {len(combinations)} combinations of choices tried" if len(combinations) > 1 else "all variables continuous"
        return _sort_choices(choices, how, True, perf_counter() - start_time)
    choices, count = _search_relaxed(objective, search_space, progress)
    how = (
        f"{search_space.combinations} combinations of choices, more than {MAX_ENUMERATED}: not all tried but {count} near what a "
        "search without steps found, until none beside the best was better"
    )
    return _sort_choices(choices, how, False, perf_counter() - start_time)


def search_combination(
    objective: SearchObjective, search_space: SearchSpace, combination: Combination, *, thorough: bool
) -> list[Choice]:
    """Return the designs of one combination, best first; with little effort (``QUICK_EFFORT``) unless ``thorough``."""
    space = search_space.pin(combination.pinned)
    designs, values = search(objective.set_choices(combination), space, combination.poisson, None if thorough else QUICK_EFFORT)
    pairs = zip(designs.T, values.tolist(), strict=True)
    return [Choice(combination, design, value) for design, value in pairs if np.isfinite(value)][:MAX_CHOICES]


def _search_all(
    objective: SearchObjective, search_space: SearchSpace, combinations: list[Combination], progress: Progress
) -> list[Choice]:
    """Search every combination: one thoroughly; of several each quickly, then the best once more from several starts."""
    thorough = len(combinations) <= MAX_THOROUGH_COMBINATIONS or not search_space.pin(combinations[0].pinned).free
    choices: list[Choice] = []
    for k, combination in enumerate(combinations):
        progress(k, len(combinations))
        choices += search_combination(objective, search_space, combination, thorough=thorough)
    progress(len(combinations), len(combinations))
    if thorough:
        return choices
    choices += _repeat_search(objective, search_space, choices)
    return choices + try_other_scans(objective, search_space, choices)


def _repeat_search(objective: SearchObjective, search_space: SearchSpace, choices: list[Choice]) -> list[Choice]:
    """Search the best combinations once more, from several starts."""
    order = sorted(choices, key=lambda choice: -choice.value)
    best = list({choice.combination.description: choice.combination for choice in order}.values())[:REPEATED_COMBINATIONS]
    return [repeated for choice in best for repeated in search_combination(objective, search_space, choice, thorough=True)]


def try_other_scans(objective: SearchObjective, search_space: SearchSpace, choices: list[Choice]) -> list[Choice]:
    """Return the best probe of all under every other scan, and refined there: a quick search may end at a worse one."""
    if len(search_space.scan_choices) < 2 or not choices:
        return []
    best, tried = max(choices, key=lambda choice: choice.value), list[Choice]()
    space, poisson = search_space.pin(best.combination.pinned), best.combination.poisson
    for scan in search_space.scan_choices:
        if scan == best.combination.scan:
            continue
        combination = replace(best.combination, scan=scan)
        changed = objective.set_choices(combination)
        refined = (
            refine_by_ipopt(changed, space, best.design, poisson=poisson, steps=QUICK_EFFORT.steps) if space.free else best.design
        )
        designs = np.stack([best.design, refined], axis=1)
        for design, value in zip(designs.T, changed.evaluate_designs(designs, poisson).tolist(), strict=True):
            if np.isfinite(value) and space.admits(design, CONSTRAINT_TOLERANCE_RELATIVE):
                tried.append(Choice(combination, design, value))
    return tried


def _search_relaxed(objective: SearchObjective, search_space: SearchSpace, progress: Progress) -> tuple[list[Choice], int]:
    """Search with continuous variables, round the best designs, then move to the best neighbour until none is better.

    Returns
    -------
    tuple[list[Choice], int]
        Designs of all combinations tried, and the number of these combinations.
    """
    relaxed, _ = search(objective, search_space, _average_poisson(search_space))
    progress(1, 2 + NEIGHBOUR_ROUNDS)
    tried: dict[str, list[Choice]] = {}
    for design in relaxed.T[:ROUNDED_DESIGNS]:
        _search_untried(objective, search_space, search_space.iterate_nearest(design), tried)
    progress(2, 2 + NEIGHBOUR_ROUNDS)
    for turn in range(NEIGHBOUR_ROUNDS):
        tried_choices = [choice for choices in tried.values() for choice in choices]
        if not tried_choices:
            break
        best = max(tried_choices, key=lambda choice: choice.value)
        _search_untried(objective, search_space, _list_neighbours(search_space, best), tried)
        progress(3 + turn, 2 + NEIGHBOUR_ROUNDS)
        # no neighbour is better than the best so far
        if max(choice.value for choices in tried.values() for choice in choices) <= best.value:
            break
    progress(2 + NEIGHBOUR_ROUNDS, 2 + NEIGHBOUR_ROUNDS)
    choices = [choice for tried_choices in tried.values() for choice in tried_choices]
    return choices + (_repeat_search(objective, search_space, choices) if choices else []), len(tried)


def _search_untried(
    objective: SearchObjective, search_space: SearchSpace, combinations: Iterable[Combination], tried: dict[str, list[Choice]]
) -> None:
    """Search the combinations that are not yet in ``tried``, by description, and add their designs."""
    for combination in combinations:
        if combination.description not in tried and len(tried) < MAX_ENUMERATED:
            tried[combination.description] = search_combination(objective, search_space, combination, thorough=False)


def _list_neighbours(search_space: SearchSpace, best: Choice) -> Iterator[Combination]:
    """Yield the combinations that differ from the best by one step of one variable or by one block's material."""
    pinned = {name: best.combination.pinned[name] for name in search_space.grids}
    for name, values in search_space.grids.items():
        position = values.index(pinned[name])
        for neighbour in values[max(0, position - 1) : position + 2]:
            if neighbour != pinned[name]:
                yield replace(best.combination, pinned={**best.combination.pinned, name: neighbour})
    yield from (replace(best.combination, film=film) for film in search_space.film_choices)
    yield from (replace(best.combination, scan=scan) for scan in search_space.scan_choices)
    if search_space.shelf:
        for combination in search_space.iterate_materials(pinned):
            pairs = zip(combination.materials, best.combination.materials, strict=True)
            if sum(first != second for first, second in pairs) == 1:
                yield combination


def _average_poisson(search_space: SearchSpace) -> tuple[float, float]:
    """Return Poisson's ratios of both blocks for a search without materials: the start's, or the mean of the materials'."""
    if not search_space.shelf:
        return search_space.start_poisson
    mean = float(np.mean(search_space.shelf_poisson))
    return mean, mean


def _sort_choices(choices: list[Choice], how: str, exhaustive: bool, seconds: float) -> ChoiceSearch:
    """Return the designs of a search, best first; raise ``InputError`` where there are none."""
    if not choices:
        raise InputError("variables", Words("no design with a finite objective"), "a wider choice, or wider limits")
    order = sorted(choices, key=lambda choice: -choice.value)
    best: dict[str, float] = {}
    for choice in order:
        best.setdefault(choice.combination.description, choice.value)
    return ChoiceSearch(tuple(order), how, exhaustive, best, seconds)
