"""Film forces of one section on one mesh, and what the gap's walls do there, with and without the inclusion."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from geometry.common.arrays import Floats, Ints
from geometry.common.errors import SolveError
from geometry.meridian.frame import Kind, MeridianFineness
from geometry.meridian.mesh import nodes
from geometry.meridian.section import LAYERS, Body, Section
from geometry.meridian.walls import GapWalls, on_sides
from geometry.scenes.probe import Material
from geometry.scenes.scene import Scene
from solver.axisymmetric.base_states import BaseStates, MeridianModel, base_states, model, products
from solver.axisymmetric.condensed_system import System
from solver.axisymmetric.modulus_response import ModulusResponse, response
from solver.axisymmetric.sections import Sections
from solver.elements.quadrilateral import lame, stiffness
from solver.elements.shape_functions import functions
from solver.linalg.threads import one_thread
from solver.linalg.workspace import current, kept

ALONG = np.linspace(0.0, 1.0, 33)  # where along an element's side the gap is looked at: its least is then smooth in the lengths
CHEAP = 4  # order up to which another factorisation costs less than a coarse mesh without the inclusion
ROUGH = 0.05  # of the energy: held by the last degree, more says that a mesh is too coarse
CENTRE = np.array([[0.5, 0.5]])
_walls = kept(GapWalls.of)


@dataclass(frozen=True)
class MeshSample:
    """Film forces at one or several moduli on one mesh.

    Attributes:
        forces, slope: F_ij and dF_ij / d ln E_object, shape (k, 2, 2).
        states: the base states that they come from.
        times: the moduli as multiples of that of ``states``, shape (k,).
        response: how the states change with the modulus, where there are several.
    """

    forces: Floats
    slope: Floats
    states: BaseStates
    times: Floats
    response: ModulusResponse | None = None

    @property
    def rounding(self) -> Floats:
        """Bound on what rounding changes in each film's total, shape (2,)."""
        return np.asarray(self.states.rounding.sum(axis=1))

    @property
    def totals(self) -> Floats:
        """Force on each film, shape (k, 2)."""
        return np.asarray(self.forces.sum(axis=2))

    @property
    def log_sensitivity(self) -> Floats:
        """Log-sensitivities, shape (k,); 0 where a total is zero."""
        totals = self.totals
        shares = np.divide(self.slope.sum(axis=2), totals, out=np.zeros_like(totals), where=totals != 0)
        return np.asarray(shares[:, 0] - shares[:, 1])


@dataclass(frozen=True)
class PressedBlocks:
    """Both blocks' bases moved down by one unit.

    Attributes:
        model: what was solved.
        totals: force on each film, N/m, shape (2,).
        edge: the elements' values on corners and edges, shape (n, 8 p).
    """

    model: MeridianModel
    totals: Floats
    edge: Floats

    @classmethod
    def of(cls, states: BaseStates) -> PressedBlocks:
        """Add up both base states."""
        return cls(states.model, states.forces.sum(axis=1), states.edge.sum(axis=2))

    @classmethod
    def without_inclusion(cls, states: BaseStates) -> PressedBlocks | None:
        """Return what tissue in the place of the inclusion makes of it on the same mesh; None where that is not cheap or good.

        The mesh is made for the inclusion, and may be too coarse without it: what the edges' functions of the last degree hold of
        the energy tells. Forces are good to a hundredth, the closing force to a tenth.

        Raises:
            SolveError: the residual of the solution is too large to be trusted.
        """
        one = states.model
        inside = np.flatnonzero(one.mesh.body == Body.INCLUSION)
        if one.section.has_details or (inside.size and one.shapes.order > CHEAP):
            return None
        if not inside.size:
            return cls.of(states)
        whole, lift = one.system.stiffness.copy(), one.system.numbering.lift
        whole[inside] = _as_tissue(one, inside)
        system = System.of(one.system.numbering, whole)
        found = system.solve(np.zeros((system.numbering.unknowns, 1)), lift.sum(axis=2, keepdims=True))
        totals, shapes = products(lift, found.loads)[:, 0], one.shapes
        last = np.tile(shapes.degrees[: shapes.skeleton].max(axis=1) == shapes.order, 2)
        part = found.own * last[:, None]
        rough = products(part, system.stiffness @ part)[0, 0] > ROUGH * totals.sum()
        return None if rough else cls(one, totals, found.own[..., 0])

    @cached_property
    def closing(self) -> tuple[Floats, Floats]:
        """Heights on the walls that face each other, m, and by how much they near each other there."""
        section, mesh, shapes = self.model.section, self.model.mesh, self.model.shapes
        walls = _walls(mesh)
        heights, edges = walls.heights(section, mesh, ALONG), shapes.skeleton
        values = functions(on_sides(ALONG).reshape(-1, 2), shapes.degrees[:edges])[0].reshape(4, len(ALONG), edges)
        moved = (values[walls.sides] @ self.edge[walls.elements, :edges, None])[..., 0]
        both = []
        for one in (slice(walls.inner), slice(walls.inner, None)):
            z, first = np.unique(heights[one], return_index=True)
            both.append((z, moved[one].ravel()[first]))
        z = np.union1d(both[0][0], both[1][0])
        z = z[z <= min(section.inner_height, section.outer_height)]
        return z, np.interp(z, *both[0]) - np.interp(z, *both[1])

    @property
    def approach(self) -> float:
        """The most that the walls near each other; 0 where they do so nowhere."""
        return float(np.max(self.closing[1], initial=0.0))

    @property
    def closure(self) -> float:
        """Force that closes the gap, N; infinite where none does."""
        gap, approach = self.model.section.hole_radius - self.model.section.inner_radius, self.approach
        return float(self.totals.sum()) * gap / approach if approach > 0 else math.inf


