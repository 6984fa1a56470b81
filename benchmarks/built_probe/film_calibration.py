"""Measure how often a calibration by predicted charges covers the truth, on virtual probes whose films are taped.

Each probe has a film of 28 to 110 um on tape of 0.1 to 1 MPa, towards the base or on both sides, of which its drawing knows 0.3
MPa; scales of d, cross-talk and the blocks' moduli are off by their tolerances. Charges are those of the solved probe. It is
calibrated on a pin, a ring, both frictionless or stuck, and three blocks of tissue, and then read over a tumour in tissue of 3
to 60 kPa. The ratio of charges is compared with that of films with the drawing's d on the true tape, and E_object by the ratio
that is predicted at its true value with the calibrated tape: as ratios rise or fall with E_object, its 95 % interval covers the
truth where the ratio's does. Beside that stands the bias of calibrations that take a charge for d33 times the force: gains from
pin and ring, and gains from the blocks.

    python -m benchmarks.built_probe.film_calibration --count 1000 --workers 2

Duration: 15 minutes.
"""

from __future__ import annotations

import argparse
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from time import perf_counter

import numpy as np

from geometry import Scene, read_scene
from geometry.common.arrays import Floats
from geometry.scenes.film import Film
from probe_design.built_probe.bench import Bench, Reference, ReferenceContact, ReferenceForce, Workshop, read_builtin_bench
from probe_design.built_probe.block_predictions import (
    BlockPredictions,
    express_by_outer_radius,
    predict_blocks,
    solve_block,
)
from probe_design.built_probe.calibration import fit_bonds
from probe_design.built_probe.gain_fit import estimate_gains
from probe_design.built_probe.gains import Gains, Observation
from probe_design.built_probe.reference_charges import compute_charge_unit, scale_bonds
from probe_design.built_probe.virtual_probe import VirtualBench, draw_delivered

SCENE = "examples/scene.toml"
LOAD, NOISE = 10e-3, 1.5e-5  # N: load, and noise of a film's reading of 10 s
DRAWN_TAPE, TAPES = 3e5, (1e5, 1e6)  # Pa: as drawn, and the range of the truth
FILMS, BOND_SIZES = (28e-6, 110e-6), (25e-6, 130e-6)  # m: thicknesses of films and of tapes
TISSUES, CONTRASTS = (3e3, 60e3), (2.0, 30.0)  # Pa; the tumour's modulus over the tissue's
BLOCKS = (3e3, 12e3, 60e3)  # Pa: of the reference blocks
QUANTILE = 1.959964  # of a 95 % interval
MIN_P_VALUE = 0.001


@dataclass(frozen=True)
class Outcome:
    """One virtual probe: errors of ln ratio over their standard deviations, and biases of calibrations by forces.

    Attributes
    ----------
    z_ratio, z_object
        Of the calibrated ratio of charges, and of that ratio from the prediction at the true E_object.
    sd_ratio, sd_log_object
        Standard deviations of ln ratio and, by the log-sensitivity, of ln E_object.
    z_bonds
        Of ln of the tape's modulus.
    by_pins, by_blocks
        Error of ln ratio by gains from pin and ring, and by gains from the blocks of tissue.
    p_value
        Of the fit.
    """

    z_ratio: float
    z_object: float
    sd_ratio: float
    sd_log_object: float
    z_bonds: float
    by_pins: float
    by_blocks: float
    p_value: float


def build_bench(contact: ReferenceContact) -> Bench:
    """Build a bench with a pin, a ring and three blocks, for a probe whose dimensions were measured."""
    blocks = [Reference(youngs_modulus=modulus) for modulus in BLOCKS]
    pins = [Reference(on="inner", contact=contact, leak=0.0), Reference(on="outer", contact=contact, leak=0.0)]
    exact = Workshop(
        length=1e-9,
        modulus=0.0,
        poisson_ratio=0.0,
        film_thickness=0.0,
        bond_thickness=0.0,
        film_modulus=0.0,
        film_poisson_ratio=0.0,
    )
    force = ReferenceForce(sensitivity=0.1, verified=True)
    return read_builtin_bench().model_copy(update={"reference": (*pins, *blocks), "workshop": exact, "force": force})


