"""What a bench does wrong in a calibration, and what then comes of a reading: `nice python -m benchmarks.built_probe.careless`.

Calibrations of the virtual probe as drawn under 10 mN, each with one fault: pin or ring that touch the other block, a force
channel with play, a filter, a delay. A row counts how many of them were refused or warned of; of those that were not refused, the
largest error of a gain or cross-talk, and the root mean square error of the ratio that is then read on the scene, both over
their stated standard deviations; and the ratio's standard deviation. ``--leak 0`` takes pin and ring as perfect.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from geometry import Scene, read_scene
from geometry.common.arrays import Floats
from geometry.common.errors import InputError
from hw.common.errors import HardwareError
from hw.common.samples import Samples
from probe_design.built_probe.bench import Bench, builtin_bench
from probe_design.built_probe.block_predictions import Shares, by_outer_radius, inner_shares, predicted
from probe_design.built_probe.calibration import calibrate
from probe_design.built_probe.gain_matrix import Gains
from probe_design.built_probe.virtual_probe import RATE, Built, signals

SCENE = "examples/scene.toml"
LOAD, SECONDS = 10e-3, 10.0  # N, s
RATIO = 0.676  # force on the inner film over that on the outer, of the reading on the scene

Change = Callable[[Floats], Floats]


@dataclass(frozen=True)
class Carelessness:
    """One fault: what share of its load pin and ring put on the other block, and what becomes of the force channel's volts."""

    pin: float = 0.0
    ring: float = 0.0
    force: Change | None = None


@dataclass(frozen=True)
class CarelessOutcome:
    """What came of one calibration: refused or warned of, the gains' errors and the ratio's over their standard deviations."""

    refused: str = ""
    warned: bool = False
    gains: float = 0.0
    ratio: float = 0.0
    stated: float = 0.0


def played(half_width: float) -> Change:
    """Return what play of this share of the amplitude does: the output stays until the input has gone through it."""

    def change(volts: Floats) -> Floats:
        width, at, out = half_width * np.ptp(volts) / 2, float(volts[0]), []
        for one in volts.tolist():
            at = min(max(at, one - width), one + width)
            out.append(at)
        return np.array(out)

    return change


def filtered(seconds: float) -> Change:
    """Return a low-pass of first order of this time constant."""
    keep = float(np.exp(-1 / (RATE * seconds)))
    return lambda volts: np.asarray(lfilter([1 - keep], [1, -keep], volts, zi=[keep * volts[0]])[0])


CARELESS = {
    "none": Carelessness(),
    "ring leaks 1 %": Carelessness(ring=0.01),
    "ring leaks 3 %": Carelessness(ring=0.03),
    "pin leaks 1 %": Carelessness(pin=0.01),
    "pin leaks 3 %": Carelessness(pin=0.03),
    "force channel with play of 1 %": Carelessness(force=played(0.01)),
    "with play of 2 %": Carelessness(force=played(0.02)),
    "with play of 5 %": Carelessness(force=played(0.05)),
    "filtered by 2 ms": Carelessness(force=filtered(0.002)),
    "filtered by 5 ms": Carelessness(force=filtered(0.005)),
    "filtered by 10 ms": Carelessness(force=filtered(0.01)),
    "one sample late": Carelessness(force=lambda volts: np.roll(volts, 1)),
}


def read_carelessly(fault: Carelessness, scene: Scene, bench: Bench, shares: Shares, seed: int) -> list[Samples]:
    """Return one reading on each reference."""
    parts = inner_shares(shares.log_ratios, bench.reference)
    parts = parts + [{"inner": -fault.pin, "outer": fault.ring}.get(one.on, 0.0) for one in bench.reference]
    times, found = np.arange(round(SECONDS * RATE)) / RATE, []
    for k, part in enumerate(parts):
        volts = signals(Built(), bench, scene, LOAD * np.array([part, 1 - part]), [seed, k])(times)
        if fault.force is not None:
            volts[:, 2] = fault.force(volts[:, 2])
        none = np.zeros(volts.shape, bool)
        names = ("inner", "outer", "force")
        found.append(Samples(RATE, names, np.arange(len(times)), volts, saturated=none, gaps=(), overruns=0, source={}))
    return found


def outcome(fault: Carelessness, scene: Scene, bench: Bench, shares: Shares, seed: int) -> CarelessOutcome:
    """Calibrate with a fault, then read the scene without noise."""
    try:
        found = calibrate(scene, bench, read_carelessly(fault, scene, bench, shares, seed), shares)
    except (HardwareError, InputError) as why:
        return CarelessOutcome(refused=str(why))
    truth = _matrix(bench)
    gains = (found.gains.matrix - truth).ravel() / np.sqrt(np.diag(found.gains.covariance))
    off, spread = _ratio(found.gains, truth)
    return CarelessOutcome(warned=bool(found.warnings), gains=float(np.abs(gains).max()), ratio=off / spread, stated=spread)


def _matrix(bench: Bench) -> Floats:
    """The true M, amplifiers included."""
    nominal, frequency = bench.amplifier.of_films(), Built().frequency * bench.load.frequency
    pairs = zip(Built().amplifiers(nominal), nominal, strict=True)
    return np.array([[abs(one.response(frequency) / drawn.response(frequency))] for one, drawn in pairs]) * Built().gains


def _ratio(gains: Gains, truth: Floats) -> tuple[float, float]:
    """By how much ln of the ratio on the scene is off, and its stated standard deviation."""
    films = truth @ (LOAD * np.array([RATIO, 1.0]) / (1 + RATIO))
    forces = gains.forces(films)
    slopes = np.array([1.0, -1.0]) / forces
    spread = np.sqrt(slopes @ gains.forces_covariance(films, np.zeros((2, 2))) @ slopes)
    return float(np.log(forces[0] / forces[1] / RATIO)), float(spread)


def row(name: str, outcomes: list[CarelessOutcome]) -> str:
    """Return a fault's line."""
    told = [one for one in outcomes if not one.refused]
    counts = f"{name:32} {len(outcomes) - len(told):7d} {sum(one.warned for one in told):6d}"
    if not told:
        return f"{counts} {'-':>9} {'-':>9} {'-':>9}  {outcomes[-1].refused[:90]}"
    rms, stated = np.sqrt(np.mean([one.ratio**2 for one in told])), 100 * np.mean([one.stated for one in told])
    return f"{counts} {max(one.gains for one in told):9.2f} {rms:9.2f} {stated:7.2f} %"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--draws", type=int, default=10)
    parser.add_argument("--leak", type=float, help="of pin and ring, in place of the bench's")
    parser.add_argument("--only", default="", help="faults whose names hold this")
    asked = parser.parse_args()
    scene, bench = by_outer_radius(read_scene(SCENE)), builtin_bench()
    if asked.leak is not None:
        kept = [one if one.on == "tissue" else one.model_copy(update={"leak": asked.leak}) for one in bench.reference]
        bench = bench.model_copy(update={"reference": tuple(kept)})
    shares = predicted(scene, bench.reference)
    print(f"{'':32} refused warned  gain, z  ratio, z ratio, sd")
    for name, fault in CARELESS.items():
        if asked.only in name:
            print(row(name, [outcome(fault, scene, bench, shares, seed) for seed in range(asked.draws)]), flush=True)


if __name__ == "__main__":
    main()
