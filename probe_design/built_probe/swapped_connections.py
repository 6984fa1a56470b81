"""Find swapped cables or references that would explain readings that contradict each other, and refuse dead or reversed films.

A swap is undone in the data: the films' readings change places, or readings their references, and the fit is repeated. The
smallest number of swaps wins; all swaps of that number that explain the readings are named together. Swaps of two references are
tried in the order of how close they bring the films' fractions of the load to the expected ones. Last, all readings are assigned
in the order of their fractions.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import InputError, Words
from hw.common.samples import FILM_NAMES
from probe_design.built_probe.bench import SIGNIFICANT_SD, Bench, Reference

MAX_DEVIATION_SD = 4.0  # standard deviations by which a gain may differ from the bench's statement
READ_AGAIN = "put it right, and read again"
MAX_TRIED_PAIRS = 24  # swaps of two references that are tried, the most promising ones
DEAD_FILM_FRACTION = 0.1  # of the expected force, below which a film counts as dead

Order = tuple[int, ...]


@dataclass(frozen=True)
class Swap:
    """A possible exchange of cables or references.

    Attributes
    ----------
    channels
        Whether the films' channels were exchanged.
    order
        For each reading the index of the reference on which it was taken.
    """

    channels: bool
    order: Order

    def describe(self, references: Sequence[Reference]) -> str:
        """Describe the exchange in words."""
        parts = ["the films' channels (cables)"] if self.channels else []
        moved = [k for k, place in enumerate(self.order) if place != k]
        if len(moved) == 2:
            parts.append(" and ".join(f"the {references[k].name}" for k in moved))
        elif moved:
            parts.append(f"the order, which was: {', '.join(references[k].name for k in self.order)}")
        return "; besides, ".join(parts)

    def restore_channels(self, films: Floats) -> Floats:
        """Return one reading of both films, or its covariance, with the channels restored, shape (2,) or (2, 2)."""
        return np.flip(films) if self.channels else films


def find_swaps(films: Floats, expected: Floats, max_error: float, agrees: Callable[[Swap], bool]) -> tuple[Swap, ...]:
    """Find the simplest swaps with which the readings agree; return an empty tuple if there are none.

    Parameters
    ----------
    films
        Both films' readings on each reference, of nominal gain, shape (n, 2).
    expected
        The inner film's expected fractions of the load, shape (n,).
    max_error
        Largest error of a fraction; a swap that leaves a larger one is not tried.
    agrees
        Whether the readings agree once a swap is undone.
    """
    fractions = films[:, 0] / films.sum(axis=1)
    for equally_simple in _iterate_candidates(fractions, expected):
        plausible = (swap for swap in equally_simple if _compute_error(fractions, expected, swap) < max_error)
        agreeing = tuple(swap for swap in plausible if agrees(swap))
        if agreeing:
            return agreeing
    return ()


def compute_max_fraction_error(bench: Bench) -> float:
    """Return the largest error of a film's fraction of the load that the bench allows.

    It is a generous limit: an error g of one gain shifts a fraction by at most g / 4.
    """
    return MAX_DEVIATION_SD * (bench.channels.gain + bench.channels.cross_talk)


def _compute_error(fractions: Floats, expected: Floats, swap: Swap) -> float:
    """Return the largest difference between a reading's fraction and its expected value once a swap is undone."""
    read = 1 - fractions if swap.channels else fractions
    return float(np.abs(read - expected[list(swap.order)]).max())


def _iterate_candidates(fractions: Floats, expected: Floats) -> Iterator[list[Swap]]:
    """Yield lists of equally simple swaps, the simplest first.

    First come single exchanges, of the channels or of two references; then both together; last the references in the order of
    their fractions.

    Parameters
    ----------
    fractions, expected
        The inner film's fraction of the load on each reference, as read and as expected, shape (n,).
    """
    unchanged = tuple(range(len(fractions)))
    pairs, pairs_of_exchanged = (_rank_pairs(inner, expected) for inner in (fractions, 1 - fractions))
    yield [Swap(True, unchanged), *(Swap(False, order) for order in pairs)]
    yield [Swap(True, order) for order in pairs_of_exchanged]
    yield [Swap(False, _assign_by_rank(fractions, expected)), Swap(True, _assign_by_rank(1 - fractions, expected))]


def _rank_pairs(fractions: Floats, expected: Floats) -> list[Order]:
    """Return the orders with two references swapped that bring the fractions closest to the expected ones, the best first."""

    def compute_misfit(order: Order) -> float:
        """Return the sum of squared differences from the expected fractions, if the references were in this order."""
        return float(np.sum((fractions - expected[list(order)]) ** 2))

    places = range(len(fractions))
    pairs = (tuple({i: j, j: i}.get(k, k) for k in places) for i, j in combinations(places, 2))
    return sorted(pairs, key=compute_misfit)[:MAX_TRIED_PAIRS]


def _assign_by_rank(fractions: Floats, expected: Floats) -> Order:
    """Return for each reading, shape (n,), the index of the reference whose expected fraction has the same rank."""
    order = np.empty(len(fractions), dtype=int)
    order[np.argsort(fractions)] = np.argsort(expected)
    return tuple(order.tolist())


def check_films(films: Floats, expected: Floats, deviations: Floats) -> None:
    """Refuse readings in which a film is dead, of reversed polarity, or below its noise.

    Parameters
    ----------
    films
        Both films' readings, shape (n, 2).
    expected
        The inner film's expected fractions of the load, shape (n,).
    deviations
        Standard deviations of ``films`` due to noise, shape (n, 2).

    Raises
    ------
    InputError
        One of these faults; the message names the film, or the polarity.
    """
    dead = find_dead_film(films, expected)
    if dead is not None:
        entry = Words(f"nothing on the {dead} film, whatever is pressed")
        raise InputError("reading", entry, f"charge on both films: is a film dead, or its cable off or short? {READ_AGAIN}")
    is_opposite = (expected > 0) & (expected < 1) & (films.prod(axis=1) < 0)
    if np.any(is_opposite & (np.abs(films) > SIGNIFICANT_SD * deviations).all(axis=1)):
        remedy = f"one polarity: a film's leads are exchanged; {READ_AGAIN}"
        raise InputError("reading", Words("charges of opposite sign"), remedy)
    if is_opposite.any():
        weaker = FILM_NAMES[int(np.argmin(np.abs(films[is_opposite][0])))]
        entry = Words(f"a charge of the {weaker} film below its noise")
        raise InputError(
            "reading", entry, "charges that stand out on both films: press harder, or read longer (--seconds, seconds=)"
        )


def find_dead_film(films: Floats, expected: Floats) -> str | None:
    """Return the name of a film that shows almost nothing on every reference that should press it, or None.

    Almost nothing is less than ``DEAD_FILM_FRACTION`` of the expected force.
    If this holds for both films, None is returned: their cables may be exchanged.

    Parameters
    ----------
    films
        Both films' readings, shape (n, 2).
    expected
        The inner film's expected fractions of the load, shape (n,).
    """
    fractions = np.stack([expected, 1 - expected], axis=1)
    load = np.abs(films).sum(axis=1)[:, None]  # a dead film adds nothing: the sum is a lower limit of the load
    is_pressed, is_alive = fractions > DEAD_FILM_FRACTION, np.abs(films) >= DEAD_FILM_FRACTION * fractions * load
    dead = [name for k, name in enumerate(FILM_NAMES) if is_pressed[:, k].any() and not (is_pressed & is_alive)[:, k].any()]
    return dead[0] if len(dead) == 1 else None
