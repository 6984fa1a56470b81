"""Measure tables of readings: time to build them, candidates a second, and errors against ``equivalent-inclusion``.

Two priors of one probe: narrow (depth 8-20 mm, diameter 5-12 mm, 16-32 kPa) and wide (5-25 mm, 4-16 mm, 8-160 kPa), in tissue of
5.3 kPa, with 2 mm of cover. Scans have 25 presses over 32 x 32 mm. Errors are of tumours drawn with another seed than the table's
own, relative to the largest signal of each tumour's scan; pairs are 0.5 mm or more apart, computed with all reflections and their
exchange. Seconds are of the processor. The last table compares the public ``evaluate_many`` with the arrays inside.

Duration: 3 minutes.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterator
from statistics import median
from time import process_time
from typing import Any

import numpy as np
from rich.console import Console

from benchmarks.tables import MeasuredTable
from geometry import Scene
from geometry.common.arrays import Floats
from geometry.common.cached_arrays import CACHE_VARIABLE
from solver import evaluate_many
from solver.closed_form.designs import build_parameters
from solver.closed_form.evaluator import solve_columns
from solver.equivalent_inclusion.evaluator import EquivalentInclusion
from solver.equivalent_inclusion.readings import compute_readings
from solver.inclusions.tumours import Tumours
from solver.reading_tables.build import read_or_build_table
from solver.reading_tables.reading_table import ReadingTable
from solver.reading_tables.tumour_ranges import TumourRanges

SCENE_TABLES: dict[str, Any] = {
    "probe": {
        "inner_radius": "6.26 mm",
        "outer_radius": "8.37 mm",
        "gap": "0.5 mm",
        "height": "1.25 mm",
        "inner": {"youngs_modulus": "1 MPa", "poisson_ratio": 0.48},
        "outer": {"youngs_modulus": "1 MPa", "poisson_ratio": 0.48},
        "base": {"rigid": True},
    },
    "tissue": {"shape": "cylinder", "radius": "50.5 mm", "depth": "60 mm", "youngs_modulus": "5.3 kPa", "poisson_ratio": 0.4},
    "inclusion": [{"diameter": "8 mm", "depth": "10 mm", "youngs_modulus": "25 kPa", "poisson_ratio": 0.45}],
    "contact": {"interface": "bonded"},
    "load": {"force": "10 mN"},
}
SCENE = Scene.from_tables(SCENE_TABLES)
RANGES = {
    "narrow": TumourRanges((8e-3, 20e-3), (5e-3, 12e-3), (16e3, 32e3), min_cover=2e-3),
    "wide": TumourRanges((5e-3, 25e-3), (4e-3, 16e-3), (8e3, 160e3), min_cover=2e-3),
}
HALF_SIDE, PRESSES = 16e-3, 5  # of the scanned square, m, and along each of its sides
CANDIDATES, CHECKED = 50_000, 40  # whose readings are timed, and compared
REPEATS = 5  # of each time
SCENES = 1000  # of ``evaluate_many``
SEED = 39


def build_positions() -> Floats:
    """Return the places of the presses, m, shape (25, 2)."""
    line = np.linspace(-HALF_SIDE, HALF_SIDE, PRESSES)
    return np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)


def draw_tumours(table: ReadingTable, count: int, bodies: int) -> Floats:
    """Return allowed candidates, drawn evenly in the table's cube and the square, shape (count, bodies, 5)."""
    random, chosen, cube = np.random.default_rng(SEED), np.empty((0, bodies, 5)), table.layers[0].cube
    while len(chosen) < count:
        points = random.uniform(-1, 1, (2 * count * bodies, 5))
        depth, diameter, modulus = cube.map_from_cube(points[:, 2:])
        depth = np.maximum(depth, cube.compute_shallowest(diameter))
        drawn = np.stack([*(HALF_SIDE * points[:, :2].T), depth, diameter, modulus], axis=-1).reshape(-1, bodies, 5)
        chosen = np.concatenate([chosen, drawn[table.is_allowed(drawn)]])
    return chosen[:count]


