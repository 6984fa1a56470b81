"""Verify the initial design for three populations, and simulate scans that the same detector reads.

    python -m benchmarks.populations.verification [--scans 10000] [--tumours 64] [--only deep] [--pictures FOLDER]

Each simulated scan draws a tumour of the verification's, the errors of every reading, both gains of the scan and a blank.

Duration: minutes.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from time import perf_counter, process_time

import numpy as np

from benchmarks.populations.cases import CASES, case
from geometry.common.arrays import Floats, Ints
from probe_design.design_report.improvements import compute_improvements
from probe_design.design_report.pictures import draw_improvements
from probe_design.populations.design_file import Design
from probe_design.populations.detection import Detector, compute_log_likelihood_ratio, whiten
from probe_design.populations.examination import Examination, examine
from probe_design.populations.noise import build_difference_noise, compute_film_charges


def simulate_scans(scan: Examination, design: Design, scans: int) -> tuple[Floats, Ints]:
    """Return the errors of scans with a blank, part by part, and numbers of the tumours that they are over."""
    rng, noise, readings = np.random.default_rng(2024), design.noise, scan.readings
    p, forces = readings.positions, np.vstack([np.exp(np.log(readings.blank).mean(axis=0)), readings.mean_forces])
    charges = compute_film_charges(scan.draw.scene, forces)
    ratio = noise.white * rng.standard_normal((scans, p + 1)) + np.sqrt(2) * noise.gain * rng.standard_normal((scans, 1))
    for film in (0, 1):
        ratio += (1 - 2 * film) * noise.charge / charges[:, film] * rng.standard_normal((scans, p + 1))
    stiffness = noise.stiffness_white * rng.standard_normal((scans, p + 1))
    stiffness += noise.stiffness_gain * rng.standard_normal((scans, 1))
    differences = np.hstack([quantity[:, 1:] - quantity[:, :1] for quantity in (ratio, stiffness)])
    return np.asarray(differences, dtype=float), rng.integers(len(scan.draw), size=scans)


def compute_detection_rates(scan: Examination, design: Design, scans: int) -> tuple[float, float]:
    """Return the share of simulated scans in which the detector finds the tumour, and of those without one."""
    blank = np.exp(np.log(scan.readings.blank).mean(axis=0))
    noise = build_difference_noise(design.noise, design.protocol, scan.draw.scene, blank, tumour_forces=scan.readings.mean_forces)
    detector = Detector.train(scan.reference, noise.covariance, design.protocol.false_alarm)
    errors, tumour = simulate_scans(scan, design, scans)
    shares = []
    for readings in (errors + scan.readings.signal[tumour], errors):
        statistic = compute_log_likelihood_ratio(detector.templates, whiten(detector.factor, readings))
        shares.append(float((statistic > detector.threshold).mean()))
    return shares[0], shares[1]


def main() -> None:
    """Print a line for each population."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--scans", type=int, default=10_000)
    parser.add_argument("--tumours", type=int, default=64)
    parser.add_argument("--pictures", type=Path)
    parser.add_argument("--only", choices=sorted(CASES))
    given = parser.parse_args()
    headings = "population", "closed form, s", "verified, s (processor)", "P closed form", "P verified", "simulated", "alarms"
    print(" | ".join((*headings, "resolved", "information")))
    for name in [given.only] if given.only else CASES:
        design = case(name)
        begin = perf_counter()
        formulas, start, spent = examine(design.scene, design).evaluate(design), perf_counter(), process_time()
        scan = examine(design.scene, design, samples=given.tumours, unseen=True)
        performance = scan.evaluate(design)
        took, spent = perf_counter() - start, process_time() - spent
        simulation, alarms = compute_detection_rates(scan, design, given.scans)
        means, errors = performance.means, performance.errors
        stated = {kind: f"{mean:.3f} +- {errors[kind].total:.3f}" for kind, mean in means.items()}
        print(
            f"{name} | {start - begin:.1f} | {took:.1f} ({spent:.1f}) | {formulas.means['detection']:.3f} | "
            f"{stated['detection']} | {simulation:.3f} | {alarms:.3f} | {stated['resolved']} | {stated['information']}",
            flush=True,
        )
        if given.pictures is not None:
            slug = name.replace(" ", "-")
            draw_improvements(compute_improvements(design.scene, design), design.objective, given.pictures / f"{slug}-levers.png")


if __name__ == "__main__":
    main()
