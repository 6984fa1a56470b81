"""Press a probe at finite strain with contact by NGSolve, used as its best user would.

Curved triangles, refined at the blocks' corners; displacements alone or with pressures of their own; what lies inside elements
condensed; ``ContactBoundary`` with penalties for the gap's walls and for each wall with the tissue beside it; each load's start
extrapolated from the last three; the log-sensitivity from two solutions of the loaded state's tangent. The law is

    W = mu/2 (x + c2 x^2 + c3 x^3) + K/4 (J^2 - 1 - 2 ln J),   x = J^(-2/3) I1 - 3,

by default with c2 = c3 = 0.

Where tissue and wall leave their common corner at a right angle ``ContactBoundary`` finds penetration in rounding: points count
as they turn to the wall. Lengths are in inner radii, moduli in the tissue's.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import ngsolve as ngs
import numpy as np
from netgen.meshing import MeshingParameters, NgException

from benchmarks.peers.ngsolve_meridian import CONTACT, corners, geometry, vertices
from benchmarks.references.axisymmetric import materials
from benchmarks.references.outline import ENDS, INCLUSION, INNER, NAMES, OUTER, Edge, outline, sizes
from geometry import Material, Probe, Scene
from geometry.common.arrays import Floats
from geometry.scenes.probe import LAW_CONSTANTS

FIRST_INDENTATION = 1e-4  # the first indentation
MIN_STEP, MAX_NEWTON_STEPS, MIN_STEP_SHARE = 1e-4, 25, 0.2  # of indentations; Newton's steps, and the least share of one
LOG_MODULUS_STEP = 1e-4  # of ln E for the derivative of the forces
GAP, SIDE = ("hole wall", "inner wall"), (("strip", "inner wall"), ("strip", "hole wall"), ("top", "tube wall"))


@dataclass(frozen=True)
class ContactSetting:
    """One discretisation.

    Attributes
    ----------
    order
        Of the displacements.
    size
        Of an element over the distance to the next edge of the same body.
    layers
        Geometric layers at the blocks' lower corners.
    mixed
        Whether pressures, of two orders less, are unknowns too.
    penalties
        Of the gap's walls and of walls with tissue, tissue moduli per inner radius.
    blur
        Gap over which the penalties' kink is rounded.
    tolerance
        Of Newton's steps, relative to the displacements.
    """

    order: int
    size: float
    layers: int = 0
    mixed: bool = False
    penalties: tuple[float, float] = (800.0, 3000.0)
    blur: float = 1e-4
    tolerance: float = 1e-6


def make_mesh(scene: Scene, setting: ContactSetting) -> ngs.Mesh:
    """Mesh the meridian plane, its lines named that may touch."""
    edges = [replace(edge, name=name_contact_line(edge, scene.probe)) for edge in outline(scene)]
    shape = geometry(edges, dict.fromkeys(vertices(edges), 1e9), corners(edges, CONTACT))
    parameters = MeshingParameters(maxh=1e9, grading=0.5 * setting.size)
    for r, z, h in sizes(edges, setting.size):
        parameters.RestrictH(r, z, 0.0, h)
    mesh = ngs.Mesh(shape.GenerateMesh(mp=parameters))
    if setting.layers:
        mesh.RefineHP(setting.layers)
    mesh.Curve(setting.order)
    return mesh


def name_contact_line(edge: Edge, probe: Probe) -> str:
    """Return the name of a line that may touch another, or the edge's own."""
    if edge.name != "free":
        return edge.name
    hole, (a, low), (b, high) = probe.hole_radius / probe.inner_radius, edge.start, edge.end
    if low == high == 0:
        return "strip" if max(a, b) <= hole else "top"
    if a == b and INNER in (edge.left, edge.right):
        return "inner wall"
    if a == b and OUTER in (edge.left, edge.right):
        return "hole wall" if a == hole else "tube wall"
    return edge.name


