"""Measure how often a calibration by predicted charges covers the truth, on virtual probes whose films are taped.

Each probe has a film of 28 to 110 um. Each of its bonds is tape of 25 to 130 um, glue of 20 um or rigid, at least one is tape.
The tape has 0.1 to 1 MPa, of which the drawing knows 0.3 MPa; scales of d, cross-talk and the blocks' moduli are off by their
tolerances. Charges are those of the solved probe. It is calibrated on a pin, a ring, both frictionless or stuck, and three
blocks of tissue, and then read over a tumour in tissue of 3 to 60 kPa. The ratio of charges is compared with that of films with
the drawing's d on the true bonds. `estimate` determines E_object from it, for the probe with the calibrated tape; its interval
is compared with the truth. Beside that stands the bias of calibrations that take a charge for d33 times the force: gains from
pin and ring, and gains from one block. Some films on soft tape that are glued to the block deliver charges of opposite signs;
such a probe has no ln ratio and is refused. Refusals are counted, and others are drawn in their place.

    python -m benchmarks.built_probe.film_calibration --count 1000 --workers 2

With `--output FILE`, outcomes are appended to a file, and those that are there are not computed again.

Duration: 25 minutes.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from time import perf_counter

import numpy as np

from geometry import Scene, read_scene
from geometry.common.arrays import Bools, Floats
from geometry.common.errors import Refusal
from geometry.scenes.film import Film
from probe_design.built_probe.bench import Bench, Reference, ReferenceContact, ReferenceForce, Workshop, read_builtin_bench
from probe_design.built_probe.block_predictions import (
    BlockPredictions,
    build_block_scene,
    compute_inner_fractions,
    express_by_outer_radius,
    predict_blocks,
    solve_block,
)
from probe_design.built_probe.calibration import fit_bonds
from probe_design.built_probe.gain_fit import estimate_gains
from probe_design.built_probe.gains import Gains, Observation
from probe_design.built_probe.reference_charges import compute_charge_units, scale_bonds
from probe_design.estimation.estimate import estimate
from probe_design.estimation.intervals import OPEN_INTERVAL
from probe_design.estimation.measurements import Reading
from solver.axisymmetric.converged_forces import Converged

SCENE = "examples/scene.toml"
LOAD, NOISE = 10e-3, 1.5e-5  # N: load, and noise of a film's reading of 10 s
DRAWN_TAPE, TAPES = 3e5, (1e5, 1e6)  # Pa: as drawn, and the range of the truth
FILMS, TAPE_SIZES = (28e-6, 110e-6), (25e-6, 130e-6)  # m: thicknesses of films and of tapes
GLUE = "epoxy-20um"  # of the catalogue
SIDES = ("bond_to_base", "bond_to_block")
STACKS = (("tape", "tape"), ("tape", "rigid"), ("rigid", "tape"), ("tape", GLUE), (GLUE, "tape"))  # by ``SIDES``
TISSUES, CONTRASTS = (3e3, 60e3), (2.0, 30.0)  # Pa; the tumour's modulus over the tissue's
BLOCKS = (12e3, 3e3, 60e3)  # Pa: of the reference blocks
REFUSED_KEY = "probe.film"  # of the refusal where charges on a block have opposite signs
QUANTILE = 1.959964  # of a 95 % interval
MIN_P_VALUE = 0.001


@dataclass(frozen=True)
class Outcome:
    """One virtual probe: errors of ln ratio over their standard deviations, and biases of calibrations by forces.

    Attributes
    ----------
    sides
        The bonds towards base and block.
    z_ratio
        Of the calibrated ratio of charges.
    covered
        Whether the interval of `estimate` holds the true E_object.
    identifiable
        Whether that interval is bounded, as `estimate` says.
    sd_ratio, sd_log_object
        Standard deviations of ln ratio and, by the log-sensitivity, of ln E_object.
    z_bonds
        Of ln of the tape's modulus.
    by_pins, by_blocks
        Error of ln ratio by gains from pin and ring, and by gains from the middle block of tissue.
    p_value
        Of the fit.
    """

    sides: str
    z_ratio: float
    covered: bool
    identifiable: bool
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
        film_piezo=0.0,
    )
    force = ReferenceForce(sensitivity=0.1, verified=True)
    return read_builtin_bench().model_copy(update={"reference": (*pins, *blocks), "workshop": exact, "force": force})


def draw_scene(random: np.random.Generator) -> tuple[Scene, float, str]:
    """Draw a scene, its bonds as in the drawing, ln of the factor on the tape's modulus, and the bonds towards base and block."""
    film, tape, tissue, contrast, true_tape = (
        float(np.exp(random.uniform(*np.log(ends)))) for ends in (FILMS, TAPE_SIZES, TISSUES, CONTRASTS, TAPES)
    )
    bonds = {"tape": {"thickness": tape, "youngs_modulus": DRAWN_TAPE, "poisson_ratio": 0.49}, GLUE: GLUE, "rigid": "rigid"}
    kinds, scene = STACKS[random.integers(len(STACKS))], read_scene(SCENE)
    stack = Film.model_validate({"thickness": film} | {side: bonds[kind] for side, kind in zip(SIDES, kinds, strict=True)})
    scene = scene.model_copy(update={"probe": scene.probe.model_copy(update={"film": stack})})
    moduli = {"tissue.youngs_modulus": tissue, "inclusion.youngs_modulus": tissue * contrast}
    scene = express_by_outer_radius(scene.replace({**moduli, "load.force": 0.0}))
    return scene, float(np.log(true_tape / DRAWN_TAPE)), " and ".join(kinds)


