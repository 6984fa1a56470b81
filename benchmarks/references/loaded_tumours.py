"""Make rows of ``tests/reference/loaded``: what tumours off the axis change under finite strain, in three dimensions by NGSolve.

The problem is that of ``finite_strain_3d``. Each state is computed with and without the tumours on one mesh, so that most of
the mesh's error cancels. ln ratio and log-sensitivity with the tumours are interpolated by cubic splines to the force that the
probe without tumours has at the indentation. A row's ``value`` is ``raw_3d``, the effect at order 3, times what
``equivalent-inclusion`` has at rest (``linear``) over what the mesh has there (``rest_3d``). Its ``uncertainty`` is the largest
of three judgements: the change of ``value`` from order 2; a third of what the mesh is off at rest, which the growth may not
share, in proportion to the indentation up to 0.3 outer radii; 0.5 %, or 2 % from there on, where tissue folds onto the outer
block's wall (``FOLDING``).

``film_forces_mN`` are those of the inner and the outer film at the row's force. ``walls`` is the smallest distance of the gap's
walls over the gap; rows end where it is zero. ``overlap_mm`` is how deep the tissue's top is in the outer block's wall in the
plane of the tumours.

Usage: ``python -m benchmarks.references.loaded_tumours FOLDER [CASE ...]``; a file for each case, rewritten

Duration: four minutes per case.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import ngsolve as ngs
import numpy as np
from scipy.interpolate import CubicSpline

from benchmarks.references.finite_strain_3d import LoadedForces, LoadedProbe
from benchmarks.references.outline import Refinement
from geometry import Scene, read_scene
from geometry.scenes.scene_file import scene_to_toml
from solver import evaluate

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
MESHES = (Refinement(1.3, 2, 0), Refinement(1.3, 3, 0))
REST = 1e-4  # indentation in outer radii that is linear
INDENTATIONS = (0.1, 0.3, 0.45, 0.55, 0.65)  # outer radii
SCAN_INDENTATIONS = (0.1, 0.3, 0.45, 0.55, 0.641)  # likewise; the last takes 0.3 N
RELATIVE_FLOOR = 0.005  # of an effect's uncertainty: what growth with load differs by on two meshes at 0.1 outer radii
# indentation in outer radii, and the floor from there on: growth on the axis differs by 1.3 % at 0.6 and 3 % at 0.45 outer radii
# on three meshes of benchmarks/contact/ngsolve_pressing.py, of which one is finer than this program's at the rim
FOLDING = 0.3, 0.02
KEYS = ("value", "uncertainty", "raw_3d", "linear", "rest_3d")
NAMES = ("change_of_ln_ratio", "log_sensitivity")
Solution = tuple[np.ndarray, np.ndarray, list[LoadedForces]]  # effects (2, n), film forces (n, 2) in N, path


@dataclass(frozen=True)
class Case:
    """A scene, whose target is solved with several moduli (Pa), and indentations in outer radii."""

    scene: Scene
    moduli: tuple[float, ...]
    indentations: tuple[float, ...] = INDENTATIONS


def build_scene(*tumours: dict[str, Any], **changes: Any) -> Scene:
    """Return the example with other tumours; the first is the target. A tumour's ``x`` is in outer radii."""
    base = read_scene(EXAMPLES / "scene.toml").model_dump(exclude_unset=True) | changes
    radius = Scene.model_validate(base | {"inclusion": ()}).probe.tube_radius
    nu = {"poisson_ratio": base["tissue"]["poisson_ratio"]}
    bodies = [nu | body | {"x": body["x"] * radius, "target": k == 0} for k, body in enumerate(tumours)]
    return Scene.model_validate(base | {"inclusion": bodies})


def tumour(x: float, depth: float, youngs_modulus: float, diameter: float = 8e-3) -> dict[str, Any]:
    """Return a sphere; ``x`` in outer radii."""
    return {"diameter": diameter, "depth": depth, "x": x, "youngs_modulus": youngs_modulus}


def tissue(youngs_modulus: float, poisson_ratio: float = 0.45, **layers: Any) -> dict[str, Any]:
    """Return the example's cylinder of another material."""
    given = {"shape": "cylinder", "radius": 45e-3, "depth": 50e-3}
    return given | {"youngs_modulus": youngs_modulus, "poisson_ratio": poisson_ratio} | layers


def place_probe(x: float) -> Scene:
    """Return the example of two tumours with the probe at x, m."""
    scene = read_scene(EXAMPLES / "two-tumours.toml")
    return scene.model_copy(update={"placement": scene.placement.model_copy(update={"x": x})})


