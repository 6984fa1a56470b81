"""Measure how much the groove, which the evaluator of a population leaves out, changes the signals of a tumour.

Usage: ``python -m benchmarks.populations.groove [--probes 24] [--seed 0]``, from the repository's root; a minute for each probe.
Probes, grooves and tumours are drawn. A signal is ln of a reading over the tumour less ln of the baseline reading, by ``solid``
with the groove and by ``equivalent-inclusion`` without it. What the groove changes of it is printed relative to eq. PO.12 at a
factor of 1: bounds r_i, eqs. RE.5 and PO.14, times what the tumour changes of each film's force.

Duration: a minute per probe.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import ProbeError
from geometry.common.resources import Limits
from geometry.scenes.scene import Scene
from geometry.scenes.scene_tables import Inclusion
from probe_design.populations.scan_errors import bound_groove_change
from solver import evaluate
from solver.equivalent_inclusion.evaluator import EquivalentInclusion
from solver.results.result import Result

LIMITS = Limits(seconds=1200.0)
MIN_COVER_M = 1.5e-3  # m, least tissue above a drawn tumour


@dataclass(frozen=True)
class Compared:
    """One tumour under one grooved probe.

    Attributes
    ----------
    position
        Its x, m; the groove lies at +x.
    signals
        Of ln ratio and ln stiffness without the groove, shape (2,).
    changes
        What the groove changes of them, shape (2,).
    blank
        What it changes of ln ratio without the tumour, and what eq. PO.14 allows.
    allowed
        eq. PO.12's groove at a factor of 1, shape (2,).
    """

    position: float
    signals: Floats
    changes: Floats
    blank: Floats
    allowed: Floats

    @property
    def factors(self) -> Floats:
        """What the factor would have to be, shape (2,)."""
        return np.asarray(np.abs(self.changes) / self.allowed)


def draw_probe(rng: np.random.Generator) -> tuple[Scene, list[Inclusion]]:
    """Draw a grooved probe on tissue, and one tumour on each side of its axis along the groove."""
    inner, gap, wall = rng.uniform(2e-3, 6e-3), rng.uniform(0.1e-3, 0.5e-3), rng.uniform(1e-3, 4e-3)
    height, tissue = rng.uniform(1.25e-3, 6e-3), rng.uniform(3e3, 10e3)
    groove = {"width": rng.uniform(0.2, 0.9) * inner, "depth": rng.uniform(0.3, 0.9) * height}
    blocks = {
        name: {"youngs_modulus": float(np.exp(rng.uniform(np.log(4e4), np.log(3e6)))), "poisson_ratio": 0.45}
        for name in ("inner", "outer")
    }
    radius = inner + gap + wall
    probe = {"inner_radius": inner, "outer_radius": radius, "gap": gap, "height": height, "groove": groove, **blocks}
    ground = {"shape": "cylinder", "radius": 50e-3, "depth": 60e-3, "youngs_modulus": tissue, "poisson_ratio": 0.45}
    contact = {"interface": str(rng.choice(["bonded", "frictionless"]))}
    scene = Scene.model_validate({"probe": probe, "tissue": ground, "contact": contact, "load": {"indentation": 1e-5}})
    bodies = []
    for side in (1.0, -1.0):
        diameter = rng.uniform(4e-3, 12e-3)
        depth = diameter / 2 + MIN_COVER_M + rng.uniform(0, 8e-3)
        bodies.append(
            Inclusion(
                diameter=diameter,
                depth=depth,
                x=side * rng.uniform(0, 1.2) * radius,
                y=0.0,
                youngs_modulus=rng.uniform(3, 8) * tissue,
                poisson_ratio=0.45,
                target=True,
            )
        )
    return scene, bodies


def compare_grooved(scene: Scene, bodies: list[Inclusion]) -> Iterator[Compared]:
    """Evaluate both with and without the groove."""
    plain = scene.model_copy(update={"probe": scene.probe.model_copy(update={"groove": None})})
    base = EquivalentInclusion().solve_alone(plain, 1e-3).films
    share = bound_groove_change(scene, base.forces)

    def logs(result: Result) -> Floats:
        assert result.ratio is not None
        assert result.stiffness is not None
        return np.log([result.ratio, result.stiffness])

    def forces(result: Result) -> Floats:
        inner, outer = (result.ratio or 0.0) * scene.probe.inner_area, scene.probe.outer_area
        return (result.stiffness or 0.0) * np.array([inner, outer]) / (inner + outer)

    blanks = [evaluate(evaluated, level, a, limits=LIMITS) for evaluated, level, a in _list_levels(scene, plain)]
    for body in bodies:
        pressed = [
            evaluate(evaluated.model_copy(update={"inclusion": (body,)}), level, a, limits=LIMITS)
            for evaluated, level, a in _list_levels(scene, plain)
        ]
        grooved, ungrooved = (logs(evaluated) - logs(blank) for evaluated, blank in zip(pressed, blanks, strict=True))
        each = share * np.abs(forces(pressed[1]) / forces(blanks[1]) - 1)
        blank = np.array([abs(logs(blanks[0])[0] - logs(blanks[1])[0]), share.max()])
        yield Compared(body.x, ungrooved, grooved - ungrooved, blank, np.array([each.sum(), each.max()]))


def _list_levels(scene: Scene, plain: Scene) -> tuple[tuple[Scene, str, float], tuple[Scene, str, float]]:
    return (scene, "solid", 5e-3), (plain, "equivalent-inclusion", 3e-3)


def main() -> None:
    """Print a line for each tumour, and the largest factors."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--probes", type=int, default=24)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    rng, factors = np.random.default_rng(given.seed), []
    print(
        "groove | moduli of tube, tissue, kPa | without: change, allowed | x of R | signals | changes | factor: ratio | stiffness"
    )
    for _ in range(given.probes):
        scene, bodies = draw_probe(rng)
        probe = scene.probe
        assert probe.groove is not None
        name = f"{1e3 * probe.groove.width:.1f} x {1e3 * probe.groove.depth:.1f} of {1e3 * probe.tube_height:.1f} mm"
        try:
            for comparison in compare_grooved(scene, bodies):
                factors.append(comparison.factors)
                cell_texts = [
                    " ".join(f"{value:.4f}" for value in values)
                    for values in (comparison.blank, comparison.signals, comparison.changes)
                ]
                moduli = " ".join(f"{value / 1e3:.3g}" for value in (probe.outer.youngs_modulus, scene.tissue.youngs_modulus))
                cells = (name, moduli, cell_texts[0], f"{comparison.position / probe.tube_radius:.2f}", *cell_texts[1:])
                print(*cells, f"{comparison.factors[0]:.3f} | {comparison.factors[1]:.3f}", sep=" | ", flush=True)
        except ProbeError as fault:
            print(f"{name} | refused: {fault}", flush=True)
    all_factors = np.array(factors)
    print(f"{len(all_factors)} tumours: largest factor {all_factors.max(axis=0)}, median {np.median(all_factors, axis=0)}")


if __name__ == "__main__":
    main()