def compute_deformation(displacement: Any, height: Any = None) -> tuple[Any, Any, Any, Any, Any]:
    """Return the deformation gradient's F_rr, F_rz, F_zr, F_zz and F_tt; ``height`` is a true height over the mesh's."""
    derivative = ngs.Grad(displacement)
    shear, along = derivative[0, 1], derivative[1, 1]
    if height is not None:
        shear, along = shear / height, along / height
    return 1 + derivative[0, 0], shear, derivative[1, 0], 1 + along, 1 + displacement[0] / ngs.x


def compute_energy_density(
    deformation: tuple[Any, ...], young: Any, nu: Any, pressure: Any = None, law: tuple[Any, Any] = (0, 0)
) -> Any:
    """Return W for the constants c2, c3 of ``law``; with a pressure p its bulk part U(J) as p (J - J*) + U(J*).

    J* is the volume at which U' = p.
    """
    a, b, c, d, hoop = deformation
    volume, first = (a * d - b * c) * hoop, a**2 + b**2 + c**2 + d**2 + hoop**2
    shear, bulk = young / (2 * (1 + nu)), young / (3 * (1 - 2 * nu))
    held, share = volume, 0.0
    if pressure is not None:
        x = pressure / bulk
        held = x + ngs.sqrt(1 + x * x)
        share = pressure * (volume - held)
    distortion, (c2, c3) = volume ** (-2 / 3) * first - 3, law
    return (
        shear / 2 * (distortion + c2 * distortion**2 + c3 * distortion**3) + share + bulk / 4 * (held**2 - 1 - 2 * ngs.log(held))
    )