def calibrate(scene: Scene, bench: Bench, films: Floats, forces: Floats, predictions: BlockPredictions) -> Gains:
    """Return the calibration by readings on all references: of both films, N, shape (references, 2), and of the load, N.

    ``predictions`` are those with which the fit starts.
    """
    covariance = NOISE**2 * np.eye(2)
    observations = [
        Observation(reference, reading, covariance, float(force), NOISE)
        for reference, reading, force in zip(bench.reference, films, forces, strict=True)
    ]

    def fit(predictions: BlockPredictions) -> tuple[Gains, None]:
        """Return the gains for predictions."""
        pairs = zip(observations, predictions.load_factors, strict=True)
        return estimate_gains([replace(item, load_factor=factor) for item, factor in pairs], predictions, bench), None

    return fit_bonds(scene, bench.reference, predictions, fit)[0]


def press(bench: Bench, predictions: BlockPredictions, random: np.random.Generator) -> Floats:
    """Return both films' readings per load on references whose moduli are drawn from their tolerance, shape (references, 2)."""
    log_moduli = np.array([item.tolerance * random.standard_normal() * (item.on == "tissue") for item in bench.reference])
    blocks = zip(predictions.blocks, log_moduli[[item.on == "tissue" for item in bench.reference]], strict=True)
    fractions = compute_inner_fractions(
        np.array([block.log_ratio + block.modulus_derivative * change for block, change in blocks]), bench.reference
    )
    # the last of the variables is one change of all blocks' moduli
    sums = [
        factor.log + factor.derivatives[-1] * change for factor, change in zip(predictions.load_factors, log_moduli, strict=True)
    ]
    return np.stack([fractions, 1 - fractions], axis=1) * np.exp(sums)[:, None]


