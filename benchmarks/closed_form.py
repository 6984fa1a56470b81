"""The closed form's true error scene by scene, its speed, and an audit of its stated error.

``python benchmarks/closed_form.py`` prints for all scenes of tests/reference that it takes the error of ratio and log-sensitivity
and the stated error (all relative), then designs per second on one core. ``--scenes N --seed K`` draws N random scenes instead,
compares them with ``axisymmetric``, or off the axis ``equivalent-inclusion``, and prints the quantiles of the true errors of
ratio, stresses, stiffness and log-sensitivity and of true over stated error, which must stay below 1.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

from geometry import Contact, CylinderTissue, Inclusion, InputError, Load, Material, Probe, Scene, read_scene
from solver import evaluate
from solver.closed_form import BALL, PROBE, TISSUE, ClosedForm, forces, parameters
from solver.film_forces import outputs

REFERENCE = Path(__file__).parents[1] / "tests" / "reference"
FOLDERS = ("axisymmetric", "extra", "extreme", "half-space", "off-axis", "solid")
DESIGNS = 8192


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=0)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    if options.scenes:
        audit(options.scenes, options.seed)
        return
    references()
    for folder, name in (("axisymmetric", "deep-small-tumour"), ("axisymmetric", "shallow"), ("solid", "flank")):
        print(f"{folder}/{name}: {designs_per_second(read_scene(REFERENCE / folder / f'{name}.toml')):.0f} designs a second")


def references() -> None:
    """Print the table scene by scene, and how many of those covered by a quarter of their diameter meet the goal."""
    print("| scene | cover/D | side/Ro | ratio | log_sensitivity | stated |\n|---|---|---|---|---|---|")
    met = [row for row in (_row(*case) for folder in FOLDERS for case in _cases(folder)) if row is not None]
    good = [sum(row[i] for row in met) for i in (0, 1)]
    print(f"cover >= D/4: {len(met)} scenes, {good[0]} within 5 % in ratio, {good[1]} within 15 % in log_sensitivity")


def _cases(folder: str) -> Iterator[tuple[str, Scene, dict[str, Any]]]:
    for name, values in json.loads((REFERENCE / folder / "expected.json").read_text()).items():
        yield f"{folder}/{name}", read_scene(REFERENCE / folder / f"{name}.toml"), values


def _row(name: str, scene: Scene, values: dict[str, Any]) -> tuple[bool, bool] | None:
    """Print a row; return whether ratio and sensitivity meet the goal, None where it does not apply."""
    if any(body.diameter is None for body in scene.inclusion):
        return None
    cover = min((body.depth / body.diameter - 0.5 for body in scene.inclusion if body.diameter), default=np.inf)
    tissue = scene.tissue
    side = np.inf if tissue.shape == "half-space" else tissue.radius if tissue.shape == "cylinder" else tissue.breadth / 2
    start = f"| {name} | {cover:.2g} | {side / scene.probe.tube_radius:.3g} |"
    try:
        found = evaluate(scene, "closed-form")
    except InputError as refused:
        print(start, "refused:", str(refused).split("allowed: ")[-1], "| | |")
        return None if cover < 0.25 else (False, False)
    ratio, exact = (found.ratio or 0.0) / values["ratio"] - 1, values.get("log_sensitivity")
    slope = (found.log_sensitivity or 0.0) / exact - 1 if exact else None
    told = "" if slope is None else f"{slope:+.1%}"
    print(start, f"{ratio:+.2%} | {told} | {found.error_estimate or 0:.1%} |")
    small = slope is None or abs(slope) <= 0.15 or abs(exact or 0.0) < 1e-5
    return None if cover < 0.25 else (abs(ratio) <= 0.05, small)


def designs_per_second(scene: Scene) -> float:
    """Evaluate designs round a scene's, all lengths and moduli varied by up to 5 %, with derivative by E_object."""
    shape, values = parameters(scene)
    rng = np.random.default_rng(3)
    designs = values[:, None] * np.exp(rng.uniform(-0.05, 0.05, (len(values), DESIGNS)))
    names = (*PROBE, *TISSUE, *BALL * len(shape.on_axis))
    fixed = [i for i, name in enumerate(names) if name.endswith("poisson")]  # varied they might reach 1/2
    designs[fixed] = values[fixed, None]
    best = np.inf
    for _ in range(3):
        start = process_time()
        forces(shape, designs)
        best = min(best, process_time() - start)
    return DESIGNS / best


