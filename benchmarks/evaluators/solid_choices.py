"""Measure the choices made in ``solid``: elements, correction and solver; docs/explanation/solid.md quotes what this prints.

    python -m benchmarks.evaluators.solid_choices

It takes some minutes; meshes of the scene come from the cache where they were made
before. pyamg is tried where it is installed. Seconds are of the processor, on one thread, medians of three.

Duration: minutes.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path
from statistics import median
from time import process_time
from typing import Any

import numpy as np
import scipy.sparse as sp
from rich.console import Console

from benchmarks.tables import MeasuredTable
from geometry import Scene, read_scene
from geometry.tetra.sizing import COARSE_FINENESS, ROUGH_FINENESS
from geometry.tetra.tet_mesh import TetMesh
from solver.axisymmetric.converged_forces import compute_converged_forces
from solver.linalg.cholesky import factorise
from solver.linalg.conjugate_gradients import Stiffness, solve
from solver.materials.linear import Isotropic
from solver.solid.base_states import SolidStates
from solver.solid.body_stiffness import assemble, integrate_part
from solver.solid.difference import solve_difference
from solver.solid.domain import choose_domain
from solver.solid.domain_mesh import mesh_domain

TESTS = Path(__file__).parents[2] / "tests"
BONDED_MODULUS_RATIOS = {
    0.3: 1.118576,
    0.49: 1.502552,
    0.4999: 1.544227,
}  # apparent modulus over modulus, R/h = 1, PHYSICS section 7
SCENE = "flank"


def main() -> None:
    for table in (elements(), *correction()):
        table.print(Console())


def elements() -> MeasuredTable:
    """Bonded cylinders: quadratic tetrahedra as they are, and with each element's dilation averaged."""
    table = MeasuredTable(
        "apparent modulus of a bonded cylinder, R/h = 1: errors", ("tetrahedra", "nu", "plain, error", "mean dilation, error")
    )
    for name in ("bonded-coarse", "bonded-fine"):
        data = np.load(TESTS / "meshes" / f"{name}.npz")
        nodes, tetrahedra = data["nodes"], data["elements"].astype(np.int64)
        for ratio, known in BONDED_MODULUS_RATIOS.items():
            errors = (apparent_modulus(nodes, tetrahedra, ratio, averaged) / known - 1 for averaged in (False, True))
            table.add(str(len(tetrahedra)), f"{ratio:g}", *errors)
    return table


def apparent_modulus(nodes: Any, tetrahedra: Any, ratio: float, averaged: bool) -> float:
    z, law = nodes[:, 2], Isotropic(1.0, ratio)
    held = (np.abs(z) < 1e-9) | (np.abs(z - 1) < 1e-9)
    number = np.full(nodes.shape, -1)
    number[~held] = np.arange(3 * np.sum(~held)).reshape(-1, 3)
    piece = integrate_part(nodes, tetrahedra, averaged)
    matrix = Stiffness(assemble({0: piece}, {0: law}, number))
    u = np.zeros((nodes.size, 1))
    u[2::3, 0] = np.where(z > 0.5, -1.0 * held, 0.0)
    free = number.ravel() >= 0
    u[free] = solve(matrix, -piece.compute_forces(law, u)[free], matrix.factor())
    return float((u.T @ piece.compute_forces(law, u)).item() / np.pi)


def correction() -> Iterator[MeasuredTable]:
    """One scene on two meshes: its ratio by itself and corrected by the reference; then its solvers."""
    scene = read_scene(TESTS / "reference" / "solid" / f"{SCENE}.toml")
    known = json.loads((TESTS / "reference" / "solid" / "expected.json").read_text())[SCENE]["ratio"]
    chosen = choose_domain(scene, np.inf, None)
    exact = compute_converged_forces(chosen.reference, 1e-3).films[0].forces
    heads = ("tetrahedra, count", "unknowns, count", "by itself, error", "corrected, error")
    table, solvers = MeasuredTable(f"{SCENE}: errors of the ratio", heads), []
    for fineness in (ROUGH_FINENESS, COARSE_FINENESS):
        print(f"{SCENE}: meshing and solving", file=sys.stderr, flush=True)
        mesh: TetMesh = mesh_domain(chosen, fineness)
        change, states = solve_difference(chosen, mesh)
        alone, added = change.reference + change.forces[0], exact + change.forces[0]
        table.add(len(mesh.elements), change.unknowns, ratio(scene, alone) / known - 1, ratio(scene, added) / known - 1)
        solvers.append(states)
    yield table
    for states in solvers:
        yield solver(states)


def ratio(scene: Scene, forces: Any) -> float:
    inner, outer = forces.sum(axis=1)
    return float(inner / outer * scene.probe.outer_area / scene.probe.inner_area)


def solver(states: SolidStates) -> MeasuredTable:
    """Factors and solutions of three states by the libraries that are there."""
    matrix, loads = states.problem.matrix, states.problem.loads
    full = sp.csc_array(matrix.lower + sp.tril(matrix.lower, -1).T)
    table = MeasuredTable(f"{len(loads)} unknowns, three states", ("library", "factor or set-up, s", "three solutions, s"))
    candidates: dict[str, Callable[[], Any]] = {
        "rslab, double precision": lambda: matrix.factor(),
        "rslab, single precision": lambda: matrix.factor(single=True),
    }
    if find_spec("pymklpardiso"):
        candidates["PARDISO"] = lambda: factorise(full, None)
    for name, make in candidates.items():
        factor, first = time_runs(make)
        table.add(name, first, time_runs(lambda factor=factor: solve(matrix, loads, factor))[1])  # type: ignore[misc]
    if find_spec("pyamg"):
        table.add("pyamg, smoothed aggregation and CG", *multigrid(full, loads, states))
    return table


def multigrid(full: Any, loads: Any, states: SolidStates) -> tuple[float, float]:
    import pyamg

    number = states.problem.supports.number
    free, x = number >= 0, states.problem.solid.nodes
    rigid = np.zeros((len(loads), 6))
    for axis in range(3):
        rigid[number[free[:, axis], axis], axis] = 1.0
        turn = np.cross(np.eye(3)[axis], x)
        rigid[number[free], 3 + axis] = turn[free]
    levels, made = time_runs(lambda: pyamg.smoothed_aggregation_solver(sp.csr_array(full), B=rigid, max_coarse=500))
    run = lambda: [levels.solve(loads[:, k], tol=1e-9, accel="cg", maxiter=400) for k in range(loads.shape[1])]  # noqa: E731
    return made, time_runs(run)[1]


def time_runs(run: Callable[[], Any], repeats: int = 3) -> tuple[Any, float]:
    seconds = []
    for _ in range(repeats):
        start = process_time()
        result = run()
        seconds.append(process_time() - start)
    return result, median(seconds)


if __name__ == "__main__":
    main()
