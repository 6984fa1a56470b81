"""The coarsest finite-element model of a probe on tissue without tumours, for planning.

One factorisation and no refinement: some 20 ms, film forces within a few per cent.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import Refusal, SolveError
from geometry.scenes.scene import Contact, HalfSpaceTissue, Load, Scene
from solver.axisymmetric.converged_forces import Converged
from solver.axisymmetric.omitted_details import Change, omitted_changes
from solver.axisymmetric.refinement import LEVELS
from solver.axisymmetric.sample import MeshSample, sample
from solver.axisymmetric.sections import sections
from solver.equivalent_inclusion.probe_on_tissue import ProbeAlone, Undisturbed
from solver.planning.gap_profile import GapProfile
from solver.planning.loads import CANCELLING_WALLS, LoadRule, nearing_at_most
from solver.planning.tumour_effects import with_tumours
from solver.results.film_forces import Bound, FilmForces
from solver.results.result import Effect

OFF = 0.05  # relative error that film forces and strains of the coarsest mesh may have
PLACES = 40  # points on each block's end where the contact pressure is evaluated
BELOW = 1e-3  # depth of these points under the surface, in outer radii


@dataclass(frozen=True)
class CoarseModel:
    """A scene without tumours, groove, films, elastic base and tilt on the coarsest mesh, its contact tied.

    Attributes:
        scene: without inclusions, tilt and load; groove, films and base are its own.
        sample: film forces and base states.
        changes: bounds on what groove, films, base and sides that are not round change.
    """

    scene: Scene
    sample: MeshSample
    changes: tuple[Change, ...]

    @classmethod
    def of(cls, scene: Scene, details: bool = True) -> CoarseModel:
        """Solve the coarse model of a scene.

        Args:
            scene: the scene.
            details: whether to compute ``changes``.

        Raises:
            Refusal: so extreme that its equations cannot be solved in double precision.
        """
        bare = without_tumours(scene)
        plain = sections(bare)
        try:
            coarse = sample(plain.section, plain, bare, LEVELS[0])
            return cls(bare, coarse, tuple(omitted_changes(bare, plain, lambda: coarse, None)) if details else ())
        except SolveError as fault:
            why = f"scenes whose sizes and moduli lie closer together ({fault})"
            raise Refusal("scene", "too extreme for a plan", why) from fault

    @property
    def forces(self) -> Floats:
        """F_ij, N/m, shape (2, 2)."""
        return np.asarray(self.sample.forces[0])

    @cached_property
    def undisturbed(self) -> Undisturbed:
        """The solution as base states for first-order effects of tumours."""
        films = FilmForces(self.forces, Bound.independent(OFF * np.abs(self.forces.sum(axis=1)), self.forces))
        alone = ProbeAlone.of(self.scene, 1.0, Converged((films,), self.sample, (), ()))
        return Undisturbed.on(alone, self.sample.states, OFF)

    @cached_property
    def edges(self) -> Effect | None:
        """Effect of the tissue's sides and floor against a half-space; None on a half-space or where that cannot be solved."""
        tissue = self.scene.tissue
        if tissue.shape == "half-space":
            return None
        material: dict[str, Any] = {key: getattr(tissue, key) for key in ("youngs_modulus", "poisson_ratio", "layer")}
        wide = self.scene.model_copy(update={"tissue": HalfSpaceTissue(shape="half-space", **material)})
        plain = sections(wide)
        try:
            totals, free = self.sample.totals[0], sample(plain.section, plain, wide, LEVELS[0]).totals[0]
        except SolveError:
            return None
        with np.errstate(divide="ignore"):
            changes = np.abs(totals - free) / np.abs(free)
            ratio = float(abs(np.log(np.abs(totals / free)) @ [1.0, -1.0]))
        return Effect(ratio, float(changes.max()), float(abs(totals.sum() / free.sum() - 1)))

    @cached_property
    def gap(self) -> GapProfile:
        """Approach of the walls along the gap."""
        return GapProfile.of(self.sample.states)

    @property
    def approach(self) -> float:
        """Maximum approach of the walls per unit indentation.

        Where what nears them cancels, inclusions and finite strain leave more of it than there is without; so it counts as

            max(nearing, PL.4 / 12)      (PL.9)
        """
        return max(self.gap.most, CANCELLING_WALLS * nearing_at_most(self.scene, self.forces.sum(axis=1)))

    @property
    def closure(self) -> float:
        """Force that closes the gap in linear elasticity, N; several times the true one."""
        return float(self.forces.sum()) * self.scene.probe.gap / self.approach

    def rule(self, scene: Scene) -> LoadRule:
        """Return the rule for loads on a scene with this probe and tissue, whatever tumours it has.

        Raises:
            InputError, Refusal: see ``TumourEffects.from_scene``.
        """
        return with_tumours(LoadRule.of(scene, self.forces.sum(axis=1), self.closure), scene, lambda: self.undisturbed)

    @cached_property
    def pulled(self) -> float:
        """Fraction of the contact forces that pull while both surfaces are tied to each other: this part would open."""
        section, tissue = self.sample.states.model.section, (*self.scene.tissue.layer, self.scene.tissue)[0]
        steps = (np.arange(PLACES) + 0.5) / PLACES
        spans = ((0.0, section.inner_radius), (section.hole_radius, section.tube_radius))
        r = np.concatenate([low + steps * (high - low) for low, high in spans])
        ring = np.repeat([(high - low) / PLACES for low, high in spans], PLACES) * r
        depth = min(BELOW * section.tube_radius, section.under_blocks / 10)
        strains = self.undisturbed.field.at(r, np.full_like(r, -depth))
        lam = tissue.youngs_modulus * tissue.poisson_ratio / ((1 + tissue.poisson_ratio) * (1 - 2 * tissue.poisson_ratio))
        shear = tissue.youngs_modulus / (1 + tissue.poisson_ratio)
        force = -(lam * strains.dilation + shear * strains.strain[:, 1]).sum(axis=-1) * ring
        return float(np.maximum(-force, 0.0).sum() / np.abs(force).sum())


def without_tumours(scene: Scene) -> Scene:
    """Return the scene without inclusions, tilt and load, its contact tied."""
    contact = scene.contact
    if contact.interface == "unilateral":
        contact = Contact(interface="bonded" if contact.friction > 0 else "frictionless")
    at = scene.placement.model_copy(update={"tilt": 0.0})
    return scene.model_copy(update={"inclusion": (), "contact": contact, "placement": at, "load": Load(indentation=0.0)})
