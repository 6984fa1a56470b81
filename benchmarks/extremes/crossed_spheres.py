"""Check that spheres which interfaces of the tissue cross or nearly touch can be meshed, and that their bounds hold.

Every drawn scene has one sphere on the axis, one to three interfaces across it, up to two elsewhere, contrasts of layers and
sphere to 1000 both ways, both contacts. Of every other scene interfaces lie near a pole: by 1e-4 to 0.1 of the radius inside or
outside, or exactly at it; spheres are up to three times as wide as the probe, layers as thin as a hundredth of the radius.

    python -m benchmarks.extremes.crossed_spheres --scenes 400 --meshes
    python -m benchmarks.extremes.crossed_spheres --scenes 60 --seed 1 --truths truths.jsonl
    python -m benchmarks.extremes.crossed_spheres --ngsolve 10 --truths truths.jsonl

Truth is order 9 with half as many cells again and up to three layers more at corners than the meshes of results. Truths are
read from a file of an earlier run where one is named.

Duration: half an hour.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from threadpoolctl import threadpool_limits

from benchmarks.tables import MeasuredTable
from geometry import Contact, CylinderTissue, Inclusion, InputError, Load, Material, Probe, Scene
from geometry.common.errors import Refusal, SolveError
from geometry.common.resources import Limits, use_limits
from geometry.meridian.mesh import build_topology, compute_nodes
from geometry.meridian.mesh_lines import MeridianFineness, find_kind
from geometry.scenes.scene_tables import Layer
from solver.axisymmetric.evaluator import Axisymmetric
from solver.axisymmetric.refinement import MESH_LEVELS
from solver.axisymmetric.sample import solve_on_mesh
from solver.axisymmetric.sections import build_sections
from solver.elements.quadrilateral import compute_geometry
from solver.elements.shape_functions import build_shapes
from solver.linalg.workspace import get_workspace

TRUTH_FINENESS = MeridianFineness(1.5, 6, 9)
TRUTH_LIMITS = Limits(memory=5e9, seconds=600.0)  # of the truth
ACCURACIES = (1e-2, 1e-3, 1e-4)
CONTRAST = 1e3
RATIOS = (0.3, 0.4, 0.45, 0.49, 0.499)  # Poisson's
POLES, TOUCHING_SHARE = (1e-4, 0.1), 0.2  # radii between pole and interface; the share of such interfaces that touch it
THINNEST = 0.01  # radii
USEFUL_BOUND_FACTOR = 20.0  # times the true error, or the accuracy: what a bound is at most where that is reached


@dataclass(frozen=True)
class CrossedTruth:
    """What the finest mesh says."""

    ratio: float
    log_sensitivity: float


@dataclass(frozen=True)
class BoundCheck:
    """One scene at one accuracy: errors, bounds or, of a log-sensitivity without a warning, what is promised."""

    error: float
    bound: float
    sensitivity_error: float
    sensitivity_bound: float
    reached: bool


def draw(seed: int, number: int) -> Scene:
    """Return one scene, the same for the same seed and number.

    Raises
    ------
    InputError, ValueError
        Its parts do not fit.
    """
    rng = np.random.default_rng([seed, number, 7])

    def draw_log_uniform(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    def material(base_modulus: float, max_contrast: float = CONTRAST) -> dict[str, Any]:
        return {
            "youngs_modulus": base_modulus * draw_log_uniform(1 / max_contrast, max_contrast) ** 0.5,
            "poisson_ratio": float(rng.choice(RATIOS)),
        }

    inner, height = draw_log_uniform(1.0, 5.0), draw_log_uniform(0.2, 2.0)
    gap, wall = draw_log_uniform(0.01, 0.3) * inner, draw_log_uniform(0.1, 1.5) * inner
    outer = inner + gap + wall
    radius = draw_log_uniform(0.2, 3.0) * outer / 2 if number % 2 else draw_log_uniform(0.15, 1.2) * outer
    top = draw_log_uniform(0.05, 1.5) * radius
    depth = top + 2 * radius + draw_log_uniform(0.1, 3.0) * radius
    centre = top + radius
    planes = _planes(rng, centre, radius, depth, poles=bool(number % 2))
    mm = 1e-3
    layers = tuple(Layer(thickness=float(h) * mm, **material(2e4)) for h in np.diff([0.0, *planes]))
    probe = Probe(
        inner_radius=inner * mm,
        outer_radius=outer * mm,
        gap=gap * mm,
        inner_height=height * inner * mm,
        outer_height=height * inner * mm,
        inner=Material(youngs_modulus=draw_log_uniform(2e4, 2e7), poisson_ratio=float(rng.uniform(0.3, 0.45))),
        outer=Material(youngs_modulus=draw_log_uniform(2e4, 2e7), poisson_ratio=float(rng.uniform(0.3, 0.45))),
    )
    tissue = CylinderTissue(
        shape="cylinder",
        radius=draw_log_uniform(1.5, 6) * max(outer, radius) * mm,
        depth=depth * mm,
        layer=layers,
        **material(2e4),
    )
    body = Inclusion(diameter=2 * radius * mm, depth=centre * mm, **material(2e4, CONTRAST**2))
    contact = Contact(interface=str(rng.choice(["bonded", "frictionless"])))  # type: ignore[arg-type]
    return Scene(probe=probe, tissue=tissue, inclusion=(body,), contact=contact, load=Load(indentation=1e-6))


def _planes(rng: np.random.Generator, centre: float, radius: float, depth: float, *, poles: bool) -> list[float]:
    """Depths of the interfaces."""
    across = [centre + radius * float(rng.uniform(-0.97, 0.97)) for _ in range(int(rng.integers(1, 4)))]
    for k in range(len(across) if poles else 0):
        offset = 0.0 if rng.random() < TOUCHING_SHARE else float(np.exp(rng.uniform(*np.log(POLES)))) * rng.choice([-1, 1])
        if k == 0 or rng.random() < 0.5:
            across[k] = centre + float(rng.choice([-1, 1])) * radius * (1 + offset)
    elsewhere = [float(rng.uniform(0.02, 0.98)) * depth for _ in range(int(rng.integers(0, 3)))]
    heights: list[float] = []
    for plane in sorted(across + elsewhere):
        if plane - (heights[-1] if heights else 0.0) > THINNEST * radius and depth - plane > THINNEST * radius:
            heights.append(plane)
    return heights


def draw_scenes(seed: int, count: int) -> Iterator[tuple[str, Scene]]:
    """Yield the first scenes of a seed whose parts fit and which an interface crosses or touches."""
    number = 0
    while count:
        try:
            scene = draw(seed, number)
            radius, centre_depth = (scene.inclusion[0].diameter or 0.0) / 2, scene.inclusion[0].depth
            if any(abs(plane - centre_depth) < 1.1 * radius for plane in scene.tissue.interfaces):
                yield f"seed {seed}, number {number}", scene
                count -= 1
        except (InputError, ValueError):
            pass
        number += 1


def meshes(scene: Scene) -> int:
    """Return how many of the evaluator's meshes have a cell without area."""
    section, bad = build_sections(scene).section, 0
    for level in MESH_LEVELS:
        functions = build_shapes(level.order)
        try:
            compute_geometry(
                compute_nodes(section, build_topology(find_kind(section, level.lean), level), functions.places), functions
            )
        except SolveError:
            bad += 1
    return bad