def audit(count: int, seed: int) -> None:
    """Print quantiles of true and stated errors of random scenes."""
    rng = np.random.default_rng(seed)
    found: list[dict[str, tuple[float, float]]] = []
    drawn = 0
    while len(found) < count:
        drawn += 1
        pairs = compared(rng)
        if pairs is not None:
            found.append(pairs)
    print(f"{len(found)} scenes of {drawn} drawn; the rest do not fit together or are refused")
    for name in ("ratio", "stresses", "stiffness", "log_sensitivity"):
        true, stated = np.array([pairs[name] for pairs in found if name in pairs]).T
        for text, values in (("true error", true), ("stated error", stated), ("true / stated", true / stated)):
            many = f"median {np.median(values):.3g}, 90 % below {np.quantile(values, 0.9):.3g}, largest {values.max():.3g}"
            print(f"{name}, {len(true)} scenes, {text}: {many}")


def compared(rng: np.random.Generator) -> dict[str, tuple[float, float]] | None:
    """Return the true and the stated error of one random scene's quantities: relative, the sensitivity's absolute."""
    try:
        scene = draw(rng)
        films, error = ClosedForm().films(scene)
        beside = any(body.x for body in scene.inclusion)
        exact = evaluate(scene, "equivalent-inclusion" if beside else "axisymmetric", 0.01 if beside else 0.003)
    except InputError:
        return None
    if exact.ratio is None or exact.error_estimate is None:
        return None
    told = outputs(scene, films)
    stresses = max(abs(told[key] / getattr(exact, key) - 1) for key in ("stress_inner", "stress_outer"))
    largest = max(np.expm1(error.log_totals))
    found = {
        "ratio": (abs(told["ratio"] / exact.ratio - 1), films.ratio_error),
        "stresses": (stresses, largest),
        "stiffness": (abs(told["stiffness"] / exact.stiffness - 1), largest),
    }
    if exact.log_sensitivity and not any("log_sensitivity" in text for text in exact.warnings):
        least = max(0.05 * abs(told["log_sensitivity"]), 1e-5)  # what no warning tells of
        found["log_sensitivity"] = (abs(told["log_sensitivity"] - exact.log_sensitivity), max(error.sensitivity, least))
    return found


def draw(rng: np.random.Generator) -> Scene:
    """Draw a scene; raises ``InputError`` where its parts do not fit."""

    def between(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    def material(modulus: float) -> dict[str, Any]:
        return {"youngs_modulus": modulus, "poisson_ratio": float(rng.choice([rng.uniform(0, 0.49), 0.45, 0.48, 0.499, 0.4999]))}

    radius, tissue = between(0.1e-3, 20e-3), between(5e2, 2e4)
    size = radius * between(0.3, 10)
    cover, beside = between(0.1, 3) * size, rng.random() < 0.35
    try:
        probe = Probe(
            inner_radius=radius,
            area_ratio=between(0.02, 50),
            gap=min(max(between(0.001, 0.5) * radius, 1e-6), 5e-3),
            inner_height=radius * between(0.05, 20),
            outer_height=radius * between(0.05, 20),
            inner=Material(**material(tissue * between(0.1, 1e4))),
            outer=Material(**material(tissue * between(0.1, 1e4))),
        )
        offset = probe.tube_radius * between(0.1, 3) if beside else 0.0
        sphere = Inclusion(diameter=size, depth=cover + size / 2, x=offset, **material(tissue * between(1e-4, 1e4)))
        return Scene(
            probe=probe,
            tissue=CylinderTissue(
                shape="cylinder",
                radius=max(probe.tube_radius * between(1.05, 20), offset + 0.55 * size),
                depth=max(between(0.3, 15) * probe.tube_radius, (size + cover) * between(1.02, 3)),
                **material(tissue),
            ),
            inclusion=() if rng.random() < 0.05 else (sphere,),
            contact=Contact(interface="bonded" if rng.random() < 0.6 else "frictionless"),
            load=Load(indentation=1e-7),
        )
    except ValueError as misfit:
        raise InputError("scene", "drawn", str(misfit)[:60]) from None


if __name__ == "__main__":
    main()
