"""The coarsest finite-element model of a probe on tissue without tumours, for planning.

One factorisation and no refinement: some 20 ms, film forces within a few per cent.

The walls at the gap bulge between the elements' corners, by a third more than at any of them, so that the finite elements'
polynomials are followed all along. Between the ends of either wall's sides the gap is one polynomial: it is evaluated at even
places, and at the top of the parabola through the largest value and both beside it, which moves smoothly with all numbers.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import SolveError
from geometry.common.json_types import JsonObject
from geometry.meridian.mesh_lines import MeridianFineness
from geometry.meridian.walls import GapWalls
from geometry.scenes.film import Film
from geometry.scenes.scene import Scene
from geometry.scenes.scene_tables import Contact, HalfSpaceTissue, Load
from solver.axisymmetric.base_states import BaseStates
from solver.axisymmetric.converged_forces import Converged
from solver.axisymmetric.film_states import CHARGE_UNIT
from solver.axisymmetric.omitted_details import Change, bound_detail, bound_omitted_changes
from solver.axisymmetric.refinement import MESH_LEVELS
from solver.axisymmetric.sample import MeshSample, solve_on_mesh
from solver.axisymmetric.sections import Sections, add_details, add_stacks, build_sections
from solver.elements.shape_functions import evaluate_edge_functions, evaluate_legendre
from solver.equivalent_inclusion.probe_on_tissue import ProbeAlone, Undisturbed
from solver.linalg.workspace import keep_result
from solver.materials.linear import Isotropic
from solver.planning.charge_changes import add_charges, compute_charge_factor, has_soft_bond
from solver.planning.loads import CANCELLING_WALL_SHARE, LoadRule, bound_wall_nearing, has_tape
from solver.planning.tumour_effects import add_tumours, adjust_rule
from solver.results.detail_compliance import FILM_DETAIL, iterate_details
from solver.results.film_forces import Bound, FilmForces
from solver.results.refusals import refuse_unsolvable
from solver.results.result import Effect

FILM_MESH = MeridianFineness(0.7, 1, 3)  # of 34 probes on tape: forces within 0.5 %, walls' approach 1.3 %, eq. PL.14 about 0.1 %
COARSE_MESH_ERROR = 0.05  # relative error that film forces and strains of the coarsest mesh may have
POINTS_PER_BLOCK = 40  # points on each block's end where the contact pressure is evaluated
PROBING_DEPTH_OUTER_RADII = 1e-3  # depth of these points under the surface, in outer radii
POINTS_PER_POLYNOMIAL = 65  # per polynomial: the maximum by parabolas is within 1e-5 of that with 1025 points
_walls = keep_result(GapWalls.from_mesh)


@dataclass(frozen=True)
class CoarseModel:
    """A scene without tumours, groove, elastic base and tilt on the coarsest mesh, its contact tied.

    Films and bonds are left out, too, unless a film has a soft bond to the base: then their film states are needed for eq. PL.14.

    Attributes
    ----------
    scene
        Without inclusions, tilt and load; groove, films and base are its own.
    sample
        Film forces and base states.
    changes
        Bounds on the effects of groove, films, base and sides that are not round; empty where they were not requested.
    """

    scene: Scene
    sample: MeshSample
    changes: tuple[Change, ...]

    @classmethod
    def from_scene(cls, scene: Scene, details: bool = True) -> CoarseModel:
        """Solve the coarse model of a scene.

        Parameters
        ----------
        scene
            The scene.
        details
            Whether to compute ``changes``.

        Raises
        ------
        Refusal
            So extreme that its equations cannot be solved in double precision.
        """
        bare = remove_tumours(scene)
        plain = build_sections(bare)
        with refuse_unsolvable("scene", "too extreme for a plan"):
            sections, coarse = _solve_coarsely(bare, plain)
            alike = replace(sections, films=None), select_base_states(coarse)
            return cls(bare, coarse, _bound_details(bare, *alike) if details else ())

    @property
    def forces(self) -> Floats:
        """F_ij, N/m, shape (2, 2)."""
        return np.asarray(self.sample.forces[0])

    @cached_property
    def base_states(self) -> Undisturbed:
        """The solution as base states for first-order effects of tumours."""
        films = FilmForces(
            self.forces, Bound.from_independent_errors(COARSE_MESH_ERROR * np.abs(self.forces.sum(axis=1)), self.forces)
        )
        sample = select_base_states(self.sample)
        alone = ProbeAlone.from_converged(self.scene, 1.0, Converged((films,), sample, (), ()))
        return Undisturbed.from_states(alone, sample.states, COARSE_MESH_ERROR)

    @cached_property
    def edge_effect(self) -> Effect | None:
        """Effect of the tissue's sides and bottom against a half-space; None on a half-space or where that cannot be solved."""
        tissue = self.scene.tissue
        if tissue.shape == "half-space":
            return None
        material: JsonObject = {key: getattr(tissue, key) for key in ("youngs_modulus", "poisson_ratio", "layer")}
        wide = self.scene.model_copy(update={"tissue": HalfSpaceTissue(shape="half-space", **material)})
        plain = build_sections(wide)
        try:
            totals, free = (sample.totals[0, :2] for sample in (self.sample, _solve_coarsely(wide, plain)[1]))
        except SolveError:
            return None
        with np.errstate(divide="ignore"):
            changes = np.abs(totals - free) / np.abs(free)
            ratio = float(abs(np.log(np.abs(totals / free)) @ [1.0, -1.0]))  # change of ln(inner / outer)
        return Effect(ratio, float(changes.max()), float(abs(totals.sum() / free.sum() - 1)))

    @cached_property
    def gap_profile(self) -> GapProfile:
        """Approach of the walls along the gap."""
        return GapProfile.from_states(self.sample.states)

    @property
    def wall_approach(self) -> float:
        """Maximum approach of the walls per unit indentation.

        Parts of the approach may cancel each other; with inclusions and at finite strain they cancel less. So it counts as at
        least a fraction of the bound PL.4, in which nothing cancels:

            max(nearing, PL.4 / 12)      (PL.9)

        with nearing the approach itself, ``GapProfile.max_nearing``.
        """
        return max(self.gap_profile.max_nearing, CANCELLING_WALL_SHARE * bound_wall_nearing(self.scene, self.forces.sum(axis=1)))

    @property
    def closure_force(self) -> float:
        """Force that closes the gap in linear elasticity, N; finite strain closes it at a fraction of that."""
        return float(self.forces.sum()) * self.scene.probe.gap / self.wall_approach

    @cached_property
    def charge_factor(self) -> float:
        """How many times as much a load changes the films' charges as the film forces, at most: eq. PL.14."""
        rule = LoadRule.from_totals(self.scene, self.forces.sum(axis=1), self.closure_force)
        return compute_charge_factor(self.scene, self.sample.states, rule)

    def build_rule(self, scene: Scene) -> LoadRule:
        """Return the rule for loads on a scene with this probe and tissue, whatever tumours it has.

        Raises
        ------
        InputError, Refusal
            See ``compute_tumour_effects``.
        """
        rule = add_charges(LoadRule.from_totals(scene, self.forces.sum(axis=1), self.closure_force), self.charge_factor)
        return add_tumours(rule, scene, self.base_states) if scene.inclusion else adjust_rule(rule, 1.0, None)

    @cached_property
    def pulled_share(self) -> float:
        """Fraction of the contact's forces that that pull while probe and tissue are tied: untied they would part there.

        Forces are those at rings of points just under both blocks' ends.
        """
        section, tissue = self.sample.states.model.section, (*self.scene.tissue.layer, self.scene.tissue)[0]
        steps = (np.arange(POINTS_PER_BLOCK) + 0.5) / POINTS_PER_BLOCK
        spans = ((0.0, section.inner_radius), (section.hole_radius, section.tube_radius))
        r = np.concatenate([low + steps * (high - low) for low, high in spans])
        ring = np.repeat([(high - low) / POINTS_PER_BLOCK for low, high in spans], POINTS_PER_BLOCK) * r
        depth = min(PROBING_DEPTH_OUTER_RADII * section.tube_radius, section.under_blocks / 10)
        strains = self.base_states.field.evaluate(r, np.full_like(r, -depth))
        law = Isotropic.from_material(tissue)
        force = -(law.dilation_modulus * strains.dilation + law.two_mu * strains.strain[:, 1]).sum(axis=-1) * ring
        return float(np.maximum(-force, 0.0).sum() / np.abs(force).sum())


