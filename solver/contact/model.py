"""Set up the equations of a deforming section: its elements and the lines that may touch."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from geometry.common.arrays import Bools, Floats
from geometry.common.errors import SolveError
from geometry.meridian.frame import MeridianFineness
from geometry.meridian.frame import kind as kind_of
from geometry.meridian.mesh import SQUARE, Topology, nodes, topology
from geometry.meridian.section import TISSUES, Body, Section
from geometry.scenes.probe import Interface, Material
from solver.axisymmetric.base_states import Materials
from solver.axisymmetric.dofs import Numbering, numbering
from solver.contact.assembly import Assembly
from solver.contact.elements import Balance, Elements, ElementValues
from solver.contact.hyperelasticity import Hyperelastic
from solver.contact.pairs import Pair
from solver.contact.states import Linearised, State, WorkingForces
from solver.contact.touch import SPRING, Touch, touch
from solver.contact.touching_lines import contact_length, pairs_of
from solver.elements.quadrilateral import geometry
from solver.elements.shape_functions import shapes
from solver.linalg.cholesky import factorise, factorise_any
from solver.linalg.workspace import kept

OPENING, ROUND = 0.02, 0.1  # where faces may open: contact length per indentation; share of the usual rounding
LARGEST_RESIDUAL = 1e-6  # of the tangent's solutions, relative to the forces that drive them
BELOW_BASE, BESIDE = 0.05, 1.02  # of the outer block's height and radius: nearer tissue reaches the base
_mesh = kept(topology)


@dataclass(frozen=True)
class ContactModel:
    """A section with its materials on one mesh, ready to be deformed.

    Attributes:
        section, materials: the modelled section and its materials.
        mesh, elements, numbering: the discretisation.
        assembly: assembler of elements and contact.
        pairs: pairs of lines that may touch.
        lift: displacements of the elements' values per indentation of either block, rigid shift included, (n, 8 p, 2).
    """

    section: Section
    materials: Materials
    mesh: Topology
    elements: Elements
    numbering: Numbering
    assembly: Assembly
    pairs: tuple[Pair, ...]
    lift: Floats

    @classmethod
    def of(
        cls,
        section: Section,
        materials: Materials,
        interface: Interface,
        fineness: MeridianFineness,
        friction: float = 0.0,
        *,
        spring: float = 1.0,
    ) -> ContactModel:
        """Mesh a section whose faces are bonded, or slide without opening (frictionless), or open and slide against ``friction``.

        Friction acts through springs; ``spring`` scales their stiffness.

        Raises:
            SolveError: the mesh has a cell without area.
        """
        mesh, functions = _mesh(kind_of(section), fineness), shapes(fineness.order)
        at = geometry(nodes(section, mesh, functions.places), functions)
        elements = Elements.of(at, functions, _laws(materials, mesh))
        numbers = numbering(mesh, fineness.order, "bonded" if interface == "bonded" else "apart")
        lift = numbers.lift.copy()
        for side, on in enumerate(_blocks(section, mesh)):
            lift[on, :, side] -= numbers.vertical
        pairs = pairs_of(section, materials, mesh, fineness.order, faces=interface, friction=friction)
        pairs = tuple(replace(pair, spring=spring * SPRING) for pair in pairs)
        return cls(section, materials, mesh, elements, numbers, Assembly.of(numbers, pairs), pairs, lift)

    def at_rest(self) -> State:
        """Return the undeformed state."""
        none, own = tuple(np.zeros(pair.points) for pair in self.pairs), np.zeros(self.lift.shape[:2])
        grips = tuple(touch(pair, own, zero).grip if pair.friction else None for pair, zero in zip(self.pairs, none, strict=True))
        return State(0.0, np.zeros(self.numbering.unknowns), self.elements.at_rest(), none, grips)

    def with_modulus(self, youngs_modulus: float) -> ContactModel:
        """Return the model with another Young's modulus of the sphere, Pa, on the same mesh, pattern and pairs."""
        sphere = Material(youngs_modulus=youngs_modulus, poisson_ratio=self.materials[Body.INCLUSION].poisson_ratio)
        materials = {**self.materials, Body.INCLUSION: sphere}
        return replace(self, materials=materials, elements=replace(self.elements, material=_laws(materials, self.mesh)))

    @property
    def loose(self) -> bool:
        """Whether faces may open."""
        return any(pair.loose for pair in self.pairs)

    @property
    def sticky(self) -> bool:
        """Whether there is friction."""
        return any(pair.friction > 0 for pair in self.pairs)

    def contact_lengths(self, indentation: float) -> list[float]:
        """Return the length, m, to which each pair's penetration and rounding are relative.

        It is the gap or a fraction of the probe's radius. Faces open, and round edges close, at any load: their length goes to
        zero with the indentation.
        """
        length = contact_length(self.section)
        return [min(length, OPENING * indentation) if pair.smooth else length for pair in self.pairs]

    @property
    def target(self) -> Floats:
        """Mask of the sphere's elements, 0 or 1, shape (n, 1)."""
        return np.asarray(self.mesh.body == Body.INCLUSION, dtype=float)[:, None]

    def displaced(self, v: Floats, indentation: float) -> Floats:
        """Return the displacements of the elements' values, m, shape (n, 8 p), the blocks' rigid shift included."""
        return np.asarray((self.numbering.gather @ v).reshape(self.lift.shape[:2]) + indentation * self.lift.sum(axis=-1))

    def touches(self, state: State) -> tuple[Touch, ...]:
        """Compute gaps, forces and tangent of all pairs in a state.

        Raises:
            SolveError: a line folds over.
        """
        own = self.displaced(state.v, state.indentation)
        lengths = self.contact_lengths(state.indentation)
        blurs = [state.blur * length * (ROUND if pair.smooth else 1.0) for pair, length in zip(self.pairs, lengths, strict=True)]
        each = zip(self.pairs, state.multipliers, blurs, state.grips, strict=True)
        return tuple(touch(pair, own, m, state.share, blur, grip=grip) for pair, m, blur, grip in each)

    def linearised(self, state: State, known: Linearised | None = None) -> Linearised:
        """Linearise about a state; ``known`` gives the elements' part if only contact has changed.

        Raises:
            SolveError: a line folds over.
        """
        if known is None:
            balance, stiffness, elimination = self.elements.tangent(state.elements)
        else:
            balance, stiffness, elimination = known.balance, known.stiffness, known.elimination
        touches = self.touches(state)
        parts = [one.stiffness for one in touches if one.stiffness is not None]
        contact = sum(parts[1:], parts[0]) if parts else None
        forces = vars(self._forces(state, balance, touches))
        return Linearised(**forces, elimination=elimination, stiffness=stiffness, contact_stiffness=contact)

    def balanced(self, state: State, near: Linearised) -> Linearised:
        """Compute the forces in a state but keep the tangent of a state next to it; see ``linearise``."""
        balance, touches = self.elements.balance(state.elements, near.elimination), self.touches(state)
        return replace(near, **vars(self._forces(state, balance, touches)))

    def _forces(self, state: State, balance: Balance, touches: tuple[Touch, ...]) -> WorkingForces:
        """Add the forces of elements and contact."""
        gather, m = self.numbering.gather, self.elements.shapes.skeleton
        contact = sum((one.forces for one in touches), np.zeros(gather.shape[0]))
        internal = np.abs(balance.internal).reshape(len(balance.internal), 2, -1)[:, :, :m].reshape(-1)
        residual = gather.T @ (balance.forces.ravel() + contact)
        scale = float(np.linalg.norm(abs(gather).T @ (internal + np.abs(contact))))
        lengths = self.contact_lengths(state.indentation)
        deepest = max((one.off / x for one, x in zip(touches, lengths, strict=True) if x > 0), default=0.0)
        return WorkingForces(balance, touches, contact, residual, scale, deepest)

    def factored(self, at: Linearised) -> Linearised:
        """Return the equations with their tangent factorised."""
        if at.factor is not None:
            return at
        matrix = self.assembly.tangent(at.stiffness, at.contact_stiffness)
        return replace(at, factor=factorise_any(matrix) if self.sticky else factorise(matrix, self.assembly.pattern))

    def moved(self, state: State, at: Linearised, step: Floats, share: float = 1.0) -> State:
        """Return the state after a share of a Newton step, given by its part on the unknowns."""
        edge = (self.numbering.gather @ step).reshape(self.lift.shape[:2])
        elements = self.elements.moved(state.elements, at.elimination, edge, at.balance, share)
        return replace(state, v=state.v + share * step, elements=elements)

    def shifted(self, state: State, at: Linearised, change: Floats, indentation: float) -> State:
        """Return a state with changed unknowns and another indentation; interior values and pressures follow linearly."""
        deeper = indentation - state.indentation
        own = self.numbering.gather @ change + deeper * self.numbering.lift.sum(axis=-1).ravel()
        elements = self.elements.moved(state.elements, at.elimination, own.reshape(self.lift.shape[:2]))
        return replace(state, indentation=indentation, v=state.v + change, elements=elements)

    def rates(self, state: State, at: Linearised, change: Floats) -> State:
        """Return the derivative of a state with respect to indentation; ``change`` is that of its unknowns."""
        none = replace(state, indentation=0.0, v=np.zeros_like(state.v), elements=self.elements.at_rest())
        return self.shifted(none, at, change, 1.0)

    def contact_radius(self, at: Linearised, state: State) -> float:
        """Return the outer radius of the contact with the tissue in the deformed state, m."""
        own, pair = self.displaced(state.v, state.indentation), self.pairs[-1]
        edge = float(pair.slave.positions(own)[0, 0, 0])
        touching = at.touches[-1].pressure > 0
        return float(np.max(pair.places(own)[touching, 0], initial=edge))

    def check_base(self, state: State) -> None:
        """Raise ``SolveError`` if the tissue's top reaches the base or its flange, whose contact is not modelled."""
        own, section = self.displaced(state.v, state.indentation), self.section
        pair = self.pairs[-1]
        top = pair.slave if self.mesh.body[pair.slave.element[0]] in TISSUES else pair.master
        r, z = np.moveaxis(top.positions(own)[:, :, :2], 1, 0)
        height = float(section.outer_height)
        flange = height + float(section.film + section.adhesive + section.step_height)
        limits = ((BESIDE * float(section.tube_radius), (1 - BELOW_BASE) * height), (float(section.flange_radius), flange))
        if any(np.any((r < radius) & (z > high - state.indentation)) for radius, high in limits):
            raise SolveError("the tissue reaches the base")

    def film_forces(self, at: Linearised) -> Floats:
        """Return the forces on the films, N, (2,): what the energy rises by per indentation of each block's base (CT.6)."""
        return np.asarray(self.lift.reshape(-1, 2).T @ (at.balance.forces.ravel() + at.contact))

    def responses(self, state: State, at: Linearised, target: Floats | None = None) -> tuple[Floats, Floats]:
        """Return derivatives of unknowns and film forces with respect to indentation and, for a target, to ln E.

        Their shapes are (unknowns, k) and (2, k).

        Raises:
            SolveError: the residual of the solution is too large.
        """
        gather, flat = self.numbering.gather, self.lift.reshape(-1, 2)
        driven = self._times(at, flat.sum(axis=1, keepdims=True))
        if target is not None:
            modulus = self.elements.by_modulus(state.elements, at.elimination, target)
            driven = np.concatenate([driven, modulus.reshape(-1, 1)], axis=1)
        factor = self.factored(at).factor
        assert factor is not None
        changes = -factor.solve(np.ascontiguousarray(gather.T @ driven))
        whole = driven + self._times(at, gather @ changes)
        unbalanced = np.linalg.norm(gather.T @ whole, axis=0)
        if not np.all(unbalanced <= LARGEST_RESIDUAL * np.linalg.norm(np.abs(driven) + np.abs(whole), axis=0)):
            raise SolveError("the equations of the tangent cannot be solved")
        return changes, np.asarray(flat.T @ whole)

    def _times(self, at: Linearised, own: Floats) -> Floats:
        """Return the tangent times changes of the elements' values, (n (8 p), k) both."""
        n, width, _ = self.lift.shape
        out = (at.stiffness @ own.reshape(n, width, -1)).reshape(n * width, -1)
        return out if at.contact_stiffness is None else out + at.contact_stiffness @ own


def _laws(materials: Materials, mesh: Topology) -> Hyperelastic:
    """Return the hyperelastic materials of all elements."""
    moduli = [[materials[Body(body)].youngs_modulus, materials[Body(body)].poisson_ratio] for body in mesh.body]
    return Hyperelastic.of(*np.array(moduli).T)


def _blocks(section: Section, mesh: Topology) -> tuple[Bools, Bools]:
    """Return masks of the elements that move with the inner and with the outer block, films and base included."""
    probe = ~np.isin(mesh.body, (*TISSUES, Body.INCLUSION))
    inside = nodes(section, mesh, SQUARE)[..., 0].mean(axis=1) < section.inner_radius
    return probe & inside, probe & ~inside


def check_volume(elements: Elements, state: ElementValues) -> None:
    """Raise ``SolveError`` if an element is turned inside out."""
    if not elements.least_volume(state.u) > 0:
        raise SolveError("an element folds over")
