"""How often the 95 % intervals of `estimate` cover the truth: `nice python -m benchmarks.readings.intervals [--draws N]`.

Readings are another evaluator's (``truths.py``) with noise as it is stated. The unknown is drawn evenly in its logarithm from a
broad range, nuisances are drawn from their priors. Every reading goes through ``probe_design.estimate``; intervals that are open
count as they are printed. p is of the exact two-sided binomial test that 95 % are covered.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from typing import Any
from unittest.mock import patch
from zlib import crc32

import numpy as np
from scipy.stats import binomtest

from benchmarks.readings.cases import cases
from benchmarks.readings.truths import Case, Truth
from geometry.common.arrays import Floats
from probe_design.estimation import estimate as command
from probe_design.estimation.answer import Estimate
from probe_design.estimation.estimate import estimate
from probe_design.estimation.model import TargetModel
from probe_design.estimation.profile import Track
from probe_design.estimation.readings import Reading
from probe_design.estimation.strength import Interval

CHECKED = 4  # points at which the truth is computed anew
COLUMNS = ("kind", "case", "truth by", "covered", "share", "p", "below", "above", "bounded", "unexplained", "interpolation, sd")


@dataclass(frozen=True)
class Outcome:
    """What came of the readings of a case.

    Attributes:
        below, above: how many intervals lie below the truth, and above.
        bounded: how many have two ends.
        unexplained: how many readings no value of the unknown explains.
        count: of all readings.
    """

    below: int
    above: int
    bounded: int
    unexplained: int
    count: int

    @property
    def covered(self) -> int:
        """How many intervals hold the truth."""
        return self.count - self.below - self.above

    @property
    def p_value(self) -> float:
        """Of the exact two-sided binomial test that 95 % are covered."""
        return float(binomtest(self.covered, self.count, 0.95).pvalue)


def row_of(truth: Truth, out: Outcome, defect: float) -> str:
    """Return a line of the table."""
    case, share = truth.case, 100 / out.count
    shares = (f"{share * out.bounded:.0f} %", f"{share * out.unexplained:.1f} %", f"{defect:.1g}")
    covered = (f"{out.covered} of {out.count}", f"{share * out.covered:.1f} %", f"{out.p_value:.2g}", out.below, out.above)
    cells = (case.kind, case.name, case.evaluator, *covered, *shares)
    return f"| {' | '.join(map(str, cells))} |"


@contextmanager
def lean(case: Case) -> Iterator[None]:
    """Let `estimate` predict once for all readings of a case, and leave out what has no part in the interval.

    Predictions depend on places, noise and signs, not on values. Left out are warnings and, where it is not asked about, the
    joint fit of depth and strength.
    """
    known: dict[tuple[Any, ...], Track] = {}
    original, with_spread = Track.of.__func__, Track.with_spread  # type: ignore[attr-defined]

    def key(model: TargetModel) -> tuple[Any, ...]:
        data = model.data
        parts = (data.places, data.place, data.is_stiffness, data.is_phase, data.is_blank, data.sign, data.noise)
        return (model.scene, model.accuracy, *(part.tobytes() for part in parts))

    def of(cls: type[Track], model: TargetModel, unknown: str) -> Track:
        at = (key(model), unknown)
        if at not in known:
            known[at] = original(cls, model, unknown)
        return replace(known[at], model=model)

    def spread(self: Track, nuisances: Mapping[str, float]) -> Track:
        at = (key(self.model), self.unknown, tuple(nuisances.items()))
        if at not in known:
            known[at] = with_spread(self, nuisances)
        return replace(known[at], model=self.model)

    with ExitStack() as stack:
        for where, name, new in ((Track, "of", classmethod(of)), (Track, "with_spread", spread), (command, "warnings", _none)):
            stack.enter_context(patch.object(where, name, new))
        if case.partner is None:
            stack.enter_context(patch.object(command, "_together", lambda findings: None))
        yield


def _none(*arguments: Any) -> tuple[str, ...]:
    return ()


def readings(case: Case, row: Floats) -> tuple[Reading, ...]:
    """Return what is read, from ln ratios and, behind them, ln stiffnesses."""
    stiff = iter(row[len(case.presses) :].tolist())
    return tuple(
        Reading(
            press.x,
            0.0,
            math.exp(value),
            case.noise,
            math.exp(next(stiff)) if press.stiff else None,
            case.stiffness_noise,
            press.blank,
        )
        for press, value in zip(case.presses, row.tolist(), strict=False)
    )


def simulated(truth: Truth, draws: int, seed: int) -> tuple[Floats, Floats]:
    """Return points of the box and, of each, readings with noise."""
    case = truth.case
    random = np.random.default_rng([seed, crc32(case.name.encode())])
    points = truth.drawn(draws, random)
    exact = truth.at(points)
    return points, exact + np.log1p(case.noises * random.normal(size=exact.shape))


def interval(case: Case, found: Estimate) -> Interval:
    """Return the interval that is asked about."""
    return found.depth_interval if case.partner is not None and found.depth_interval is not None else found.interval


def outcome(truth: Truth, draws: int, seed: int, tell: Callable[[str], None] = lambda text: None) -> Outcome:
    """Return what comes of a case."""
    case = truth.case
    points, rows = simulated(truth, draws, seed)
    below = above = bounded = unexplained = 0
    unknown = case.unknown if case.partner is None else case.partner[0]
    with lean(case):
        for k, (point, row) in enumerate(zip(points, rows, strict=True)):
            found = estimate(case.scene, readings(case, row), unknown, nuisances=case.nuisances)
            (low, high), value = interval(case, found), math.exp(point[0])
            below += high is not None and high < value
            above += low is not None and low > value
            bounded += low is not None and high is not None
            unexplained += found.interval == (None, None) and "explain" in str(found.reason) and "any" not in str(found.reason)
            tell(f"{case.name}: {k + 1} of {draws} readings, {below + above} missed")
    return Outcome(below, above, bounded, unexplained, draws)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", default="", help="cases whose kind or name hold this")
    given = parser.parse_args()

    def tell(text: str) -> None:
        if sys.stderr.isatty():
            print(f"\r{text:70}", end="", file=sys.stderr, flush=True)

    print(f"| {' | '.join(COLUMNS)} |\n{'|---' * len(COLUMNS)}|", flush=True)
    for case in cases():
        if given.only in f"{case.kind}: {case.name}":
            truth = Truth.of(case, tell)
            defect = (truth.defect(CHECKED, np.random.default_rng([given.seed, 36])) / case.noises).max()
            print(row_of(truth, outcome(truth, given.draws, given.seed, tell), float(defect)), flush=True)


if __name__ == "__main__":
    main()
