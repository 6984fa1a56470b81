"""Print the closed form's true and stated error for each reference scene, and its speed.

``python -m benchmarks.closed_form.accuracy`` prints for all scenes of tests/reference that it takes the error of ratio and
log-sensitivity and the stated error (all relative), those on layers apart, then designs per second on one core, also on skins.
``error.py`` audits the stated errors.

Duration: a minute.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

from geometry import InputError, Scene, read_scene
from geometry.common.arrays import Floats
from geometry.scenes.scene_tables import Layer
from solver import evaluate
from solver.closed_form.designs import (
    LAYER_PARAMETERS,
    PROBE_PARAMETERS,
    SPHERE_PARAMETERS,
    TISSUE_PARAMETERS,
    Shape,
    build_parameters,
    compute_forces,
)

REFERENCE = Path(__file__).parents[2] / "tests" / "reference"
FOLDERS = ("axisymmetric", "extra", "extreme", "half-space", "off-axis", "solid")
LAYERED = ("tissue-layers",)
SKINS = (0.05, 0.3)  # thicknesses in outer radii, five times as stiff as the tissue
DESIGNS = 8192


def main() -> None:
    argparse.ArgumentParser(description=__doc__).parse_args()
    references(FOLDERS)
    references(LAYERED)
    for folder, name in (("axisymmetric", "deep-small-tumour"), ("axisymmetric", "shallow"), ("solid", "flank")):
        scene = read_scene(REFERENCE / folder / f"{name}.toml")
        rates = [
            designs_per_second(tissue_scene) for tissue_scene in (scene, *(add_skin(scene, thickness) for thickness in SKINS))
        ]
        skins = ", ".join(
            f"{speed:.0f} under a skin of {thickness:g} Ro" for speed, thickness in zip(rates[1:], SKINS, strict=True)
        )
        print(f"{folder}/{name}: {rates[0]:.0f} designs per second, {skins}")


def add_skin(scene: Scene, thickness: float) -> Scene:
    """Return the scene with a layer on top, five times as stiff as the tissue; ``thickness`` in outer radii."""
    tissue = scene.tissue
    layer = Layer(
        thickness=thickness * scene.probe.tube_radius,
        youngs_modulus=5 * tissue.youngs_modulus,
        poisson_ratio=tissue.poisson_ratio,
    )
    return scene.model_copy(update={"tissue": tissue.model_copy(update={"layer": (layer,)})})


def references(folders: tuple[str, ...]) -> None:
    """Print the table scene by scene, and how many of those covered by a quarter of their diameter meet the goal."""
    print("| scene | cover/D | side/Ro | ratio | log_sensitivity | stated |\n|---|---|---|---|---|---|")
    met = [row for row in (_row(*case) for folder in folders for case in _cases(folder)) if row is not None]
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
        result = evaluate(scene, "closed-form")
    except InputError as refused:
        print(start, "refused:", str(refused).split("allowed: ")[-1], "| | |")
        return None if cover < 0.25 else (False, False)
    ratio, exact = (result.ratio or 0.0) / values["ratio"] - 1, values.get("log_sensitivity")
    derivative = (result.log_sensitivity or 0.0) / exact - 1 if exact else None
    slope_text = "" if derivative is None else f"{derivative:+.1%}"
    print(start, f"{ratio:+.2%} | {slope_text} | {result.error_estimate or 0:.1%} |")
    small = derivative is None or abs(derivative) <= 0.15 or abs(exact or 0.0) < 1e-5
    return None if cover < 0.25 else (abs(ratio) <= 0.05, small)


def designs_per_second(scene: Scene) -> float:
    """Evaluate designs round a scene's, with derivative by E_object."""
    shape, designs = draw_designs(scene, DESIGNS)
    best = np.inf
    for _ in range(3):
        start = process_time()
        compute_forces(shape, designs)
        best = min(best, process_time() - start)
    return DESIGNS / best


def draw_designs(scene: Scene, number: int) -> tuple[Shape, Floats]:
    """Return designs round a scene's, all lengths and moduli varied by up to 5 %, and their structure."""
    shape, values = build_parameters(scene)
    rng = np.random.default_rng(3)
    designs = values[:, None] * np.exp(rng.uniform(-0.05, 0.05, (len(values), number)))
    names = (*PROBE_PARAMETERS, *TISSUE_PARAMETERS, *SPHERE_PARAMETERS * len(shape.on_axis), *LAYER_PARAMETERS * shape.layers)
    fixed = [i for i, name in enumerate(names) if name.endswith("poisson")]  # varied they might reach 1/2
    designs[fixed] = values[fixed, None]
    return shape, designs


if __name__ == "__main__":
    main()
