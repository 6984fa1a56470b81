"""Measure how often the 95 % intervals of `estimate` cover the truth.

    nice python -m benchmarks.readings.intervals [--draws N]

Readings are another evaluator's (``truths.py``) with noise as it is stated. The unknown is drawn evenly in its logarithm from a
broad range, nuisances are drawn from their priors. The intervals are those of ``estimate``, found for all readings of a case at
once (``compute_hulls``); the first of each case go through ``estimate`` itself, and must come out alike. Ends that are open
count as they are printed. p is of the exact two-sided binomial test that 95 % are covered.

Duration: ten minutes.
"""

from __future__ import annotations

import argparse
import math
import sys
from dataclasses import dataclass
from zlib import crc32

import numpy as np
from scipy.stats import binomtest

from benchmarks.readings.cases import cases
from benchmarks.readings.truths import ReadingCase, ReadingTruth
from geometry.common.arrays import Floats
from probe_design.data.noise import choose_accuracy
from probe_design.estimation.estimate import estimate
from probe_design.estimation.intervals import Interval, Likelihood, compute_hulls
from probe_design.estimation.measurements import Measurements, Reading
from probe_design.estimation.model import TargetModel
from probe_design.estimation.profile import Track

CHECKED_POINTS = 4  # points at which the truth is computed anew
ESTIMATED_READINGS = 5  # readings of each case that `estimate` itself is given
COLUMNS = ("kind", "case", "truth by", "covered", "share", "p", "below", "above", "bounded", "unexplained", "interpolation, sd")


@dataclass(frozen=True)
class CoverageOutcome:
    """What came of the readings of a case.

    Attributes
    ----------
    below, above
        How many intervals lie below the truth, and above.
    bounded
        How many have two ends.
    unexplained
        How many readings no value of the unknown explains.
    count
        Of all readings.
    """

    below: int
    above: int
    bounded: int
    unexplained: int
    count: int

    @property
    def count_covered(self) -> int:
        """How many intervals hold the truth."""
        return self.count - self.below - self.above

    @property
    def p_value(self) -> float:
        """Of the exact two-sided binomial test that 95 % are covered."""
        return float(binomtest(self.count_covered, self.count, 0.95).pvalue)


def build_row(truth: ReadingTruth, coverage: CoverageOutcome, defect: float) -> str:
    """Return a line of the table."""
    case, share = truth.case, 100 / coverage.count
    shares = (f"{share * coverage.bounded:.0f} %", f"{share * coverage.unexplained:.1f} %", f"{defect:.1g}")
    covered = (
        f"{coverage.count_covered} of {coverage.count}",
        f"{share * coverage.count_covered:.1f} %",
        f"{coverage.p_value:.2g}",
        coverage.below,
        coverage.above,
    )
    cells = (case.kind, case.name, case.evaluator, *covered, *shares)
    return f"| {' | '.join(map(str, cells))} |"


def build_likelihood(case: ReadingCase, row: Floats) -> Likelihood:
    """Return what `estimate` holds readings against: predictions depend on places, noise and signs, not on values."""
    data = Measurements.from_readings(readings(case, row))
    model = TargetModel(case.scene, data, choose_accuracy(float(data.noise[data.is_ratio].min()) / 4))
    return Likelihood(Track.from_model(model, case.unknown).add_nuisances(case.nuisances), data.noise)


def readings(case: ReadingCase, row: Floats) -> tuple[Reading, ...]:
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


def simulate_readings(truth: ReadingTruth, draws: int, seed: int) -> tuple[Floats, Floats]:
    """Return points of the box and, of each, readings with noise."""
    case = truth.case
    random = np.random.default_rng([seed, crc32(case.name.encode())])
    points = truth.draw_points(draws, random)
    exact = truth.interpolate(points)
    return points, exact + np.log1p(case.noises * random.normal(size=exact.shape))


def outcome(truth: ReadingTruth, draws: int, seed: int) -> CoverageOutcome:
    """Return what comes of a case.

    Raises
    ------
    RuntimeError
        ``estimate`` itself gives another interval for one of the first readings.
    """
    case = truth.case
    points, rows = simulate_readings(truth, draws, seed)
    fit, values = build_likelihood(case, rows[0]), np.exp(points[:, 0])
    hulls = compute_hulls(fit, rows)
    for row, interval in zip(rows[:ESTIMATED_READINGS], hulls, strict=False):
        estimated_interval = estimate(case.scene, readings(case, row), case.unknown, nuisances=case.nuisances).interval
        if not np.allclose(_numbers(estimated_interval), _numbers(interval), rtol=1e-3):
            raise RuntimeError(f"{case.name}: estimate says {estimated_interval}, the benchmark {interval}")
    low, high = np.array([_numbers(hull) for hull in hulls]).T
    bounded = int((np.isfinite(high) & (low > 0)).sum())
    return CoverageOutcome(
        int((high < values).sum()), int((low > values).sum()), bounded, int(fit.find_unexplained(rows).sum()), draws
    )


def _numbers(interval: Interval) -> tuple[float, float]:
    low, high = interval
    return low or 0.0, np.inf if high is None else high


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", default="", help="cases whose kind or name hold this")
    given = parser.parse_args()

    def progress(text: str) -> None:
        if sys.stderr.isatty():
            print(f"\r{text:70}", end="", file=sys.stderr, flush=True)

    print(f"| {' | '.join(COLUMNS)} |\n{'|---' * len(COLUMNS)}|", flush=True)
    for case in cases():
        if given.only in f"{case.kind}: {case.name}":
            truth = ReadingTruth.from_case(case, progress)
            defect = (truth.defect(CHECKED_POINTS, np.random.default_rng([given.seed, 36])) / case.noises).max()
            print(build_row(truth, outcome(truth, given.draws, given.seed), float(defect)), flush=True)


if __name__ == "__main__":
    main()
