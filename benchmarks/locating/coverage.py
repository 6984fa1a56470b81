"""Measure how often the posterior of one tumour holds the truth, how true P(no tumour) is, and how many tumours are detected.

    nice python -m benchmarks.locating.coverage [--scans 600] [--settings narrow wide] [--rows rows.jsonl]

Half of the scans hold a tumour drawn from the population; ``scans`` says how they are simulated. Settings: narrow and wide
populations, the wide one by hand with an error of the place of 0.5 mm along each axis; under a skin of 1 mm and 20 kPa; in 12 mm
of fat and in the gland below it; and with tables of their own tissues whose modulus or skin is not known, presses at the limit of
linear elasticity by ``contact``, and noise of the charges. The detector is that of ``optimize`` (eq. PO.4) on the same scans,
with 512 tumours of the population; both thresholds are the 95 % quantile of the scans without tumour.

Duration: 40 minutes.
"""

from __future__ import annotations

import argparse
from itertools import pairwise
from pathlib import Path
from time import process_time

import numpy as np
from rich.console import Console
from scipy.linalg import block_diag

from benchmarks.locating.scans import FAT, NARROW, SKIN, WIDE, ScanMaker, Setting
from benchmarks.rows import Row, RowFile
from benchmarks.tables import MeasuredTable
from geometry.common.arrays import Bools, Floats
from probe_design.locating.inference import Posterior, infer
from probe_design.locating.posterior import find_region
from probe_design.populations.detection import compute_log_likelihood_ratio, whiten

QUANTITIES = ("x", "y", "depth", "diameter", "ln_contrast")
UNKNOWN_SKIN = {"thickness": ["0.8 mm", "1.25 mm"], "modulus": ["10 kPa", "40 kPa"]}
SETTINGS = {
    "narrow": Setting(NARROW),
    "wide": Setting(WIDE, has_stiffness=True),
    "hand-held": Setting(WIDE, has_stiffness=True, noise={"pose": "0.5 mm"}),
    "fat over gland": Setting(NARROW | {"depth": ["6 mm", "20 mm"]}, has_stiffness=True, tissue={"layer": [FAT]}),
    "under a skin": Setting(NARROW, has_stiffness=True, tissue={"layer": [SKIN]}),
    "unknown tissue": Setting(NARROW | {"tissue": ["4 kPa", "7 kPa"]}, has_stiffness=True),
    "unknown skin": Setting(NARROW | {"layer": [UNKNOWN_SKIN]}, has_stiffness=True, tissue={"layer": [SKIN]}),
    "charge noise 0.002 pC": Setting(NARROW, noise={"charge": "0.002 pC"}),
    "charge noise 0.01 pC": Setting(NARROW, noise={"charge": "0.01 pC"}),
    "finite load": Setting(NARROW, has_stiffness=True, load="85 mN"),  # linear elasticity changes the ratio by 1 % at 88 mN
}
MAIN = ("narrow", "wide", "hand-held", "under a skin")  # whose P(no tumour) are counted together
BINS = (0.0, 0.1, 0.3, 0.5, 0.7, 0.85, 1.0)  # of P(no tumour)
FALSE_ALARM, TEMPLATES = 0.05, 512
RESAMPLED = 2000  # times, for the standard deviation of a difference of detected scans


class DesignDetector:
    """The detector of ``optimize`` for the scans of a setting."""

    def __init__(self, maker: ScanMaker) -> None:
        self.data = maker.unread.data
        self.channels, k = np.flatnonzero(self.data.is_read.any(axis=0)), len(self.data)
        blocks = (np.diag(self.data.variance[:, c]) + maker.gain_sd[c] ** 2 * np.ones((k, k)) for c in self.channels)
        self.factor = np.linalg.cholesky(block_diag(*blocks))
        drawn = maker.prior.transform(maker.prior.draw(TEMPLATES, 1, 2))
        drawn = drawn[maker.prior.find_allowed(drawn)]
        signals = np.zeros((len(drawn), k, 2))
        signals[:, 1:] = maker.model.predict(drawn, maker.positions)
        self.templates = whiten(self.factor, self.stack(signals))

    def stack(self, values: Floats) -> Floats:
        """Return readings (n, k, 2) channel by channel."""
        return np.concatenate([values[:, :, channel] for channel in self.channels], axis=1)

    def compute(self, values: Floats) -> float:
        """Return ln Lambda of a scan."""
        return float(compute_log_likelihood_ratio(self.templates, whiten(self.factor, self.stack(values[None])))[0])


def locate_scan(maker: ScanMaker, detector: DesignDetector, index: int) -> Row:
    """Simulate and locate a scan; odd ones hold no tumour."""
    tumours = maker.draw_tumours(index) if index % 2 == 0 else np.empty((0, 5))
    truth = maker.simulate(index, tumours, maker.move(index))
    likelihood = maker.build_likelihood(maker.build_readings(maker.add_noise(index, truth)))
    start = process_time()
    posterior = Posterior.from_likelihood(likelihood, index)
    seconds = process_time() - start
    location = infer(likelihood, maker.conditions, index, advise=False, posterior=posterior)
    row: Row = {
        "is_free": not len(tumours),
        "none": float(posterior.probability[0]),
        "statistic": detector.compute(likelihood.data.values),
        "p_value": location.p_value,
        "seconds": seconds,
        "size": posterior.samples[0].size,
        "is_warned": any("the map is little more than the population" in line for line in location.warnings),
    }
    if len(tumours):
        sample, known = posterior.samples[0], dict(zip(QUANTITIES, tumours[0].tolist(), strict=True))
        host = maker.tissues[index % len(maker.tissues)].tissue.find_material(tumours[0, 2])
        known["ln_contrast"] = float(np.log(tumours[0, 4] / host.youngs_modulus))
        summary = location.by_number[0].tumours[0].quantities
        intervals = {key: summary[key].interval_90 for key in QUANTITIES}
        region = find_region(maker.prior, sample.points[:, 0], sample.weights)
        row["held"] = [bool(intervals[key][0] <= known[key] <= intervals[key][1]) for key in QUANTITIES]
        row["held"].append(region.contains(known["x"], known["y"]))
        row["error"] = float(np.hypot(summary["x"].median - known["x"], summary["y"].median - known["y"]))
        row["truth"], row["truths"], row["intervals"] = tumours[0].tolist(), truth.tolist(), intervals
    return row


