"""Coverage and false alarms of calibration and check, over probes drawn within the workshop's tolerances and out of them.

Each probe is solved anew as it was built, read with noise on references off by their tolerances (the same blocks for calibration
and check, as in a laboratory), calibrated, and checked against its drawing. Out of tolerance is one variable, by 5 to 15 of its
tolerances; the others stay within. ``--explain N`` asks for the explanation of so many of those that are found.

    python -m benchmarks.built_probe.study --within 200 --out 100 --explain 10
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from dataclasses import dataclass

import numpy as np

from geometry import Scene, read_scene
from geometry.common.arrays import Floats
from geometry.common.errors import InputError
from geometry.scenes.variables import changed, values
from probe_design.built_probe.bench import Bench, Reference, builtin_bench
from probe_design.built_probe.block_predictions import Shares, by_outer_radius, predicted
from probe_design.built_probe.gain_matrix import Gains, Observed
from probe_design.built_probe.trusted_gains import trusted
from probe_design.built_probe.virtual_probe import as_delivered
from probe_design.probe_check.check import Comparison
from probe_design.probe_check.deviation import LEVEL, Deviation
from probe_design.probe_check.verdicts import judged

LOAD = 10e-3  # N, that examples/scene.toml has
NOISE = 1.5e-5  # N, of a film's reading of 10 s of the virtual probe
SCENE = "examples/scene.toml"


@dataclass(frozen=True)
class Study:
    """What is believed: drawing, bench and predictions."""

    scene: Scene
    bench: Bench
    shares: Shares

    @classmethod
    def of(cls, block_tolerance: float | None) -> Study:
        """Return the built-in bench's, its blocks known to ``block_tolerance``."""
        scene, bench = by_outer_radius(read_scene(SCENE)), builtin_bench()
        if block_tolerance is not None:
            blocks = [
                one if one.on != "tissue" else one.model_copy(update={"tolerance": block_tolerance}) for one in bench.reference
            ]
            bench = bench.model_copy(update={"reference": tuple(blocks)})
        return cls(scene, bench, predicted(scene, bench.reference))

    def built(self, random: np.random.Generator, off: str | None) -> tuple[Scene, float]:
        """Draw a probe within the tolerances, one variable beyond them; returns it and by how many tolerances that is."""
        tolerances = dict(zip(self.shares.variables, self.shares.tolerances(self.bench.workshop), strict=True))
        at = values(self.scene)
        while True:  # until the blocks fit
            turns = {name: float(random.standard_normal()) for name in at if tolerances.get(name)}
            if off is not None:
                turns[off] = float(random.choice([-1, 1]) * random.uniform(5, 15))
            try:
                new = {name: at[name] + turn * tolerances[name] for name, turn in turns.items()}
                return changed(self.scene, new), turns.get(off or "", 0.0)
            except ValueError:
                continue

    def forces(self, probe: Scene, blocks: tuple[Reference, ...]) -> Floats:
        """Both films' true forces on all references as delivered, N, shape (references, 2)."""
        logs = iter(predicted(probe, blocks).log_ratios)
        inner = [{"inner": 1.0, "outer": 0.0}.get(one.on) for one in blocks]
        shares = np.array([1 / (1 + np.exp(-next(logs))) if share is None else share for share in inner])
        return np.asarray(LOAD * np.stack([shares, 1 - shares], axis=1))

    def one(self, seed: int, off: str | None) -> tuple[Floats, Deviation, float]:
        """Build, calibrate and check: errors of M over their standard deviations, the deviation, the tolerances."""
        random = np.random.default_rng([seed, off is not None])
        probe, turn = self.built(random, off)
        matrix = np.eye(2) + np.array([[0.05, 0.01], [0.01, 0.05]]) * random.standard_normal((2, 2))
        blocks = tuple(as_delivered(one, random) for one in self.bench.reference)
        sensor = LOAD * (1 + (self.bench.force.tolerance if self.bench.force else 0.0) * random.standard_normal())
        true = self.forces(probe, blocks) @ matrix.T
        first, second = (true + NOISE * random.standard_normal(true.shape) for _ in range(2))
        spread = NOISE**2 * np.eye(2)
        pressed = zip(self.bench.reference, first, strict=True)
        observed = [Observed(one, films, spread, sensor, 1e-3 * LOAD) for one, films in pressed]
        gains, _ = trusted(observed, self.shares, self.bench)
        again = [(films, spread) for one, films in zip(blocks, second, strict=True) if one.on == "tissue"]
        error = (gains.matrix - matrix).ravel() / np.sqrt(np.diag(gains.covariance))
        return error, self.compared(gains, again), turn

    def compared(self, gains: Gains, films: list[tuple[Floats, Floats]]) -> Deviation:
        """Compare at the calibration's temperature give or take the bench's warming."""
        known = gains.warmed(self.bench.channels.warming)
        return Comparison(self.bench, known, self.shares.variables, self.shares).deviation(films)


def main() -> None:
    """Print both counts."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--within", type=int, default=200)
    parser.add_argument("--out", type=int, default=100)
    parser.add_argument("--explain", type=int, default=0)
    parser.add_argument("--block-tolerance", type=float)
    asked = parser.parse_args()
    study = Study.of(asked.block_tolerance)
    _within(study, asked.within)
    _out(study, asked.out, asked.explain)


def _within(study: Study, count: int) -> None:
    errors, alarms, refused = [], 0, 0
    for seed in range(count):
        try:
            error, deviation, _ = study.one(seed, None)
        except InputError:
            refused += 1
            continue
        errors.append(error)
        alarms += deviation.p_value < LEVEL
    beyond = np.mean(np.abs(errors) > 1.96, axis=0)
    print(f"{count} within tolerance: {alarms} false alarms ({count * LEVEL:g} stated), {refused} calibrations refused")
    print("gains within 1.96 sd (95 % stated):", " ".join(f"{100 * (1 - one):.1f} %" for one in beyond), flush=True)


def _out(study: Study, count: int, explain: int) -> None:
    tolerances = study.shares.tolerances(study.bench.workshop)
    names = [name for name, tolerance in zip(study.shares.variables, tolerances, strict=True) if tolerance]
    found: dict[str, list[bool]] = defaultdict(list)
    named: list[bool] = []
    for seed in range(count):
        name = names[seed % len(names)]
        try:
            _, deviation, _ = study.one(seed, name)
        except InputError:
            found[name].append(True)  # refused is found, too
            continue
        found[name].append(deviation.p_value < LEVEL)
        if found[name][-1] and len(named) < explain:
            named.append(name in judged(study.scene, study.bench, deviation, study.shares, ()).alike)
    for name, ones in found.items():
        print(f"{name}: {sum(ones)} of {len(ones)} found")
    print(f"{count} out of tolerance: {sum(map(sum, found.values()))} found")
    if named:
        print(f"of {len(named)} explained, {sum(named)} name the variable")


if __name__ == "__main__":
    main()
