"""Measure what a calibration and a later reading state after a mistake at the bench.

    nice python -m benchmarks.built_probe.bench_mistakes

Each draw is another probe on another bench: gains, cross-talk, amplifiers, force sensor, leaks, blocks, and by the predictions'
derivatives the probe's dimensions deviate by their tolerances. It is read under 10 mN with noise, hum and drift, calibrated,
and the gains then serve a reading on the scene without noise. A row is one fault, in all draws. It counts

* refused calibrations; those with a warning that a film lags; those with a warning about the fault;
* of the others, how many per cent of the true gains, of the ratios and of the films' sums of forces lie within 1.96 of their
  stated standard deviations: 95 is stated;
* the mean stated standard deviations of ratio and sum, %.

``--weight 0.01`` adds a weight to the bench: a pin reading whose load is known to 1 %.

Duration: minutes.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.signal import lfilter

from benchmarks.built_probe.counts import share
from geometry import Scene, read_scene
from geometry.common.arrays import Floats
from geometry.common.errors import InputError
from hw.common.errors import HardwareError
from hw.common.samples import Samples
from probe_design.built_probe.bench import Bench, read_builtin_bench
from probe_design.built_probe.block_predictions import (
    BlockPredictions,
    compute_inner_fractions,
    express_by_outer_radius,
    predict_blocks,
)
from probe_design.built_probe.calibration import calibrate
from probe_design.built_probe.film_forces import measure_strict_reading
from probe_design.built_probe.gains import Gains
from probe_design.built_probe.virtual_probe import SAMPLE_RATE_HZ, BuiltProperties, build_signals

SCENE = "examples/scene.toml"
LOAD, SECONDS = 10e-3, 5.0  # N, s
RATIO = 0.676  # force on the inner film over that on the outer, of the reading on the scene
HALF_WIDTH = 1.96  # standard deviations of an interval of 95 %

Change = Callable[[Floats], Floats]


@dataclass(frozen=True)
class BenchFault:
    """One fault of a bench.

    Attributes
    ----------
    pin, ring
        Share of its load that goes to the other block, in place of a drawn one.
    sensor
        Factor on the force sensor's sensitivity.
    clock
        True over stated sampling rate.
    channels
        What becomes of a channel's volts, by its column.
    frequency
        Nominal frequency of the load, Hz; None: the bench's.
    word
        That a warning about it holds.
    """

    pin: float | None = None
    ring: float | None = None
    sensor: float = 1.0
    clock: float = 1.0
    channels: dict[int, Change] = field(default_factory=dict)
    frequency: float | None = None
    word: str = "film lags"


@dataclass(frozen=True)
class CalibrationOutcome:
    """What came of one calibration: refused or warned of; by how many standard deviations gains, ratio and sum are off."""

    refused: str = ""
    lags: bool = False
    warned: bool = False
    gains: Floats = field(default_factory=lambda: np.zeros(4))
    ratio: float = 0.0
    total: float = 0.0
    stated: tuple[float, float] = (0.0, 0.0)


def build_play(half_width: float) -> Change:
    """Return what play of this share of the amplitude does: the output stays until the input has gone through it."""

    def change(volts: Floats) -> Floats:
        width, output, outputs = half_width * np.ptp(volts) / 2, float(volts[0]), []
        for volt in volts.tolist():
            output = min(max(output, volt - width), volt + width)
            outputs.append(output)
        return np.array(outputs)

    return change


def build_low_pass(seconds: float) -> Change:
    """Return a low-pass of first order of this time constant."""
    keep = float(np.exp(-1 / (SAMPLE_RATE_HZ * seconds)))
    return lambda volts: np.asarray(lfilter([1 - keep], [1, -keep], volts, zi=[keep * volts[0]])[0])


def late(rows: int) -> Change:
    """Return a delay by so many samples."""
    return lambda volts: np.roll(volts, rows)


BENCH_FAULTS = {
    "none": BenchFault(),
    "inner film late by 0.1 rad": BenchFault(channels={0: late(3)}, word="inner film lags"),
    "outer film late by 0.1 rad": BenchFault(channels={1: late(3)}, word="outer film lags"),
    "outer film filtered by 2 ms": BenchFault(channels={1: build_low_pass(0.002)}, word="outer film lags"),
    "force sensor 10 % high": BenchFault(sensor=1.1, word="force channel"),
    "force sensor 10 % low": BenchFault(sensor=0.9, word="force channel"),
    "force sensor 3 % high": BenchFault(sensor=1.03, word="force channel"),
    "pin leaks 1 %": BenchFault(pin=0.01, word="does it touch"),
    "ring leaks 1 %": BenchFault(ring=0.01, word="does it touch"),
    "both leak 1 %": BenchFault(pin=0.01, ring=0.01, word="does it touch"),
    "pin leaks 3 %": BenchFault(pin=0.03, word="does it touch"),
    "ring leaks 3 %": BenchFault(ring=0.03, word="does it touch"),
    "rate 0.5 % high": BenchFault(clock=0.995, word="sampling rate"),
    "rate 3 % low": BenchFault(clock=1.03, word="sampling rate"),
    "rate 10 % high": BenchFault(clock=1 / 1.1, word="sampling rate"),
    "rate 0.1 % high": BenchFault(clock=0.999, word="sampling rate"),
    "load of 0.5 Hz, rate 3 % low": BenchFault(clock=1.03, frequency=0.5, word="sampling rate"),
    "load of 0.5 Hz, rate 10 % high": BenchFault(clock=1 / 1.1, frequency=0.5, word="sampling rate"),
    "force channel with play of 1 %": BenchFault(channels={2: build_play(0.01)}, word="force channel lags"),
    "with play of 2 %": BenchFault(channels={2: build_play(0.02)}, word="force channel lags"),
    "with play of 5 %": BenchFault(channels={2: build_play(0.05)}, word="force channel lags"),
    "filtered by 2 ms": BenchFault(channels={2: build_low_pass(0.002)}, word="force channel lags"),
    "filtered by 5 ms": BenchFault(channels={2: build_low_pass(0.005)}, word="force channel lags"),
    "filtered by 10 ms": BenchFault(channels={2: build_low_pass(0.01)}, word="force channel lags"),
    "one sample late": BenchFault(channels={2: late(1)}, word="force channel lags"),
}


@dataclass(frozen=True)
class DrawnBench:
    """A probe and its bench as they are, which nobody knows: channels, and the inner film's share of each reference's load."""

    built: BuiltProperties
    shares: Floats

    @classmethod
    def draw(cls, fault: BenchFault, bench: Bench, shares: BlockPredictions, seed: int) -> DrawnBench:
        """Draw all that chance decides, each thing by the bench's tolerance of it."""
        random = np.random.default_rng(seed)
        channels, amplifier = bench.channels, bench.amplifier
        spread = np.array([[channels.gain, channels.cross_talk], [channels.cross_talk, channels.gain]])
        films = np.eye(2) + spread * random.standard_normal((2, 2))
        parts = 1 + np.array([amplifier.resistance_tolerance, amplifier.capacitance_tolerance]) * random.standard_normal((2, 2))
        tolerance = 0.0 if bench.force is None else bench.force.tolerance
        built = BuiltProperties(
            gains=((films[0, 0], films[0, 1]), (films[1, 0], films[1, 1])),
            resistance=(parts[0, 0], parts[1, 0]),
            capacitance=(parts[0, 1], parts[1, 1]),
            force=fault.sensor * (1 + tolerance * random.standard_normal()),
            frequency=1 + 2e-4 * random.standard_normal(),
            hum=0.0 if fault.clock != 1.0 else BuiltProperties.hum,  # whose frequency would tell the rate
        )
        moduli = [block.tolerance * share.modulus_derivative for block, share in zip(bench.blocks, shares.blocks, strict=True)]
        logs = shares.log_ratios + moduli * random.standard_normal(len(moduli))
        deviations = shares.compute_tolerances(bench.workshop) * random.standard_normal(len(shares.variables))
        logs = logs + shares.derivatives @ deviations
        leaks = {"inner": fault.pin, "outer": fault.ring}
        parts_of_load = compute_inner_fractions(logs, bench.reference)
        for k, block in enumerate(bench.reference):
            drawn, leak = block.leak_sd * abs(random.standard_normal()), leaks.get(block.on)
            parts_of_load[k] += {"inner": -1.0, "outer": 1.0}.get(block.on, 0.0) * (drawn if leak is None else leak)
        return cls(built, parts_of_load)

    def read(self, fault: BenchFault, scene: Scene, bench: Bench, seed: int) -> list[Samples]:
        """Return one reading on each reference."""
        names, readings = ("inner", "outer", "force"), []
        rows = np.arange(round(max(SECONDS, 25 / bench.load.frequency) * SAMPLE_RATE_HZ))
        for k, (part, reference) in enumerate(zip(self.shares, bench.reference, strict=True)):
            load = reference.known_force or LOAD
            volts = build_signals(self.built, bench, scene, load * np.array([part, 1 - part]), [seed, k])(
                rows / SAMPLE_RATE_HZ / fault.clock
            )
            for column, change in fault.channels.items():
                volts[:, column] = change(volts[:, column])
            unsaturated = np.zeros(volts.shape, bool)
            readings.append(Samples(SAMPLE_RATE_HZ, names, rows, volts, saturated=unsaturated, gaps=(), overruns=0, source={}))
        return readings

    def matrix(self, bench: Bench) -> Floats:
        """Return the true M, amplifiers included, shape (2, 2)."""
        nominal, frequency = bench.amplifier.build_films(), self.built.frequency * bench.load.frequency
        pairs = zip(self.built.build_amplifiers(nominal), nominal, strict=True)
        return (
            np.array([[abs(channel.response(frequency) / drawn.response(frequency))] for channel, drawn in pairs])
            * self.built.gains
        )