def find_charge_factors(coarse: CoarseModel) -> tuple[int, float]:
    """Return whether eq. PL.13 holds for what a load changes of the ratio, 1 or 0, and eq. PL.14; 0 and 1 without charges."""
    if not has_tape(coarse.scene):
        return 0, 1.0 if coarse.scene.observable == "stress" else coarse.charge_factor
    return 1, coarse.charge_factor


def compute_charge_per_force(scene: Scene) -> Floats:
    """Return the charge per force of both films without tumours, C/N, with its sign, shape (2,), on the coarsest mesh.

    Raises
    ------
    Refusal
        So extreme that its equations cannot be solved in double precision.
    """
    film, bare = scene.probe.film or Film(), remove_tumours(scene)
    if film.uses_psi:
        return np.array([block_film.charge_per_force for block_film in film.by_block])
    layered = add_details(bare, build_sections(bare))
    with refuse_unsolvable("scene", "too extreme for a plan", "films and bonds of less extreme sizes and moduli"):
        totals = solve_on_mesh(layered.section, layered, bare, MESH_LEVELS[0]).totals[0]
    return np.asarray(CHARGE_UNIT * totals[2:] / totals[:2])


def _solve_coarsely(scene: Scene, plain: Sections) -> tuple[Sections, MeshSample]:
    """Solve a scene without tumours, and its sections ``plain``, on the coarsest mesh; return the sections that are modelled.

    They have film states where eq. PL.14 needs them, unless stacks so extreme that these cannot be solved for.

    Raises
    ------
    SolveError
        The equations cannot be solved in double precision.
    """
    if has_soft_bond(scene):
        stacked = add_stacks(scene, plain)
        try:
            return stacked, solve_on_mesh(stacked.section, stacked, scene, FILM_MESH)
        except SolveError:
            pass  # eq. PL.14 has a bound that does without
    return plain, solve_on_mesh(plain.section, plain, scene, MESH_LEVELS[0])


