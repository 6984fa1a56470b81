"""Measure how exact tumours' effects under load are that are added to a loaded state without them (eq. CT.10).

    python -m benchmarks.contact.tumours_under_load [--scenes 70] [--seed 1] [--rows FILE]

Scenes are drawn with one sphere on the axis: probes of 4 to 12 mm radius on tissue of 2 to 20 kPa, a quarter below a skin, a
third with films between bonds; spheres of 3 to 14 mm below 0.25 to 2 diameters of tissue, contrasts 0.1 to 100. There ``contact``
has the tumour in its mesh and computes all of its effects; the same mesh with a sphere of the tissue's modulus is the state
without it, so that the mesh's error cancels. Each scene is pressed to 0.1, 0.2, 0.3 and 0.45 outer radii, as far as both go.

With ``--rows`` the errors of each scene are kept in a file of JSON lines, from which the next run continues.

The table gives the errors of the change of ln ratio and of the log-sensitivity, relative to the change and per indentation in
outer radii (``MODEL_ERRORS_PER_X`` bounds them), how many exceed what is stated, and how many do so by more than ``contact``'s
own two meshes differ.

Duration: an hour for 70 scenes.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from dataclasses import replace
from math import exp, log
from pathlib import Path

import numpy as np
from numpy.random import Generator
from rich.console import Console

from benchmarks.tables import MeasuredTable
from geometry import Scene
from geometry.common.arrays import Floats
from geometry.common.errors import InputError, SolveError
from solver.contact.loaded_scene import LoadedScene
from solver.contact.pressed_tissue import compute_linear_changes
from solver.contact.tumours_anywhere import prepare_tissue
from solver.equivalent_inclusion.readings import compute_readings
from solver.inclusions.tumours import Tumours

INDENTATIONS_OUTER_RADII = 0.1, 0.2, 0.3, 0.45
NEARLY_ONE = 1.001  # contrast of a sphere that keeps the mesh and hardly changes the readings
ACCURACY = 0.003  # of the linear readings


def draw_scene(generator: Generator) -> Scene:
    """Return a scene with a sphere on the axis."""

    def draw(low: float, high: float) -> float:
        """Return a number whose logarithm is evenly distributed."""
        return exp(generator.uniform(log(low), log(high)))

    radius, modulus, diameter = draw(4, 12), draw(2e3, 20e3), draw(3, 14)  # mm, Pa, mm
    poisson, cover = float(generator.choice([0.4, 0.45, 0.49])), draw(0.25, 2) * diameter
    tissue: dict[str, object] = {"shape": "cylinder", "youngs_modulus": f"{modulus} Pa", "poisson_ratio": poisson}
    if generator.random() < 0.25:
        skin = draw(0.5, 3)
        tissue["layer"] = [{"thickness": f"{skin} mm", "youngs_modulus": f"{modulus * draw(1, 10)} Pa", "poisson_ratio": poisson}]
        cover = max(cover, 1.05 * skin + 0.02 * diameter)
    tissue |= {"radius": f"{max(45, 6 * radius)} mm", "depth": f"{max(50, cover + diameter + 20, 5 * radius)} mm"}
    blocks = {name: {"youngs_modulus": f"{draw(5e4, 2e6)} Pa", "poisson_ratio": 0.48} for name in ("inner", "outer")}
    core = generator.uniform(0.4, 0.8) * radius
    gap = min(draw(0.05, 0.8), 0.5 * (0.95 * radius - core))
    sizes = {"inner_radius": core, "outer_radius": radius, "gap": gap, "height": draw(2, 8)}
    probe: dict[str, object] = {key: f"{size} mm" for key, size in sizes.items()}
    probe |= {**blocks, "base": {"rigid": True}}
    if generator.random() < 0.33:
        bonds = {"bond_to_base": {"name": "tape-50um"}, "bond_to_block": {"name": "epoxy-20um"}}
        probe["film"] = {"thickness": "52 um", "youngs_modulus": "3 GPa"} | bonds
    sphere = {
        "diameter": f"{diameter} mm",
        "depth": f"{cover + diameter / 2} mm",
        "youngs_modulus": f"{modulus * draw(0.1, 100)} Pa",
        "poisson_ratio": poisson,
    }
    return Scene.from_dict({"probe": probe, "tissue": tissue, "inclusion": [sphere], "load": {"force": "1 mN"}})


def compute_errors(scene: Scene) -> Iterator[Floats]:
    """Yield for each load and output an array, shape (2, 7), with rows for the change of ln ratio and the log-sensitivity.

    Its columns are the error, what the compared meshes differ by, the error that is stated, the true value, what it is linearly,
    what the load adds, and the indentation in outer radii.
    """
    body, target = scene.inclusion[0], 0
    host = scene.tissue.find_material(body.depth).youngs_modulus
    neutral = scene.model_copy(update={"inclusion": (body.model_copy(update={"youngs_modulus": NEARLY_ONE * host}),)})
    # without the check of corners, which concerns the state without tumours
    true, reference = (replace(LoadedScene.from_scene(meshed, 0.01), corner_check=None) for meshed in (scene, neutral))
    tissue, tumours = prepare_tissue(scene, ACCURACY), Tumours.from_scene(scene)
    tissue = replace(tissue, loaded=replace(tissue.loaded, corner_check=None))
    linear = compute_readings(tissue.base, tumours, target, reflect=True, sensitive=True)
    at_rest = compute_linear_changes(tissue.base, linear)
    for x in INDENTATIONS_OUTER_RADII:
        force = reference.press_to_indentation(x * scene.probe.tube_radius).point.force
        changes = tissue.press(force).compute_changes(linear, tumours, target)
        for part, readings in enumerate(linear.parts):
            coarse, fine = (_compute_expected(true, reference, force, part, mesh) for mesh in (0, 1))
            computed, unloaded = changes.ratios[:, 0, part], at_rest[:, 0, 2 * part] - at_rest[:, 0, 2 * part + 1]
            linear_errors = np.array([readings.log_ratio_bound[0], float(readings.sensitivity_error[0])])
            stated = changes.ratio_errors[:, 0, part] + linear_errors
            columns = np.abs(computed - fine), np.abs(coarse - fine), stated, fine, unloaded, computed - unloaded, np.full(2, x)
            yield np.stack(columns, axis=1)


def _compute_expected(true: LoadedScene, reference: LoadedScene, force: float, part: int, mesh: int) -> Floats:
    """Return the change of ln ratio and the log-sensitivity of an output on one mesh, shape (2,)."""
    outputs, bare = true.outputs[part], reference.outputs[part]
    loaded, unloaded = outputs.paths[mesh].press_to_force(force), bare.paths[mesh].press_to_force(force)
    change = log(abs(outputs.compute_ratio(loaded))) - log(abs(bare.compute_ratio(unloaded)))
    return np.array([change, outputs.compute_sensitivity(outputs.paths[mesh], loaded)])


def compute_scene_errors(seed: int, number: int) -> list[list[list[float]]]:
    """Return the errors of one drawn scene, as far as both solutions go: a list of ``compute_errors``' arrays."""
    rows = []
    try:
        for row in compute_errors(draw_scene(np.random.default_rng([seed, number]))):
            rows.append(row.tolist())
    except (InputError, SolveError):
        pass  # the larger loads of this scene are refused
    return rows


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=int, default=70)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--rows", type=Path)
    options = parser.parse_args()
    lines = options.rows.read_text().splitlines() if options.rows and options.rows.exists() else []
    scenes = [json.loads(line) for line in lines]
    for number in range(len(scenes), options.scenes):
        scenes.append(compute_scene_errors(options.seed, number))
        if options.rows:
            with options.rows.open("a") as file:
                print(json.dumps(scenes[-1]), file=file)
    values = np.array([row for scene in scenes for row in scene])
    title = f"{len(values)} outputs under load of {sum(map(bool, scenes))} scenes; {len(scenes)} drawn"
    table = MeasuredTable(
        title,
        (
            "quantity",
            "median, error",
            "0.9 quantile, error",
            "largest, error",
            "error over stated, 0.95 quantile",
            "above stated, count",
            "beyond the compared meshes' difference, count",
        ),
    )
    for k, name in enumerate(("change of ln ratio", "log-sensitivity")):
        error, uncertainty, stated, true, _, _, x = values[:, k].T
        relative, excess = error / x / np.abs(true), np.maximum(0.0, error - uncertainty) / stated
        quantiles = np.quantile(relative, [0.5, 0.9, 1.0]).tolist()
        table.add(
            name, *quantiles, float(np.quantile(error / stated, 0.95)), int((error > stated).sum()), int((excess > 1).sum())
        )
    table.print(Console(width=120))


if __name__ == "__main__":
    main()
