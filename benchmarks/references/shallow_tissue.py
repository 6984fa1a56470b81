"""Make ``tests/reference/contact/shallow.json``: what finite strain changes on shallow tissue, by NGSolve.

The probe of ``tests/reference/contact/example.toml``, bonded, on wide tissue of growing depth; its sphere keeps its place where
there is room and else shrinks with the depth. The materials are those of that folder's ``law``,

    W = mu/2 (J^(-2/3) I1 - 3) + K/4 (J^2 - 1 - 2 ln J),

minimised over displacements by Newton's method on the meshes of ``outline``, step by step along the indentation. Each change is
relative to a tiny indentation's value on the same mesh, so that most of the mesh's error drops out; ``uncertainty`` is what the
last refinement changes of a row's values. At the corners it falls slowly: a code of mixed elements on other meshes differs by
up to 0.22 of a tenth of the indentation. Contact adds nothing: nine tenths of the gap are left.

Usage: ``python -m benchmarks.references.shallow_tissue FILE``

Duration: an hour.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import ngsolve as ngs
import numpy as np
from netgen.meshing import NgException

from benchmarks.references.axisymmetric import materials
from benchmarks.references.outline import ENDS, INCLUSION, NAMES, Refinement, make_mesh
from geometry import CylinderTissue, Scene, read_scene

EXAMPLE = Path(__file__).resolve().parents[2] / "tests" / "reference" / "contact" / "example.toml"
MESHES = (Refinement(0.7, 4, 0), Refinement(0.55, 5, 0))
INDENTATIONS = (0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.28)  # outer radii
LINEAR_INDENTATION = 1e-4  # the indentation that is linear
MAX_LOAD_MEASURE = 0.3  # of indentation * sqrt(1 + (25 / depth^2)^2), lengths in outer radii: rows end here
MIN_STEP = 1e-3  # of the indentation, inner radii
LOG_MODULUS_STEP = 0.02  # of the logarithm of the sphere's modulus
VALUES = ("stiffness", "stress_inner", "stress_outer", "ratio")


@dataclass(frozen=True)
class Case:
    """Tissue and sphere; lengths in outer radii, ``stiffer`` is the sphere's modulus over the tissue's."""

    depth: float
    poisson_ratio: float
    stiffer: float
    centre: float
    radius: float


def case(depth: float, poisson_ratio: float = 0.45, stiffer: float = 5.0) -> Case:
    """Return a case with the example's sphere, or a smaller one in the middle of the tissue."""
    return Case(depth, poisson_ratio, stiffer, min(1.63, depth / 2), min(0.727, 0.3 * depth))


CASES = [
    *(case(depth) for depth in (1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 9.0, 15.0)),
    *(case(depth, poisson_ratio=0.49) for depth in (1.0, 2.0, 3.0, 4.0, 9.0)),
    *(case(depth, stiffer=100.0) for depth in (1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 9.0)),
    case(2.0, stiffer=20.0),
    case(2.0, stiffer=1.0),
    *(Case(9.0, 0.45, stiffer, 1.0, 0.6) for stiffer in (5.0, 100.0)),  # nearer to the surface
]


def build_scene(case: Case) -> Scene:
    """Return the example with the tissue and the sphere of a case."""
    scene = read_scene(EXAMPLE)
    unit, soft = scene.probe.tube_radius, scene.tissue.youngs_modulus
    material: dict[str, Any] = {"poisson_ratio": case.poisson_ratio}
    sphere = {"diameter": 2 * case.radius * unit, "depth": case.centre * unit, "youngs_modulus": case.stiffer * soft}
    size: dict[str, Any] = {"radius": max(8.0, 6 * case.depth) * unit, "depth": case.depth * unit}
    tissue = CylinderTissue(shape="cylinder", youngs_modulus=soft, **size, **material)
    body = scene.inclusion[0].model_copy(update=sphere | material)
    return scene.model_copy(update={"tissue": tissue, "inclusion": (body,)})