def run(name: str, scans: int, rows: RowFile) -> list[Row]:
    """Return the rows of the scans of a setting."""
    maker = ScanMaker(name, SETTINGS[name])
    detector = DesignDetector(maker)
    return [rows.get(f"{name}/{index}", lambda index=index: locate_scan(maker, detector, index)) for index in range(scans)]  # type: ignore[misc]


def detect(statistic: Floats, is_free: Bools) -> Bools:
    """Return which scans with a tumour are above the quantile of those without."""
    return np.asarray(statistic[~is_free] > np.quantile(statistic[is_free], 1 - FALSE_ALARM))


def compare_detectors(first: Floats, second: Floats, is_free: Bools) -> tuple[float, float]:
    """Return how many more scans the first statistic detects than the second, and the standard deviation over resampled scans."""
    rng, differences = np.random.default_rng(0), []
    with_tumour, without = np.flatnonzero(~is_free), np.flatnonzero(is_free)
    for _ in range(RESAMPLED):
        chosen = np.concatenate([rng.choice(with_tumour, len(with_tumour)), rng.choice(without, len(without))])
        rates = [detect(statistic[chosen], is_free[chosen]).mean() for statistic in (first, second)]
        differences.append(rates[0] - rates[1])
    return float(detect(first, is_free).mean() - detect(second, is_free).mean()), float(np.std(differences))


def compute_area(statistic: Floats, is_free: Bools) -> float:
    """Return the area under the receiver operating characteristic: how often a scan with a tumour is above one without."""
    return float((statistic[~is_free][:, None] > statistic[is_free]).mean())


def build_bins(rows: list[Row]) -> MeasuredTable:
    """Return P(no tumour) as stated and as it came."""
    table = MeasuredTable(f"P(no tumour) of {len(rows)} scans", ("stated", "scans", "true", "two standard deviations"))
    stated, free = (np.array([row[key] for row in rows]) for key in ("none", "is_free"))
    for low, high in pairwise(BINS):
        chosen = (stated >= low) & (stated < high)
        if chosen.any():
            fraction, count = float(free[chosen].mean()), int(chosen.sum())
            spread = 2 * np.sqrt(max(fraction * (1 - fraction), 1 / count) / count)
            table.add(f"{stated[chosen].mean():.2f}", count, f"{fraction:.2f}", f"{spread:.2f}")
    return table


def build_tables(outcomes: dict[str, list[Row]]) -> list[MeasuredTable]:
    """Return coverage, detection and P(no tumour)."""
    coverage = MeasuredTable("90 % intervals that hold the truth", ("setting", "scans", *QUANTITIES, "region"))
    detection = MeasuredTable(
        "Detected at 5 % false alarms, place of the detected, scans that nothing explains, maps that say nothing",
        ("setting", "locate", "optimize", "difference", "areas", "median, mm", "90 %, mm", "scan, s", "unexplained", "warned"),
    )
    for name, rows in outcomes.items():
        held = np.array([row["held"] for row in rows if not row["is_free"]])
        coverage.add(name, len(held), *(f"{value:.3f}" for value in held.mean(axis=0)))
        free = np.array([row["is_free"] for row in rows])
        evidence = -np.log(np.maximum([row["none"] for row in rows], 1e-300))
        statistic = np.array([row["statistic"] for row in rows])
        is_detected, by_design = detect(evidence, free), detect(statistic, free)
        difference, spread = compare_detectors(evidence, statistic, free)
        areas = f"{compute_area(evidence, free):.3f}, {compute_area(statistic, free):.3f}"
        errors = 1e3 * np.array([row["error"] for row in rows if not row["is_free"]])[is_detected]
        unexplained, warned = sum(row["p_value"] < 1e-3 for row in rows), sum(row["is_warned"] for row in rows)
        place = (f"{np.median(errors):.2f}", f"{np.quantile(errors, 0.9):.1f}") if len(errors) else (None, None)
        seconds = float(np.median([row["seconds"] for row in rows]))
        rates = f"{is_detected.mean():.3f}", f"{by_design.mean():.3f}", f"{difference:+.3f} ± {spread:.3f}", areas
        detection.add(name, *rates, *place, seconds, f"{unexplained} of {len(rows)}", warned)
    main_rows = [row for name in MAIN if name in outcomes for row in outcomes[name]]
    return [coverage, detection, *([build_bins(main_rows)] if main_rows else [])]


def main() -> None:
    """Print all tables, after each setting."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scans", type=int, default=600)
    parser.add_argument("--settings", nargs="*", choices=list(SETTINGS), default=list(SETTINGS))
    parser.add_argument("--rows", type=Path, help="file of rows, from which a run continues that was cut off")
    arguments = parser.parse_args()
    rows, outcomes = RowFile(arguments.rows), dict[str, list[Row]]()
    for name in arguments.settings:
        outcomes[name] = run(name, arguments.scans, rows)
    for table in build_tables(outcomes):
        table.print(Console(width=140))


if __name__ == "__main__":
    main()
