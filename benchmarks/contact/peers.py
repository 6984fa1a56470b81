"""Compare ``contact`` with NGSolve's ``ContactBoundary`` and CalculiX: twenty loads on examples/scene.toml, in one run.

    pip install -e '.[bench]'; apt-get install calculix-ccx
    python -m benchmarks.contact.peers [--part ours|ngsolve|calculix] [--repeats 3] [--json FILE]

Each presses to 2 mm in twenty loads and gives ratio and log-sensitivity at all; CalculiX presses to four of them and gives no
log-sensitivity. Errors are the largest at the indentations of ``tests/reference/contact``, whose own uncertainty is up to 0.13 %
of the ratio and 1.3 % of the log-sensitivity. Seconds are the processor's, on one thread, the least of the repeats, from the
scene to the last load, mesh included. NGSolve's settings are the cheapest of some that were tried with the
true values known, and some of smaller error.

Duration: half an hour.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from time import process_time

import ngsolve as ngs
import numpy as np
from rich.console import Console
from threadpoolctl import threadpool_limits

from benchmarks.contact import calculix_pressing
from benchmarks.contact.ngsolve_pressing import ContactSetting, PressedProbe
from benchmarks.peers.axisymmetric import ONE_THREAD
from benchmarks.peers.calculix_meridian import HOW_TO_GET, is_installed
from benchmarks.peers.calculix_mesh import Fineness
from benchmarks.tables import MeasuredTable
from geometry import Scene, read_scene
from geometry.common.arrays import Floats
from geometry.meridian.mesh_lines import MeridianFineness
from solver.axisymmetric.sections import build_sections
from solver.contact.evaluator import ContactEvaluator
from solver.contact.model import ContactModel
from solver.contact.path import Path as LoadPath

FOLDER = Path(__file__).parents[2] / "tests" / "reference" / "contact"
LOADS = (*(1e-4 * k for k in range(1, 12)), 1.25e-3, *(1e-4 * k for k in range(13, 21)))  # m; the references' are among them
PARTS = ("ours", "ngsolve", "calculix")
NGSOLVE = (
    ContactSetting(3, 1.5, mixed=True, tolerance=1e-4),
    ContactSetting(3, 1.5, layers=1, tolerance=1e-4),
    ContactSetting(3, 1.5, layers=1, mixed=True, tolerance=1e-4),
    ContactSetting(4, 1.5, layers=1, mixed=True, tolerance=1e-4),
)
CALCULIX = (Fineness(0.4, 1.5, 0.5), Fineness(0.2, 1.0, 0.35))
COLUMNS = ("code", "unknowns, count", "steps", "ratio off, error", "log-sensitivity off, error", "force off, error")


@dataclass(frozen=True)
class PressedRun:
    """A code's results at ``LOADS``; log-sensitivities are NaN where it has none."""

    ratio: Floats
    log_sensitivity: Floats
    force: Floats
    unknowns: int
    steps: int
    seconds: float


def scene() -> Scene:
    """Return the scene."""
    return read_scene(FOLDER / "example.toml")


def one_mesh(order: int) -> PressedRun:
    """Press on one mesh of this project, without an error estimate."""
    start, sections, probe = process_time(), build_sections(scene()), scene().probe
    path = LoadPath(
        ContactModel.from_section(sections.section, sections.materials, "bonded", MeridianFineness(1, 0, order)), sensitive=True
    )
    points = [path.press_to_indentation(load) for load in LOADS]
    seconds = process_time() - start
    films = np.array([point.films for point in points])
    ratio = films[:, 0] / films[:, 1] * probe.outer_area / probe.inner_area
    steps = sum(len(point.equilibrium.residuals) for point in path.points)
    derivatives = np.array([point.log_sensitivity for point in points])
    return PressedRun(ratio, derivatives, films.sum(axis=1), path.model.numbering.unknowns, steps, seconds)


def press_with_bounds() -> PressedRun:
    """Press on two meshes of this project, with error bounds, as ``probe-design load`` does before it looks for what ends."""
    start, probe = process_time(), scene().probe
    loaded_scene = ContactEvaluator().prepare_scene(scene(), 0.01)
    loaded_points = [loaded_scene.press_to_indentation(load) for load in LOADS]
    seconds = process_time() - start
    films = np.array([loaded.films.totals for loaded in loaded_points])
    ratio = films[:, 0] / films[:, 1] * probe.outer_area / probe.inner_area
    unknowns = sum(path.model.numbering.unknowns for path in loaded_scene.paths)
    steps = sum(len(point.equilibrium.residuals) for path in loaded_scene.paths for point in path.points)
    derivatives = np.array([loaded.films.log_sensitivity for loaded in loaded_points])
    return PressedRun(ratio, derivatives, films.sum(axis=1) * LOADS, unknowns, steps, seconds)