def outcome(fault: BenchFault, scene: Scene, bench: Bench, shares: BlockPredictions, seed: int) -> CalibrationOutcome:
    """Calibrate with a fault, then read the scene without noise."""
    drawn = DrawnBench.draw(fault, bench, shares, seed)
    try:
        readings = [measure_strict_reading(samples, bench, scene) for samples in drawn.read(fault, scene, bench, seed)]
        calibration = calibrate(scene, bench, readings, shares)
    except (HardwareError, InputError) as refusal:
        return CalibrationOutcome(refused=str(refusal))
    truth = drawn.matrix(bench)
    return CalibrationOutcome(
        "",
        any("film lags" in warning for warning in calibration.warnings),
        any(fault.word in warning for warning in calibration.warnings),
        (calibration.gains.matrix - truth).ravel() / np.sqrt(np.diag(calibration.gains.covariance)),
        *_reading_errors(calibration.gains, truth),
    )


def _reading_errors(gains: Gains, truth: Floats) -> tuple[float, float, tuple[float, float]]:
    """Errors of ln of ratio and sum on the scene over their standard deviations, and these."""
    forces = LOAD * np.array([RATIO, 1.0]) / (1 + RATIO)
    films = truth @ forces
    computed = gains.compute_forces(films)
    covariance = gains.compute_forces_covariance(films, np.zeros((2, 2)))
    slopes = np.array([[1.0, -1.0] / computed, np.ones(2) / computed.sum()])
    ratio, total = np.sqrt(np.einsum("ka,ab,kb->k", slopes, covariance, slopes)).tolist()
    errors = np.log(computed[0] / computed[1] / RATIO), np.log(computed.sum() / LOAD)
    return float(errors[0]) / ratio, float(errors[1]) / total, (ratio, total)


