"""Measure the trade of pytetwild's settings on one scene, beside netgen: seconds, mesh checks, true error of the film forces.

Usage: ``python -m benchmarks.solid.tetwild_settings [--name flank] [--fineness rough]``; some minutes. One trial each, never
repeated where a check fails. Seconds are the processor's while meshing; the error is that of the ratio on this one mesh.

Duration: minutes.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from dataclasses import replace
from typing import Any
from unittest.mock import patch

import numpy as np
from rich.console import Console

from benchmarks.evaluators.solid_references import scenes
from benchmarks.solid.changes import processor
from benchmarks.tables import MeasuredTable
from geometry import Scene
from geometry.common.errors import SolveError
from geometry.processes.child import Failure
from geometry.tetra import irregular_mesh, mesher
from geometry.tetra.layout import build_layout, find_extent
from geometry.tetra.mesh_check import check_mesh, find_max_error
from geometry.tetra.sizing import COARSE_FINENESS, ROUGH_FINENESS, TetraFineness
from solver.axisymmetric.converged_forces import compute_converged_forces
from solver.solid.difference import solve_difference
from solver.solid.domain import choose_domain, compute_reach

FINENESS = {"rough": ROUGH_FINENESS, "coarse": COARSE_FINENESS}
SIZES = "rim", "block", "wall", "sphere", "layer", "growth"
SETTINGS: Mapping[str, tuple[dict[str, float], float]] = {  # constants of the mesher, and a factor on all sizes
    "as it is": ({}, 1.0),
    "envelope halved": ({"_ENVELOPE_FRACTION": 0.075}, 1.0),
    "envelope doubled": ({"_ENVELOPE_FRACTION": 0.3}, 1.0),
    "envelope four times": ({"_ENVELOPE_FRACTION": 0.6}, 1.0),
    "stop energy 30": ({"_STOP_ENERGY": 30.0}, 1.0),
    "stop energy 100": ({"_STOP_ENERGY": 100.0}, 1.0),
    "10 iterations": ({"_MAX_ITERATIONS": 10}, 1.0),
    "edges 1.25 times": ({}, 1.25),
    "netgen": ({}, 1.0),
}


def trials(scene: Scene, fineness: TetraFineness, true: float) -> Iterator[tuple[Any, ...]]:
    domain = choose_domain(scene, compute_reach(scene), None)
    layout = build_layout(domain.scene, domain.half, find_extent(domain.scene, None), domain.radius)
    exact = compute_converged_forces(domain.reference, 1e-4).films[0].forces
    for name, (constants, factor) in SETTINGS.items():
        sizes = replace(fineness, **{key: factor * getattr(fineness, key) for key in SIZES})
        with ExitStack() as stack:
            for constant, value in constants.items():
                stack.enter_context(patch.object(irregular_mesh, constant, value))
            chosen, start = mesher.NETGEN_MESHER if name == "netgen" else mesher.TETWILD_MESHER, processor()
            try:
                mesh = chosen.trial(layout, sizes, 0)
            except (SolveError, Failure) as fault:
                yield name, processor() - start, None, None, None, str(fault)[:60]
                continue
        seconds, passed = processor() - start, "passed"
        try:
            check_mesh(mesh, layout)
            change, _ = solve_difference(domain, mesh)
        except SolveError as fault:
            yield name, seconds, len(mesh.elements), find_max_error(mesh, layout), None, str(fault)[:60]
            continue
        inner, outer = (exact + change.forces[0]).sum(axis=1)
        error = abs(float(inner / outer) * scene.probe.outer_area / scene.probe.inner_area / true - 1)
        yield (
            name,
            seconds,
            len(mesh.elements),
            find_max_error(mesh, layout),
            error,
            f"{passed}, quality {np.min(mesh.quality):.2f}",
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--name", default="flank", help="of tests/reference/solid, with tissue round about the probe")
    parser.add_argument("--fineness", choices=tuple(FINENESS), default="rough")
    given = parser.parse_args()
    ((_, scene, known),) = scenes(["solid"], [given.name])
    columns = ("settings", "meshing, processor, s", "tetrahedra, count", "volumes, error", "ratio, error", "checks")
    table = MeasuredTable(f"{given.name}, {given.fineness} mesh", columns)
    for row in trials(scene, FINENESS[given.fineness], known["ratio"]):
        table.add(*row)
    table.print(Console(width=150))


if __name__ == "__main__":
    main()