def press_by_ngsolve(setting: ContactSetting) -> PressedRun:
    """Press with NGSolve."""
    start, pressed_scene, films, derivatives = process_time(), scene(), [], []
    problem = PressedProbe(pressed_scene, setting)
    for load in LOADS:
        problem.press(load / pressed_scene.probe.inner_radius)
        films.append(problem.films())
        derivatives.append(problem.log_sensitivity(films[-1]))
    seconds, unit = process_time() - start, pressed_scene.tissue.youngs_modulus * pressed_scene.probe.inner_radius**2
    forces = unit * np.array(films)
    ratio = forces[:, 0] / forces[:, 1] * pressed_scene.probe.outer_area / pressed_scene.probe.inner_area
    return PressedRun(ratio, np.array(derivatives), forces.sum(axis=1), problem.unknowns, problem.steps, seconds)


def press_by_calculix(fineness: Fineness) -> PressedRun:
    """Press with CalculiX, to the references' loads alone."""
    pressed_scene, rows = scene(), [row["indentation"] for row in references()]
    run = calculix_pressing.press(pressed_scene, fineness, [depth / pressed_scene.probe.inner_radius for depth in rows])
    blanks, unit = np.full(len(LOADS), np.nan), pressed_scene.tissue.youngs_modulus * pressed_scene.probe.inner_radius**2
    ratio, force = blanks.copy(), blanks.copy()
    places = np.searchsorted(LOADS, np.array(rows) - 1e-9)
    ratio[places], force[places] = run.ratio, unit * run.force
    walls = run.walls * pressed_scene.probe.inner_radius
    for row, wall in zip(references(), walls, strict=True):
        print(
            f"closest walls at {1e3 * row['indentation']:g} mm: {1e6 * wall:.2f} um, reference {1e6 * row['closest_walls']:.2f}"
        )
    return PressedRun(ratio, blanks, force, run.unknowns, 0, run.seconds)


def references() -> list[dict[str, float]]:
    """Return the rows of the references up to the last load."""
    rows = json.loads((FOLDER / "expected.json").read_text(encoding="utf-8"))["example"]["rows"]
    return [row for row in rows if row["indentation"] <= LOADS[-1]]


def errors(run: PressedRun) -> list[float | None]:
    """Return the largest errors of ratio, log-sensitivity and force, relative."""
    rows = references()
    places = np.searchsorted(LOADS, np.array([row["indentation"] for row in rows]) - 1e-9)
    largest = []
    for key in ("ratio", "log_sensitivity", "force"):
        error = np.abs(getattr(run, key)[places] / [row[key] for row in rows] - 1)
        largest.append(None if np.isnan(error).any() else float(error.max()))
    return largest


def measure(parts: list[str], repeats: int) -> Iterator[tuple[str, PressedRun]]:
    """Yield each code's name with its cheapest run."""
    trials: dict[str, list[tuple[str, Callable[[], PressedRun]]]] = {
        "ours": [
            ("ours, one mesh, order 2", lambda: one_mesh(2)),
            ("ours, one mesh, order 3", lambda: one_mesh(3)),
            ("ours, with its error bounds", press_with_bounds),
        ],
        "ngsolve": [(_name_setting(setting), lambda setting=setting: press_by_ngsolve(setting)) for setting in NGSOLVE],  # type: ignore[misc]
        "calculix": [
            (f"CalculiX, corners {mesh.corner:g}", lambda mesh=mesh: press_by_calculix(mesh))  # type: ignore[misc]
            for mesh in CALCULIX
        ],
    }
    for part in parts:
        if part == "calculix" and not is_installed():
            print(HOW_TO_GET, file=sys.stderr)
            continue
        for name, run in trials[part]:
            yield name, min((run() for _ in range(1 if part == "calculix" else repeats)), key=lambda fineness: fineness.seconds)


def _name_setting(setting: ContactSetting) -> str:
    kind = f"P{setting.order}/P{setting.order - 2}" if setting.mixed else f"P{setting.order}"
    return f"NGSolve, {kind}, size {setting.size:g}, {setting.layers} layers"


def main() -> None:
    """Run the chosen parts and print their table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--part", action="append", choices=PARTS, help="only this part")
    parser.add_argument("--repeats", type=int, default=3, help="of each run (3); CalculiX runs once")
    parser.add_argument("--json", type=Path, help="write the raw values to this file, times in seconds")
    chosen, console = parser.parse_args(), Console(width=150)
    ngs.SetNumThreads(1)
    table, base_seconds = MeasuredTable("twenty loads to 2 mm", (*COLUMNS, "processor, s", "over ours on one mesh, times")), 0.0
    with threadpool_limits(1):
        for name, run in measure(chosen.part or list(PARTS), chosen.repeats):
            base_seconds = base_seconds or run.seconds
            table.add(name, run.unknowns, run.steps or None, *errors(run), run.seconds, run.seconds / base_seconds)
            print(name, f"{run.seconds:.3g} s", file=sys.stderr, flush=True)
            if chosen.json is not None:
                chosen.json.write_text(json.dumps(table.as_json(), indent=1) + "\n", encoding="utf-8")
    table.note(", ".join(f"{name} {version(name)}" for name in ("ngsolve", "numpy")) + f", python {platform.python_version()}")
    table.print(console)


if __name__ == "__main__":
    if any(os.environ.get(key) != value for key, value in ONE_THREAD.items()):  # they count when libraries are loaded
        os.execve(sys.executable, [sys.executable, "-m", "benchmarks.contact.peers", *sys.argv[1:]], os.environ | ONE_THREAD)
    main()