def compute_truth(candidates: Floats, positions: Floats) -> Floats:
    """Return signals by ``equivalent-inclusion`` with reflections, all tumours together, shape (n, k, 2)."""
    base = EquivalentInclusion().prepare(SCENE, 0.003)
    x, y, depth, diameter, modulus = np.moveaxis(np.repeat(candidates, len(positions), axis=0), -1, 0)
    places = np.tile(positions, (len(candidates), 1))
    tumours = Tumours(x - places[:, :1], y - places[:, 1:], depth, diameter, modulus, 0.45)
    readings, blank = compute_readings(base, tumours, reflect=True), base.films.totals
    ratio = np.log(readings.totals[:, 0] / readings.totals[:, 1] / (blank[0] / blank[1]))
    return np.stack([ratio, np.log(readings.stiffness / blank.sum())], axis=-1).reshape(len(candidates), len(positions), 2)


def measure_seconds(run: Callable[[], object]) -> float:
    """Return the median of the processor's seconds over some runs."""
    seconds = []
    for _ in range(REPEATS):
        start = process_time()
        run()
        seconds.append(process_time() - start)
    return median(seconds)


def measure_tables() -> Iterator[MeasuredTable]:
    """Yield the times and the errors of both tables."""
    columns = (
        "prior",
        "build, s",
        "from cache, ms",
        "one tumour per second, count",
        "two per second, count",
        "slopes per second, count",
    )
    times = MeasuredTable(f"Tables, and candidates of {PRESSES**2} presses a second", columns)
    error_columns = ("prior", "tumours", "signal", "stated, error", "rms, error", "median of worst, error", "worst, error")
    errors, positions = MeasuredTable("Errors against equivalent-inclusion with reflections", error_columns), build_positions()
    for name, ranges in RANGES.items():
        start = process_time()
        table = read_or_build_table(SCENE, ranges)
        build = process_time() - start
        cached = measure_seconds(lambda ranges=ranges: read_or_build_table(SCENE, ranges))  # type: ignore[misc]
        single, pairs = (draw_tumours(table, CANDIDATES // bodies, bodies) for bodies in (1, 2))
        speeds = [
            len(drawn) / measure_seconds(lambda run=run, drawn=drawn: run(drawn, positions))  # type: ignore[misc]
            for run, drawn in ((table.predict, single), (table.predict, pairs), (table.slopes, single))
        ]
        times.add(name, build, cached, *(round(speed) for speed in speeds))
        for bodies, count in ((1, CHECKED), (2, CHECKED // 4)):
            drawn = draw_tumours(table, count, bodies)
            truth = compute_truth(drawn, positions)
            deviations = np.abs(table.predict(drawn, positions) - truth)
            worst = deviations.max(axis=1) / np.abs(truth).max(axis=1)
            rms = np.sqrt((deviations**2).mean(axis=(0, 1)) / (truth**2).mean(axis=(0, 1)))
            for channel, label in enumerate(("ln ratio", "ln stiffness")):
                part = worst[:, channel]
                errors.add(name, bodies, label, table.error[channel], rms[channel], float(np.median(part)), part.max())
    yield times
    yield errors


def measure_many() -> MeasuredTable:
    """Return the scenes a second of the public call in closed form, and of the arrays inside, in one run."""
    random = np.random.default_rng(SEED)
    keys = ("probe.gap", "probe.height", "inclusion[0].youngs_modulus")
    values = random.uniform((0.2e-3, 1e-3, 16e3), (0.6e-3, 5e-3, 80e3), (SCENES, 3))
    scenes = [SCENE.replace(dict(zip(keys, row, strict=True))) for row in values.tolist()]
    parameters = [build_parameters(scene) for scene in scenes]
    shape, stack = parameters[0][0], np.column_stack([column for _, column in parameters])
    public, read, arrays = (
        SCENES / measure_seconds(run)
        for run in (
            lambda: evaluate_many(scenes, "closed-form"),
            lambda: list(evaluate_many(scenes, "closed-form")),
            lambda: solve_columns(shape, stack),
        )
    )
    table = MeasuredTable(
        "closed-form, scenes a second",
        ("evaluate_many, count", "every result read, count", "arrays inside, count", "part of the arrays' speed"),
    )
    table.add(round(public), round(read), round(arrays), f"{public / arrays:.2f}")
    return table


def main() -> None:
    """Print all tables."""
    console = Console()
    with tempfile.TemporaryDirectory() as folder:
        os.environ[CACHE_VARIABLE] = folder
        for table in (*measure_tables(), measure_many()):
            table.print(console)


if __name__ == "__main__":
    main()