def truth(scene: Scene) -> CrossedTruth:
    """Solve on the finest mesh.

    Raises
    ------
    SolveError, LimitReached
        It cannot be solved.
    """
    sections = build_sections(scene)
    with use_limits(TRUTH_LIMITS):
        sample = solve_on_mesh(sections.section, sections, scene, TRUTH_FINENESS)
    inner, outer = sample.totals[0]
    return CrossedTruth(float(inner / outer * _areas(scene)), float(sample.log_sensitivities[0, 0]))


def _areas(scene: Scene) -> float:
    return scene.probe.outer_area / scene.probe.inner_area


def compare(scene: Scene, true: CrossedTruth, accuracy: float) -> BoundCheck:
    """Return errors and bounds."""
    get_workspace().begin()  # what earlier scenes needed may go
    solution = Axisymmetric().compute_converged(scene, accuracy)
    (films,), (inner, outer) = solution.films, solution.sample.totals[0]
    bound, derivative = films.compute_max_error(scene), films.log_sensitivity or 0.0
    wide = any(note.kind == "sensitivity" for note in solution.notes)
    promised = films.sensitivity_error if wide else max(5 * accuracy * abs(derivative), 1e-5)
    error = abs(float(inner / outer) * _areas(scene) / true.ratio - 1)
    return BoundCheck(error, bound, abs(derivative - true.log_sensitivity), promised, bound <= accuracy)


