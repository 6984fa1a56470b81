"""Measure scans that are not as the design file says: what is refused as unexplained, and what the rest of the maps still hold.

    nice python -m benchmarks.locating.flaws [--scans 100] [--rows rows.jsonl]

All scans hold one tumour of the narrow population, and are located with it. Flaws: two wild readings, their logarithms off by a
standard deviation of 0.5, with and without ``outliers``; tumours up to 6 mm outside the scanned square, with and without the
``margin`` in the population; a baseline reading over the tumour; a gain that changes by 15 % in mid-scan; readings of another
probe; a tumour larger and stiffer than the population has.

Duration: four minutes.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console

from benchmarks.locating.scans import NARROW, ScanMaker, Setting
from benchmarks.rows import Row, RowFile
from benchmarks.tables import MeasuredTable
from geometry.common.arrays import Floats
from probe_design.locating.inference import MIN_P_VALUE, Posterior, infer
from probe_design.locating.posterior import find_region

OUTLIER_RATE, WILD_READINGS, WILD_SD = 0.05, 2, 0.5
MARGIN_M = 6e-3
GAIN_CHANGE = 0.15  # of ln ratio, after half of the readings
NOTED = ("standard deviations off", "off alike", "may lie beyond")  # what warnings say of readings, gains and places
BEYOND = (8.5e-3, 13e-3, 150e3)  # depth, diameter and modulus of a tumour that the population has not


@dataclass(frozen=True)
class Flaw:
    """What is not as the design file says.

    Attributes
    ----------
    kind
        Of the flaw.
    margin
        Of the population by which the scans are located, m.
    outlier_rate
        With which they are located.
    """

    kind: str = ""
    margin: float = 0.0
    outlier_rate: float = 0.0


FLAWS = {
    "none": Flaw(),
    "none, 5 % outliers": Flaw(outlier_rate=OUTLIER_RATE),
    "two wild readings": Flaw("wild"),
    "two wild readings, 5 % outliers": Flaw("wild", outlier_rate=OUTLIER_RATE),
    "outside, margin 6 mm": Flaw("outside", margin=MARGIN_M),
    "outside, no margin": Flaw("outside"),
    "baseline reading over the tumour": Flaw("baseline"),
    "gain changes by 15 %": Flaw("gain"),
    "another probe": Flaw("probe"),
    "tumour beyond the population": Flaw("beyond"),
}


class FlawedScans:
    """Scans of one flaw."""

    def __init__(self, flaw: Flaw) -> None:
        self.flaw = flaw
        margin = {"margin": flaw.margin} if flaw.margin else {}
        self.maker = ScanMaker("flaws", Setting(NARROW | margin))

    def draw(self, index: int) -> Floats:
        """Return the tumour, shape (1, 5)."""
        tumour = ScanMaker.draw_tumours(self.maker, index)
        rng = self.maker.build_rng(index, 7)
        if self.flaw.kind == "outside":
            half = float(np.abs(self.maker.positions).max())
            places = rng.uniform(-half - MARGIN_M, half + MARGIN_M, (100, 2))
            tumour[0, :2] = places[np.abs(places).max(axis=1) > half][0]
        elif self.flaw.kind == "beyond":
            tumour[0, 2:] = BEYOND
            tumour[0, :2] /= 2
        return tumour

    def simulate(self, index: int, tumour: Floats) -> Floats:
        """Return the readings with their flaw, as logarithms, shape (k + 1, 2)."""
        maker, kind, rng = self.maker, self.flaw.kind, self.maker.build_rng(index, 8)
        simulating = maker
        if kind == "probe":
            simulating = ScanMaker("other probe", Setting(NARROW, probe={"outer_radius": "9.2 mm"}))
        truth = simulating.simulate(index, tumour, maker.positions)
        if kind == "baseline":
            truth[0] = maker.simulate(index, tumour, tumour[:, :2])[1]
        values = maker.add_noise(index, truth)
        if kind == "wild":
            values[1 + rng.choice(len(maker.positions), WILD_READINGS, replace=False), 0] += WILD_SD * rng.standard_normal(2)
        elif kind == "gain":
            values[len(values) // 2 :, 0] += GAIN_CHANGE
        return values

    def locate(self, index: int) -> Row:
        """Simulate and locate a scan."""
        tumour, maker = self.draw(index), self.maker
        likelihood = maker.build_likelihood(maker.build_readings(self.simulate(index, tumour)), self.flaw.outlier_rate)
        posterior = Posterior.from_likelihood(likelihood, index)
        location = infer(likelihood, maker.conditions, index, advise=False, posterior=posterior)
        sample = posterior.samples[0]
        region = find_region(maker.prior, sample.points[:, 0], sample.weights)
        return {
            "none": location.probability[0], "p_value": location.p_value, "region": region.contains(*tumour[0, :2].tolist()),
            "notes": sum(any(text in line for text in NOTED) for line in location.warnings), "size": sample.size,
            "error": float(np.hypot(*(np.array([location.tumours[0].quantities[k].median for k in "xy"]) - tumour[0, :2]))),
        }  # fmt: skip


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scans", type=int, default=100)
    parser.add_argument("--rows", type=Path, help="file of rows, from which a run continues that was cut off")
    arguments = parser.parse_args()
    rows = RowFile(arguments.rows)
    table = MeasuredTable(
        f"Scans of a tumour with a flaw, {arguments.scans} of each",
        (
            "flaw",
            "unexplained",
            "region holds the place",
            "of those explained",
            "P(none) < 0.01",
            "and median off by 4 mm",
            "and no warning",
        ),
    )
    for name, flaw in FLAWS.items():
        scans = FlawedScans(flaw)
        located = [rows.get(f"{name}/{k}", lambda k=k, scans=scans: scans.locate(k)) for k in range(arguments.scans)]  # type: ignore[misc]
        is_explained = np.array([row["p_value"] >= MIN_P_VALUE for row in located])
        held = np.array([row["region"] for row in located])
        is_certain = is_explained & np.array([row["none"] < 0.01 for row in located])
        is_wrong = is_certain & np.array([row["error"] > 4e-3 for row in located])
        is_quiet = is_wrong & np.array([row["notes"] == 0 for row in located])
        table.add(
            name, f"{1 - is_explained.mean():.2f}", f"{held.mean():.2f}",
            f"{held[is_explained].mean():.2f}" if is_explained.any() else None, int(is_certain.sum()), int(is_wrong.sum()),
            int(is_quiet.sum()),
        )  # fmt: skip
    table.print(Console(width=140))


if __name__ == "__main__":
    main()
