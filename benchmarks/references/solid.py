"""Compute reference solutions of off-axis scenes by NGSolve in three dimensions, independently of ``solver``.

The problem: that of ``axisymmetric``, but with any number of spheres and ellipsoids whose centres and axes lie in
the plane y = 0 of symmetry; tissue of any layers in a cylinder about the probe's axis, rigid base, no film, no groove,
bonded or frictionless interface.

The method: the axisymmetric code gives the states u0_1, u0_2 without tumours (displacement of one unit of one block's end)
to about eight digits. What is sought in three dimensions is the scattered field w_j = u_j - u0_j only: with dC the tumours'
elasticity less that of the layer in whose place they are, a the bilinear form with tumours and l_j(v) = integral over the
tumours of dC e(u0_j) : e(v),

    a(w_j, v) = -l_j(v) for all v at rest at the ends of the blocks and the bottom of the tissue,
    F_ij = F0_ij + l_i(u0_j + w_j),        dF_ij / d ln E = integral over the target of C e(u_i) : e(u_j).

The strain of u0 is taken point by point from the plane mesh at the quadrature points of the tumours. The first term of l_i
has the error of that quadrature only, the second that of w's energy: a(w - w_h, w - w_h). So a mesh with a few per cent of
error in w gives a few tenths of per cent of the tumour's second-order effect, and F approaches its limit from one side.
The derivative is the exact one of the discrete forces.

Half of the bodies, y > 0, is meshed (``bodies``). The value is that of the finest mesh; ``relative_uncertainty``
is the largest change of stresses, ratio and stiffness from the mesh before, which is coarser in size and order at once;
``log_sensitivity_uncertainty`` the change of that (absolute). On the axis (contrast 10, cover of
0.25 diameters), where the axisymmetric code knows the result, the change from order 4 to 5 was 1.1e-4 and the true error
left 2.7e-5.

Usage, after ``pip install ngsolve``: ``python -m benchmarks.references.solid SCENE.toml ...``, a folder means all its scenes;
each result goes into ``expected.json`` beside its scene as soon as it is known

Duration: ten minutes per scene.
"""

from __future__ import annotations

import json
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import ngsolve as ngs
import numpy as np
from ngsolve.comp import IntegrationRuleSpace

from benchmarks.references.axisymmetric import ReferenceAnswer, ReferenceProblem, difference, summary
from benchmarks.references.bodies import check, make_mesh, piece, slabs
from benchmarks.references.outline import Refinement
from geometry import Scene, read_scene

PLANE = Refinement(0.55, 10, 10)  # of the states without tumours
LADDER = (Refinement(1.15, 4, 1), Refinement(1.0, 5, 1))
EXTRA_POINTS = 6  # of the quadrature in the tumours, over twice the order


@dataclass(frozen=True)
class Forces:
    """F_ij without and with the tumours present, dF_ij / d ln E_target; N per m of displacement."""

    without: np.ndarray
    present: np.ndarray
    derivatives: np.ndarray | None
    unknowns: int


class MeridianStates:
    """The two states without tumours, by the axisymmetric code."""

    def __init__(self, scene: Scene) -> None:
        bare = scene.model_copy(update={"inclusion": ()})
        self.problem = ReferenceProblem(bare, PLANE)
        self.states = self.problem.states()
        works = [self.problem.work(self.states, part) for part in self.problem.parts]
        self.forces = np.sum(works, axis=0) * scene.probe.inner_radius

    def strains(self, points: np.ndarray) -> list[np.ndarray]:
        """Return each state's e_r, e_theta, e_z and engineering shear rz at points x, y, z of the tissue."""
        mesh_points = self.problem.mesh(np.hypot(points[:, 0], points[:, 1]), points[:, 2])
        fields = []
        for state in self.states:
            normal, shear = self.problem.strain(state.components, self.problem.parts[0])
            fields.append(np.asarray(ngs.CoefficientFunction((*normal, shear))(mesh_points)))
        return fields


