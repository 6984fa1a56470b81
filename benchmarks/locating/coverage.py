"""Measure how often the posterior of one tumour holds the truth, how true P(no tumour) is, and how many tumours are detected.

    nice python -m benchmarks.locating.coverage [--scans 600] [--settings narrow wide]

Scans are simulated by ``equivalent-inclusion`` with reflections, not by the tables that the inference uses, with white noise, a
gain common to scan and baseline reading and, for hand-held readings, a place that differs from the stated one by 0.5 mm along
each axis. Half of the scans hold a tumour drawn from the population. Settings: narrow and wide populations as in
``forward_model``, with the ratio alone and with the stiffness; hand-held; under a skin of 1 mm and 20 kPa; in a tissue whose
modulus, or whose skin, differs from scan to scan within a range that the design states. The detector is that
of ``optimize`` (eq. PO.4) on the same scans, with 512 tumours of the population; both thresholds are the 95 % quantile of the
scans without tumour.

Duration: 30 minutes.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from itertools import pairwise
from time import process_time
from typing import Any

import numpy as np
from rich.console import Console
from scipy.linalg import block_diag

from benchmarks.locating.forward_model import SCENE_TABLES, build_positions
from benchmarks.tables import MeasuredTable
from geometry import Scene
from geometry.common.arrays import Bools, Floats
from probe_design.locating.common_errors import CommonErrors
from probe_design.locating.forward_model import build_models
from probe_design.locating.inference import Posterior
from probe_design.locating.likelihood import Likelihood
from probe_design.locating.posterior import find_region, summarise
from probe_design.locating.prior import TumourPrior
from probe_design.locating.scan_data import ScanConditions, ScanData
from probe_design.populations.design_file import Design, design_from_dict
from probe_design.populations.detection import compute_log_likelihood_ratio, whiten
from probe_design.populations.population import ScenePopulation
from solver.equivalent_inclusion.evaluator import EquivalentInclusion
from solver.equivalent_inclusion.readings import compute_readings
from solver.inclusions.tumours import Tumours

QUANTITIES = ("x", "y", "depth", "diameter", "ln_contrast")
NARROW = {"depth": ["8 mm", "20 mm"], "diameter": ["5 mm", "12 mm"], "object": ["16 kPa", "32 kPa"]}
COMMON = {"x": ["-16 mm", "16 mm"], "least_cover": "2 mm", "tumours": 1}
WIDE = {"depth": ["5 mm", "25 mm"], "diameter": ["4 mm", "16 mm"], "object": ["8 kPa", "160 kPa"]}
SKIN = {"thickness": "1 mm", "youngs_modulus": "20 kPa", "poisson_ratio": 0.45}
UNKNOWN_SKIN = {"thickness": ["0.8 mm", "1.25 mm"], "modulus": ["10 kPa", "40 kPa"]}
TISSUES = 12  # different ones, where the tissue is not known
SETTINGS: dict[str, tuple[dict[str, Any], bool, float, dict[str, Any]]] = {  # population, stiffness, pose error in m, tissue
    "narrow": (NARROW, False, 0.0, {}),
    "wide": (WIDE, True, 0.0, {}),
    "hand-held": (WIDE, True, 0.5e-3, {}),
    "under a skin": (NARROW, True, 0.0, {"layer": [SKIN]}),
    "unknown tissue": (NARROW | {"tissue": ["4 kPa", "7 kPa"]}, True, 0.0, {}),
    "unknown skin": (NARROW | {"layer": [UNKNOWN_SKIN]}, True, 0.0, {"layer": [SKIN]}),
}
WHITE, GAIN = np.array([0.01, 0.03]), np.array([0.0707, 0.05])  # of ln ratio and ln stiffness
BINS = (0.0, 0.1, 0.3, 0.5, 0.7, 0.85, 1.0)  # of P(no tumour)
FALSE_ALARM, TEMPLATES = 0.05, 512
SEED = 39


@dataclass
class Outcome:
    """What came of the scans of one setting.

    Attributes
    ----------
    covered
        Whether each quantity's 90 % interval, and the region of the place, held the truth, of scans with a tumour.
    none
        P(no tumour) of all scans.
    statistic
        Ln Lambda of the detector of ``optimize``, of all scans.
    is_free
        Which scans hold no tumour.
    errors
        Distance of the median place from the truth, m, of scans with a tumour.
    seconds
        Of the processor, of each scan.
    """

    covered: list[list[bool]]
    none: list[float]
    statistic: list[float]
    is_free: list[bool]
    errors: list[float]
    seconds: list[float]


def simulate(scene: Scene, tumour: Floats, positions: Floats) -> Floats:
    """Return ln ratio and ln stiffness against tissue without tumours, by reflections, shape (k, 2)."""
    base = EquivalentInclusion().prepare(scene, 0.003)
    x, y, depth, diameter, modulus = np.repeat(tumour[:, None], len(positions), axis=1)
    columns = (x - positions[:, 0], y - positions[:, 1], depth, diameter, modulus)
    tumours = Tumours(*np.broadcast_arrays(*(part[:, None] for part in columns), 0.45))
    readings, blank = compute_readings(base, tumours, reflect=True), base.films.totals
    ratio = np.log(readings.totals[:, 0] / readings.totals[:, 1] / (blank[0] / blank[1]))
    return np.stack([ratio, np.log(readings.stiffness / blank.sum())], axis=-1)


def compute_blank(scene: Scene) -> Floats:
    """Return ln ratio, but for the areas, and ln stiffness without tumours, shape (2,)."""
    forces = EquivalentInclusion().prepare(scene, 0.003).films.totals
    return np.log([forces[0] / forces[1], forces.sum()])


def draw_tissues(design: Design) -> list[Scene]:
    """Return tissues of the population, without tumours."""
    population = ScenePopulation.from_scene(design.scene, design.population)
    fractions = np.random.default_rng(SEED).permuted(np.tile((np.arange(TISSUES) + 0.5) / TISSUES, (3, 1)), axis=1)
    rows = {
        key: population.ranges[key].compute_quantiles(row)
        for key, row in zip(population.tissue_parameters, fractions, strict=False)
    }
    return [population.build_tissue_scene({key: float(row[index]) for key, row in rows.items()}) for index in range(TISSUES)]


def run(name: str, scans: int) -> Outcome:
    """Simulate and locate the scans of a setting, the first half with a tumour."""
    population, has_stiffness, pose, extra = SETTINGS[name]
    tables = SCENE_TABLES | {"tissue": SCENE_TABLES["tissue"] | extra}
    design = design_from_dict({"scene": tables, "population": population | COMMON})
    scene = design.scene.model_copy(update={"inclusion": ()})
    grid, rng = build_positions(), np.random.default_rng((SEED, list(SETTINGS).index(name)))
    places, k = np.vstack([[30e-3, 0.0], grid]), len(grid) + 1
    prior, conditions = TumourPrior.from_design(design, grid), ScanConditions.from_design(design)
    tissues, free = draw_tissues(design) if conditions.middles else [scene], conditions.loads.main
    known = [index for index, name in enumerate(conditions.errors.names) if not name.startswith("ln_gain")]
    errors = CommonErrors.from_channels("ln_gain", GAIN).join(conditions.errors.select(known))
    models = build_models(prior, conditions.loads.scenes)
    tumours = prior.transform(rng.random((2 * scans, 1, 5)))
    tumours = tumours[prior.find_allowed(tumours)][:scans]  # a skin leaves no room for some
    variance = np.tile(np.where([True, has_stiffness], WHITE**2, np.inf), (k, 1))
    channels = [0, 1] if has_stiffness else [0]
    covariance = block_diag(*(WHITE[c] ** 2 * np.eye(k) + GAIN[c] ** 2 for c in channels))
    factor = np.linalg.cholesky(covariance)

    def stack(values: Floats) -> Floats:
        """Return readings (n, k, 2) channel by channel."""
        return np.concatenate([values[:, :, channel] for channel in channels], axis=1)

    drawn = prior.transform(prior.draw(TEMPLATES, 1, 2))
    drawn = drawn[prior.find_allowed(drawn)]
    signals = np.zeros((len(drawn), k, 2))
    signals[:, 1:] = models[0].predict(drawn, grid)
    templates = whiten(factor, stack(signals))
    outcome = Outcome([], [], [], [], [], [])
    for index in range(scans):
        is_free = index % 2 == 1
        tissue = tissues[index % len(tissues)]
        values = np.tile(compute_blank(tissue) - compute_blank(free.scene), (k, 1))
        if not is_free:
            values[1:] += simulate(tissue, tumours[index, 0], grid + pose * rng.standard_normal(grid.shape))
        values += GAIN * rng.standard_normal(2) + WHITE * rng.standard_normal((k, 2))
        values[:, [c for c in range(2) if c not in channels]] = 0.0
        data = ScanData(places, values, variance, np.full((k, 2), pose), np.arange(k) == 0, errors)
        start = process_time()
        posterior = Posterior.from_likelihood(Likelihood(data, models, prior), index)
        outcome.seconds.append(process_time() - start)
        outcome.none.append(float(posterior.probability[0]))
        outcome.is_free.append(is_free)
        outcome.statistic.append(float(compute_log_likelihood_ratio(templates, whiten(factor, stack(values[None])))[0]))
        if not is_free:
            sample, truth = posterior.samples[0], dict(zip(QUANTITIES, tumours[index, 0], strict=True))
            truth["ln_contrast"] = float(prior.compute_contrast(tumours[index, 0]))
            found = summarise(prior, sample)[0]
            held = [found[key].interval_90[0] <= truth[key] <= found[key].interval_90[1] for key in QUANTITIES]
            region = find_region(prior, sample.points[:, 0], sample.weights)
            outcome.covered.append([*held, region.contains(truth["x"], truth["y"])])
            outcome.errors.append(float(np.hypot(found["x"].median - truth["x"], found["y"].median - truth["y"])))
    return outcome


def detect(statistic: Floats, is_free: Bools) -> float:
    """Return the fraction of scans with a tumour above the quantile of those without."""
    return float(np.mean(statistic[~is_free] > np.quantile(statistic[is_free], 1 - FALSE_ALARM)))


def main() -> None:
    """Print all tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scans", type=int, default=600)
    parser.add_argument("--settings", nargs="*", choices=list(SETTINGS), default=list(SETTINGS))
    arguments = parser.parse_args()
    console = Console()
    coverage = MeasuredTable("90 % intervals that hold the truth", ("setting", "scans", *QUANTITIES, "region of the place"))
    detection = MeasuredTable(
        "Detected at 5 % false alarms, and place of the detected",
        ("setting", "locate", "optimize", "median, mm", "90 %, mm", "scan, s"),
    )
    bins = MeasuredTable("P(no tumour), all these settings", ("stated", "scans", "true", "two standard deviations"))
    none: list[float] = []
    is_free: list[bool] = []
    for name in arguments.settings:
        outcome = run(name, arguments.scans)
        held = np.array(outcome.covered)
        coverage.add(name, len(held), *(f"{value:.2f}" for value in held.mean(axis=0)))
        free, evidence = np.array(outcome.is_free), -np.log(np.maximum(outcome.none, 1e-300))
        detected = evidence[~free] > np.quantile(evidence[free], 1 - FALSE_ALARM)
        errors = 1e3 * np.array(outcome.errors)[detected]
        rates = (detect(evidence, free), detect(np.array(outcome.statistic), free))
        detection.add(
            name, *(f"{rate:.3f}" for rate in rates), f"{np.median(errors):.2f}", f"{np.quantile(errors, 0.9):.1f}",
            float(np.median(outcome.seconds)),
        )  # fmt: skip
        none, is_free = none + outcome.none, is_free + outcome.is_free
        for table in (coverage, detection):
            table.print(console)
    stated, free = np.array(none), np.array(is_free)
    for low, high in pairwise(BINS):
        chosen = (stated >= low) & (stated <= high)
        if chosen.any():
            fraction, count = float(free[chosen].mean()), int(chosen.sum())
            spread = 2 * np.sqrt(fraction * (1 - fraction) / count)
            bins.add(f"{stated[chosen].mean():.2f}", count, f"{fraction:.2f}", f"{spread:.2f}")
    bins.print(console)


if __name__ == "__main__":
    main()