def measure(seed: int, *, as_drawn: bool = False) -> Outcome:
    """Build, calibrate and read one virtual probe; ``as_drawn``: the fit starts from the drawing's bonds."""
    random = np.random.default_rng([7, seed])
    scene, log_bonds, sides = draw_scene(random)
    bench = build_bench("stuck" if random.random() < 0.5 else "frictionless")
    unit, built = compute_charge_units(scene), scale_bonds(scene, log_bonds)
    matrix = np.eye(2) + 0.05 * np.diag(random.standard_normal(2)) + 0.01 * (1 - np.eye(2)) * random.standard_normal((2, 2))
    # where the fit ends does not depend on where it starts: from the drawing, or, in half the time, from the bonds as built
    start = predict_blocks(scene, bench.reference, log_bonds, variables=(), limit_loads=False)
    true_films = press(bench, start, random)
    scale = 1 + 0.005 * random.standard_normal()

    def read(charges: Floats) -> Floats:
        """Return noisy readings of both films, N, from their charges per load, C/N."""
        return LOAD * charges / unit @ matrix.T + NOISE * random.standard_normal(charges.shape)

    films = read(true_films * unit)
    first = predict_blocks(scene, bench.reference, variables=(), limit_loads=False) if as_drawn else start
    gains = calibrate(scene, bench, films, scale * LOAD + NOISE * random.standard_normal(len(films)), first)
    assert gains.bonds is not None
    solved, charges, true_log = solve_block(built)
    reading = read(charges.totals / solved.films[0].totals.sum())
    forces = gains.compute_forces(reading)
    log_read, log_forces = float(np.log(forces[0] / forces[1])), _compute_log_forces(solved)
    # d ln (f_inner / f_outer); without the bonds' column for the ratio itself
    derivatives = np.array([1.0, -1.0]) / forces @ gains.differentiate_by_entries(reading)
    noise = float(np.sum((np.array([1.0, -1.0]) / forces @ np.linalg.inv(gains.matrix)) ** 2)) * NOISE**2
    ratio_derivatives = derivatives * (np.arange(len(derivatives)) < 4)
    sd_ratio, sd_read = (float(np.sqrt(row @ gains.covariance @ row + noise)) for row in (ratio_derivatives, derivatives))
    ratio = float(np.exp(log_read)) * scene.probe.outer_area / scene.probe.inner_area
    estimated = estimate(scale_bonds(scene, gains.bonds.log_factor), (Reading(0.0, 0.0, ratio, sd_read),))
    low, high = estimated.interval
    is_explained = estimated.strength_interval != OPEN_INTERVAL  # open where no E_object agrees with the reading
    first_block = solve_block(build_block_scene(express_by_outer_radius(built), bench.blocks[0]))[0]
    log_reading = float(np.log(reading[0] / reading[1])) - log_forces
    return Outcome(
        sides=sides,
        z_ratio=(log_read - true_log) / sd_ratio,
        covered=is_explained and (low or 0.0) <= scene.inclusion[0].youngs_modulus <= (high or np.inf),
        identifiable=estimated.identifiable,
        sd_ratio=sd_ratio,
        sd_log_object=sd_read / abs(charges.log_sensitivity or np.nan),
        z_bonds=float((gains.bonds.log_factor - log_bonds) / np.sqrt(gains.covariance[4, 4])),
        by_pins=log_reading - float(np.log(films[0, 0] / films[1, 1])),
        by_blocks=log_reading - float(np.log(films[2, 0] / films[2, 1]) - _compute_log_forces(first_block)),
        p_value=gains.p_value,
    )


def _compute_log_forces(solved: Converged) -> float:
    """Return ln of the ratio of the films' forces."""
    return float(np.log(np.divide(*solved.films[0].totals)))


def compute_coverage(covered: Bools) -> tuple[float, float]:
    """Return the fraction of probes within their 95 % intervals, and the p-value of the exact binomial test against 95 %."""
    from scipy.stats import binomtest

    return float(np.mean(covered)), float(binomtest(int(np.sum(covered)), len(covered), 0.95).pvalue)


