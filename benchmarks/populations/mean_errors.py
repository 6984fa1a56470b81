"""Compare the stated error of a population's mean, for more and more tumours, with an independent Monte Carlo study.

Usage: ``python -m benchmarks.populations.mean_errors [--samples 40 80 200 400] [--tumours 400]``, from the repository's root.
The probe is the recommended design of the built-in run. The Monte Carlo has tumours of its own from numpy's generator, readings
by ``equivalent-inclusion`` at an accuracy of 1e-3 with all reflections, errors of each reading drawn part by part, and a detector
of its own: the likelihood ratio averaged over other tumours, its threshold from scans without a tumour.

Duration: ten minutes.
"""

from __future__ import annotations

import argparse

import numpy as np
from scipy.special import logsumexp

from geometry.common.arrays import Floats
from geometry.scenes.scene import Scene
from geometry.scenes.scene_tables import Load
from probe_design.populations.design_file import Design, read_builtin_design
from solver.equivalent_inclusion.evaluator import EquivalentInclusion
from solver.equivalent_inclusion.readings import compute_readings
from solver.inclusions.tumours import Tumours
from tests.support.designs import verify

OPTIMUM = {"probe.inner_radius": 6.26e-3, "probe.outer_radius": 8.37e-3, "probe.gap": 0.5e-3, "probe.height": 1.25e-3}
ACCURACY, SCANS, BLANKS = 1e-3, 400, 40_000


def optimum(design: Design) -> Scene:
    """Return the built-in scene with the recommended probe under its force."""
    probe = design.scene.probe.model_copy(update={"area_ratio": None, "outer_radius": OPTIMUM["probe.outer_radius"]})
    scene = design.scene.model_copy(update={"probe": probe, "load": Load(force=0.025)})
    return scene.replace(OPTIMUM | {f"probe.{name}.youngs_modulus": 1e6 for name in ("inner", "outer")})


def signals(scene: Scene, design: Design, count: int, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Draw tumours; return ln ratio over them at all positions less that without, (count, p), and film forces without, (2,)."""
    base = EquivalentInclusion().prepare(scene.model_copy(update={"inclusion": ()}), ACCURACY)
    p = design.population
    logs = [np.log(values.values) for values in (p.depth, p.diameter, p.object) if values is not None]
    kept = np.empty((0, 3))
    while len(kept) < count:
        drawn = np.exp(np.stack([rng.uniform(low, high, count) for low, high in logs], axis=1))
        kept = np.concatenate([kept, drawn[drawn[:, 0] - drawn[:, 1] / 2 >= p.least_cover]])[:count]
    x = rng.uniform(-4e-3, 4e-3, count)
    distances = np.abs(x[:, None] - design.protocol.places)
    depth, diameter, modulus = (np.repeat(values, distances.shape[1])[:, None] for values in kept.T)
    nu = scene.inclusion[0].poisson_ratio
    nothing = np.zeros((distances.size, 1))
    tumours = Tumours(distances.reshape(-1, 1), nothing, depth, diameter, modulus, nothing + nu)
    totals = compute_readings(base, tumours, 0, reflect=True).totals.reshape(*distances.shape, 2)
    return np.log(totals[..., 0] / totals[..., 1]) - np.log(base.films.totals[0] / base.films.totals[1]), base.films.totals


def monte_carlo(scene: Scene, design: Design, count: int) -> tuple[float, float]:
    """Return the detection and its standard error."""
    rng, p, noise = np.random.default_rng(7), len(design.protocol.positions), design.noise
    all_signals, films = signals(scene, design, 2 * count, rng)
    known, tried = all_signals[:count], all_signals[count:]
    charge = 20e-12 * films / films.sum() * (scene.load.force or 0.0)  # |d33| = 20 pC/N
    noise_sd = np.sqrt(noise.white**2 + ((noise.charge / charge) ** 2).sum())

    def scans(number: int) -> Floats:
        each = noise_sd * rng.standard_normal((number, p + 1)) + np.sqrt(2) * noise.gain * rng.standard_normal((number, 1))
        return np.asarray(each[:, :p] - each[:, p:])

    inverse = np.linalg.inv(noise_sd**2 * (np.eye(p) + np.ones((p, p))))

    def statistic(y: Floats) -> Floats:
        return np.asarray(logsumexp(y @ inverse @ known.T - ((known @ inverse) * known).sum(axis=1) / 2, axis=1))

    threshold = np.quantile(statistic(scans(BLANKS)), 1 - design.protocol.false_alarm)
    rates = np.array([(statistic(signal + scans(SCANS)) > threshold).mean() for signal in tried])
    return float(rates.mean()), float(rates.std(ddof=1) / np.sqrt(count))


def main() -> None:
    """Print a line for each number of tumours, and the Monte Carlo."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--samples", type=int, nargs="+", default=[40, 80, 200, 400])
    parser.add_argument("--tumours", type=int, default=400)
    given = parser.parse_args()
    design = read_builtin_design()
    scene = optimum(design)
    print("| tumours | detection | sampling error | model error | both |\n|---|---|---|---|---|")
    for samples in given.samples:
        verification = verify(scene, design, samples=samples)
        detection, error = verification.means["detection"], verification.errors["detection"]
        print(
            f"| {samples} | {detection:.3f} | {error.sampling:.4f} | {error.model:.4f} | {error.total:.4f} |",
            flush=True,
        )
    truth, spread = monte_carlo(scene, design, given.tumours)
    print(f"| independent, {given.tumours} | {truth:.3f} | {spread:.4f} | | |")


if __name__ == "__main__":
    main()
