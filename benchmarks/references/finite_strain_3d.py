"""Solve the finite-strain problem of a probe on tissue with tumours in three dimensions by NGSolve, independently of ``solver``.

The half y > 0 of the bodies (``bodies``), bonded faces, base pressed straight down, with the energy per volume

    W = mu/2 (J^(-2/3) I1 - 3) + K/4 (J^2 - 1 - 2 ln J).

In nearly incompressible tissue the volume's part is p J - U*(p), U* the Legendre transform of K/4 (J^2 - 1 - 2 ln J), with a
discontinuous pressure p two orders below the displacements, which is condensed by element. Lengths are in inner radii, moduli in
the tissue's. A penalty holds the tissue's top, which folds at the rim, off the outer block's wall; the gap's walls do not touch.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import ngsolve as ngs
import numpy as np
from netgen.meshing import NgException

from benchmarks.references.bodies import make_mesh, piece, slabs
from benchmarks.references.outline import Refinement
from geometry import Scene

MIN_STEP = 0.02  # of the indentation, outer radii: below it Newton's method has failed
MAX_ITERATIONS = 40  # more mean that a smaller step of the indentation is cheaper
STEP_TOLERANCE = 2e-5  # of the displacements, relative; contact is sought anew in each step
SLOW_CONVERGENCE = 0.6  # of one step over the last: from here on a new tangent is cheaper than more steps
PENALTY = 3000.0  # of contact, tissue moduli per inner radius: 1 um of penetration at 0.65 outer radii of the example
PENALTY_BLUR = 1e-3  # inner radii: distance over which the penalty's kink is rounded
CONTACT_REACH = 0.1  # inner radii: within which the opposite surface is sought
NEARLY_INCOMPRESSIBLE = 0.485  # Poisson's ratio from which on the pressure is an unknown; the blocks have 0.48


@dataclass(frozen=True)
class LoadedForces:
    """Forces on the films (inner, outer; N) at an indentation (m), and their derivatives.

    ``by_indentation`` is in N/m, ``by_ln_modulus`` (of the target's modulus, at that indentation) in N; zero without tumours.
    ``walls`` is the smallest distance of the gap's walls over the gap, ``overlap`` how deep the tissue's top is in the outer
    block's wall, m.
    """

    indentation: float
    forces: np.ndarray
    by_indentation: np.ndarray
    by_ln_modulus: np.ndarray
    walls: float
    overlap: float


class LoadedProbe:
    """The equilibrium with or without the tumours on one mesh."""

    def __init__(self, scene: Scene, refinement: Refinement) -> None:
        self.scene, self.order, self.radius = scene, refinement.order, scene.probe.inner_radius
        self.mesh = make_mesh(scene, refinement)
        self.unit = scene.tissue.youngs_modulus
        self.present = ngs.Parameter(0.0)
        self.ln_contrast = ngs.Parameter(0.0)
        held = ngs.VectorH1(self.mesh, order=self.order, dirichlet="bottom|end", dirichlety="bottom|end|mirror")
        materials = [slab.material for slab in slabs(scene)] + list(scene.inclusion)
        self.soft = any(each.poisson_ratio >= NEARLY_INCOMPRESSIBLE for each in materials)
        self.tissue = self.mesh.Materials("tissue|layer.*|tumour.*")
        pressure = ngs.L2(self.mesh, order=self.order - 2, definedon=self.tissue)
        self.space = ngs.FESpace([held, pressure] if self.soft else [held])
        self.form, self.target_form = self._build_forms()
        self.contact = self._build_contact()
        self.state, self.lifts = ngs.GridFunction(self.space), [self._lift(inside) for inside in (True, False)]
        self.inverse: Any = None

    def _build_forms(self) -> tuple[ngs.BilinearForm, ngs.BilinearForm]:
        trial = self.space.TrialFunction()
        gradient = ngs.Grad(trial[0]) + ngs.Id(3)
        jacobian = ngs.Det(gradient)
        distortion = (jacobian ** (-2 / 3) * ngs.InnerProduct(gradient, gradient) - 3) / 2
        volume = (jacobian**2 - 1 - 2 * ngs.log(jacobian)) / 4

        def build_form(bodies: dict[str, tuple[Any, float]]) -> ngs.BilinearForm:
            """Return the form of bodies with their (Young's modulus, Poisson's ratio)."""
            form = ngs.BilinearForm(self.space, symmetric=True, condense=True)
            for names in (("inner", "outer"), tuple(name for name in bodies if name not in ("inner", "outer"))):
                chosen = {name: bodies[name] for name in names if name in bodies}
                if not chosen:
                    continue
                shear = self.mesh.MaterialCF({name: young / (2 * (1 + nu)) for name, (young, nu) in chosen.items()})
                bulk = self.mesh.MaterialCF(
                    {name: young / (3 * (1 - 2 * nu)) for name, (young, nu) in chosen.items()}, default=1.0
                )
                if self.soft and "inner" not in names:
                    pressure = trial[1]
                    root = (pressure / bulk * pressure / bulk + 1) ** 0.5
                    best = pressure / bulk + root  # the J at which p J - U(J) is largest
                    energy = shear * distortion + pressure * (jacobian - best) + bulk * (best**2 - 1 - 2 * ngs.log(best)) / 4
                else:
                    energy = shear * distortion + bulk * volume
                form += ngs.Variation(energy.Compile() * ngs.dx(definedon=self.mesh.Materials("|".join(chosen))))
            return form

        scene, bodies, target = self.scene, dict[str, tuple[Any, float]](), dict[str, tuple[Any, float]]()
        for name, block in (("inner", scene.probe.inner), ("outer", scene.probe.outer)):
            bodies[name] = (block.youngs_modulus / self.unit, block.poisson_ratio)
        for slab in slabs(scene):
            young = slab.material.youngs_modulus / self.unit
            bodies[slab.name] = (young, slab.material.poisson_ratio)
            for k, tumour in enumerate(scene.inclusion):
                stiff = tumour.youngs_modulus / self.unit * (ngs.exp(self.ln_contrast) if k == scene.target else 1.0)
                mixed = young + self.present * (stiff - young)
                nu = slab.material.poisson_ratio + self.present * (tumour.poisson_ratio - slab.material.poisson_ratio)
                bodies[piece(k, slab)] = (mixed, nu)
                if k == scene.target:
                    target[piece(k, slab)] = (stiff, tumour.poisson_ratio)
        present = set(self.mesh.GetMaterials())
        whole, part = (build_form({k: v for k, v in each.items() if k in present}) for each in (bodies, target))
        return whole, part

    def _build_contact(self) -> ngs.ContactBoundary:
        """Return the contact of the tissue's top with the outer block's wall.

        They meet at a right angle, where rounding would be penetration: points count as the top turns towards the wall.
        """
        contact = ngs.ContactBoundary(self.mesh.Boundaries("top"), self.mesh.Boundaries("side"))
        moved = self.space.TrialFunction()[0]
        place, normal, blur = ngs.CF((ngs.x, ngs.y, ngs.z)), contact.normal, PENALTY_BLUR
        penetration = (place + moved - place.Other() - moved.Other()) * normal
        beyond = penetration**2 / 2 + blur**2 / 6
        rounded = ngs.IfPos(penetration - blur, beyond, ngs.IfPos(penetration + blur, (penetration + blur) ** 3 / (12 * blur), 0))
        share = (-(ngs.x * normal[0] + ngs.y * normal[1]) / (ngs.x**2 + ngs.y**2) ** 0.5 - 0.3) / 0.4
        turned = ngs.IfPos(share, ngs.IfPos(1 - share, share**2 * (3 - 2 * share), 1), 0)
        contact.AddEnergy(PENALTY * rounded * turned)
        return contact

    def _apply(self, residual: Any) -> None:
        """Compute the residual forces of the state, with contact where it is now."""
        self.contact.Update(self.state.components[0], self.form, 2 * self.order + 2, CONTACT_REACH)
        self.form.Apply(self.state.vec, residual)

    def _lift(self, inner: bool) -> Any:
        """Return the unit displacement of one block's film end."""
        displacement = ngs.GridFunction(self.space)
        middle = (1 + self.scene.probe.hole_radius / self.radius) / 2
        inside = ngs.IfPos(ngs.x**2 + ngs.y**2 - middle**2, 0.0, 1.0)
        value = inside if inner else 1 - inside
        displacement.components[0].Set(ngs.CF((0, 0, value)), definedon=self.mesh.Boundaries("end"))
        return displacement.vec

    def balance(self) -> None:
        """Take steps of Newton's method, with a tangent that is assembled anew where it converges slowly.

        Raises
        ------
        ArithmeticError
            They do not end, or turn an element over.
        """
        vec, residual, step, last_size = self.state.vec, self.state.vec.CreateVector(), self.state.vec.CreateVector(), math.inf
        for iteration in range(MAX_ITERATIONS):
            self._apply(residual)
            step.data = self._solve(residual)
            size = ngs.Norm(step) / ngs.Norm(vec)
            if not size < (0.3 if iteration < 2 else max(0.1, 2 * last_size)):
                raise ArithmeticError("Newton's method does not converge")
            vec.data -= step
            if size < STEP_TOLERANCE:
                return
            if size > SLOW_CONVERGENCE * last_size:
                self._factorise()
            last_size = size
        raise ArithmeticError("Newton's method does not converge")

    def _factorise(self) -> None:
        self.form.AssembleLinearization(self.state.vec)
        self.inverse = self.form.mat.Inverse(self.space.FreeDofs(True), "sparsecholesky")

    def _solve(self, load: Any) -> Any:
        """Return the solution of the last tangent for a load."""
        right, solution = load.CreateVector(), load.CreateVector()
        right.data = load
        right.data += self.form.harmonic_extension_trans * right
        solution.data = self.inverse * right
        solution.data += self.form.harmonic_extension * solution
        solution.data += self.form.inner_solve * right
        return solution

    def measure(self, indentation: float) -> LoadedForces:
        """Return forces and derivatives of the state at an indentation in inner radii."""
        vec, residual, total = self.state.vec, self.state.vec.CreateVector(), self.state.vec.CreateVector()
        force = 2 * self.unit * self.radius**2  # of the half's forces in the units of the mesh: N
        self._apply(residual)
        forces, by_indentation, by_ln_modulus = self._react(residual) * force, np.zeros(2), np.zeros(2)
        if self.present.Get():
            self._factorise()
            # The condensed matrix holds the rows of the film ends, so that it gives reactions without the whole tangent.
            total.data = self._move_ends()
            residual.data = self.form.mat * total
            by_indentation = self._react(residual) * force / self.radius
            self.target_form.Apply(vec, residual)
            residual.data += self.form.harmonic_extension_trans * residual
            total.data = self.inverse * residual
            residual.data -= self.form.mat * total
            by_ln_modulus = self._react(residual) * force
        walls, overlap = self._measure_gap()
        return LoadedForces(indentation * self.radius, forces, by_indentation, by_ln_modulus, walls, overlap)

    def _move_ends(self) -> Any:
        """Return the tangent displacement of a unit indentation, without the elements' inner unknowns."""
        moved, load = self.lifts[0].CreateVector(), self.lifts[0].CreateVector()
        moved.data = -1.0 * self.lifts[0] - self.lifts[1]
        load.data = self.form.mat * moved
        moved.data -= self.inverse * load
        return moved

    def _react(self, residual: Any) -> np.ndarray:
        return np.array([-ngs.InnerProduct(residual, lift) for lift in self.lifts])

    def _measure_gap(self) -> tuple[float, float]:
        """Return the smallest distance of the gap's walls over the gap, and how deep the tissue's top is in the outer wall, m.

        Both in the plane y = 0, where the tumours lie, on both sides of the axis.
        """
        probe, unit = self.scene.probe, self.radius
        hole, outer = probe.hole_radius / unit, probe.tube_radius / unit
        walls, overlaps = [], []
        for sign in (-1, 1):
            z = np.linspace(1e-3, 0.999, 80)
            core = self._deform(sign, 0 * z + 1 - 1e-6, z * probe.core_height / unit)
            hole_wall = self._deform(sign, 0 * z + hole + 1e-6, z * probe.tube_height / unit)
            walls.append(np.nanmin(np.interp(core[1], hole_wall[1], hole_wall[0], np.nan, np.nan) - core[0]))
            side = self._deform(sign, 0 * z + outer - 1e-6, z * probe.tube_height / unit)
            top = self._deform(sign, outer + np.geomspace(2e-3, 1, 80), 0 * z - 1e-6)
            overlaps.append(np.nanmax(np.interp(top[1], side[1], side[0], np.nan, np.nan) - top[0], initial=-1))
        return float(min(walls) / (hole - 1)), float(max(0.0, *overlaps) * unit)

    def _deform(self, sign: int, r: np.ndarray, z: np.ndarray) -> np.ndarray:
        """Return the deformed places (outwards, up) of points of the plane y = 0."""
        points = self.mesh(sign * r, 0 * r + 1e-6, z)
        moved = self.state.components[0](points)
        return np.array([r + sign * moved[:, 0], z + moved[:, 2]])

    def press(self, indentations: tuple[float, ...]) -> list[LoadedForces]:
        """Return the path of the state through indentations in outer radii; it ends early where Newton's method fails."""
        path, previous = list[LoadedForces](), list[tuple[float, np.ndarray]]()
        outer, last = self.scene.probe.tube_radius / self.radius, 0.0
        for goal in indentations:
            step = goal - last
            while last < goal - 1e-9:
                step = min(step, goal - last)
                try:
                    self._predict(previous, last + step)
                    self.balance()
                except (ArithmeticError, NgException):
                    step /= 2
                    self._restore(previous)
                    if step < MIN_STEP * min(1.0, goal / 0.1):
                        return path
                    continue
                last += step
                previous = [*previous[-2:], (last, self.state.vec.FV().NumPy().copy())]
            path.append(self.measure(goal * outer))
        return path

    def _restore(self, previous: list[tuple[float, np.ndarray]]) -> None:
        """Return to the last state and its tangent."""
        self.state.vec.FV().NumPy()[:] = previous[-1][1] if previous else 0.0
        self._factorise()

    def _predict(self, previous: list[tuple[float, np.ndarray]], indentation: float) -> None:
        """Extrapolate the state through rest and the last states to an indentation in outer radii."""
        vec = self.state.vec
        if not previous:
            vec[:] = 0
            self._factorise()
            vec.data = indentation * self.scene.probe.tube_radius / self.radius * self._move_ends()
            vec.data += self.form.harmonic_extension * vec
            return
        nodes = [0.0] + [x for x, _ in previous]
        values = vec.FV().NumPy()
        values[:] = 0
        for k, (x, state) in enumerate(previous, start=1):
            weight = math.prod((indentation - other) / (x - other) for n, other in enumerate(nodes) if n != k)
            values[:] += weight * state
