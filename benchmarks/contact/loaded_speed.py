"""Measure what a load adds to the cost of readings over tumours anywhere.

    python -m benchmarks.contact.loaded_speed

By scene: the load path of the probe on its tissue without tumours, pressed and with the adjoint fields; 61 positions of a scan
linearly with all reflections, and what the load adds to them. Seconds of processor time of one thread, all in one run.

Duration: one minute.
"""

from __future__ import annotations

from pathlib import Path
from time import process_time

import numpy as np
from rich.console import Console

from benchmarks.tables import MeasuredTable
from geometry import Load, Scene, read_scene
from probe_design.maps.scan_line import ScanLine
from solver.contact.tumours_anywhere import prepare_tissue
from solver.equivalent_inclusion.probe_on_tissue import solve_undisturbed
from solver.equivalent_inclusion.readings import compute_readings

EXAMPLES = Path(__file__).parents[2] / "examples"
POSITIONS_M = np.linspace(-20e-3, 20e-3, 61)
ACCURACY = 0.01


def list_scenes() -> dict[str, Scene]:
    """Return scenes by what they are: the example probe, one of 8 mm under 0.3 N on tissue below a skin, two tumours."""
    example, skin, two = (read_scene(EXAMPLES / f"{name}.toml") for name in ("scene", "skin", "two-tumours"))
    wide = skin.replace({"probe.inner_radius": 8e-3, "tissue.youngs_modulus": 6e3})
    return {
        "examples/scene.toml, 0.1 N": example.replace({"load.force": 0.1}),
        "examples/skin.toml, inner radius 8 mm, tissue 6 kPa, 0.3 N": wide.replace({"load.force": 0.3}),
        "examples/two-tumours.toml, 0.3 N": two.model_copy(update={"load": Load(force=0.3)}),
    }


def measure(scene: Scene) -> tuple[float, float, float, float]:
    """Return seconds: linear solution of the tissue, its load path, positions linearly, and what the load adds to them."""
    times = [process_time()]
    solve_undisturbed(scene, 0.3 * ACCURACY)
    times.append(process_time())
    pressed = prepare_tissue(scene, ACCURACY).press(scene.load.force or 0.0)
    times.append(process_time())
    tumours = ScanLine(scene, "x", 0.0, ACCURACY).build_tumours(POSITIONS_M)
    linear = compute_readings(pressed.base, tumours, 0, reflect=True, sensitive=True)
    times.append(process_time())
    pressed.compute_readings(linear, tumours)
    times.append(process_time())
    base, path, positions, added = np.diff(times).tolist()
    return base, path, positions, added


def main() -> None:
    """Print the table."""
    columns = ("scene", "tissue linearly, s", "load path, s", "61 positions linearly, s", "added by the load, s", "together, s")
    table = MeasuredTable("readings under load", columns)
    for name, scene in list_scenes().items():
        times = measure(scene)
        table.add(name, *times, sum(times))
    table.print(Console(width=130))


if __name__ == "__main__":
    main()
