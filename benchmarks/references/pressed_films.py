"""Charges of bonded films under load by NGSolve, at finite strain with contact, films and bonds meshed.

The pressed probe of ``benchmarks/contact/ngsolve_pressing.py`` on the meshes of ``film_stacks.py``. A charge is

    Q = Int over the electrode's part of the film, per undeformed volume, of (1/t) [d_p (S_r + S_t) + d33 S_z],

d_p = (d31 + d32) / 2, with the second Piola-Kirchhoff stresses S, which turn with the film. Its derivatives at one force follow
from the loaded state's tangent.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import ngsolve as ngs
import numpy as np

from benchmarks.contact.ngsolve_pressing import ContactSetting, PressedProbe, compute_deformation
from benchmarks.references.axisymmetric import materials
from benchmarks.references.film_stacks import CLEARANCE, SIDES, SOLES, find_layers, make_stack_mesh
from benchmarks.references.outline import NAMES
from geometry import Material, Scene
from geometry.common.arrays import Floats

FORCE_TOLERANCE = 1e-7  # relative
LOG_MODULUS_CHANGE, NUDGE = 0.05, 1e-5  # of ln E and, relative, of the indentation
TISSUE_LINES = ("face_inner|strip", "strip|face_outer|top")  # that the inner and the outer block may slide on
TINY_INDENTATION = 1e-5  # inner radii


@dataclass(frozen=True)
class LoadedCharges:
    """One state: indentation (m), film forces (N) and charges (C), inner and outer, and d ln(Q_inner / Q_outer) / d ln E."""

    indentation: float
    forces: Floats
    charges: Floats
    log_sensitivity: float


class PressedFilms(PressedProbe):
    """A pressed probe with films and bonds on its blocks."""

    def __init__(self, scene: Scene, setting: ContactSetting, corner_layers: int) -> None:
        self.corner_layers, self.stacks = corner_layers, find_layers(scene)
        super().__init__(scene, setting)
        self.charge_forms = [self._build_charge_form(k) for k in range(2)]

    def _forms(self) -> None:
        super()._forms()
        if self.scene.contact.interface == "frictionless":
            trial = self.space.TrialFunction()
            moved = trial[0] if self.setting.mixed else trial
            self.contacts += [self._tie(moved, *names) for names in zip(SOLES, TISSUE_LINES, strict=True)]

    def _tie(self, moved: Any, sole: str, tissue: str) -> ngs.ContactBoundary:
        """Return what holds a block's lower face on the tissue's surface, along which it slides."""
        boundary = ngs.ContactBoundary(self.mesh.Boundaries(sole), self.mesh.Boundaries(tissue))
        place = ngs.CF((ngs.x, ngs.y))
        deep = (place + moved - place.Other() - moved.Other()) * boundary.normal + CLEARANCE
        boundary.AddEnergy(math.pi * ngs.x * self.setting.penalties[1] * deep**2)
        return boundary

    def _balance(self) -> None:
        """Take Newton's steps and one more: what a tolerance leaves of the displacements is much to a film as stiff as this."""
        super()._balance()
        step = self.state.vec.CreateVector()
        self._solve(self._residual(), step)
        self.state.vec.data -= step

    def make_mesh(self, scene: Scene, setting: ContactSetting) -> ngs.Mesh:
        """Mesh the meridian plane with the layers on the blocks."""
        return make_stack_mesh(scene, setting, self.corner_layers)

    def find_bodies(self) -> dict[str, Material]:
        """Return the material of each body."""
        bodies = {NAMES[k]: material for k, material in materials(self.scene).items()}
        bodies = {name: material for name, material in bodies.items() if name not in ("film", "adhesive")}
        return bodies | {name: each.material for stack in self.stacks for each in stack for _, _, name in each.columns}

    def find_heights(self) -> Any:
        """Return the layers' true heights over the mesh's."""
        layers = [each for stack in self.stacks for each in stack]
        heights = {name: each.thickness / (each.high - each.low) for each in layers for _, _, name in each.columns}
        return self.mesh.MaterialCF(heights, default=1.0)

    def _build_charge_form(self, side: int) -> ngs.BilinearForm:
        """Return a form whose energy is a charge, in C per tissue modulus and inner radius squared, for the whole circle."""
        assert self.scene.probe.film is not None
        film, heights = self.scene.probe.film.by_block[side], self.find_heights()
        trial = self.space.TrialFunction()
        a, b, c, d, hoop = compute_deformation(trial[0] if self.setting.mixed else trial, heights)
        plane = a * d - b * c
        volume, trace = plane * hoop, a**2 + b**2 + c**2 + d**2 + hoop**2
        inverses = ((b**2 + d**2) / plane**2, (a**2 + c**2) / plane**2, 1 / hoop**2)  # of C: r, z, around
        shear, bulk = self.young / (2 * (1 + self.nu)), self.young / (3 * (1 - 2 * self.nu))
        radial, axial, around = (
            shear * volume ** (-2 / 3) * (1 - trace / 3 * inverse) + bulk / 2 * (volume**2 - 1) * inverse for inverse in inverses
        )
        lateral = (film.d31 + film.d32) / 2
        density = lateral * (radial + around) + film.d33 * axial
        density *= 2 * math.pi * ngs.x * heights * self.scene.probe.inner_radius / film.thickness
        form = ngs.BilinearForm(self.space)
        form += ngs.Variation(density.Compile() * ngs.dx(definedon=self.mesh.Materials(f"film_{SIDES[side]}"), bonus_intorder=4))
        return form

    def measure(self) -> LoadedCharges:
        """Return the last state's charges and derivative."""
        probe = self.scene.probe
        unit = self.scene.tissue.youngs_modulus * probe.inner_radius**2
        charges = np.array([form.Energy(self.state.vec) for form in self.charge_forms])
        forces, indentation = self.films(), self.reached[-1][0] * probe.inner_radius
        sensitivity = self._differentiate(self._differentiate_by_modulus(), charges) if self.scene.inclusion else math.nan
        return LoadedCharges(indentation, unit * forces, -unit * charges, sensitivity)

    def compute_difference(self, force: float, step: float) -> float:
        """Return d ln(Q_inner / Q_outer) / d ln E at a force, N, between moduli ``LOG_MODULUS_CHANGE`` to either side."""
        logs = []
        for sign in (-1, 1, 0):
            self.stiffer.Set(math.exp(sign * LOG_MODULUS_CHANGE))
            self.reached = self.reached[-1:]
            self.press(self.reached[0][0] * (1 + NUDGE))  # a new equilibrium, from which the force is sought
            self.reached = self.reached[-1:]
            self.press_to_force(force, step)
            charges = [form.Energy(self.state.vec) for form in self.charge_forms]
            logs.append(math.log(charges[0] / charges[1]))
        return (logs[1] - logs[0]) / (2 * LOG_MODULUS_CHANGE)

    def measure_at_rest(self) -> LoadedCharges:
        """Return what a tiny indentation gives per metre, of a probe that has not been pressed."""
        assert not self.reached
        self._residual()  # finds what touches at rest
        unit = self.scene.tissue.youngs_modulus * self.scene.probe.inner_radius
        inverse = self._factorise()
        pressed, forces = self._move_base(inverse)
        charges, sensitivity = self._apply_to_charges(pressed), math.nan
        if self.scene.inclusion:
            self.state.vec.data = TINY_INDENTATION * pressed
            driven = self._differentiate_by_modulus()
            driven.data *= 1 / TINY_INDENTATION
            self.state.vec.data *= 0.0
            sensitivity = self._differentiate(driven, charges)
        return LoadedCharges(0.0, unit * forces, -unit * charges, sensitivity)

    def _factorise(self) -> Any:
        self.form.AssembleLinearization(self.state.vec)
        return self.form.mat.Inverse(self.free, "sparsecholesky")

    def _move_base(self, inverse: Any) -> tuple[Any, Floats]:
        """Return the tangent displacement of a unit indentation, and the film forces."""
        pressed, reactions = self.state.vec.CreateVector(), self.state.vec.CreateVector()
        pressed.data = self.lifts[0] + self.lifts[1]
        reactions.data = self.form.mat * pressed
        pressed.data -= inverse * reactions
        reactions.data = self.form.mat * pressed
        forces = np.array([ngs.InnerProduct(reactions, lift) for lift in self.lifts])
        pressed.data += self.form.harmonic_extension * pressed
        return pressed, forces

    def _apply_to_charges(self, change: Any) -> Floats:
        """Return what a small displacement from the present state changes of both charges."""
        slope, changes = self.state.vec.CreateVector(), []
        for form in self.charge_forms:
            form.Apply(self.state.vec, slope)
            changes.append(ngs.InnerProduct(slope, change))
        return np.array(changes)

    def _differentiate(self, driven: Any, charges: Floats) -> float:
        """Return d ln(Q_inner / Q_outer) / d ln E at one force, ``driven`` the forces of a stiffer sphere; the base follows."""
        inverse, load, softer = self._factorise(), driven.CreateVector(), driven.CreateVector()
        load.data = driven + self.form.harmonic_extension_trans * driven
        softer.data = inverse * load
        softer.data += self.form.harmonic_extension * softer
        softer.data += self.form.inner_solve * driven
        pressed, forces = self._move_base(inverse)
        deeper = -ngs.InnerProduct(pressed, driven) / forces.sum()  # of the base per ln E
        change = deeper * self._apply_to_charges(pressed) - self._apply_to_charges(softer)
        return float(change @ (np.array([1.0, -1.0]) / charges))

    def compute_force(self) -> float:
        """Return the last state's force, N."""
        return float(self.films().sum()) * self.scene.tissue.youngs_modulus * self.scene.probe.inner_radius**2

    def press_to_force(self, force: float, step: float) -> None:
        """Press to a force in N, by steps of at most ``step`` inner radii."""
        distinct = self.reached[-1:]  # states that lie close together extrapolate badly
        for point in reversed(self.reached[:-1]):
            if distinct[0][0] - point[0] >= step / 4:
                distinct.insert(0, point)
        self.reached, points = distinct, [(0.0, 0.0)]
        while abs(points[-1][1] / force - 1) > FORCE_TOLERANCE:
            last, value = (self.reached[-1][0], self.compute_force()) if self.reached else (0.0, 0.0)
            before = points[-1]
            points.append((last, value))
            rate = (value - before[1]) / (last - before[0]) if last != before[0] else math.nan
            change = (force - value) / rate if rate > 0 else step
            if abs(value / force - 1) > FORCE_TOLERANCE:
                self.press(last + min(change, step))
                points[-1] = (last, value)
