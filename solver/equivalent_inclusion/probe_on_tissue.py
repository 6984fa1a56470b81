"""Solve a probe on tissue without tumours, once for all tumours: film forces with their errors, and the strains everywhere."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from geometry.common.arrays import Bools, Floats
from geometry.common.errors import Refusal
from geometry.common.limits import format_maximum_mm
from geometry.meridian.mesh_lines import MeridianFineness
from geometry.meridian.section import LAYERS, Body, Section
from geometry.scenes.probe import format_mm
from geometry.scenes.scene import Scene
from geometry.scenes.scene_tables import Load
from solver.axisymmetric.base_states import BaseStates, Materials, build_model, solve_base_states
from solver.axisymmetric.converged_forces import Converged, compute_converged_forces
from solver.axisymmetric.dofs import Interface
from solver.axisymmetric.film_states import CHARGE_UNIT, Films
from solver.axisymmetric.stack_cells import choose_strain_stack
from solver.axisymmetric.tissue_field import TissueField
from solver.equivalent_inclusion.strain_products import Energies
from solver.inclusions.tumours import Strata, Tumours
from solver.linalg.workspace import get_workspace, keep_within_limits
from solver.multiple_scattering.exchange import Reflector
from solver.results.film_forces import FilmForces
from solver.results.refusals import refuse_unsolvable
from solver.results.result import Decision
from solver.results.warnings import Note, select_notes

FIELD_FINENESSES = (
    MeridianFineness(1.5, 3, 5),
    MeridianFineness(2, 3, 6),
)  # meshes of the strains; tests hold their errors below FIELD_ERRORS
FIELD_ERRORS = 5e-4, 3e-5  # of the effect of a tumour one outer radius from the probe, rising with the square of the distance
FINE_MESH_ACCURACY = 0.0015  # accuracy below which the finer mesh is used
LAYER_CELLS = 2.0  # cells per length in layers, whose own rows may be few and tall
SHALLOW_DEPTH_OUTER_RADII = 0.2  # outer radii: the depth of a centre above which the coarser mesh is too coarse
REFLECTION_FINENESS = MeridianFineness(1, 1, 4)  # mesh for reflections to ordinary tumours
REFLECTION_ERROR = 3e-4  # of an ordinary tumour's effect, from that mesh; a sweep over finer ones gave 1e-4
HALF_SPACE_END_OUTER_RADII = 300.0  # outer radii: where a half-space ends for strains, which this changes by its square
FILM_ACCURACY_SHARE = 0.2  # fraction of the requested accuracy for film forces without tumours


@dataclass(frozen=True)
class ProbeAlone:
    """Film forces and charges of a scene's probe on its tissue without tumours, without the mesh: enough for bounds.

    Attributes
    ----------
    scene
        Without inclusions, at no load.
    accuracy
        Requested with tumours.
    films
        Film forces without tumours, and charges where they follow from the films' stress.
    plan
        Features that are left out or modelled beyond blocks and tissue.
    notes
        Features that are left out and matter.
    stopped
        Notes on limits of memory and time that stopped refinement.
    section, materials, actuators
        What is modelled; ``actuators`` are the inner and the outer film, None where no charge follows from their stress.
    residual
        The largest relative residual of the linear solutions.
    """

    scene: Scene
    accuracy: float
    films: FilmForces
    plan: tuple[Decision, ...]
    notes: tuple[Note, ...]
    stopped: tuple[Note, ...]
    section: Section
    materials: Materials
    actuators: Films | None
    residual: float

    @classmethod
    def from_converged(cls, scene: Scene, accuracy: float, converged: Converged) -> ProbeAlone:
        """Build from converged film forces, without their mesh, which would take most of the memory."""
        states, notes, stopped = converged.sample.states, *(select_notes(converged.notes, kind) for kind in ("left_out", "limit"))
        plan, solved_model = tuple(replace(decision, tolerance=accuracy) for decision in converged.plan), states.model
        return cls(
            scene,
            accuracy,
            converged.films[0],
            plan,
            notes,
            stopped,
            solved_model.section,
            solved_model.materials,
            solved_model.films,
            states.residual,
        )


@dataclass(frozen=True)
class Undisturbed(ProbeAlone):
    """The base states of a scene's probe and tissue, everywhere, and the film states with ``actuators``.

    Attributes
    ----------
    energies
        Strain products of the states, on another mesh than film forces.
    nearest_error
        Relative error, by the mesh of the strains, of the effect of a tumour close to the probe.
    """

    energies: Energies
    nearest_error: float

    @classmethod
    def from_states(cls, films: ProbeAlone, states: BaseStates, nearest_error: float) -> Undisturbed:
        """Add base states to a probe's film forces."""
        fields = vars(films) | {"residual": max(films.residual, states.residual)}
        return cls(**fields, energies=Energies(TissueField(states)), nearest_error=nearest_error)

    @cached_property
    def strata(self) -> Strata:
        """The tissue's materials by depth."""
        return Strata.from_tissue(self.scene.tissue)

    @property
    def observables(self) -> tuple[tuple[FilmForces, slice, float], ...]:
        """Film forces and, with ``actuators``, charges: without tumours, their rows among the states, and the unit of these."""
        forces = (self.films, slice(0, 2), 1.0)
        return (forces,) if self.films.charges is None else (forces, (self.films.charges, slice(2, 4), CHARGE_UNIT))

    @property
    def field(self) -> TissueField:
        """The states as functions of position."""
        return self.energies.field

    def bound_field_error(self, tumours: Tumours) -> Floats:
        """Bound the relative error of each tumour's effect due to the mesh, whose cells grow with the distance from the probe."""
        far = (tumours.offset**2 + tumours.depth**2) / self.field.states.model.section.tube_radius**2
        return np.asarray(self.nearest_error * (1 + far))

    def bound_reflection_error(self, tumours: Tumours) -> Floats:
        """Bound the error of each tumour's reflection due to the mesh, not refined at the tumour, relative to its effect."""
        depth = tumours.depth / self.field.states.model.section.tube_radius
        error = self.nearest_error / 50 / depth**3  # 1e-5 on the coarser mesh, from a sweep against ``axisymmetric``
        mesh_error = np.minimum(0.1, error) * (tumours.diameter / 2 / tumours.depth) ** 3
        return np.asarray(mesh_error + REFLECTION_ERROR * self._is_ordinary(tumours))

    def choose_reflector(self, tumours: Tumours) -> Reflector:
        """Return the boundary that reflects the fields of one set of tumours: a coarse model where no tumour is near it."""
        return self._coarse_reflector if self._is_ordinary(tumours) else self._fine_reflector

    def _is_ordinary(self, tumours: Tumours) -> bool:
        """Return whether no tumour is shallow, large or near a face of its layer, so that the coarse mesh is accurate."""
        section, depth, diameter = self.field.states.model.section, tumours.depth, tumours.diameter
        clearance = np.minimum(
            np.minimum(tumours.cover, self.strata.compute_gap(tumours)), section.tissue_depth - depth - diameter / 2
        )
        shallow = (clearance < 0.07 * diameter) | (depth < 0.3 * section.tube_radius)
        large = diameter > np.minimum(3 * section.tube_radius, section.tissue_radius - tumours.offset)
        return self.nearest_error == FIELD_ERRORS[0] and not np.any(shallow | large)

    @cached_property
    def _fine_reflector(self) -> Reflector:
        """Reflecting boundary on the mesh of the strains, for tumours close to it."""
        return Reflector(self.field.states, get_tied_interface(self.scene), close=True)

    @cached_property
    def _coarse_reflector(self) -> Reflector:
        """Reflecting boundary on a coarse mesh, for ordinary tumours."""
        fine, interface = self.field.states.model, get_tied_interface(self.scene)  # the model on the mesh of the strains
        fineness = _refine_in_layers(REFLECTION_FINENESS, fine.section)
        return Reflector(solve_base_states(build_model(fine.section, fine.materials, interface, fineness)), interface)

    def move_inside(self, tumours: Tumours) -> tuple[Tumours, Bools]:
        """Move tumours that extend beyond the modelled cylinder of tissue to its side or bottom.

        Returns all tumours, and for each whether it was moved.

        Tissue in a block, or not centred under the probe, is a cylinder of the same area, and a half-space ends somewhere: a
        tumour may lie beyond it. At the new position its effect is larger, as strains decay with distance.

        Raises
        ------
        Refusal
            A sphere larger than the modelled tissue.
        """
        section, radius = self.field.states.model.section, tumours.diameter / 2
        # offset and depth of a centre up to which its sphere is inside, less a rounding margin
        widest, deepest = ((size - radius) * (1 - 1e-6) for size in (section.tissue_radius, section.tissue_depth))
        if np.any(widest <= 0) or np.any(deepest <= radius):
            largest = min(section.tissue_radius, section.tissue_depth / 2 * (1 - 1e-6))
            given = format_mm(float(tumours.diameter.max()))
            raise Refusal("inclusion.diameter", given, f"below {format_maximum_mm(2 * largest)} under this probe")
        outside = np.asarray((tumours.offset > widest) | (tumours.depth > deepest))
        times = np.where(tumours.offset > widest, widest / np.maximum(tumours.offset, 1e-300), 1.0)
        return replace(tumours, x=tumours.x * times, y=tumours.y * times, depth=np.minimum(tumours.depth, deepest)), outside


