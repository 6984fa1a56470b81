"""Measure coverage and false alarms of `calibrate` and `check` on probes within and outside their tolerances.

Each probe is solved anew as it was built, read with noise on references that deviate by their tolerances (the same blocks for
calibration and check, as in a laboratory), calibrated, and checked against its drawing at another temperature. Out of tolerance
is one variable, by 5 to 15 of its tolerances; the others stay within. ``--explain N`` explains so many of those that are
detected. What is solved is kept in ``--solved FILE``, from which an interrupted study goes on; all else takes a second.

    python -m benchmarks.built_probe.study --within 200 --out 100 --explain 10

Duration: hours.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.built_probe.counts import ProbeOutcome, print_out, print_within
from benchmarks.built_probe.solved_probes import SolvedProbes
from geometry import Scene, read_scene
from geometry.common.arrays import Floats
from geometry.common.errors import InputError
from geometry.scenes.variables import list_values
from probe_design.built_probe.bench import Bench, Reference, read_bench, read_builtin_bench
from probe_design.built_probe.block_predictions import (
    BlockPredictions,
    compute_inner_fractions,
    express_by_outer_radius,
    predict_blocks,
)
from probe_design.built_probe.gain_checks import estimate_consistent_gains
from probe_design.built_probe.gains import GAIN_CHANGE_PER_KELVIN, Gains, Observation
from probe_design.built_probe.virtual_probe import draw_delivered
from probe_design.probe_check.check import Comparison
from probe_design.probe_check.deviation import Deviation, compute_power
from probe_design.probe_check.verdicts import decide_verdict

LOAD = 10e-3  # N, that examples/scene.toml has
NOISE = 1.5e-5  # N, of a film's reading of 10 s of the virtual probe
SCENE = "examples/scene.toml"


@dataclass(frozen=True)
class Drawn:
    """One probe, its bench and its noise as they are, which nobody knows.

    Attributes
    ----------
    probe
        As built.
    off, turn
        The variable beyond its tolerance, and by how many tolerances; None and 0.
    blocks
        References as delivered.
    matrix, warm
        M of eq. BP.1 at the calibration and at the check, shape (2, 2).
    sensor
        Amplitude of the load by the force channel, N.
    noise
        Of both films' readings at the calibration and at the check, N, shape (2, references, 2).
    """

    probe: Scene
    off: str | None
    turn: float
    blocks: tuple[Reference, ...]
    matrix: Floats
    warm: Floats
    sensor: float
    noise: Floats

    def readings(self, logs: Floats) -> tuple[Floats, Floats]:
        """Return both films' readings on all references, N, shape (references, 2), at the calibration and at the check."""
        shares = compute_inner_fractions(logs, self.blocks)
        forces = LOAD * np.stack([shares, 1 - shares], axis=1)
        return forces @ self.matrix.T + self.noise[0], forces @ self.warm.T + self.noise[1]