def draw_scene(random: np.random.Generator) -> tuple[Scene, float]:
    """Draw a scene, its tape as in the drawing, and ln of the factor on the tape's modulus."""
    film, tape, tissue, contrast, true_tape = (
        float(np.exp(random.uniform(*np.log(ends)))) for ends in (FILMS, BOND_SIZES, TISSUES, CONTRASTS, TAPES)
    )
    bond = {"thickness": tape, "youngs_modulus": DRAWN_TAPE, "poisson_ratio": 0.49}
    sides = ("bond_to_base", "bond_to_block") if random.random() < 0.5 else ("bond_to_base",)
    scene = read_scene(SCENE)
    stack = Film.model_validate({"thickness": film} | dict.fromkeys(sides, bond))
    scene = scene.model_copy(update={"probe": scene.probe.model_copy(update={"film": stack})})
    moduli = {"tissue.youngs_modulus": tissue, "inclusion.youngs_modulus": tissue * contrast}
    return express_by_outer_radius(scene.replace({**moduli, "load.force": LOAD})), float(np.log(true_tape / DRAWN_TAPE))


def calibrate(scene: Scene, bench: Bench, films: Floats, forces: Floats) -> Gains:
    """Return the calibration by readings on all references: of both films, N, shape (references, 2), and of the load, N."""
    covariance = NOISE**2 * np.eye(2)
    observations = [
        Observation(reference, reading, covariance, float(force), NOISE)
        for reference, reading, force in zip(bench.reference, films, forces, strict=True)
    ]

    def fit(predictions: BlockPredictions) -> tuple[Gains, None]:
        """Return the gains for predictions."""
        pairs = zip(observations, predictions.load_factors, strict=True)
        return estimate_gains([replace(item, load_factor=factor) for item, factor in pairs], predictions, bench), None

    return fit_bonds(scene, bench.reference, predict_blocks(scene, bench.reference, differentiate=False), fit)[0]


def measure(seed: int) -> Outcome:
    """Build, calibrate and read one virtual probe."""
    random = np.random.default_rng([7, seed])
    scene, log_bonds = draw_scene(random)
    bench = build_bench("stuck" if random.random() < 0.5 else "frictionless")
    unit = compute_charge_unit(scene)
    virtual = VirtualBench(scene, scene, bench, log_bonds=log_bonds)
    matrix = np.eye(2) + 0.05 * np.diag(random.standard_normal(2)) + 0.01 * (1 - np.eye(2)) * random.standard_normal((2, 2))
    delivered = [draw_delivered(item, random) for item in bench.reference]
    true_films, true_forces = virtual.compute_film_readings(delivered), virtual.compute_film_forces(delivered)
    scale = 1 + 0.005 * random.standard_normal()

    def read(per_load: Floats) -> Floats:
        """Return noisy readings of both films under the load, N."""
        return LOAD * per_load @ matrix.T + NOISE * random.standard_normal(per_load.shape)

    films = read(true_films)
    gains = calibrate(scene, bench, films, scale * LOAD + NOISE * random.standard_normal(len(films)))
    assert gains.bonds is not None
    built = virtual.as_built
    solved, charges, true_log = solve_block(built)
    reading = read(charges.totals / solved.films[0].totals.sum() / unit)
    forces = gains.compute_forces(reading)
    log_read, force_log = float(np.log(forces[0] / forces[1])), float(np.log(np.divide(*solved.films[0].totals)))
    _, predicted, predicted_log = solve_block(scale_bonds(scene, gains.bonds.log_factor))
    # d ln (f_inner / f_outer); without the bonds' column for the ratio itself
    derivatives = np.array([1.0, -1.0]) / forces @ gains.differentiate_by_entries(reading)
    noise = float(np.sum((np.array([1.0, -1.0]) / forces @ np.linalg.inv(gains.matrix)) ** 2)) * NOISE**2
    ratio_derivatives = derivatives * (np.arange(len(derivatives)) < 4)
    sd_ratio, sd_object = (np.sqrt(row @ gains.covariance @ row + noise) for row in (ratio_derivatives, derivatives))
    sd_object = np.hypot(sd_object, predicted.bound.log_ratio / np.sqrt(3))
    log_films = np.log(films[2:, 0] / films[2:, 1]) - np.log(true_forces[2:, 0] / true_forces[2:, 1])
    log_reading = float(np.log(reading[0] / reading[1])) - force_log
    return Outcome(
        z_ratio=float((log_read - true_log) / sd_ratio),
        z_object=float((log_read - predicted_log) / sd_object),
        sd_ratio=float(sd_ratio),
        sd_log_object=float(sd_object / abs(predicted.log_sensitivity or np.nan)),
        z_bonds=float((gains.bonds.log_factor - log_bonds) / np.sqrt(gains.covariance[4, 4])),
        by_pins=log_reading - float(np.log(films[0, 0] / films[1, 1])),
        by_blocks=log_reading - float(log_films.mean()),
        p_value=gains.p_value,
    )