def select_base_states(sample: MeshSample) -> MeshSample:
    """Return a sample at one modulus without its film states."""
    states = sample.states
    base = replace(
        states,
        v=states.v[:, :2],
        edge=states.edge[..., :2],
        shift=states.shift[:, :2],
        products=states.products[:2],
        rounding=states.rounding[:2],
    )
    return replace(sample, products=sample.products[:, :2], product_derivatives=sample.product_derivatives[:, :2], states=base)


def _bound_details(scene: Scene, plain: Sections, coarse: MeshSample) -> tuple[Change, ...]:
    """Return bounds on the effects of a scene's details; films whose stress gives the charge are modelled in any case."""
    changes = tuple(bound_omitted_changes(scene, plain, lambda: coarse, None))
    films = (detail for detail in iterate_details(scene.probe) if detail.name == FILM_DETAIL and scene.models_charges)
    return (*changes, *(replace(bound_detail(detail, coarse), modelled=True) for detail in films))


def remove_tumours(scene: Scene) -> Scene:
    """Return the scene without inclusions, tilt and load, its contact tied."""
    contact = scene.contact
    if contact.interface == "unilateral":
        contact = Contact(interface="bonded" if contact.friction > 0 else "frictionless")
    placement = scene.placement.model_copy(update={"tilt": 0.0})
    return scene.model_copy(update={"inclusion": (), "contact": contact, "placement": placement, "load": Load(indentation=0.0)})


@dataclass(frozen=True)
class GapProfile:
    """The walls where they face each other.

    Attributes
    ----------
    heights
        Heights along the gap, m, rising; each row belongs to one polynomial, shape (k, places).
    nearing
        By how much the walls approach each other at these heights per unit indentation, of the same shape.
    """

    heights: Floats
    nearing: Floats

    @classmethod
    def from_states(cls, states: BaseStates, places: int = POINTS_PER_POLYNOMIAL) -> GapProfile:
        """Compute the approach of both walls, from the tissue to the end of the shorter block, at ``places`` per polynomial."""
        model, walls = states.model, _walls(states.model.mesh)
        section, sides = model.section, walls.compute_ends(model.section, model.mesh)
        # radial displacement of the sides' functions, summed over both base states: the whole base moves by one unit
        bases = states.edge[walls.elements, :, :2]  # without the film states, if there are any
        moved = bases.reshape(len(sides), 2, -1, 2)[:, 0].sum(axis=-1)
        moved = np.take_along_axis(moved, walls.list_functions(model.shapes.order), axis=1)
        ends = np.unique(np.minimum(sides, min(section.inner_height, section.outer_height)))
        heights = ends[:-1, None] + np.linspace(0.0, 1.0, places) * np.diff(ends)[:, None]
        inner, outer = (_compute_outward_motion(sides[wall], moved[wall], heights) for wall in walls.wall_slices)
        return cls(heights, inner - outer)

    @cached_property
    def max_nearing(self) -> float:
        """Maximum approach of the walls per unit indentation; 0 where they approach nowhere.

        At each three neighbouring places it is the top of the parabola through them, if that lies between them.
        """
        lower, middle, upper = (self.nearing[:, k : k - 2 or None] for k in range(3))
        bend, lean = 2 * middle - lower - upper, upper - lower
        top = (bend > 0) & (np.abs(lean) <= bend)
        rise = np.divide(lean**2, 8 * bend, out=np.zeros_like(middle), where=top)
        return float(max(np.max(self.nearing, initial=0.0), np.max(middle + rise, initial=0.0)))


def _compute_outward_motion(ends: Floats, moved: Floats, heights: Floats) -> Floats:
    """Return how far a wall moves outwards at ``heights``, per unit indentation.

    ``ends`` are the heights of the ends of its m element sides, (m, 2), ``moved`` the values of their functions, (m, p + 1).
    """
    side = np.searchsorted(ends.max(axis=1), heights.mean(axis=1))
    start, end = ends[side].T[..., None]
    fraction = (heights - start) / (end - start)
    values = evaluate_edge_functions(fraction, evaluate_legendre(fraction, moved.shape[1] - 1))[0]
    return np.asarray((values @ moved[side, :, None])[..., 0])