class FiniteStrain:
    """The probe's equilibrium on one mesh; lengths in inner radii, moduli in the tissue's."""

    def __init__(self, scene: Scene, refinement: Refinement) -> None:
        self.scene, self.mesh = scene, make_mesh(scene, refinement)
        ends, order = "|".join(ENDS), refinement.order
        radial = ngs.H1(self.mesh, order=order, dirichlet=f"axis|bottom|{ends}")
        self.space = radial * ngs.H1(self.mesh, order=order, dirichlet=f"bottom|{ends}")
        self.stiffening = ngs.Parameter(1.0)
        self.form = ngs.BilinearForm(self.space, symmetric=True, condense=True)
        self.form += ngs.Variation((2 * math.pi * ngs.x * self.energy()).Compile() * ngs.dx(bonus_intorder=4))
        self.lifts = [self.lift(end) for end in ENDS]
        self.state = ngs.GridFunction(self.space)

    def energy(self) -> ngs.CoefficientFunction:
        """Return W."""
        bodies, unit = materials(self.scene), self.scene.tissue.youngs_modulus
        young = self.mesh.MaterialCF({NAMES[k]: body.youngs_modulus / unit for k, body in bodies.items()})
        young *= self.mesh.MaterialCF({NAMES[INCLUSION]: self.stiffening}, default=1.0)
        nu = self.mesh.MaterialCF({NAMES[k]: body.poisson_ratio for k, body in bodies.items()})
        u, w = self.space.TrialFunction()
        a, b, c, d, hoop = 1 + ngs.grad(u)[0], ngs.grad(u)[1], ngs.grad(w)[0], 1 + ngs.grad(w)[1], 1 + u / ngs.x
        j, first = (a * d - b * c) * hoop, a**2 + b**2 + c**2 + d**2 + hoop**2
        shear, bulk = young / (2 * (1 + nu)), young / (3 * (1 - 2 * nu))
        return shear / 2 * (j ** (-2 / 3) * first - 3) + bulk / 4 * (j**2 - 1 - 2 * ngs.log(j))

    def lift(self, end: str) -> ngs.BaseVector:
        """Return the displacement by one that touches a block's end alone."""
        displacement = ngs.GridFunction(self.space)
        displacement.components[1].Set(1.0, definedon=self.mesh.Boundaries(end))
        return displacement.vec

    def balance(self) -> None:
        """Take Newton steps until they change nothing; raise ``ArithmeticError`` where they do not end."""
        vec, residual, step = self.state.vec, self.state.vec.CreateVector(), self.state.vec.CreateVector()
        for _ in range(25):
            self.form.Apply(vec, residual)
            self.form.AssembleLinearization(vec)
            residual.data += self.form.harmonic_extension_trans * residual
            step.data = self.form.mat.Inverse(self.space.FreeDofs(True), "sparsecholesky") * residual
            step.data += self.form.harmonic_extension * step
            step.data += self.form.inner_solve * residual
            vec.data -= step
            if ngs.Norm(step) <= 1e-10 * ngs.Norm(vec):
                return
        raise ArithmeticError("Newton's method does not converge")

    def values(self, indentation: float) -> np.ndarray:
        """Return ``VALUES`` of the state per unit indentation, up to constant factors."""
        residual = self.state.vec.CreateVector()
        self.form.Apply(self.state.vec, residual)
        inner, outer = (-ngs.InnerProduct(residual, lift) / indentation for lift in self.lifts)
        return np.array([inner + outer, inner, outer, inner / outer])

    def sensitivity(self) -> float:
        """Return d ln(ratio) / d ln E of the sphere by central differences."""
        kept, logs = self.state.vec.FV().NumPy().copy(), []
        for sign in (1, -1):
            self.stiffening.Set(math.exp(sign * LOG_MODULUS_STEP))
            self.balance()
            logs.append(math.log(self.values(1.0)[3]))
            self.state.vec.FV().NumPy()[:] = kept
        self.stiffening.Set(1.0)
        return (logs[0] - logs[1]) / (2 * LOG_MODULUS_STEP)

    def press(self, last_indentation: float, indentation: float) -> None:
        """Go on from one indentation to another, in proportion, where Newton's method fails in two steps.

        Raises
        ------
        ArithmeticError
            It fails in the smallest ones too.
        """
        kept = self.state.vec.FV().NumPy().copy()
        try:
            if last_indentation:
                self.state.vec.data *= indentation / last_indentation
            else:
                self.state.vec.data -= indentation * (self.lifts[0] + self.lifts[1])
            self.balance()
        except (ArithmeticError, NgException):
            if indentation - last_indentation < MIN_STEP:
                raise
            self.state.vec.FV().NumPy()[:] = kept
            self.press(last_indentation, (last_indentation + indentation) / 2)
            self.press((last_indentation + indentation) / 2, indentation)


def rows(case: Case, refinement: Refinement) -> Iterator[tuple[float, np.ndarray]]:
    """Yield indentations with the relative changes of ``VALUES`` and ln(S / S0)."""
    scene, last_indentation = build_scene(case), 0.0
    problem, unit = FiniteStrain(scene, refinement), scene.probe.tube_radius / scene.probe.inner_radius
    for indentation in (
        LINEAR_INDENTATION,
        *(x for x in INDENTATIONS if x * math.hypot(1, 25 / case.depth**2) <= MAX_LOAD_MEASURE),
    ):
        problem.press(last_indentation, indentation * unit)
        values, derivative = problem.values(indentation), problem.sensitivity()
        if indentation == LINEAR_INDENTATION:
            linear, small = values, derivative
        else:
            yield indentation, np.append(values / linear - 1, math.log(derivative / small))
        last_indentation = indentation * unit


def entries(case: Case) -> list[dict[str, float]]:
    """Return the rows of a case as the file names them, those of the finer mesh."""
    results = []
    for (indentation, coarse), (_, fine) in zip(*(rows(case, mesh) for mesh in MESHES), strict=True):
        numbers = [indentation, *fine.tolist(), float(abs(fine - coarse).max())]
        names = ("indentation", *VALUES, "ln_sensitivity", "uncertainty")
        results.append(asdict(case) | dict(zip(names, (round(number, 6) for number in numbers), strict=True)))
    return results


def main(path: Path) -> None:
    """Write the file, one row a line."""
    ngs.SetNumThreads(1)
    lines = [json.dumps(row) for case in CASES for row in entries(case)]
    path.write_text("[\n" + ",\n".join(lines) + "\n]\n", encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
