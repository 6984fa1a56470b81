"""Make ``tests/reference/contact/ngsolve.json``: ratio, force, log-sensitivity and closest walls under load, by NGSolve.

The law is that of ``benchmarks/contact/ngsolve_pressing.py``. ``SETTINGS`` differ in order, mesh and penalties. What a mesh is
off at rest is taken off as a factor: the truth there is ``EXACT``, linear elements of order 7 with seven layers at all corners.
The value is their median, its uncertainty the largest difference from it.

Usage: ``python -m benchmarks.contact.references FILE``

Duration: an hour.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import ngsolve as ngs
import numpy as np

from benchmarks.contact.ngsolve_pressing import FIRST_INDENTATION, ContactSetting, PressedProbe
from benchmarks.peers.ngsolve_curve import solve_by_reusing
from benchmarks.peers.ngsolve_meridian import NGSolveProblem, make_mesh
from benchmarks.peers.ngsolve_settings import EXACT
from geometry import Scene, read_scene
from geometry.common.arrays import Floats

FOLDER = Path(__file__).resolve().parents[2] / "tests" / "reference" / "contact"
SETTINGS = (
    ContactSetting(4, 1.0, layers=1, mixed=True, tolerance=3e-5),
    ContactSetting(5, 1.5, layers=1, mixed=True, tolerance=3e-5, penalties=(1600.0, 6000.0)),
    ContactSetting(4, 1.5, layers=1, mixed=True, tolerance=3e-5),
)
INDENTATIONS = {  # mm
    "example": (0.4, 0.8, 1.25, 2.0),
    "equal-blocks-6kpa": (0.8, 1.25, 2.0),
    "yeoh": (0.4, 0.8),
}
LAW = "W = mu/2 (x + c2 x^2 + c3 x^3) + K/4 (J^2 - 1 - 2 ln J), x = J^(-2/3) I1 - 3"
STEP_MM = 0.1  # mm, of loads on the way
KEPT_VALUES = ("ratio", "force", "log_sensitivity", "closest_walls")


def compute_at_rest(scene: Scene) -> Floats:
    """Return ratio, stiffness and log-sensitivity by linear elements, N and m."""
    curve = solve_by_reusing(scene, EXACT, np.array([scene.inclusion[0].youngs_modulus])).curve
    problem = NGSolveProblem(scene, make_mesh(scene, EXACT), EXACT.order)
    matrix, pressed = problem.form().mat, problem.lifts[0].CreateVector()
    pressed.data = problem.lifts[0] + problem.lifts[1]
    state = problem.solve(matrix, matrix.Inverse(problem.free, "sparsecholesky"), pressed)
    stiffness = scene.probe.inner_radius * ngs.InnerProduct((matrix * state).Evaluate(), pressed)
    return np.array([curve.ratio[0], stiffness, curve.log_sensitivity[0]])


def values(problem: PressedProbe) -> Floats:
    """Return ``KEPT_VALUES`` of the last state, N and m."""
    probe, films = problem.scene.probe, problem.films()
    unit, length = problem.scene.tissue.youngs_modulus * probe.inner_radius**2, probe.inner_radius
    ratio = films[0] / films[1] * probe.outer_area / probe.inner_area
    return np.array([ratio, unit * films.sum(), problem.log_sensitivity(films), length * problem.closest_walls()])


def rows(scene: Scene, setting: ContactSetting, depths: tuple[float, ...], exact: Floats) -> list[Floats]:
    """Return ``KEPT_VALUES`` at depths, mm, as far as they are reached."""
    problem, unit, row_values = PressedProbe(scene, setting), 1e3 * scene.probe.inner_radius, list[Floats]()
    problem.press(FIRST_INDENTATION)
    factors = np.append(exact / (values(problem)[:3] / [1.0, FIRST_INDENTATION * scene.probe.inner_radius, 1.0]), 1.0)
    try:
        for depth in np.unique(np.round([*np.arange(STEP_MM, depths[-1], STEP_MM), *depths], 6)).tolist():
            problem.press(depth / unit)
            if depth in depths:
                row_values.append(factors * values(problem))
                print(setting, depth, row_values[-1].tolist(), problem.steps, file=sys.stderr, flush=True)
    except ArithmeticError as fault:
        print(setting, fault, file=sys.stderr, flush=True)
    return row_values


def entry(name: str) -> dict[str, object]:
    """Return a scene's rows as the file has them."""
    scene, depths = read_scene(FOLDER / f"{name}.toml"), INDENTATIONS[name]
    exact = compute_at_rest(scene)
    all_rows, entries = [rows(scene, setting, depths, exact) for setting in SETTINGS], []
    for depth, *several in zip(depths, *all_rows, strict=False):
        value = np.median(several, axis=0)
        spread = np.abs(several - value).max(axis=0)
        row = {"indentation": round(1e-3 * depth, 9)}
        row |= {key: float(f"{x:.6g}") for key, x in zip(KEPT_VALUES, value, strict=True)}
        entries.append(row | {f"{key}_unc": float(f"{x:.2g}") for key, x in zip(KEPT_VALUES, spread, strict=True)})
    at_zero_load = dict(zip(("ratio", "stiffness", "log_sensitivity"), (float(f"{x:.7g}") for x in exact), strict=True))
    return {
        "law": LAW,
        "small_load": at_zero_load,
        "rows": entries,
    }


def main(path: Path) -> None:
    """Write the file."""
    ngs.SetNumThreads(1)
    path.write_text(json.dumps({name: entry(name) for name in INDENTATIONS}, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
