"""Set up the equations of a deforming section: its elements and the lines that may touch."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from geometry.common.arrays import Bools, Floats
from geometry.common.errors import SolveError
from geometry.meridian.mesh import Topology, build_topology, compute_nodes
from geometry.meridian.mesh_lines import MeridianFineness, find_kind
from geometry.meridian.section import TISSUES, Body, Section
from geometry.scenes.probe import Interface
from solver.axisymmetric.base_states import Materials
from solver.axisymmetric.dofs import Numbering, number_unknowns
from solver.axisymmetric.film_states import CHARGE_UNIT, Films, build_film_lift
from solver.contact.assembly import Assembly, join_entries
from solver.contact.contact_forces import FRICTION_SPRING_RELATIVE, Touch, compute_touch
from solver.contact.elements import Elements, ElementValues
from solver.contact.pairs import Pair, compute_contact_length, find_pairs
from solver.contact.states import Linearised, State
from solver.elements.quadrilateral import compute_geometry
from solver.elements.shape_functions import build_shapes
from solver.linalg.cholesky import factorise, factorise_any
from solver.linalg.workspace import keep_result
from solver.materials.hyperelastic import Hyperelastic
from solver.materials.strain_energies import StableRange

# where faces may open: contact length per indentation; fraction of the usual rounding
OPENING_LENGTH_RELATIVE, OPENING_BLUR_SHARE = 0.02, 0.1
MAX_RESIDUAL = 1e-6  # of the tangent's solutions, relative to the forces that drive them
BASE_HEIGHT_MARGIN, BASE_RADIUS_FACTOR = 0.05, 1.02  # of the outer block's height and radius: nearer tissue reaches the base
_mesh = keep_result(build_topology)


@dataclass(frozen=True)
class ContactModel:
    """A section with its materials on one mesh, ready to be deformed.

    Attributes
    ----------
    section, materials
        The modelled section and its materials.
    mesh, elements, numbering
        The discretisation.
    assembly
        Assembler of elements and contact.
    pairs
        Pairs of lines that may touch.
    lift
        Displacements of the elements' values per indentation of either block, rigid shift included, (n, 8 p, 2).
    outputs
        Displacements of the elements' values, (n (8 p), 2 or 4), whose energies with a state are the film forces, N, by eq. CT.4,
        and after them the charges of the films that are modelled, C, by eq. CT.7.
    """

    section: Section
    materials: Materials
    mesh: Topology
    elements: Elements
    numbering: Numbering
    assembly: Assembly
    pairs: tuple[Pair, ...]
    lift: Floats
    outputs: Floats

    @classmethod
    def from_section(
        cls,
        section: Section,
        materials: Materials,
        interface: Interface,
        fineness: MeridianFineness,
        friction: float = 0.0,
        *,
        spring: float = 1.0,
        dense: bool = False,
        tied: bool = False,
        films: Films | None = None,
        mesh: Topology | None = None,
    ) -> ContactModel:
        """Mesh a section and prepare it to be deformed.

        Parameters
        ----------
        section, materials
            The section and its materials.
        interface
            Whether faces are bonded, or slide without opening (frictionless), or open and slide against friction (unilateral).
        fineness
            Fineness and polynomial order of the mesh.
        friction
            Coulomb's coefficient.
        spring
            Factor of the stiffness of the springs through which friction acts.
        dense
            Whether there are twice the usual number of contact points; see ``find_pairs``.
        tied
            Whether nothing touches and faces stay tied as in linear elasticity: for loads that change little.
        films
            The inner and the outer film, if their charges are wanted.
        mesh
            That of a similar section, whose nodes are to move with the section; None: the section's own.

        Raises
        ------
        SolveError
            The mesh has a cell without area.
        """
        mesh, functions = mesh or _mesh(find_kind(section), fineness), build_shapes(fineness.order)
        nodes = compute_nodes(section, mesh, functions.places)
        element_geometry, corners = compute_geometry(nodes, functions), nodes[:, functions.corners]
        elements = Elements.from_geometry(element_geometry, functions, _build_laws(materials, mesh))
        numbers = number_unknowns(
            mesh, fineness.order, "bonded" if interface == "bonded" else "frictionless" if tied else "apart"
        )
        lift = numbers.lift.copy()
        # a block's unknowns are relative to its rigid shift downwards (-z), which is added here
        for side, block_elements in enumerate(_find_block_elements(section, mesh, corners)):
            lift[block_elements, :, side] -= numbers.vertical
        pairs: tuple[Pair, ...] = ()
        if not tied:
            pairs = find_pairs(section, materials, mesh, fineness.order, faces=interface, friction=friction, dense=dense)
        pairs = tuple(replace(pair, spring=spring * FRICTION_SPRING_RELATIVE) for pair in pairs)
        outputs = lift.reshape(-1, 2)
        if films is not None:
            film_lift = CHARGE_UNIT * build_film_lift(section, mesh, corners, functions.skeleton, films)
            outputs = np.hstack([outputs, film_lift.reshape(-1, 2)])
        return cls(section, materials, mesh, elements, numbers, Assembly.from_pairs(numbers, pairs), pairs, lift, outputs)

    def build_rest_state(self) -> State:
        """Return the undeformed state."""
        multipliers, displacements = tuple(np.zeros(pair.points) for pair in self.pairs), np.zeros(self.lift.shape[:2])
        grips = tuple(
            compute_touch(pair, displacements, zero).grip if pair.friction else None
            for pair, zero in zip(self.pairs, multipliers, strict=True)
        )
        return State(0.0, np.zeros(self.numbering.unknowns), self.elements.build_rest_values(), multipliers, grips)

    def with_modulus(self, youngs_modulus: float) -> ContactModel:
        """Return the model with another Young's modulus of the sphere, Pa, on the same mesh, pattern and pairs."""
        sphere = self.materials[Body.INCLUSION].model_copy(update={"youngs_modulus": youngs_modulus})
        materials = {**self.materials, Body.INCLUSION: sphere}
        return replace(self, materials=materials, elements=replace(self.elements, material=_build_laws(materials, self.mesh)))

    @property
    def may_open(self) -> bool:
        """Whether faces may open."""
        return any(pair.loose for pair in self.pairs)

    @property
    def has_friction(self) -> bool:
        """Whether there is friction."""
        return any(pair.friction > 0 for pair in self.pairs)

    def compute_contact_lengths(self, indentation: float) -> list[float]:
        """Return the length, m, to which each pair's penetration and rounding are relative.

        It is the gap or a fraction of the probe's radius. Faces open, and round edges close, at any load: their length goes to
        zero with the indentation.
        """
        length = compute_contact_length(self.section)
        return [min(length, OPENING_LENGTH_RELATIVE * indentation) if pair.smooth else length for pair in self.pairs]

    @property
    def target(self) -> Floats:
        """Mask of the sphere's elements, 0 or 1, shape (n, 1)."""
        return np.asarray(self.mesh.body == Body.INCLUSION, dtype=float)[:, None]

    def compute_displacements(self, v: Floats, indentation: float) -> Floats:
        """Return the displacements on the elements' corners and edges, m, shape (n, 8 p), the blocks' rigid shift included.

        ``v`` are the unknowns, shape (unknowns,), and ``indentation`` is that of the base, m.
        """
        return np.asarray((self.numbering.gather @ v).reshape(self.lift.shape[:2]) + indentation * self.lift.sum(axis=-1))

    def compute_blurs(self, state: State) -> list[float]:
        """Return the gap over which each pair's kink is rounded, m."""
        lengths = self.compute_contact_lengths(state.indentation)
        return [
            state.blur * x * (OPENING_BLUR_SHARE if pair.smooth else 1.0) for pair, x in zip(self.pairs, lengths, strict=True)
        ]

    def compute_touches(self, state: State) -> tuple[Touch, ...]:
        """Compute gaps, forces and tangent of all pairs in a state.

        Raises
        ------
        SolveError
            A line folds over.
        """
        displacements = self.compute_displacements(state.v, state.indentation)
        expected = state.expected or (None,) * len(self.pairs)
        rows = zip(self.pairs, state.multipliers, self.compute_blurs(state), state.grips, expected, strict=True)
        share = state.penalty_fraction
        return tuple(compute_touch(pair, displacements, m, share, blur, grip=g, expected=p) for pair, m, blur, g, p in rows)

    def linearise(self, state: State, known: Linearised | None = None, *, keep_tangent: bool = False) -> Linearised:
        """Linearise about a state; ``known`` gives the elements' part if only contact has changed.

        With ``keep_tangent`` it gives the elements' tangent and its factor alone, of a state nearby, and forces are computed:
        for one step of the modified Newton method.

        Raises
        ------
        SolveError
            A line folds over.
        """
        if known is None:
            balance, stiffness, elimination = self.elements.linearise(state.elements)
        else:
            stiffness, elimination = known.stiffness, known.elimination
            balance = self.elements.balance(state.elements, elimination) if keep_tangent else known.balance
        touches = self.compute_touches(state)
        stiffnesses = [touch.stiffness for touch in touches if touch.stiffness is not None]
        numbering, m = self.numbering, self.elements.shapes.skeleton
        contact_forces = sum((touch.forces for touch in touches), np.zeros(numbering.gather.shape[0]))
        # forces on corners and edges before they cancel: the scale of the residual
        internal = np.abs(balance.internal).reshape(len(balance.internal), 2, -1)[:, :, :m].reshape(-1)
        lengths = self.compute_contact_lengths(state.indentation)
        return Linearised(
            balance,
            touches,
            contact_forces,
            residual=numbering.scatter @ (balance.forces.ravel() + contact_forces),
            scale=float(np.linalg.norm(numbering.unsigned_scatter @ (internal + np.abs(contact_forces)))),
            deepest=max((touch.max_violation / x for touch, x in zip(touches, lengths, strict=True) if x > 0), default=0.0),
            elimination=elimination,
            stiffness=stiffness,
            contact_stiffness=join_entries(stiffnesses) if stiffnesses else None,
            factor=known.factor if known is not None and keep_tangent else None,
        )

    def factorise_tangent(self, equations: Linearised) -> Linearised:
        """Return the equations with their tangent factorised; those that have a factor are returned as they are."""
        if equations.factor is not None:
            return equations
        matrix = self.assembly.assemble_tangent(equations.stiffness, equations.contact_stiffness)
        return replace(equations, factor=factorise_any(matrix) if self.has_friction else factorise(matrix, self.assembly.pattern))

    def move(self, state: State, equations: Linearised, step: Floats, step_fraction: float = 1.0) -> State:
        """Return the state after a fraction of a Newton step.

        ``step`` is its part on the unknowns, shape (unknowns,); interior values and pressures follow with their own corrections.
        """
        edge = (self.numbering.gather @ step).reshape(self.lift.shape[:2])
        elements = self.elements.move(state.elements, equations.elimination, edge, equations.balance, step_fraction)
        return replace(state, v=state.v + step_fraction * step, elements=elements)

    def shift(self, state: State, equations: Linearised, change: Floats, indentation: float) -> State:
        """Return a state at another indentation, m, with the unknowns changed by ``change``, shape (unknowns,).

        Interior values and pressures follow linearly.
        """
        deeper = indentation - state.indentation
        displacements = self.numbering.gather @ change + deeper * self.numbering.lift.sum(axis=-1).ravel()
        elements = self.elements.move(state.elements, equations.elimination, displacements.reshape(self.lift.shape[:2]))
        return replace(state, indentation=indentation, v=state.v + change, elements=elements)

    def compute_rates(self, state: State, equations: Linearised, changes: Floats) -> State:
        """Return the derivative of a state with respect to indentation; ``changes`` is that of its unknowns, (unknowns,)."""
        zero_state = replace(state, indentation=0.0, v=np.zeros_like(state.v), elements=self.elements.build_rest_values())
        return self.shift(zero_state, equations, changes, 1.0)

    def compute_contact_radius(self, equations: Linearised, state: State) -> float:
        """Return the outer radius of the contact with the tissue in the deformed state, m."""
        displacements, pair = self.compute_displacements(state.v, state.indentation), self.pairs[-1]
        edge = float(pair.slave.compute_positions(displacements)[0, 0, 0])
        touching = equations.touches[-1].pressure > 0
        return float(np.max(pair.compute_positions(displacements)[touching, 0], initial=edge))

    def check_base(self, state: State) -> None:
        """Raise ``SolveError`` if the tissue's top reaches the base or its flange, whose contact is not modelled."""
        displacements, section = self.compute_displacements(state.v, state.indentation), self.section
        pair = self.pairs[-1]
        top = pair.slave if self.mesh.body[pair.slave.element[0]] in TISSUES else pair.master
        r, z = np.moveaxis(top.compute_positions(displacements)[:, :, :2], 1, 0)
        height = float(section.outer_height)
        flange = float(max(section.top_heights)) + float(section.step_height)
        limits = (  # outer radius and height of the base's underside and of its flange
            (BASE_RADIUS_FACTOR * float(section.tube_radius), (1 - BASE_HEIGHT_MARGIN) * height),
            (float(section.flange_radius), flange),
        )
        if any(np.any((r < radius) & (z > high - state.indentation)) for radius, high in limits):
            raise SolveError("the tissue reaches the base")

    def check_laws(self, state: State) -> None:
        """Raise ``SolveError`` if a material is strained so much that its law is not stable."""
        distortions = self.elements.find_max_distortions(state.elements.u)
        for x, (_, law), stable in zip(distortions, self.elements.material.laws, self._stable_ranges, strict=True):
            if x > stable.x:
                raise SolveError(
                    f"{law.description} is unstable where a material is stretched beyond {stable.stretch:.3g} times its length"
                )

    @cached_property
    def _stable_ranges(self) -> list[StableRange]:
        """Ranges in which the laws that are not neo-Hookean are stable, in their order."""
        return [StableRange.from_law(law) for _, law in self.elements.material.laws]

    def compute_outputs(self, equations: Linearised) -> Floats:
        """Return the film forces, N, and after them the charges that are modelled, C; shape (2,) or (4,).

        A film force is the derivative of the energy with respect to the indentation of the base (CT.4). A charge is that of the
        energy of the film under its electrode with respect to the displacement -u* of eq. AX.15 there,

            -Q = -Int P : grad u* dV = -Int (1/t) [d_p (P_r + P_t) + d33 P_z] dV,        (CT.7)

        with the stresses P per undeformed area. Films strain by less than 1e-3 where blocks bear the load, so that no other
        measure of stress or strain differs by more. No line of contact belongs to a film.
        """
        return np.asarray(self.outputs.T @ (equations.balance.forces.ravel() + equations.contact))

    def compute_responses(self, state: State, equations: Linearised, target: Floats | None = None) -> tuple[Floats, Floats]:
        """Return the derivatives of unknowns and outputs with respect to indentation and, for a target, to its ln E.

        The modulus derivative is taken at constant indentation. ``target`` is the mask of the target's elements, shape (n, 1);
        None for the derivatives with respect to indentation alone. The results' shapes are (unknowns, k) and (outputs, k), with
        k = 1 or 2; for the outputs see ``compute_outputs``.

        Raises
        ------
        SolveError
            The residual of the solution is too large.
        """
        gather, scatter = self.numbering.gather, self.numbering.scatter
        # forces that indentation and modulus cause while the unknowns are held
        driven = self._apply_tangent(equations, self.lift.reshape(-1, 2).sum(axis=1, keepdims=True))
        if target is not None:
            modulus = self.elements.compute_modulus_derivative(state.elements, equations.elimination, target)
            driven = np.concatenate([driven, modulus.reshape(-1, 1)], axis=1)
        factor = self.factorise_tangent(equations).factor
        assert factor is not None
        changes = -factor.solve(np.ascontiguousarray(scatter @ driven))
        whole = driven + self._apply_tangent(equations, gather @ changes)
        self._check_balance(driven, whole)
        return changes, np.asarray(self.outputs.T @ whole)

    def predict_outputs(self, equations: Linearised) -> Floats:
        """Return the film forces and charges of ``compute_outputs`` after one step of Newton's method, to first order in it."""
        factor = self.factorise_tangent(equations).factor
        assert factor is not None
        step = -factor.solve(np.ascontiguousarray(equations.residual[:, None]))
        forces = self._apply_tangent(equations, self.numbering.gather @ step)
        return self.compute_outputs(equations) + (self.outputs.T @ forces)[:, 0]

    def compute_adjoints(self, equations: Linearised) -> Floats:
        """Return the adjoint displacements of all k outputs on the elements' corners and edges, shape (k, n, 8 p).

        The work of small forces on an adjoint displacement is the change of its output at constant indentation. The tangent is
        factorised, and symmetric: there is no friction.

        Raises
        ------
        SolveError
            The residual of a solution is too large.
        """
        factor, scatter = equations.factor, self.numbering.scatter
        assert factor is not None
        assert not self.has_friction
        driven = self._apply_tangent(equations, self.outputs)
        adjoints = self.outputs - self.numbering.gather @ factor.solve(np.ascontiguousarray(scatter @ driven))
        whole = self._apply_tangent(equations, adjoints)
        self._check_balance(driven, whole)
        return np.asarray(adjoints.T.reshape(-1, *self.lift.shape[:2]))

    def _check_balance(self, driven: Floats, whole: Floats) -> None:
        """Refuse solutions that leave too much of the forces ``driven``: ``whole`` adds those of the solution."""
        unbalanced = np.linalg.norm(self.numbering.scatter @ whole, axis=0)
        if not np.all(unbalanced <= MAX_RESIDUAL * np.linalg.norm(np.abs(driven) + np.abs(whole), axis=0)):
            raise SolveError("the equations of the tangent cannot be solved")

    def _apply_tangent(self, equations: Linearised, displacements: Floats) -> Floats:
        """Return the tangent times ``displacements``, changes of the elements' values; shape (n (8 p), k) both."""
        n, width, _ = self.lift.shape
        forces = (equations.stiffness @ displacements.reshape(n, width, -1)).reshape(n * width, -1)
        return forces if equations.contact_stiffness is None else forces + equations.contact_stiffness @ displacements


def _build_laws(materials: Materials, mesh: Topology) -> Hyperelastic:
    """Return the hyperelastic materials of all elements."""
    return Hyperelastic.from_materials([materials[Body(body)] for body in mesh.body])


def _find_block_elements(section: Section, mesh: Topology, corners: Floats) -> tuple[Bools, Bools]:
    """Return masks of the elements that move with the inner and with the outer block, films and base included.

    ``corners`` are those of the elements, m, shape (n, 4, 2).
    """
    probe = ~np.isin(mesh.body, (*TISSUES, Body.INCLUSION))
    inside = corners[..., 0].mean(axis=1) < section.inner_radius
    return probe & inside, probe & ~inside


def check_volume(elements: Elements, state: ElementValues) -> None:
    """Raise ``SolveError`` if an element is turned inside out."""
    if not elements.compute_min_volume_ratio(state.u) > 0:
        raise SolveError("an element folds over")
