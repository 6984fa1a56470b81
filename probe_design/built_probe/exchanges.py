"""Which exchange of cables or references would explain readings that contradict each other.

An exchange is tried as it would be mended: the films' readings change places, or readings their references, and the fit is
judged again. The fewest exchanges win; those of one number that all do are named together. Single exchanges of two references
are tried in the order in which they bring the films' shares to the expected ones; last, all readings as these shares rank.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import InputError, Words
from hw.signal.measure import FILMS
from probe_design.built_probe.bench import Bench, Reference

FAR = 4.0  # standard deviations by which a gain may be off what the bench says of the channels
READ_AGAIN = "put it right, and read again"
TRIED = 24  # exchanges of two references, the most promising ones
SHOWS = 3.0  # standard deviations by which a film's charge stands out from its noise
DEAD = 0.1  # share of what a film should feel below which it feels nothing

Order = tuple[int, ...]


@dataclass(frozen=True)
class Misplacement:
    """What may have been exchanged.

    Attributes:
        channels: whether the films' channels were.
        order: by reading the index of the reference that it was taken on.
    """

    channels: bool
    order: Order

    def told(self, references: Sequence[Reference]) -> str:
        """Name it."""
        parts = ["the films' channels (cables)"] if self.channels else []
        moved = [k for k, at in enumerate(self.order) if at != k]
        if len(moved) == 2:
            parts.append(" and ".join(f"the {references[k].name}" for k in moved))
        elif moved:
            parts.append(f"the order, which was: {', '.join(references[k].name for k in self.order)}")
        return "; besides, ".join(parts)

    def mended(self, films: Floats) -> Floats:
        """Return one reading of both films as it is when their channels are put right, shape (2,) or (2, 2)."""
        return films if not self.channels else np.flip(films)


def explaining(films: Floats, expected: Floats, doubt: float, agrees: Callable[[Misplacement], bool]) -> tuple[Misplacement, ...]:
    """Return the simplest exchanges with which the readings agree; none if there are none.

    Args:
        films: both films' readings on each reference, of nominal gain, shape (n, 2).
        expected: shares of the load that the inner film should feel there, shape (n,).
        doubt: by which a share may be off, where neither is small: what is off by more is not tried.
        agrees: whether the readings do once an exchange is undone.
    """
    shares = films[:, 0] / films.sum(axis=1)
    for equals in _candidates(shares, expected):
        near = (one for one in equals if _off(shares, expected, one) < doubt)
        found = tuple(one for one in near if agrees(one))
        if found:
            return found
    return ()


def dead_film(films: Floats, expected: Floats) -> str | None:
    """Return the name of a film that feels less than ``DEAD`` of what it should on every reference that should press it.

    Both at once are no dead films: they may feel each other's load.

    Args:
        films: both films' readings, shape (n, 2).
        expected: shares of the load that the inner film should feel, shape (n,).
    """
    shares = np.stack([expected, 1 - expected], axis=1)
    load = np.abs(films).sum(axis=1)[:, None]  # of a film that is dead nothing is known: the load is the other's, or more
    pressed, felt = shares > DEAD, np.abs(films) >= DEAD * shares * load
    dead = [name for k, name in enumerate(FILMS) if pressed[:, k].any() and not (pressed & felt)[:, k].any()]
    return dead[0] if len(dead) == 1 else None


def share_doubt(bench: Bench) -> float:
    """By which a share may be off for all that the bench says: a gain off by g shifts it by up to g / 4."""
    return FAR * (bench.channels.gain + bench.channels.cross_talk)


def check_films(films: Floats, expected: Floats, deviations: Floats) -> None:
    """Refuse readings of which a film is dead, of reversed polarity, or below its noise.

    Args:
        films: both films' readings, shape (n, 2).
        expected: shares of the load that the inner film should feel, shape (n,).
        deviations: standard deviations of ``films`` by noise, shape (n, 2).

    Raises:
        InputError: names the film, or the polarity.
    """
    dead = dead_film(films, expected)
    if dead is not None:
        what = Words(f"nothing on the {dead} film, whatever is pressed")
        raise InputError("reading", what, f"charge on both films: is a film dead, or its cable off or short? {READ_AGAIN}")
    both = (expected > 0) & (expected < 1)
    opposite = both & (films.prod(axis=1) < 0)
    if np.any(opposite & (np.abs(films) > SHOWS * deviations).all(axis=1)):
        raise InputError(
            "reading", Words("charges of opposite sign"), f"one polarity: a film's leads are exchanged; {READ_AGAIN}"
        )
    if opposite.any():
        weaker = FILMS[int(np.argmin(np.abs(films[opposite][0])))]
        what = Words(f"a charge of the {weaker} film below its noise")
        raise InputError("reading", what, "charges that stand out on both films: press harder, or read longer (--seconds)")


def _off(shares: Floats, expected: Floats, exchange: Misplacement) -> float:
    """The most by which a share is off what is expected with an exchange undone."""
    read = 1 - shares if exchange.channels else shares
    return float(np.abs(read - expected[list(exchange.order)]).max())


def _candidates(shares: Floats, expected: Floats) -> Iterator[list[Misplacement]]:
    """Lists of exchanges, each as simple as the others of its list."""
    here = tuple(range(len(shares)))
    plain, turned = (_transpositions(inner, expected) for inner in (shares, 1 - shares))
    yield [Misplacement(True, here), *(Misplacement(False, order) for order in plain)]
    yield [Misplacement(True, order) for order in turned]
    yield [Misplacement(False, _sorted(shares, expected)), Misplacement(True, _sorted(1 - shares, expected))]


def _transpositions(shares: Floats, expected: Floats) -> list[Order]:
    """Those of two references that bring the shares closest to the expected ones."""

    def left(order: Order) -> float:
        return float(np.sum((shares - expected[list(order)]) ** 2))

    here = range(len(shares))
    pairs = (tuple({i: j, j: i}.get(k, k) for k in here) for i, j in combinations(here, 2))
    return sorted(pairs, key=left)[:TRIED]


def _sorted(shares: Floats, expected: Floats) -> Order:
    """The references in the order in which the readings' shares rank."""
    order = np.empty(len(shares), dtype=int)
    order[np.argsort(shares)] = np.argsort(expected)
    return tuple(order.tolist())