def compute_coverage(z: Floats) -> tuple[float, float]:
    """Return the fraction of probes within their 95 % intervals, and the p-value of the exact binomial test against 95 %."""
    from scipy.stats import binomtest

    within = int(np.sum(np.abs(z) <= QUANTILE))
    return within / len(z), float(binomtest(within, len(z), 0.95).pvalue)


def print_outcomes(outcomes: list[Outcome]) -> bool:
    """Print coverage and biases; return whether both coverages are as stated."""
    columns = {name: np.array([getattr(item, name) for item in outcomes]) for name in vars(outcomes[0])}
    good = True
    for name, label in (("z_ratio", "ratio of charges"), ("z_object", "E_object"), ("z_bonds", "tape's modulus")):
        coverage, p_value = compute_coverage(columns[name])
        good = good and (name == "z_bonds" or p_value > MIN_P_VALUE)
        spread = f"z {columns[name].mean():+.2f} ± {columns[name].std():.2f}"
        print(f"{label}: {100 * coverage:.1f} % of {len(outcomes)} within their 95 % intervals, p = {p_value:.2g}; {spread}")
    print(f"sd of the ratio, %: median {100 * np.median(columns['sd_ratio']):.2f}")
    print(f"sd of ln E_object: median {np.median(columns['sd_log_object']):.2g}")
    print(f"fits with p < 0.001: {np.mean(columns['p_value'] < MIN_P_VALUE):.3f}")
    for name, label in (("by_pins", "pin and ring"), ("by_blocks", "blocks of tissue")):
        error = 100 * np.expm1(columns[name])
        low, middle, high = np.quantile(error, [0.05, 0.5, 0.95])
        text = f"median {middle:+.1f}, 5 to 95 % of probes {low:+.1f} to {high:+.1f}, root mean square "
        text += f"{np.sqrt(np.mean(error**2)):.1f}"
        print(f"error of the ratio by gains alone, from {label}, %: {text}")
    return good


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--first", type=int, default=0, help="seed of the first probe")
    parser.add_argument("--workers", type=int, default=1)
    options = parser.parse_args()
    seeds, start = range(options.first, options.first + options.count), perf_counter()
    if options.workers > 1:
        with ProcessPoolExecutor(options.workers) as pool:
            outcomes = list(pool.map(partial(measure), seeds, chunksize=4))
    else:
        outcomes = [measure(seed) for seed in seeds]
    good = print_outcomes(outcomes)
    print(f"{(perf_counter() - start) / options.count:.2f} s a probe")
    if not good:
        raise SystemExit(1)


if __name__ == "__main__":
    main()
