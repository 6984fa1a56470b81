"""Compute curves over the inclusion's modulus by NGSolve, and their gradients by central differences.

Element by element, condensing the inner unknowns commutes with scaling by Young's modulus, so that the condensed matrix
too is K_0 + E_object K_o. Film forces are F_ij = u_i.K u_j of the two base states, dF_ij/dE_object = u_i.K_o u_j.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import ngsolve as ngs
import numpy as np

from benchmarks.peers.designs import vary_design
from benchmarks.peers.measured import RatioCurve, Stopwatch
from benchmarks.peers.ngsolve_meridian import MeridianSetting, NGSolveProblem, make_mesh
from benchmarks.references.outline import INCLUSION
from geometry import Scene
from geometry.common.arrays import Floats


@dataclass(frozen=True)
class CurveRun:
    """A curve, the unknowns of its system, and the seconds of each stage."""

    curve: RatioCurve
    unknowns: int
    stages: dict[str, float] = field(default_factory=dict)

    @property
    def seconds(self) -> float:
        """All stages together."""
        return sum(self.stages.values())


Run = Callable[[Scene, MeridianSetting, Floats], CurveRun]


def solve_by_looping(scene: Scene, setting: MeridianSetting, moduli: Floats) -> CurveRun:
    """Assemble and factorise for each modulus anew, on one mesh and one space."""
    watch = Stopwatch()
    problem = _prepare(scene, setting, watch)
    derivative = problem.form(1.0, (INCLUSION,)).mat
    watch.lap("assemble")
    points = []
    for modulus in moduli:
        matrix = problem.form(modulus).mat
        watch.lap("assemble")
        inverse = matrix.Inverse(problem.free, "sparsecholesky")
        watch.lap("factorise")
        points.append(_point(problem, matrix, inverse, derivative))
        watch.lap("solve")
    return _run(problem, moduli, points, watch)


def solve_by_reusing(scene: Scene, setting: MeridianSetting, moduli: Floats) -> CurveRun:
    """Assemble twice in all, then add, factorise in the ordering found first, and solve for each modulus."""
    watch = Stopwatch()
    problem = _prepare(scene, setting, watch)
    inverse, points = None, []
    start, derivative = _affine(problem)
    matrix = start.CreateMatrix()
    watch.lap("assemble")
    for modulus in moduli:
        matrix.AsVector().data = start.AsVector() + float(modulus) * derivative.AsVector()
        if inverse is None:
            inverse = matrix.Inverse(problem.free, "sparsecholesky")
        else:
            inverse.Update()
        watch.lap("factorise")
        points.append(_point(problem, matrix, inverse, derivative))
        watch.lap("solve")
    return _run(problem, moduli, points, watch)


def _prepare(scene: Scene, setting: MeridianSetting, watch: Stopwatch) -> NGSolveProblem:
    mesh = make_mesh(scene, setting)
    watch.lap("mesh")
    problem = NGSolveProblem(scene, mesh, setting.order)
    watch.lap("space")
    return problem


def _affine(problem: NGSolveProblem) -> tuple[Any, Any]:
    """Return K_0 and K_o in one sparsity pattern, from two moduli: a form of the inclusion alone has a pattern of its own."""
    unit = problem.scene.tissue.youngs_modulus
    start, double = problem.form(unit).mat, problem.form(2 * unit).mat
    derivative = start.CreateMatrix()
    derivative.AsVector().data = (1 / unit) * double.AsVector() - (1 / unit) * start.AsVector()
    start.AsVector().data -= unit * derivative.AsVector()
    return start, derivative


def _point(problem: NGSolveProblem, matrix: Any, inverse: Any, derivative: Any) -> tuple[Floats, Floats]:
    """Return the film forces and their derivatives with respect to the inclusion's modulus, both blocks pressed."""
    states = [problem.solve(matrix, inverse, lift) for lift in problem.lifts]
    pressed = states[0].CreateVector()
    pressed.data = states[0] + states[1]
    forces = []
    for operator in (matrix, derivative):
        reaction = (operator * pressed).Evaluate()
        forces.append(np.array([ngs.InnerProduct(reaction, state) for state in states]))
    return forces[0], forces[1]


def _run(problem: NGSolveProblem, moduli: Floats, points: Sequence[tuple[Floats, Floats]], watch: Stopwatch) -> CurveRun:
    forces, derivatives = (np.array(values) for values in zip(*points, strict=True))
    sensitivity = moduli * (derivatives[:, 0] / forces[:, 0] - derivatives[:, 1] / forces[:, 1])
    curve = RatioCurve(moduli, np.array([problem.ratio(pair) for pair in forces]), sensitivity)
    return CurveRun(curve, problem.unknowns, watch.stages)


def central_difference(
    run: Run, scene: Scene, setting: MeridianSetting, moduli: Floats, variable: str, step: float
) -> tuple[Floats, float]:
    """Return d ln ratio / d ln variable along the curve and the seconds of its two runs."""
    runs = [run(vary_design(scene, variable, 1 + sign * step), setting, moduli) for sign in (1, -1)]
    logs = [np.log(np.abs(curve_run.curve.ratio)) for curve_run in runs]
    return (logs[0] - logs[1]) / (2 * step), sum(curve_run.seconds for curve_run in runs)
