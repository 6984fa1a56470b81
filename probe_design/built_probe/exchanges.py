"""Find the exchange of cables or references that would explain readings that contradict each other.

An exchange is undone in the data: the films' readings change places, or readings their references, and the fit is repeated. The
smallest number of exchanges wins; all exchanges of that number that explain the readings are named together. Exchanges of two
references are tried in the order of how close they bring the films' shares of the load to the expected ones. Last, all readings
are assigned in the order of their shares.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import InputError, Words
from hw.signal.measure import FILM_NAMES
from probe_design.built_probe.bench import SIGNIFICANT_SD, Bench, Reference

MAX_DEVIATION_SD = 4.0  # standard deviations by which a gain may differ from the bench's statement
READ_AGAIN = "put it right, and read again"
MAX_TRIED_EXCHANGES = 24  # exchanges of two references that are tried, the most promising ones
DEAD_FILM_SHARE = 0.1  # fraction of the expected force below which a film counts as dead

Order = tuple[int, ...]


@dataclass(frozen=True)
class Misplacement:
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
        return films if not self.channels else np.flip(films)


def find_exchanges(
    films: Floats, expected: Floats, doubt: float, agrees: Callable[[Misplacement], bool]
) -> tuple[Misplacement, ...]:
    """Find the simplest exchanges with which the readings agree; return an empty tuple if there are none.

    Parameters
    ----------
    films
        Both films' readings on each reference, of nominal gain, shape (n, 2).
    expected
        The inner film's expected shares of the load, shape (n,).
    doubt
        Largest error of a share; an exchange that leaves a larger one is not tried.
    agrees
        Whether the readings agree once an exchange is undone.
    """
    shares = films[:, 0] / films.sum(axis=1)
    for equals in _iterate_candidates(shares, expected):
        plausible = (exchange for exchange in equals if _compute_share_error(shares, expected, exchange) < doubt)
        agreeing = tuple(exchange for exchange in plausible if agrees(exchange))
        if agreeing:
            return agreeing
    return ()


def find_dead_film(films: Floats, expected: Floats) -> str | None:
    """Return the name of a film with less than 10 % of the expected force on every reference that should press it, or None.

    If this holds for both films, None is returned: their cables may be exchanged.

    Parameters
    ----------
    films
        Both films' readings, shape (n, 2).
    expected
        The inner film's expected shares of the load, shape (n,).
    """
    shares = np.stack([expected, 1 - expected], axis=1)
    load = np.abs(films).sum(axis=1)[:, None]  # a dead film adds nothing: the sum is a lower limit of the load
    pressed, detected = shares > DEAD_FILM_SHARE, np.abs(films) >= DEAD_FILM_SHARE * shares * load
    dead = [name for k, name in enumerate(FILM_NAMES) if pressed[:, k].any() and not (pressed & detected)[:, k].any()]
    return dead[0] if len(dead) == 1 else None


def compute_share_doubt(bench: Bench) -> float:
    """Return the largest error of a share that the bench's tolerances allow; a relative gain error g shifts it by up to g / 4."""
    return MAX_DEVIATION_SD * (bench.channels.gain + bench.channels.cross_talk)


def check_films(films: Floats, expected: Floats, deviations: Floats) -> None:
    """Refuse readings in which a film is dead, of reversed polarity, or below its noise.

    Parameters
    ----------
    films
        Both films' readings, shape (n, 2).
    expected
        The inner film's expected shares of the load, shape (n,).
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
    both_pressed = (expected > 0) & (expected < 1)
    opposite = both_pressed & (films.prod(axis=1) < 0)
    if np.any(opposite & (np.abs(films) > SIGNIFICANT_SD * deviations).all(axis=1)):
        raise InputError(
            "reading", Words("charges of opposite sign"), f"one polarity: a film's leads are exchanged; {READ_AGAIN}"
        )
    if opposite.any():
        weaker = FILM_NAMES[int(np.argmin(np.abs(films[opposite][0])))]
        entry = Words(f"a charge of the {weaker} film below its noise")
        raise InputError("reading", entry, "charges that stand out on both films: press harder, or read longer (--seconds)")


def _compute_share_error(shares: Floats, expected: Floats, exchange: Misplacement) -> float:
    """Return the largest difference between a share and its expected value with an exchange undone."""
    read = 1 - shares if exchange.channels else shares
    return float(np.abs(read - expected[list(exchange.order)]).max())


def _iterate_candidates(shares: Floats, expected: Floats) -> Iterator[list[Misplacement]]:
    """Yield lists of equally simple exchanges, the simplest first."""
    unchanged = tuple(range(len(shares)))
    as_read, exchanged = (_rank_transpositions(inner, expected) for inner in (shares, 1 - shares))
    yield [Misplacement(True, unchanged), *(Misplacement(False, order) for order in as_read)]
    yield [Misplacement(True, order) for order in exchanged]
    yield [Misplacement(False, _rank_references(shares, expected)), Misplacement(True, _rank_references(1 - shares, expected))]


def _rank_transpositions(shares: Floats, expected: Floats) -> list[Order]:
    """Return the exchanges of two references that bring the shares closest to the expected ones, the best first."""

    def compute_misfit(order: Order) -> float:
        return float(np.sum((shares - expected[list(order)]) ** 2))

    places = range(len(shares))
    pairs = (tuple({i: j, j: i}.get(k, k) for k in places) for i, j in combinations(places, 2))
    return sorted(pairs, key=compute_misfit)[:MAX_TRIED_EXCHANGES]


def _rank_references(shares: Floats, expected: Floats) -> Order:
    """Assign the references to the readings by the rank of their shares."""
    order = np.empty(len(shares), dtype=int)
    order[np.argsort(shares)] = np.argsort(expected)
    return tuple(order.tolist())
