"""Measure what is stated of several tumours: their number, their places, and how evidence repeats with other random numbers.

    nice python -m benchmarks.locating.several [--scans 24] [--three 12] [--rows rows.jsonl]

Scans of two and of three tumours of the wide population, three at most, with ratio and stiffness: each tumour alone would change
the scan by more than six standard deviations, and centres are 12 mm apart or more. All tumours are simulated together, with the
fields that they exchange. Each scan is located with two seeds.

Duration: half an hour.
"""

from __future__ import annotations

import argparse
from itertools import combinations, permutations
from pathlib import Path

import numpy as np
from rich.console import Console

from benchmarks.locating.scans import WIDE, ScanMaker, Setting
from benchmarks.rows import Row, RowFile
from benchmarks.tables import MeasuredTable
from geometry.common.arrays import Floats
from probe_design.locating.inference import Posterior
from probe_design.locating.posterior import summarise

MIN_DEFLECTION, MIN_DISTANCE_M = 6.0, 12e-3
DRAWN = 4096  # sets of tumours, of which the first that is clear counts
SEEDS = (0, 1)


def draw_clear(maker: ScanMaker, index: int, count: int) -> Floats:
    """Return tumours that each would change the scan clearly, and far apart, shape (count, 5)."""
    drawn = maker.prior.transform(maker.build_rng(index, count).random((DRAWN, count, 5)))
    drawn = drawn[maker.prior.find_allowed(drawn)]
    for first, second in combinations(range(count), 2):
        distances = np.linalg.norm(drawn[:, first, :3] - drawn[:, second, :3], axis=1)
        drawn = drawn[distances >= MIN_DISTANCE_M]
    deflections = maker.compute_deflections(drawn.reshape(-1, 5)).reshape(drawn.shape[:2])
    return np.asarray(drawn[deflections.min(axis=1) > MIN_DEFLECTION][0])


def locate_scan(maker: ScanMaker, index: int, count: int) -> Row:
    """Simulate a scan, and locate it with two seeds."""
    tumours = draw_clear(maker, index, count)
    values = maker.add_noise(index, maker.simulate(index, tumours, maker.positions))
    likelihood = maker.build_likelihood(maker.build_readings(values))
    parts = []
    for seed in SEEDS:
        posterior = Posterior.from_likelihood(likelihood, seed)
        part: Row = {
            "probability": posterior.probability.tolist(),
            "log_evidence": posterior.log_evidence.tolist(),
            "repeats": [sample.repeat_difference for sample in (*posterior.samples, *posterior.withheld)],
            "sizes": [sample.size for sample in (*posterior.samples, *posterior.withheld)],
        }
        if len(posterior.samples) >= count:
            known = summarise(maker.prior, posterior.samples[count - 1])
            places = np.array([[summary["x"].median, summary["y"].median] for summary in known])
            errors = [np.linalg.norm(places[list(order)] - tumours[:, :2], axis=1) for order in permutations(range(count))]
            part["errors"] = min(errors, key=lambda part: float(part.sum())).tolist()
        parts.append(part)
    return {"tumours": tumours.tolist(), "parts": parts}


def build_tables(rows: dict[int, list[Row]]) -> list[MeasuredTable]:
    """Return the tables of numbers and places, and of how the evidence repeats."""
    numbers = MeasuredTable(
        "Clear tumours, seed 0: probabilities as stated",
        ("tumours", "scans", "fewer: median", "90 %", "worst", "withheld", "place, median, mm", "90 %, mm"),
    )
    repeats = MeasuredTable("Ln evidence of the number with two seeds", ("number", "scans", "median", "90 %", "worst"))
    for count, scans in rows.items():
        stated = [row["parts"][0] for row in scans if len(row["parts"][0]["probability"]) > count]
        fewer = [sum(part["probability"][:count]) for part in stated]
        errors = 1e3 * np.concatenate([part["errors"] for part in stated])
        numbers.add(
            count, len(scans), f"{np.median(fewer):.2g}", f"{np.quantile(fewer, 0.9):.2g}", f"{max(fewer):.2g}",
            len(scans) - len(stated), f"{np.median(errors):.2f}", f"{np.quantile(errors, 0.9):.2f}",
        )  # fmt: skip
    everything = [row for scans in rows.values() for row in scans]
    for number in (1, 2, 3):
        stated = [row for row in everything if min(len(part["log_evidence"]) for part in row["parts"]) > number]
        first, second = ([row["parts"][seed]["log_evidence"] for row in stated] for seed in SEEDS)
        # the constant of ln evidence is that of no tumour, computed without sampling
        changes = [abs((a[number] - a[0]) - (b[number] - b[0])) for a, b in zip(first, second, strict=True)]
        repeats.add(number, len(stated), *(f"{value:.2f}" for value in np.quantile(changes, (0.5, 0.9, 1.0))))
    return [numbers, repeats]


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scans", type=int, default=24, help="of two tumours")
    parser.add_argument("--three", type=int, default=12, help="scans of three tumours")
    parser.add_argument("--rows", type=Path, help="file of rows, from which a run continues that was cut off")
    arguments = parser.parse_args()
    rows = RowFile(arguments.rows)
    maker = ScanMaker("several", Setting(WIDE | {"tumours": 3}, has_stiffness=True))
    located = {
        count: [
            rows.get(f"{count}/{index}", lambda index=index, count=count: locate_scan(maker, index, count))  # type: ignore[misc]
            for index in range(scans)
        ]
        for count, scans in ((2, arguments.scans), (3, arguments.three))
    }
    for table in build_tables(located):
        table.print(Console(width=140))


if __name__ == "__main__":
    main()