SKIN = ({"thickness": 2e-3, "youngs_modulus": 60e3, "poisson_ratio": 0.45},)
SOFT_CORE = {
    "inner_radius": 7e-3,
    "area_ratio": 1.2,
    "gap": 0.2e-3,
    "height": 5e-3,
    "inner": {"youngs_modulus": 80e3, "poisson_ratio": 0.48},
    "outer": {"youngs_modulus": 1e6, "poisson_ratio": 0.48},
    "base": {"rigid": True},
}
CASES = {
    "base-0.5": Case(build_scene(tumour(0.5, 8e-3, 30e3)), (30e3,)),
    "base-1.0": Case(build_scene(tumour(1.0, 8e-3, 30e3)), (30e3,)),
    "skin-0.5": Case(build_scene(tumour(0.5, 9e-3, 40e3), tissue=tissue(8e3, layer=SKIN)), (40e3,)),
    "soft-core-0.5": Case(build_scene(tumour(0.5, 12e-3, 30e3, 10e-3), probe=SOFT_CORE), (30e3,)),
    "two-tumours": Case(build_scene(tumour(0.8, 8e-3, 30e3), tumour(-0.8, 9e-3, 60e3, 6e-3)), (30e3,)),
    "incompressible-0.5": Case(build_scene(tumour(0.5, 8e-3, 30e3), tissue=tissue(6e3, 0.49)), (30e3,)),
    "scan-near": Case(place_probe(-12e-3), (60e3,), SCAN_INDENTATIONS),
    "scan-beside": Case(place_probe(-9e-3), (60e3,), SCAN_INDENTATIONS),
    "small-0.5": Case(build_scene(tumour(0.5, 5e-3, 30e3, 4e-3)), (30e3,)),
}


def set_modulus(scene: Scene, youngs_modulus: float) -> Scene:
    """Return a scene whose target has another modulus."""
    bodies = list(scene.inclusion)
    assert scene.target is not None  # of CASES
    bodies[scene.target] = bodies[scene.target].model_copy(update={"youngs_modulus": youngs_modulus})
    return scene.model_copy(update={"inclusion": tuple(bodies)})


def compute_effects(bare: list[LoadedForces], path: list[LoadedForces]) -> tuple[np.ndarray, np.ndarray]:
    """Return change of ln ratio and log-sensitivity at the forces of the path without tumours, (2, n), and film forces."""
    forces, by_depth, by_modulus = (
        np.array([getattr(state, name) for state in path]) for name in ("forces", "by_indentation", "by_ln_modulus")
    )
    total, ratios = forces.sum(axis=1), np.log(forces[:, 0] / forces[:, 1])
    turn = np.diff(by_modulus / forces, axis=1)[:, 0] * -1, np.diff(by_depth / forces, axis=1)[:, 0] * -1
    # At a force that is kept, a stiffer tumour lowers the indentation by dF/dlnE over dF/dz.
    sensitivity = turn[0] - turn[1] * by_modulus.sum(axis=1) / by_depth.sum(axis=1)
    wanted = np.array([state.forces.sum() for state in bare[: len(path)]])
    without = np.array([state.forces for state in bare[: len(path)]])
    ratio, slope = (_interpolate(total, values, wanted) for values in (ratios, sensitivity))
    films = np.stack([wanted / (1 + np.exp(-ratio)), wanted / (1 + np.exp(ratio))], axis=1)
    return np.stack([ratio - np.log(without[:, 0] / without[:, 1]), slope]), films