def pressed_alone(states: BaseStates) -> tuple[Floats, float] | None:
    """Return film forces per indentation, N/m, shape (2,), and the force that closes the gap, N, without the inclusion.

    None where that is not cheap, or cannot be solved. Kept for the mesh and all materials but the inclusion's, on which nothing
    here depends: no answer hangs on what was answered before.
    """
    one, layout = states.model, states.model.mesh.layout
    others = tuple((body, material) for body, material in one.materials.items() if body != Body.INCLUSION)
    key = (pressed_alone, one.section, others, one.interface, layout.kind, layout.fineness)
    return current().keep(key, partial(_pressed_alone, states), fixed=True)


def _pressed_alone(states: BaseStates) -> tuple[Floats, float] | None:
    try:
        with one_thread():
            pressed = PressedBlocks.without_inclusion(states)
    except (SolveError, np.linalg.LinAlgError):
        return None
    return None if pressed is None else (pressed.totals, pressed.closure)


def _as_tissue(one: MeridianModel, inside: Ints) -> Floats:
    """Matrices of the inclusion's elements, were they of the tissue at their depth."""
    section, bodies = one.section, [Body.TISSUE]
    if section.interfaces:
        layers = [*LAYERS[: len(section.interfaces)], Body.TISSUE]
        depth = -nodes(section, one.mesh, CENTRE, inside)[:, 0, 1]
        bodies = [layers[k] for k in np.searchsorted(section.interfaces, depth)]
    materials = [one.materials[body] for body in bodies]
    ratios = np.array([each.poisson_ratio for each in materials])
    moduli = np.array([each.youngs_modulus for each in materials])
    two_mu, lam = (np.broadcast_to(each, inside.shape) for each in lame(moduli, ratios))
    return stiffness(one.at.of(inside), one.shapes, two_mu, lam).condensed().stiffness


def sample(
    section: Section,
    of: Sections,
    scene: Scene,
    level: MeridianFineness,
    *,
    moduli: Floats | None = None,
    kind: Kind | None = None,
) -> MeshSample:
    """Solve one section on one mesh, at the inclusion's modulus or at all ``moduli``.

    Raises:
        SolveError: the equations cannot be solved in double precision.
    """
    materials, interface = dict(of.materials), scene.contact.interface
    assert interface != "unilateral"  # refused before
    if moduli is not None:
        shift = _middle(moduli, scene.tissue.youngs_modulus)
        ratio = scene.inclusion[0].poisson_ratio
        materials[Body.INCLUSION] = Material(youngs_modulus=shift, poisson_ratio=ratio)
    try:
        states = base_states(model(section, materials, interface, level, kind))
    except np.linalg.LinAlgError as fault:  # Poisson's ratio within rounding of 1/2
        raise SolveError(f"an element's matrix cannot be inverted: {fault}") from fault
    if moduli is None:
        slope = states.slope() if scene.inclusion else np.zeros((2, 2))
        return MeshSample(states.forces[None], slope[None], states, np.ones(1))
    times = moduli / shift
    spanned = response(states, times.min(), times.max())
    return MeshSample(*spanned.forces(times), states, times, spanned)


def _middle(moduli: Floats, tissue: float) -> float:
    """The modulus from which a curve is spanned: the middle of its part in which the film forces change."""
    low, high = np.clip([moduli.min(), moduli.max()], 0.01 * tissue, 100 * tissue)
    return float(np.sqrt(low * high))