def row(name: str, outcomes: list[CalibrationOutcome]) -> str:
    """Return a fault's line of the table."""
    read = [outcome for outcome in outcomes if not outcome.refused]
    counts = (
        f"| {name} | {len(outcomes) - len(read)} | {sum(outcome.lags for outcome in read)} | "
        f"{sum(outcome.warned for outcome in read)} |"
    )
    if not read:
        return f"{counts} - | - | - | - | - |  {outcomes[-1].refused[:90]}"
    covered = [np.mean(np.abs([getattr(outcome, key) for outcome in read]) < HALF_WIDTH) for key in ("gains", "ratio", "total")]
    stated = 100 * np.mean([outcome.stated for outcome in read], axis=0)
    return counts + "".join(f" {100 * outcome:.0f} |" for outcome in covered) + "".join(f" {outcome:.2f} |" for outcome in stated)


def build_bench(weight: float | None, leak: float | None) -> Bench:
    """Return the built-in bench, its pin's load known or its leaks others where that is asked for."""
    bench = read_builtin_bench()
    references = list(bench.reference)
    if leak is not None:
        references = [
            reference if reference.on == "tissue" else reference.model_copy(update={"leak": leak}) for reference in references
        ]
    if weight is not None:
        references[0] = references[0].model_copy(update={"known_force": LOAD, "known_force_tolerance": weight})
    return bench.model_copy(update={"reference": tuple(references)})


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--draws", type=int, default=20)
    parser.add_argument("--weight", type=float, help="relative tolerance of a known load on the pin")
    parser.add_argument("--leak", type=float, help="of pin and ring, in place of the bench's")
    parser.add_argument("--only", default="", help="faults whose names hold this; several, parted by commas")
    options = parser.parse_args()
    scene, bench = express_by_outer_radius(read_scene(SCENE)), build_bench(options.weight, options.leak)
    shares = predict_blocks(scene, bench.reference)
    shares = replace(shares, blocks=tuple(replace(item, rule=None) for item in shares.blocks))
    print(
        f"{options.draws} draws\n\n| fault | refused | film lags | warned | gains, % | ratio, % | sum, % | sd ratio, % | "
        "sd sum, % |"
    )
    print("|---|---|---|---|---|---|---|---|---|")
    for name, fault in BENCH_FAULTS.items():
        if any(item in name for item in options.only.split(",")):
            load = bench.load if fault.frequency is None else bench.load.model_copy(update={"frequency": fault.frequency})
            loaded_bench = bench.model_copy(update={"load": load})
            outcomes = [outcome(fault, scene, loaded_bench, shares, seed) for seed in range(options.draws)]
            print(row(name, outcomes), flush=True)
            if name == "none":
                false = sum(item.lags for item in outcomes if not item.refused)
                print(f"| false lag warnings: {share(false, len(outcomes))} |", flush=True)


if __name__ == "__main__":
    main()