def cartesian(meridian: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Turn e_r, e_theta, e_z, 2 e_rz into the nine Cartesian components."""
    radial, hoop, axial, shear = meridian.T
    r = np.hypot(points[:, 0], points[:, 1])
    c, s = points[:, 0] / r, points[:, 1] / r
    xx, yy, xy = radial * c**2 + hoop * s**2, radial * s**2 + hoop * c**2, (radial - hoop) * c * s
    xz, yz = shear * c / 2, shear * s / 2
    return np.column_stack([xx, xy, xz, xy, yy, yz, xz, yz, axial])


class ScatteredFields:
    """The scattered fields on one mesh."""

    def __init__(self, scene: Scene, refinement: Refinement, plane: MeridianStates) -> None:
        self.scene, self.plane, self.order = scene, plane, refinement.order
        self.mesh = make_mesh(scene, refinement)
        self.slides = scene.contact.interface == "frictionless"
        self.parts = [("tissue|layer.|tumour.*", (0, 1, 2)), ("inner|outer", (3, 4, 2) if self.slides else (0, 1, 2))]
        self.space = self.spaces()
        layers = slabs(scene)
        around = {"inner": scene.probe.inner, "outer": scene.probe.outer} | {slab.name: slab.material for slab in layers}
        pieces = [(piece(k, slab), body, slab.material) for k, body in enumerate(scene.inclusion) for slab in layers]
        self.mu, self.lam = self.lame(around | {name: body for name, body, _ in pieces})
        mu, lam = self.lame(around | {name: outside for name, _, outside in pieces})
        self.change = (self.mu - mu, self.lam - lam)
        self.tumours = self.mesh.Materials("tumour.*")

    def lame(self, bodies: dict[str, Any]) -> tuple[Any, Any]:
        """Return mu and lambda of bodies."""
        mu = {name: body.youngs_modulus / (2 * (1 + body.poisson_ratio)) for name, body in bodies.items()}
        lam = {name: 2 * mu[name] * body.poisson_ratio / (1 - 2 * body.poisson_ratio) for name, body in bodies.items()}
        return self.mesh.MaterialCF(mu), self.mesh.MaterialCF(lam)

    def spaces(self) -> ngs.FESpace:
        """Return u_x, u_y, u_z of all and, if they slide, u_x and u_y of the blocks instead."""
        held = ("bottom|end", "bottom|end|mirror")
        bodies = [self.mesh.Materials(name) for name, _ in self.parts] if self.slides else [self.mesh.Materials(".*")]
        pairs = [
            [ngs.H1(self.mesh, order=self.order, dirichlet=held_boundary, definedon=body) for held_boundary in held]
            for body in bodies
        ]
        pairs[0].append(ngs.H1(self.mesh, order=self.order, dirichlet=held[0]))
        return ngs.FESpace([space for spaces in pairs for space in spaces])

    def strain(self, components: Any, part: tuple[str, tuple[int, ...]]) -> Any:
        """Return the strain in a part as a 3 x 3 matrix."""
        gradient = ngs.CoefficientFunction(tuple(ngs.grad(components[k]) for k in part[1]), dims=(3, 3))
        return (gradient + gradient.trans) / 2

    def evaluate_given_strains(self) -> tuple[list[Any], Any]:
        """Return the strains without tumours as fields at the quadrature points of the tumours, and these points' rules."""
        space = IntegrationRuleSpace(self.mesh, order=2 * self.order + EXTRA_POINTS, definedon=self.tumours)
        axes = [ngs.GridFunction(space) for _ in range(3)]
        for field, axis in zip(axes, (ngs.x, ngs.y, ngs.z), strict=True):
            field.Interpolate(axis)
        points, fields = np.column_stack([axis.vec.FV().NumPy() for axis in axes]), list[Any]()
        for meridian in self.plane.strains(points):
            entries = []
            for values in cartesian(meridian, points).T:
                entries.append(ngs.GridFunction(space))
                entries[-1].vec.FV().NumPy()[:] = values
            fields.append(ngs.CoefficientFunction(tuple(entries), dims=(3, 3)))
        return fields, space.GetIntegrationRules()

    def forces(self) -> Forces:
        """Find the forces of both states."""
        u, v = self.space.TnT()
        form = ngs.BilinearForm(self.space, symmetric=True, condense=True)
        for part in self.parts:
            pair = (self.strain(u, part), self.strain(v, part))
            form += work(self.mu, self.lam, *pair) * ngs.dx(definedon=self.mesh.Materials(part[0]))
        form.Assemble()
        inverse = form.mat.Inverse(self.space.FreeDofs(coupling=True), "sparsecholesky")
        strains, rules = self.evaluate_given_strains()
        inside = ngs.dx(definedon=self.tumours, intrules=rules)
        loads, scattered = list[Any](), list[ngs.GridFunction]()
        for strain in strains:
            loads.append(ngs.LinearForm(work(*self.change, strain, self.strain(v, self.parts[0])) * inside).Assemble())
            scattered.append(self.solve(form, inverse, loads[-1].vec))
        first = self.matrix(lambda i, j: ngs.Integrate(work(*self.change, strains[i], strains[j]) * inside, self.mesh))
        second = self.matrix(lambda i, j: ngs.InnerProduct(loads[i].vec, scattered[j].vec))
        unit, target = 2 * self.scene.probe.inner_radius, self.scene.target
        derivatives = None
        if target is not None:
            whole = [e + self.strain(w.components, self.parts[0]) for e, w in zip(strains, scattered, strict=True)]
            body = ngs.dx(definedon=self.mesh.Materials(f"tumour{target}in.*"), intrules=rules)
            derivatives = unit * self.matrix(
                lambda i, j: ngs.Integrate(work(self.mu, self.lam, whole[i], whole[j]) * body, self.mesh)
            )
        free = sum(self.space.FreeDofs(coupling=True))
        return Forces(self.plane.forces, self.plane.forces + unit * (first + second), derivatives, free)

    def solve(self, form: ngs.BilinearForm, inverse: Any, load: Any) -> ngs.GridFunction:
        """Solve a(w, v) = -l(v)."""
        solution, right = ngs.GridFunction(self.space), load.CreateVector()
        right.data = -load
        right.data += form.harmonic_extension_trans * right
        solution.vec.data = inverse * right
        solution.vec.data += form.harmonic_extension * solution.vec
        solution.vec.data += form.inner_solve * right
        return solution

    def matrix(self, entry: Any) -> np.ndarray:
        """Return a symmetric 2 x 2 matrix by its entries."""
        a, b, c = entry(0, 0), entry(0, 1), entry(1, 1)
        return np.array([[a, b], [b, c]])


def work(mu: Any, lam: Any, e: Any, f: Any) -> Any:
    """Return the work of the stress of strain e on strain f, per volume."""
    return 2 * mu * ngs.InnerProduct(e, f) + lam * ngs.Trace(e) * ngs.Trace(f)


def reference(scene: Scene, ladder: tuple[Refinement, ...] = LADDER) -> dict[str, Any]:
    """Find the entry of ``expected.json``: the finest mesh's values."""
    check(scene)
    plane, steps = MeridianStates(scene), list[ReferenceAnswer]()
    for refinement in ladder:
        start = time.perf_counter()
        forces = ScatteredFields(scene, refinement, plane).forces()
        steps.append(build_reference_answer(scene, forces.present, forces.derivatives))
        print(refinement, forces.unknowns, steps[-1], f"{time.perf_counter() - start:.0f} s", file=sys.stderr, flush=True)
    coarse, fine = steps[-2:]
    derivatives = [each.log_sensitivity for each in (coarse, fine) if each.log_sensitivity is not None]
    return {
        "stress_inner_pa": fine.stress_inner,
        "stress_outer_pa": fine.stress_outer,
        "ratio": fine.ratio,
        "stiffness_n_per_m": fine.stiffness,
        "log_sensitivity": fine.log_sensitivity,
        "relative_uncertainty": difference(replace(coarse, log_sensitivity=None), fine),
        "log_sensitivity_uncertainty": abs(derivatives[0] - derivatives[-1]) if derivatives else None,
        "ratio_without": build_reference_answer(scene, forces.without, None).ratio,
        "forces_n_per_m": forces.present.tolist(),
        "forces_without_n_per_m": forces.without.tolist(),
    }


def build_reference_answer(scene: Scene, forces: np.ndarray, derivatives: np.ndarray | None) -> ReferenceAnswer:
    """Return the stresses of a common displacement; the log-sensitivity is None where there is no target."""
    if derivatives is None:
        return summary(scene.model_copy(update={"inclusion": ()}), forces, np.zeros((2, 2)))
    return summary(scene, forces, derivatives)


def main(paths: list[Path]) -> None:
    """Add every scene's result to the ``expected.json`` beside it."""
    ngs.SetNumThreads(1)
    for path in (scene for given in paths for scene in (sorted(given.glob("*.toml")) if given.is_dir() else [given])):
        answer, file = reference(read_scene(path)), path.parent / "expected.json"
        known = json.loads(file.read_text(encoding="utf-8")) if file.exists() else {}
        file.write_text(json.dumps(known | {path.stem: answer}, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main([Path(name) for name in sys.argv[1:]])
