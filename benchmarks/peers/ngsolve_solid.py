"""Solve the scenes of ``solid.py`` by NGSolve, used as its best user would: curved elements, graded by hand.

Run as a program it takes a scene's file and a ``SolidSetting`` as JSON, and prints ratio, unknowns and seconds as JSON. Its task
manager has ``OMP_NUM_THREADS`` threads, one if that is not set; meshing has one, which is faster.

Duration: a minute.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from typing import Any

import ngsolve as ngs
from ngsolve.krylovspace import CGSolver

from benchmarks.peers.measured_solid import Laps, SolidAnswer
from benchmarks.peers.solid_mesh import ENDS, SolidSetting, materials, tetrahedra
from geometry import Scene, read_scene

TOLERANCE = 1e-6  # of the iterations: the ratio is then off by 1e-5 at most


def make_mesh(scene: Scene, setting: SolidSetting) -> ngs.Mesh:
    """Build the curved mesh: tetrahedra, and prisms round the rims where there are layers."""
    mesh = ngs.Mesh(tetrahedra(scene, setting))
    if setting.layers:
        mesh.RefineHP(setting.layers, setting.factor)
    mesh.Curve(setting.order)
    return mesh


def system(scene: Scene, mesh: ngs.Mesh, setting: SolidSetting) -> tuple[Any, Any, Any]:
    """Assemble; return space, form and preconditioner (None for direct solvers)."""
    held = {"dirichletx": "bottom|end_inner|end_outer", "dirichlety": "bottom|end_inner|end_outer|mirror"}
    flags = {"wb_withedges": False} if setting.solver == "vertices" else {}
    space = ngs.VectorH1(mesh, order=setting.order, **held, dirichletz="bottom|end_inner|end_outer", **flags)
    known = materials(scene).items()
    mu = mesh.MaterialCF({name: material.youngs_modulus / (2 * (1 + material.poisson_ratio)) for name, material in known})
    lam = mesh.MaterialCF(
        {
            name: material.youngs_modulus
            * material.poisson_ratio
            / ((1 + material.poisson_ratio) * (1 - 2 * material.poisson_ratio))
            for name, material in known
        }
    )
    u, v = space.TnT()
    e, f = ngs.Sym(ngs.Grad(u)), ngs.Sym(ngs.Grad(v))
    form = ngs.BilinearForm(space, symmetric=True, condense=True)
    form += (2 * mu * ngs.InnerProduct(e, f) + lam * ngs.Trace(e) * ngs.Trace(f)).Compile() * ngs.dx
    condition = None
    if setting.solver in ("bddc", "vertices"):
        condition = ngs.Preconditioner(form, "bddc", inverse="sparsecholesky")
    form.Assemble()
    return space, form, condition


def evaluate(scene: Scene, setting: SolidSetting, tasks: Callable[[], AbstractContextManager[Any]] = nullcontext) -> SolidAnswer:
    """Find the ratio: one mesh on one thread, one system and one solve on those of ``tasks``."""
    laps = Laps()
    mesh = make_mesh(scene, setting)
    laps.lap("mesh")
    with tasks():
        return solve(scene, setting, mesh, laps)


def solve(scene: Scene, setting: SolidSetting, mesh: ngs.Mesh, laps: Laps) -> SolidAnswer:
    space, form, condition = system(scene, mesh, setting)
    laps.lap("assemble")
    lifts = []
    for end in ENDS:
        lift = ngs.GridFunction(space)
        lift.Set(ngs.CF((0, 0, -1)), definedon=mesh.Boundaries(end))
        lifts.append(lift.vec)
    pressed, load = lifts[0].CreateVector(), lifts[0].CreateVector()
    pressed.data = lifts[0] + lifts[1]
    load.data = -(form.mat * pressed)
    free = space.FreeDofs(coupling=True)
    iterations = 0
    if condition is None:
        inverse = form.mat.Inverse(free, setting.solver)
    else:
        inverse = CGSolver(form.mat, condition.mat, tol=TOLERANCE, maxiter=2000)
    pressed.data += inverse * load
    if condition is not None:
        iterations = inverse.iterations
    reaction = (form.mat * pressed).Evaluate()
    inner, outer = (2 * ngs.InnerProduct(reaction, lift) for lift in lifts)
    laps.lap("solve")
    ratio = inner / scene.probe.inner_area / (outer / scene.probe.outer_area)
    return SolidAnswer(ratio, inner + outer, int(free.NumSet()), mesh.ne, laps.wall, laps.process, {"iterations": iterations})


if __name__ == "__main__":
    threads = int(os.environ.get("OMP_NUM_THREADS", "1"))
    ngs.SetNumThreads(threads)
    arguments = read_scene(sys.argv[1]), SolidSetting(**json.loads(sys.argv[2]))
    print(json.dumps(vars(evaluate(*arguments, ngs.TaskManager if threads > 1 else nullcontext))), flush=True)
    os._exit(0)