@dataclass(frozen=True)
class Study:
    """What is believed: drawing, bench and predictions."""

    scene: Scene
    bench: Bench
    shares: BlockPredictions

    @classmethod
    def from_bench(cls, bench: Bench, block_tolerance: float | None) -> Study:
        """Return a bench's, its blocks known to ``block_tolerance``."""
        scene = express_by_outer_radius(read_scene(SCENE))
        if block_tolerance is not None:
            blocks = [
                block if block.on != "tissue" else block.model_copy(update={"tolerance": block_tolerance})
                for block in bench.reference
            ]
            bench = bench.model_copy(update={"reference": tuple(blocks)})
        return cls(scene, bench, predict_blocks(scene, bench.reference))

    @property
    def names(self) -> tuple[str, ...]:
        """Variables that have a tolerance."""
        tolerances = self.shares.compute_tolerances(self.bench.workshop)
        return tuple(name for name, tolerance in zip(self.shares.variables, tolerances, strict=True) if tolerance)

    def draw(self, seed: int, off: str | None) -> Drawn:
        """Draw all that chance decides."""
        random = np.random.default_rng([seed, off is not None])
        probe, turn = self._draw_probe(random, off)
        matrix = np.eye(2) + np.array([[0.05, 0.01], [0.01, 0.05]]) * random.standard_normal((2, 2))
        blocks = tuple(draw_delivered(block, random) for block in self.bench.reference)
        sensor = LOAD * (1 + (self.bench.force.tolerance if self.bench.force else 0.0) * random.standard_normal())
        noise = NOISE * random.standard_normal((2, len(blocks), 2))
        drift = 1 + GAIN_CHANGE_PER_KELVIN * self.bench.channels.warming * random.standard_normal((2, 1))
        return Drawn(probe, off, turn, blocks, matrix, drift * matrix, sensor, noise)

    def _draw_probe(self, random: np.random.Generator, off: str | None) -> tuple[Scene, float]:
        """Draw a probe within the tolerances, one variable beyond them; returns it and by how many tolerances that is."""
        tolerances = dict(zip(self.shares.variables, self.shares.compute_tolerances(self.bench.workshop), strict=True))
        values = list_values(self.scene)
        while True:  # until the blocks fit
            turns = {name: float(random.standard_normal()) for name in values if tolerances.get(name)}
            if off is not None:
                turns[off] = float(random.choice([-1, 1]) * random.uniform(5, 15))
            try:
                new = {name: values[name] + turn * tolerances[name] for name, turn in turns.items()}
                return self.scene.replace(new), turns.get(off or "", 0.0)
            except ValueError:
                continue

    def outcome(self, drawn: Drawn, logs: Floats) -> ProbeOutcome:
        """Calibrate and check a probe of which ln(F_inner / F_outer) on its blocks is known."""
        first, second = drawn.readings(logs)
        try:
            gains = self._gains(first, drawn.sensor)
            deviation = self._deviation(gains, second)
        except InputError as fault:
            return ProbeOutcome(drawn.off, drawn.turn, refused=str(fault))
        error = (gains.matrix - drawn.matrix).ravel() / np.sqrt(np.diag(gains.covariance))
        likely = compute_power(deviation, {drawn.off: drawn.turn}) if drawn.off else None
        return ProbeOutcome(drawn.off, drawn.turn, deviation.p_value, likely, error)

    def _gains(self, films: Floats, sensor: float) -> Gains:
        pressed = zip(self.bench.reference, films, strict=True)
        observed = [Observation(block, read, NOISE**2 * np.eye(2), sensor, 1e-3 * LOAD) for block, read in pressed]
        return estimate_consistent_gains(observed, self.shares, self.bench)[0]

    def _deviation(self, gains: Gains, films: Floats) -> Deviation:
        on_tissue = [read for block, read in zip(self.bench.reference, films, strict=True) if block.on == "tissue"]
        known = gains.add_warming(self.bench.channels.warming)
        comparison = Comparison(self.bench, known, self.shares.variables, self.shares)
        return comparison.compute_deviation([(read, NOISE**2 * np.eye(2)) for read in on_tissue])

    def is_named(self, drawn: Drawn, logs: Floats) -> bool:
        """Return whether the check's explanation names the variable that is off."""
        first, second = drawn.readings(logs)
        deviation = self._deviation(self._gains(first, drawn.sensor), second)
        verdict = decide_verdict(self.scene, self.bench, deviation, self.shares, (), coverage=())
        return drawn.off in {*verdict.alike, *(name for pair in verdict.pairs if pair.explains for name in pair.variables)}


def predict_logs(drawn: Drawn) -> Floats:
    """Return ln(F_inner / F_outer) of a probe as built on each of its blocks of tissue, shape (blocks,)."""
    return predict_blocks(drawn.probe, drawn.blocks, variables=(), limit_loads=False).log_ratios


def iterate_outcomes(
    study: Study, count: int, names: tuple[str | None, ...], solved: SolvedProbes, explain: int = 0
) -> Iterator[ProbeOutcome]:
    """Yield the outcome of each of ``count`` probes, one of ``names`` after the other off; those solved before are not again."""
    left = explain
    for seed in range(count):
        drawn = study.draw(seed, names[seed % len(names)])
        logs = solved.get(seed, drawn.off, partial(predict_logs, drawn))
        outcome = study.outcome(drawn, logs)
        if left and outcome.alarmed and not outcome.refused:
            left, outcome = left - 1, replace(outcome, named=study.is_named(drawn, logs))
        yield outcome


def main() -> None:
    """Print both counts."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--within", type=int, default=200)
    parser.add_argument("--out", type=int, default=100)
    parser.add_argument("--explain", type=int, default=0)
    parser.add_argument("--block-tolerance", type=float)
    parser.add_argument("--bench", type=Path)
    parser.add_argument("--solved", type=Path)
    options = parser.parse_args()
    bench = read_builtin_bench() if options.bench is None else read_bench(options.bench)
    study, solved = Study.from_bench(bench, options.block_tolerance), SolvedProbes(options.solved, options.block_tolerance)
    print_within(list(iterate_outcomes(study, options.within, (None,), solved)))
    print_out(list(iterate_outcomes(study, options.out, study.names, solved, options.explain)))


if __name__ == "__main__":
    main()