def _interpolate(forces: np.ndarray, values: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Interpolate by a cubic spline; the first value, at rest, is kept."""
    return np.append(values[0], CubicSpline(np.append(0.0, forces[1:]), values)(wanted[1:]))


def compute_rest(scene: Scene) -> np.ndarray:
    """Return what ``equivalent-inclusion`` has for both effects."""
    present, bare = (
        evaluate(each, "equivalent-inclusion", accuracy=1e-3, linear=True)
        for each in (scene, scene.model_copy(update={"inclusion": ()}))
    )
    assert present.ratio is not None  # the load is not zero
    assert bare.ratio is not None
    return np.array([np.log(present.ratio / bare.ratio), present.log_sensitivity], dtype=float)


def solve(case: Case, refinement: Refinement) -> tuple[list[LoadedForces], list[Solution]]:
    """Return the path without tumours, and for each modulus of the target its effects, film forces and path."""
    start, problem = time.perf_counter(), LoadedProbe(case.scene, refinement)
    print(refinement, problem.mesh.ne, "elements,", problem.space.ndof, "unknowns", file=sys.stderr, flush=True)
    bare, results = problem.press((REST, *case.indentations)), []
    assert case.scene.target is not None  # of CASES
    given = case.scene.inclusion[case.scene.target].youngs_modulus
    for modulus in case.moduli:
        problem.present.Set(1.0)
        problem.ln_contrast.Set(float(np.log(modulus / given)))
        path = problem.press(tuple(state.indentation / case.scene.probe.tube_radius for state in bare))
        results.append((*compute_effects(bare, path), path))
        print(f"{time.perf_counter() - start:.0f} s", len(bare), results[-1][0].tolist(), file=sys.stderr, flush=True)
    return bare, results


def compute_rows(name: str, case: Case) -> list[dict[str, Any]]:
    """Return a case's rows."""
    (_, coarse), (bare, fine) = (solve(case, refinement) for refinement in MESHES)
    rows = []
    for modulus, (rough, _, _), (effects, films, path) in zip(case.moduli, coarse, fine, strict=True):
        scene = set_modulus(case.scene, modulus)
        rest = compute_rest(scene)
        values, rough_values = (each * (rest / each[:, 0])[:, None] for each in (effects, rough))
        shared = np.abs(effects[:, 0] / rest - 1) / 3
        for k in range(1, min(effects.shape[1], rough.shape[1])):
            x, force = bare[k].indentation / scene.probe.tube_radius, float(bare[k].forces.sum())
            walls = min(bare[k].walls, path[k].walls)
            if walls <= 0:  # they pass through each other
                break
            loaded = scene.model_copy(update={"load": replace_force(scene, force)})
            row: dict[str, Any] = {"case": name, "youngs_modulus": modulus, "indentation_over_outer_radius": round(x, 4)}
            row |= {"force_mN": 1e3 * force, "scene": tomllib.loads(scene_to_toml(loaded))}
            for j, quantity in enumerate(NAMES):
                value, raw = values[j, k], effects[j, k]
                relative = max(FOLDING[1] if x > FOLDING[0] + 1e-6 else RELATIVE_FLOOR, shared[j] * min(1.0, x / 0.3))
                uncertainty = max(abs(value - rough_values[j, k]), relative * abs(value))
                numbers = (value, uncertainty, raw, rest[j], effects[j, 0])
                row[quantity] = dict(
                    zip(("value", "uncertainty", "raw_3d", "linear", "rest_3d"), map(_round, numbers), strict=True)
                )
            films_mn = {"with": 1e3 * films[k], "without": 1e3 * bare[k].forces}
            row["film_forces_mN"] = {key: [_round(force) for force in pair] for key, pair in films_mn.items()}
            row["walls"] = _round(walls)
            row["overlap_mm"] = _round(1e3 * max(bare[k].overlap, path[k].overlap))
            rows.append(row)
    return rows


def replace_force(scene: Scene, force: float) -> Any:
    """Return the load of a force, N, to a hundredth of a micronewton."""
    return type(scene.load)(force=round(force, 8))


def _round(value: float) -> float:
    return float(f"{value:.6g}")


def write(path: Path, rows: list[dict[str, Any]]) -> None:
    """Write rows with what they are, one row a line."""
    head = {
        "origin": "python -m benchmarks.references.loaded_tumours",
        "code": f"NGSolve {ngs.__version__}",
        "meshes": [f"size {each.size}, order {each.order}" for each in MESHES],
        "law": "W = mu/2 (J^(-2/3) I1 - 3) + K/4 (J^2 - 1 - 2 ln J)",
        "interface": "bonded; contact of the tissue's top with the outer block's wall",
        "uncertainty": "a judgement: the change from order 2, a third of what the mesh is off at rest, 0.5 or 2 %; no bound",
    }
    lines = ",\n".join(json.dumps(row) for row in rows)
    path.write_text(json.dumps(head)[:-1] + ', "rows": [\n' + lines + "\n]}\n", encoding="utf-8")


def main() -> None:
    """Write the files of the cases that are named, or of all."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("case", nargs="*", default=list(CASES), choices=list(CASES))
    options = parser.parse_args()
    ngs.SetNumThreads(1)
    options.folder.mkdir(parents=True, exist_ok=True)
    for name in options.case:
        write(options.folder / f"{name}.json", compute_rows(name, CASES[name]))


if __name__ == "__main__":
    main()
