"""Detection of the built-in population against force, of designs found for two forces, and simulated scans under load.

    python -m benchmarks.populations.loads [--found 0.025 0.3] [--forces 0.005 0.01 ...] [--scans 20000] [--samples 40]

A search is limited to each force of ``--found``, N. Each design found is then verified under each force that the limits allow it,
on the same tumours. Simulated scans under the force draw white noise, gains and the noise of
each charge, whose logarithms are taken without linearisation, and are read by the same detector.

Duration: ten minutes.
"""

from __future__ import annotations

import argparse
from functools import partial

import numpy as np
from rich.console import Console

from benchmarks.tables import MeasuredTable
from geometry.common.arrays import Floats
from geometry.common.errors import Refusal
from geometry.scenes.scene import Scene
from probe_design.design_search.loaded_pressing import press_design
from probe_design.design_search.population_study import PopulationStudy, optimize_for_population
from probe_design.populations.design_file import Design, read_builtin_design
from probe_design.populations.detection import Detector, compute_log_likelihood_ratio, whiten
from probe_design.populations.examination import Examination, examine
from probe_design.populations.noise import build_difference_noise, compute_film_charges
from probe_design.populations.population import ScenePopulation

FORCES_N = 0.005, 0.01, 0.025, 0.05, 0.1, 0.2, 0.3, 0.5, 1.0


def limit_force(design: Design, force: float) -> Design:
    """Return a design file whose largest force is another one, N."""
    return design.model_copy(update={"limits": design.limits.model_copy(update={"force": force})})


def simulate_errors(scan: Examination, design: Design, scans: int) -> Floats:
    """Return the errors of the ratios of scans less their baseline readings, by drawn charges, shape (scans, p)."""
    rng, noise, readings = np.random.default_rng(2024), design.noise, scan.readings
    places = np.vstack([np.exp(np.log(readings.blank).mean(axis=0)), readings.mean_forces])
    charges = compute_film_charges(scan.draw.scene, places)
    size = scans, len(charges)
    read = [np.abs(charges[:, film] + noise.charge * rng.standard_normal(size)) for film in (0, 1)]
    ratio = np.log(read[0] / read[1]) - np.log(charges[:, 0] / charges[:, 1])
    ratio += noise.white * rng.standard_normal(size) + np.sqrt(2) * noise.gain * rng.standard_normal((scans, 1))
    return np.asarray(ratio[:, 1:] - ratio[:, :1])


def compute_detection_rate(scan: Examination, design: Design, scans: int) -> float:
    """Return the fraction of simulated scans in which the detector detects the tumour, by the ratio alone."""
    scan = scan.select(np.arange(len(design.protocol.positions)), "ratio")
    blank = np.exp(np.log(scan.readings.blank).mean(axis=0))
    known = design.noise, design.protocol, scan.draw.scene, blank
    noise = build_difference_noise(*known, tumour_forces=scan.readings.mean_forces, channel_set="ratio")
    detector = Detector.train(scan.reference, noise.covariance, design.protocol.false_alarm)
    tumours = np.random.default_rng(7).integers(len(scan.draw), size=scans)
    readings = simulate_errors(scan, design, scans) + scan.readings.signal[tumours]
    statistic = compute_log_likelihood_ratio(detector.templates, whiten(detector.factor, readings))
    return float((statistic > detector.threshold).mean())


def verify_under(design: Design, scene: Scene, scans: int) -> tuple[float, float, float, float, str]:
    """Return the force, N, P, its error, that of simulated scans, and the evaluator of a design under its largest force."""
    population = ScenePopulation.from_scene(scene, design.population)
    study = PopulationStudy.from_design(design, lambda *_: None)
    tissues = population.draw_tumours(unseen=True).tissues
    loaded, pressed, pressed_tissues = press_design(study.objective.rule, scene, tissues)
    scan = examine(loaded, design, unseen=True, pressed=pressed_tissues)
    performance = scan.evaluate(design)
    plain = float(performance.values["detection"].mean())  # of the tumours that the simulated scans draw
    rate = compute_detection_rate(scan, design, scans) - plain
    mean, error = performance.means["detection"], performance.errors["detection"].total
    return pressed.force, mean, error, rate, scan.evaluator


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--forces", type=float, nargs="+", default=FORCES_N)
    parser.add_argument("--found", type=float, nargs="+", default=(0.025, 0.3))
    parser.add_argument("--scans", type=int, default=20_000)
    parser.add_argument("--samples", type=int, default=40)
    given = parser.parse_args()
    design = read_builtin_design()
    design = design.model_copy(update={"population": design.population.model_copy(update={"samples": given.samples})})
    columns = "design found at, N", "force, N", "detected of 100", "error of that", "simulated less P, of 100", "evaluator"
    table = MeasuredTable("detection of the built-in population against force", columns)
    for search_force in given.found:
        scene = optimize_for_population(limit_force(design, search_force), lambda *_: None).scene
        verify = partial(verify_under, scene=scene, scans=given.scans)
        for force in given.forces:
            try:
                reached, mean, error, rate, name = verify(limit_force(design, force))
            except Refusal as fault:
                table.note(f"{search_force:g} N, {force:g} N: {fault}")
                continue
            numbers = f"{reached:.3g}", f"{100 * mean:.1f}", f"{100 * error:.1f}", f"{100 * rate:+.1f}"
            print(search_force, force, *numbers, name, flush=True)
            table.add(f"{search_force:g}", *numbers, name)
            if reached < 0.99 * force:
                break  # more is not allowed
    table.print(Console(width=120))


if __name__ == "__main__":
    main()