def solve_undisturbed(scene: Scene, accuracy: float) -> Undisturbed:
    """Solve the base states of a scene's probe on its tissue without tumours; the latest are cached in the workspace.

    The finer of two meshes is used for fine accuracies, and where one of the scene's own tumours is shallow for the probe.

    Raises
    ------
    Refusal
        Scenes so extreme that their equations cannot be solved in double precision.
    """
    get_workspace().begin()
    shallow = any(body.depth < SHALLOW_DEPTH_OUTER_RADII * scene.probe.tube_radius for body in scene.inclusion)
    return _solve_undisturbed(remove_tumours(scene), accuracy, shallow)


def solve_alone(scene: Scene, accuracy: float) -> ProbeAlone:
    """Solve only the film forces of a scene's probe on its tissue; they are cached too.

    Raises
    ------
    Refusal
        See ``solve_undisturbed``.
    """
    get_workspace().begin()
    return _solve_alone(remove_tumours(scene), accuracy)


def get_tied_interface(scene: Scene) -> Interface:
    """Return how probe and tissue are tied to each other: bonded or frictionless."""
    interface = scene.contact.interface
    assert interface != "unilateral"  # refused before
    return interface


def remove_tumours(scene: Scene) -> Scene:
    """Return the scene without inclusions and load."""
    return scene.model_copy(update={"inclusion": (), "load": Load(indentation=0.0)})