class PressedProbe:
    """A bonded probe pressed further and further; ``steps`` counts those of Newton's method."""

    def __init__(self, scene: Scene, setting: ContactSetting) -> None:
        self.scene, self.setting, self.mesh = scene, setting, self.make_mesh(scene, setting)
        held = "bottom|" + "|".join(ENDS)
        body = ngs.VectorH1(self.mesh, order=setting.order, dirichletx=held + "|axis", dirichlety=held)
        self.space = ngs.FESpace([body, ngs.L2(self.mesh, order=setting.order - 2)]) if setting.mixed else body
        self.state = ngs.GridFunction(self.space)
        self.displacement = self.state.components[0] if setting.mixed else self.state
        self.free = self.space.FreeDofs(True)
        self.unknowns, self.steps = int(self.free.NumSet()), 0
        self.reached: list[tuple[float, Floats]] = []
        self.lifts = [self._lift(end) for end in ENDS]
        self._forms()

    def make_mesh(self, scene: Scene, setting: ContactSetting) -> ngs.Mesh:
        """Mesh the meridian plane."""
        return make_mesh(scene, setting)

    def find_bodies(self) -> dict[str, Material]:
        """Return the material of each body by its name in the mesh."""
        return {NAMES[k]: material for k, material in materials(self.scene).items()}

    def find_heights(self) -> Any:
        """Return the true heights over the mesh's, by body; None where all are true."""
        return None

    def _forms(self) -> None:
        """Forms of all bodies, with contact, and of the sphere alone."""
        trial = self.space.TrialFunction()
        moved, pressure = trial if self.setting.mixed else (trial, None)
        bodies, unit, heights = self.find_bodies(), self.scene.tissue.youngs_modulus, self.find_heights()
        self.stiffer = ngs.Parameter(1.0)
        self.young = self.mesh.MaterialCF({name: material.youngs_modulus / unit for name, material in bodies.items()})
        young = self.young * self.mesh.MaterialCF({NAMES[INCLUSION]: self.stiffer}, default=1.0)
        self.nu = self.mesh.MaterialCF({name: material.poisson_ratio for name, material in bodies.items()})
        constants = [self.mesh.MaterialCF({name: getattr(m, key) for name, m in bodies.items()}) for key in LAW_CONSTANTS]
        deformation = compute_deformation(moved, heights)
        density = compute_energy_density(deformation, young, self.nu, pressure, (constants[0], constants[1]))
        energy = (2 * math.pi * ngs.x * density * (1 if heights is None else heights)).Compile()
        self.form = ngs.BilinearForm(self.space, symmetric=True, condense=True)
        self.form += ngs.Variation(energy * ngs.dx(bonus_intorder=4))
        self.sphere = ngs.BilinearForm(self.space, symmetric=True)
        self.sphere += ngs.Variation(energy * ngs.dx(definedon=self.mesh.Materials(NAMES[INCLUSION]), bonus_intorder=4))
        self.contacts = [self._contact(moved, *GAP, self.setting.penalties[0])]
        self.contacts += [self._contact(moved, *names, self.setting.penalties[1]) for names in SIDE]

    def _contact(self, moved: Any, slave: str, master: str, penalty: float) -> ngs.ContactBoundary:
        boundary = ngs.ContactBoundary(self.mesh.Boundaries(slave), self.mesh.Boundaries(master))
        place, blur = ngs.CF((ngs.x, ngs.y)), self.setting.blur
        penetration = (place + moved - place.Other() - moved.Other()) * boundary.normal
        rounded = ngs.IfPos(
            penetration - blur,
            penetration**2 / 2 + blur**2 / 6,
            ngs.IfPos(penetration + blur, (penetration + blur) ** 3 / (12 * blur), 0),
        )
        towards = boundary.normal[0] if (slave, master) == SIDE[1] else -boundary.normal[0]
        share = (towards - 0.3) / 0.4
        turned = ngs.IfPos(share, ngs.IfPos(1 - share, share**2 * (3 - 2 * share), 1), 0)
        boundary.AddEnergy(2 * math.pi * ngs.x * penalty * rounded * turned)
        return boundary

    def _lift(self, end: str) -> Any:
        lift = ngs.GridFunction(self.space)
        body = lift.components[0] if self.setting.mixed else lift
        body.Set(ngs.CF((0.0, -1.0)), definedon=self.mesh.Boundaries(end))
        return lift.vec

    def press(self, indentation: float) -> None:
        """Go on to an indentation, where Newton's method fails in two steps.

        Raises
        ------
        ArithmeticError
            It fails in the smallest ones too.
        """
        last_indentation, kept = self.reached[-1] if self.reached else (0.0, self.state.vec.FV().NumPy().copy())
        if not self.reached and indentation > FIRST_INDENTATION:
            self.press(FIRST_INDENTATION)
            last_indentation, kept = self.reached[-1]
        try:
            self._extrapolate(indentation)
            self._balance()
        except (ArithmeticError, NgException) as fault:
            if indentation - last_indentation < MIN_STEP:
                raise ArithmeticError(f"no step beyond {last_indentation:g} converges") from fault
            self.state.vec.FV().NumPy()[:] = kept
            self.press((last_indentation + indentation) / 2)
            self.press(indentation)
            return
        self.reached.append((indentation, self.state.vec.FV().NumPy().copy()))

    def _extrapolate(self, indentation: float) -> None:
        """Start from the polynomial through the last three states."""
        latest = self.reached[-3:]
        if not latest:
            self.state.vec.data = indentation * (self.lifts[0] + self.lifts[1])
            return
        states = latest if len(latest) > 1 else [(0.0, 0 * latest[0][1]), *latest]
        weights = [math.prod((indentation - b) / (a - b) for b, _ in states if b != a) for a, _ in states]
        self.state.vec.FV().NumPy()[:] = sum(w * state for w, (_, state) in zip(weights, states, strict=True))

    def _residual(self) -> Any:
        residual = self.state.vec.CreateVector()
        for contact in self.contacts:
            contact.Update(self.displacement, self.form, 2 * self.setting.order + 2, 0.05)
        self.form.Apply(self.state.vec, residual)
        return residual

    def _balance(self) -> None:
        """Take Newton's steps, halved where forces grow; normals are those of the last step, so they end linearly."""
        vec, inner = self.state.vec, ngs.Projector(self.space.FreeDofs(), True)
        residual, step, kept = self._residual(), vec.CreateVector(), vec.CreateVector()
        for count in range(MAX_NEWTON_STEPS):
            last_norm = ngs.Norm((inner * residual).Evaluate())
            self._solve(residual, step)
            kept.data, share = vec, 1.0
            while True:
                vec.data = kept - share * step
                residual = self._residual()
                now = ngs.Norm((inner * residual).Evaluate())
                if count == 0 or (math.isfinite(now) and (now <= 2 * last_norm or share <= MIN_STEP_SHARE)):
                    break
                if not math.isfinite(now) and share < MIN_STEP:
                    raise ArithmeticError("an element folds over")
                share /= 2
            if share == 1 and ngs.Norm(step) <= self.setting.tolerance * ngs.Norm(vec):
                return
        raise ArithmeticError("Newton's method does not converge")

    def _solve(self, residual: Any, step: Any) -> None:
        """Solve with the tangent."""
        self.form.AssembleLinearization(self.state.vec)
        load = residual.CreateVector()
        load.data = residual
        load.data += self.form.harmonic_extension_trans * residual
        step.data = self.form.mat.Inverse(self.free, "sparsecholesky") * load
        step.data += self.form.harmonic_extension * step
        step.data += self.form.inner_solve * residual
        self.steps += 1

    def films(self) -> Floats:
        """Return both film forces, tissue moduli times inner radii squared."""
        residual = self._residual()
        return np.array([ngs.InnerProduct(residual, lift) for lift in self.lifts])

    def closest_walls(self) -> float:
        """Return the least distance of the gap's walls, inner radii, at points of equal height."""
        heights = np.linspace(0, 1, 201) * min(self.scene.probe.core_height, self.scene.probe.tube_height)
        lines = []
        for radius in (1 - 1e-9, self.scene.probe.hole_radius / self.scene.probe.inner_radius + 1e-9):
            points = [(radius, z / self.scene.probe.inner_radius) for z in heights]
            moved = np.array([self.displacement(self.mesh(*point)) for point in points])
            lines.append(np.array(points) + moved)
        inner, hole = lines
        return float(np.min(np.interp(inner[:, 1], hole[:, 1], hole[:, 0]) - inner[:, 0]))

    def log_sensitivity(self, films: Floats) -> float:
        """Return that of the ratio at one force."""
        self.form.AssembleLinearization(self.state.vec)
        inverse, driven = self.form.mat.Inverse(self.free, "sparsecholesky"), self._differentiate_by_modulus()
        bases, by_modulus = [], []
        for lift in self.lifts:
            base = lift.CreateVector()
            base.data = lift - inverse * (self.form.mat * lift).Evaluate()
            bases.append(base)
            whole = base.CreateVector()
            whole.data = base + self.form.harmonic_extension * base
            by_modulus.append(ngs.InnerProduct(whole, driven))
        products = [[ngs.InnerProduct((self.form.mat * a).Evaluate(), b) for a in bases] for b in bases]
        deeper, change = np.sum(products, axis=1), np.array(by_modulus)
        change -= deeper * change.sum() / deeper.sum()
        return float(change @ (np.array([1.0, -1.0]) / films))

    def _differentiate_by_modulus(self) -> Any:
        """Return the derivative of the forces with respect to ln E of the sphere, at fixed strains and pressures."""
        ends = []
        for sign in (1, -1):
            self.stiffer.Set(math.exp(sign * LOG_MODULUS_STEP))
            ends.append(self.state.vec.CreateVector())
            self.sphere.Apply(self.state.vec, ends[-1])
        self.stiffer.Set(1.0)
        ends[0].data -= ends[1]
        ends[0].data *= 1 / (2 * LOG_MODULUS_STEP)
        return ends[0]