def solve_by_ngsolve(scene: Scene) -> tuple[float, float, float]:
    """Return ratio, log-sensitivity and their relative uncertainty by NGSolve."""
    from benchmarks.references.axisymmetric import reference

    answer = reference(scene, 1e-6)
    return answer.ratio, answer.log_sensitivity or 0.0, answer.relative_uncertainty


def table(checks: dict[float, list[BoundCheck]]) -> MeasuredTable:
    """Return the shares of bounds by accuracy."""
    columns = (
        "accuracy",
        "scenes",
        "accuracy reached",
        "bounds broken",
        "error / bound, times",
        "median, times",
        "bounds too wide",
        "log-sensitivity / promise, times",
    )
    printed = MeasuredTable("spheres across interfaces: errors against their bounds", columns)
    for accuracy, rows in checks.items():
        shares = np.array([row.error / row.bound for row in rows])
        wide = sum(row.reached and row.bound > max(USEFUL_BOUND_FACTOR * row.error, accuracy) for row in rows)
        derivatives = max(row.sensitivity_error / row.sensitivity_bound for row in rows)
        reached, broken = sum(row.reached for row in rows), int((shares > 1).sum())
        printed.add(
            f"{accuracy:g}",
            str(len(rows)),
            str(reached),
            str(broken),
            shares.max(),
            float(np.median(shares)),
            str(wide),
            derivatives,
        )
    return printed


def _read_truths(path: Path | None) -> dict[str, CrossedTruth]:
    rows = (json.loads(row) for row in path.read_text().splitlines()) if path and path.exists() else ()
    return {name: CrossedTruth(**values) for name, values in rows}


def main() -> None:
    """Draw, solve, compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=int, default=120, help="drawn scenes (120)")
    parser.add_argument("--seed", type=int, default=1, help="of drawn scenes (1)")
    parser.add_argument("--meshes", action="store_true", help="look at meshes alone, which takes little time")
    parser.add_argument(
        "--ngsolve", type=int, default=0, help="compare the truths of so many scenes with NGSolve, and nothing else"
    )
    parser.add_argument("--truths", type=Path, help="file of truths, read and added to")
    options = parser.parse_args()
    scenes = list(draw_scenes(options.seed, options.scenes))
    if options.meshes:
        bad = {name: count for name, scene in scenes if (count := meshes(scene))}
        print(f"{len(scenes)} scenes, {len(MESH_LEVELS)} meshes each: {sum(bad.values())} have a cell without area {bad or ''}")
        return
    known = _read_truths(options.truths)
    checks: dict[float, list[BoundCheck]] = {accuracy: [] for accuracy in ACCURACIES}
    with threadpool_limits(1):
        for name, scene in scenes[: options.ngsolve or None]:
            try:
                if name not in known:
                    known[name] = truth(scene)
                    if options.truths:
                        with options.truths.open("a") as kept:
                            kept.write(json.dumps([name, vars(known[name])]) + "\n")
                true = known[name]
                if options.ngsolve:
                    ratio, derivative, uncertain = solve_by_ngsolve(scene)
                    print(
                        f"{name}: ratio {true.ratio / ratio - 1:+.1e}, "
                        f"log_sensitivity {true.log_sensitivity - derivative:+.1e}, NGSolve's own {uncertain:.1e}",
                        flush=True,
                    )
                    continue
                for accuracy in ACCURACIES:
                    row = compare(scene, true, accuracy)
                    checks[accuracy].append(row)
                    if row.error > row.bound or row.sensitivity_error > row.sensitivity_bound or not row.reached:
                        print(f"{name}: at {accuracy:g} {row}", flush=True)
            except (SolveError, Refusal) as fault:
                print(f"{name}: {fault}", flush=True)
    if not options.ngsolve:
        table(checks).print(Console(width=150))


if __name__ == "__main__":
    main()