def solve_other_tissue(base: Undisturbed, scene: Scene) -> Undisturbed:
    """Solve the probe on tissue with other moduli and thicknesses of layers on the mesh of the strains, which moves with them.

    Film forces are of that mesh too, so that two such results differ by the effect of the tissue and not by their meshes; the
    bounds are those of ``base``.

    Parameters
    ----------
    base
        Solution of the same probe on the previous tissue.
    scene
        The scene with the other tissue, which has the same number of layers.

    Raises
    ------
    Refusal
        See ``solve_undisturbed``.
    """
    previous, layers = base.field.states.model, dict(zip(LAYERS, scene.tissue.layer, strict=False))
    section = replace(previous.section, **{body.name.lower(): layer.thickness for body, layer in layers.items()})
    materials: Materials = {**previous.materials, Body.TISSUE: scene.tissue, **layers}
    layout = previous.mesh.layout
    with refuse_unsolvable("evaluator", "equivalent-inclusion"):
        interface = get_tied_interface(scene)
        states = solve_base_states(
            build_model(section, materials, interface, layout.fineness, kind=layout.kind, films=base.actuators)
        )
    charges = base.films.charges and FilmForces(CHARGE_UNIT * states.products[2:], base.films.charges.bound)
    films, energies = FilmForces(states.forces, base.films.bound, charges=charges), Energies(TissueField(states))
    return replace(base, scene=remove_tumours(scene), films=films, section=section, materials=materials, energies=energies)


@keep_within_limits
def _solve_undisturbed(scene: Scene, accuracy: float, shallow: bool) -> Undisturbed:
    """Solve the base states of a scene without tumours; ``shallow`` says that one will be shallow, which needs the finer mesh."""
    fine, films = int(accuracy < FINE_MESH_ACCURACY or shallow), _solve_alone(scene, accuracy)
    with refuse_unsolvable("evaluator", "equivalent-inclusion"):
        section = _truncate_half_space(scene, films.section)
        fineness = _refine_in_layers(FIELD_FINENESSES[fine], section)
        if any(section.stacks) and not fine:
            fineness = replace(fineness, stack=choose_strain_stack(scene))
        model = build_model(section, films.materials, get_tied_interface(scene), fineness, films=films.actuators)
        states = solve_base_states(model)
    get_workspace().begin()  # what was needed only on the way may be dropped
    return Undisturbed.from_states(films, states, FIELD_ERRORS[fine])


@keep_within_limits
def _solve_alone(scene: Scene, accuracy: float) -> ProbeAlone:
    """Solve the film forces of a scene without tumours."""
    with refuse_unsolvable("evaluator", "equivalent-inclusion"):
        return ProbeAlone.from_converged(scene, accuracy, compute_converged_forces(scene, FILM_ACCURACY_SHARE * accuracy))


def _refine_in_layers(fineness: MeridianFineness, section: Section) -> MeridianFineness:
    """Return the fineness with more cells in layers, if there are any."""
    return replace(fineness, cells=LAYER_CELLS) if section.interfaces else fineness


def add_bounds(films: FilmForces, bound: Floats, forces: Floats) -> tuple[Floats, Floats]:
    """Return bounds on the errors of each film's total, (n, 2), and of ln(ratio), (n,), for n sets of tumours.

    The bound on ln(ratio) is inf where a total is below its own error.

    Parameters
    ----------
    films
        Film forces without tumours, N/m, or charges, C/m.
    bound
        Bounds on the errors of the totals' changes by tumours, shape (n, 2).
    forces
        Film forces or charges with tumours, shape (n, 2, 2).
    """
    totals = np.abs(forces.sum(axis=2))
    total_bounds = bound + films.bound.totals
    # sets with a total below its error; their fractions would have no logarithm
    buried = np.any(total_bounds >= totals, axis=1)
    tumour_share = np.divide(bound, totals, out=np.zeros_like(bound), where=np.logical_not(buried)[:, None])
    log_ratio = films.bound.log_ratio - np.log1p(-tumour_share).sum(axis=1)
    return total_bounds, np.where(buried, np.inf, log_ratio)


def _truncate_half_space(scene: Scene, section: Section) -> Section:
    """Return the section for the mesh of the strains: a half-space ends so far away that this hardly changes the strains."""
    if scene.tissue.shape != "half-space":
        return section
    far = max(HALF_SPACE_END_OUTER_RADII * section.tube_radius, 2 * max(section.interfaces, default=0.0))
    return replace(section, tissue_radius=min(section.tissue_radius, far), tissue_depth=min(section.tissue_depth, far))
