"""Profile one evaluation by ``axisymmetric``: the stages on the light mesh and on that of order 6.

``python -m benchmarks.extremes.stages`` prints the least processor time of 25 runs of each, on one thread, on the peers' first
scene; operations in millions where they are counted, and how fast products of many matrices of 48 x 48 are.

Duration: seconds.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from time import process_time
from timeit import repeat
from typing import Any

import numpy as np
from rich.console import Console

from benchmarks.peers.measured import NAMES, cases
from benchmarks.tables import MeasuredTable
from geometry.meridian.mesh import compute_nodes
from geometry.meridian.mesh_lines import MeridianFineness
from solver.axisymmetric.base_states import MeridianModel, build_model, integrate_elements, solve_base_states
from solver.axisymmetric.lower_order import (
    OWN_DEGREE_FACTOR_OF_ORDER,
    bound_by_descent,
    bound_by_last_degree,
    bound_by_lower_order,
)
from solver.axisymmetric.refinement import LIGHT_MESH, MESH_LEVELS
from solver.axisymmetric.sample import solve_on_mesh
from solver.axisymmetric.sections import build_sections
from solver.elements.quadrilateral import compute_geometry
from solver.elements.tensor_products import TensorSums
from solver.linalg.cholesky import factorise
from solver.linalg.memory import keep_freed
from solver.linalg.threads import limit_to_one_thread

RUN_COUNT = 25


def time_fastest(run: Callable[[], Any]) -> float:
    """Return the least processor time of some runs, s."""
    return min(repeat(run, timer=process_time, number=1, repeat=RUN_COUNT))


def stages(model: MeridianModel) -> dict[str, Callable[[], Any]]:
    """Return what makes a model, by name."""
    shapes = model.shapes
    integrate = partial(integrate_elements, model.mesh, model.geometry, shapes, model.law)
    matrices, pattern = list(integrate()), model.system.numbering.pattern
    return {
        "nodes and geometry": lambda: compute_geometry(compute_nodes(model.section, model.mesh, shapes.places), shapes),
        "integrals": lambda: list(integrate()),
        "insides eliminated": lambda: [part.condense() for part in matrices],
        "added up": lambda: model.system.numbering.assemble(model.system.stiffness),
        "factorised": lambda: factorise(model.system.matrix, pattern),
        "states": lambda: solve_base_states(model),
    }


def operations(model: MeridianModel) -> dict[str, float]:
    """Return how many multiplications and additions stages need, by name; rectangles' integrals, which are few, left out."""
    shapes, tables, n = model.shapes, model.shapes.tables, len(model.mesh.body)
    edge, pressures = 2 * shapes.skeleton, shapes.pressure.shape[1]
    inside = 2 * len(shapes.degrees) - edge
    entries = edge * edge + inside * edge + inside * inside
    volume = 2 * pressures * (pressures * (edge + inside) + entries + pressures**2)

    def sums(table: TensorSums, terms: int) -> int:
        points, pairs = table.y_tables[0].shape
        return int(2 * pairs * (points * points * terms + table.x_tables.size))

    shear = sums(tables.symmetric, 5) + sums(tables.symmetric, 4) + sums(tables.unsymmetric, 4)
    shear += sums(tables.dilation, 3) + sums(tables.dilation, 2)
    eliminated = inside**3 / 3 + inside * inside * edge + inside * edge * edge
    return {"integrals": (n - model.mesh.columns[-1]) * (shear + volume), "insides eliminated": n * eliminated}


def measure(fineness: MeridianFineness) -> MeasuredTable:
    """Return the stages of one mesh."""
    scene = cases(NAMES[:1])[0].scene
    sections = build_sections(scene)
    sample = solve_on_mesh(sections.section, sections, scene, fineness)
    model = sample.states.model
    all_stages = stages(model) | {
        "error, smaller space": lambda: bound_by_lower_order(sample),
        "error, one step": lambda: bound_by_descent(sample),
    }
    if fineness.order in OWN_DEGREE_FACTOR_OF_ORDER:
        all_stages["error, own part"] = lambda: bound_by_last_degree(sample)
    counted = operations(model)
    cells, unknowns = len(model.mesh.body), model.system.numbering.unknowns
    table = MeasuredTable(f"order {fineness.order}, {cells} cells, {unknowns} unknowns", ("stage", "least, ms", "operations"))
    for name, run in all_stages.items():
        table.add(name, time_fastest(run), f"{counted[name] / 1e6:.0f} M" if name in counted else "")
    table.add(
        "model, all of it", time_fastest(partial(build_model, sections.section, sections.materials, "bonded", fineness)), ""
    )
    return table


def main() -> None:
    """Print both meshes' tables."""
    keep_freed()
    matrices = np.random.default_rng(0).random((200, 48, 48))
    with limit_to_one_thread():
        print(f"products of 48 x 48: {200 * 2 * 48**3 / time_fastest(lambda: matrices @ matrices) / 1e9:.0f} Gflop/s")
        for fineness in (LIGHT_MESH, MESH_LEVELS[3]):
            measure(fineness).print(Console(width=100))


if __name__ == "__main__":
    main()