def print_outcomes(outcomes: list[Outcome]) -> bool:
    """Print coverage and biases; return whether both coverages are as stated."""
    columns = {name: np.array([getattr(item, name) for item in outcomes]) for name in vars(outcomes[0])}
    good = True
    for name, label in (("z_ratio", "ratio of charges"), ("covered", "E_object"), ("z_bonds", "tape's modulus")):
        covered = columns[name] if name == "covered" else np.abs(columns[name]) <= QUANTILE
        coverage, p_value = compute_coverage(covered)
        good = good and (name == "z_bonds" or p_value > MIN_P_VALUE)
        print(f"{label}: {int(covered.sum())} of {len(covered)} ({100 * coverage:.1f} %) in 95 % intervals, p = {p_value:.2g}")
    for sides in sorted(set(columns["sides"])):
        chosen = columns["sides"] == sides
        ratios, objects = np.abs(columns["z_ratio"][chosen]) <= QUANTILE, columns["covered"][chosen]
        text = f"ratio {100 * np.mean(ratios):.1f} %, E_object {100 * np.mean(objects):.1f} %"
        print(f"  {sides} towards base and block: {chosen.sum()} probes, {text}")
    print(f"sd of the ratio, %: median {100 * np.median(columns['sd_ratio']):.2f}")
    bounded = f"bounded intervals: {columns['identifiable'].sum()}"
    print(f"sd of ln E_object: median {np.median(columns['sd_log_object']):.2g}; {bounded}")
    print(f"fits with p < 0.001: {np.mean(columns['p_value'] < MIN_P_VALUE):.3f}")
    for name, label in (("by_pins", "pin and ring"), ("by_blocks", "a block of tissue")):
        error = 100 * np.expm1(columns[name])
        low, middle, high = np.quantile(error, [0.05, 0.5, 0.95])
        text = f"median {middle:+.1f}, 5 to 95 % of probes {low:+.1f} to {high:+.1f}, root mean square "
        text += f"{np.sqrt(np.mean(error**2)):.1f}"
        print(f"error of the ratio by gains alone, from {label}, %: {text}")
    return good


def measure_or_refuse(seed: int) -> Outcome | None:
    """Return the outcome of a virtual probe, or None where its prediction is refused."""
    try:
        return measure(seed)
    except Refusal as refusal:
        if refusal.key != REFUSED_KEY:
            raise
        return None


def iterate_outcomes(seeds: list[int], workers: int) -> Iterator[tuple[int, Outcome | None]]:
    """Yield each seed with its outcome, computed by this process or by several."""
    if workers == 1:
        yield from zip(seeds, map(measure_or_refuse, seeds), strict=True)
        return
    with ProcessPoolExecutor(workers) as pool:
        yield from zip(seeds, pool.map(measure_or_refuse, seeds, chunksize=4), strict=True)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--first", type=int, default=0, help="seed of the first probe")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--output", type=Path, help="file of outcomes, one a line, to which new ones are appended")
    options = parser.parse_args()
    start, computed, stop = perf_counter(), 0, options.first + options.count
    lines = options.output.read_text().splitlines() if options.output and options.output.exists() else []
    saved = map(json.loads, lines)
    outcomes = {item["seed"]: item["outcome"] and Outcome(**item["outcome"]) for item in saved}
    while True:
        missing = [seed for seed in range(options.first, stop) if seed not in outcomes]
        computed += len(missing)
        for seed, outcome in iterate_outcomes(missing, options.workers):
            outcomes[seed] = outcome
            if options.output:
                with options.output.open("a") as file:
                    file.write(json.dumps({"seed": seed, "outcome": outcome and asdict(outcome)}) + "\n")
        measured = [outcome for seed in range(options.first, stop) if (outcome := outcomes[seed])]
        if len(measured) >= options.count:
            break
        stop += options.count - len(measured)
    print(f"refused, as the films' charges have opposite signs: {stop - options.first - len(measured)}")
    good = print_outcomes(measured)
    print(f"{(perf_counter() - start) / max(computed, 1):.2f} s a probe")
    if not good:
        raise SystemExit(1)


if __name__ == "__main__":
    main()
