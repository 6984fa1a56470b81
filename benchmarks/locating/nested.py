"""Compare evidence and marginals of one tumour with nested sampling by dynesty, on the same likelihood and prior.

    pip install -c constraints.txt '.[bench]'
    nice python -m benchmarks.locating.nested [--scans 10] [--rows rows.jsonl]

Scans are those of ``coverage`` with a tumour. The sample of ``locate`` is that of seed 0; for the marginals, samples of several
seeds are joined, each by its evidence, until their effective size reaches 2000. Distances of the marginals are the largest
difference of the cumulative distributions (Kolmogorov and Smirnov); two samples of this size of one distribution differ by 0.043
in one of 20 cases. With 450 live points and 25 steps of a walk, two runs of dynesty differed by up to 0.06, locate's by 0.014.

Duration: nine minutes.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable
from pathlib import Path
from time import process_time
from types import SimpleNamespace
from typing import Any

import dynesty
import numpy as np
from dynesty.internal_samplers import RWalkSampler, SamplerReturn
from rich.console import Console

from benchmarks.locating.coverage import QUANTITIES, SETTINGS
from benchmarks.locating.scans import ScanMaker
from benchmarks.rows import Row, RowFile
from benchmarks.tables import MeasuredTable
from geometry.common.arrays import Floats
from probe_design.locating.likelihood import Likelihood
from probe_design.locating.posterior import list_values
from probe_design.locating.sampling import draw_posterior

COMPARED = ("narrow", "wide", "hand-held")  # settings, in turn
LIVE_POINTS, WALKING_SHARE, WALKS = 1350, 9, 50  # of the live points one in nine walks together with others, so many steps
MIN_SIZE = 2000.0  # effective sample size on both sides
NO_LIKELIHOOD = -1e290  # ln L of tumours that do not fit: dynesty takes finite numbers alone


def join_samples(likelihood: Likelihood) -> tuple[Floats, Floats, float]:
    """Return tumours (n, 5) and weights of ``locate`` over several seeds, and the size of their sample."""
    points, log_weights, size = [], [], 0.0
    for seed in range(12):
        sample = draw_posterior(likelihood, 1, seed)
        points.append(likelihood.prior.transform(sample.points)[:, 0])
        log_weights.append(sample.log_weights + sample.log_evidence)
        joined = np.concatenate(log_weights)
        weights = np.exp(joined - joined.max())
        weights /= weights.sum()
        size = float(1 / (weights**2).sum())
        if size >= MIN_SIZE:
            break
    return np.concatenate(points), weights, size


class WalkingPool:
    """Dynesty's pool: random walks of several new points, step by step together, so that their likelihoods are one array.

    The steps are those of ``dynesty.internal_samplers.generic_random_walk``: uniform in an ellipsoid about the point, rejected
    outside the cube and at or below the likelihood of the worst live point.
    """

    def __init__(self, likelihood: Likelihood) -> None:
        self.likelihood, self.rng = likelihood, np.random.default_rng(2)

    def map(self, function: Callable[[Any], Any], arguments: Iterable[Any]) -> list[Any]:
        """Return the function of each argument, of walks all together."""
        arguments = list(arguments)
        if function is not RWalkSampler.sample:
            return [function(argument) for argument in arguments]
        first, points = arguments[0], np.array([argument.u for argument in arguments])
        axes, (count, dimensions) = np.array([argument.axes for argument in arguments]), points.shape
        values, accepted = np.full(count, -np.inf), np.zeros(count, dtype=int)
        for _ in range(first.kwargs["walks"]):
            steps = self.rng.standard_normal(points.shape)
            radius = self.rng.random(count) ** (1 / dimensions) / np.linalg.norm(steps, axis=1)
            proposed = points + first.scale * np.einsum("nij,nj->ni", axes, steps * radius[:, None])
            inside = np.flatnonzero(np.all((proposed > 0) & (proposed < 1), axis=1))
            computed = compute_log_likelihoods(self.likelihood, proposed[inside])
            better = inside[computed > first.loglstar]
            points[better], values[better] = proposed[better], computed[computed > first.loglstar]
            accepted[better] += 1
        still = accepted == 0
        values[still] = compute_log_likelihoods(self.likelihood, points[still])
        return [
            SamplerReturn(
                u=point, v=point.copy(), logl=value, ncalls=first.kwargs["walks"], evaluation_history=[],
                tuning_info={"accept": number, "reject": first.kwargs["walks"] - number, "scale": first.scale},
                proposal_stats={"n_accept": number, "n_reject": first.kwargs["walks"] - number},
            )
            for point, value, number in zip(points, values.tolist(), accepted.tolist(), strict=True)
        ]  # fmt: skip


def compute_log_likelihoods(likelihood: Likelihood, points: Floats) -> Floats:
    """Return ln L at points of the cube (n, d), finite everywhere, shape (n,)."""
    return np.maximum(likelihood.evaluate(points[:, None]), NO_LIKELIHOOD)


def run_nested(likelihood: Likelihood) -> SimpleNamespace:
    """Return tumours, weights, ln evidence and its error by dynesty, with enough live points."""
    start, live, size = process_time(), LIVE_POINTS, 0.0
    while size < MIN_SIZE:
        sampler = dynesty.NestedSampler(
            lambda point: float(compute_log_likelihoods(likelihood, np.asarray(point)[None])[0]), lambda point: point,
            len(likelihood.prior.free), nlive=live, bound="multi", sample="rwalk", walks=WALKS, pool=WalkingPool(likelihood),
            queue_size=live // WALKING_SHARE, rstate=np.random.default_rng(1),
        )  # fmt: skip
        sampler.run_nested(dlogz=0.01, print_progress=False)
        results = sampler.results
        weights = results.importance_weights()
        live, size = 2 * live, float(1 / (weights**2).sum())
    log_fraction = np.log(likelihood.prior.compute_allowed_fraction(1))
    return SimpleNamespace(
        tumours=likelihood.prior.transform(results.samples[:, None])[:, 0], weights=weights, size=size,
        log_evidence=float(results.logz[-1] - log_fraction), error=float(results.logzerr[-1]), seconds=process_time() - start,
    )  # fmt: skip


def compute_distance(first: Floats, first_weights: Floats, second: Floats, second_weights: Floats) -> float:
    """Return the largest difference of two weighted cumulative distributions."""
    values = np.concatenate([first, second])
    order = np.argsort(values, kind="stable")
    steps = np.concatenate([first_weights, -second_weights])[order]
    return float(np.abs(np.cumsum(steps)).max())


def compare(maker: ScanMaker, index: int) -> Row:
    """Return evidence and distances of the marginals of a scan."""
    tumours = maker.draw_tumours(index)
    values = maker.add_noise(index, maker.simulate(index, tumours, maker.move(index)))
    likelihood = maker.build_likelihood(maker.build_readings(values))
    start = process_time()
    single = draw_posterior(likelihood, 1, 0)
    seconds = process_time() - start
    points, weights, size = join_samples(likelihood)
    nested = run_nested(likelihood)
    columns = [list_values(maker.prior, part[:, None])[:, 0] for part in (points, nested.tumours)]
    picked = [0, 1, 2, 3, 5]
    distances = [compute_distance(columns[0][:, c], weights, columns[1][:, c], nested.weights) for c in picked]
    return {
        "difference": single.log_evidence - nested.log_evidence, "error": single.evidence_error, "nested_error": nested.error,
        "log_evidence": nested.log_evidence - float(likelihood.evaluate_tumours(np.zeros((1, 0, 5)))[0]),
        "sizes": [size, nested.size], "distances": distances, "seconds": [seconds, nested.seconds],
    }  # fmt: skip


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scans", type=int, default=10)
    parser.add_argument("--rows", type=Path, help="file of rows, from which a run continues that was cut off")
    arguments = parser.parse_args()
    rows, makers = RowFile(arguments.rows), {name: ScanMaker(name, SETTINGS[name]) for name in COMPARED}
    table = MeasuredTable(
        "locate less dynesty",
        ("scan", "ln Bayes factor", "difference", "limit", *QUANTITIES, "sizes", "locate, s", "dynesty, s"),
    )
    for number in range(arguments.scans):
        name, index = COMPARED[number % len(COMPARED)], 2 * number  # scans of even numbers hold a tumour
        row = rows.get(f"{name}/{index}", lambda name=name, index=index: compare(makers[name], index))  # type: ignore[misc]
        table.add(
            f"{name} {index}", f"{row['log_evidence']:.1f}", f"{row['difference']:+.3f}", f"{0.1 + 2 * row['nested_error']:.2f}",
            *(f"{value:.3f}" for value in row["distances"]), " ".join(f"{size:.0f}" for size in row["sizes"]), *row["seconds"],
        )  # fmt: skip
    table.print(Console(width=140))


if __name__ == "__main__":
    main()
