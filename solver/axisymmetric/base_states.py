"""Solve the two base states of a scene: the base of one block displaced by one unit, the base of the other fixed.

A third and a fourth state, the film states, belong to probes with films: a film acts as an actuator, by which its charge is
the energy of its film state with a base state (``solver.axisymmetric.film_states``).

Film forces are energies of pairs of states,
F_ij = u_i^T K u_j: consistent reactions, which converge at twice the rate of the displacements. K is affine in every
Young's modulus, so that the derivative of F_ij by ln of a body's modulus is the part of that energy inside the body (the
states are their own adjoints).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from geometry.common.arrays import Floats, Ints
from geometry.common.resources import check_memory, check_time
from geometry.meridian.mesh import Topology, build_topology, compute_nodes
from geometry.meridian.mesh_lines import Kind, MeridianFineness, find_kind
from geometry.meridian.section import Body, Section
from geometry.scenes.probe import Material
from solver.axisymmetric.condensed_system import MAX_RESIDUAL_RELATIVE, System
from solver.axisymmetric.dofs import Interface, number_unknowns, select_subspace
from solver.axisymmetric.film_states import Films, build_film_lift
from solver.elements.quadrilateral import (
    Blocks,
    Condensed,
    Geometry,
    compute_geometry,
    integrate_stiffness,
)
from solver.elements.rectangles import integrate_rectangles
from solver.elements.shape_functions import Shapes, build_shapes
from solver.linalg.workspace import get_workspace, keep_result
from solver.materials.linear import Isotropic

Materials = Mapping[Body, Material]
MAX_RESIDUAL_EFFECT_RELATIVE = 1e-12  # change of a force by the residual above which the solution is refined
MAX_LOOSE_BOUND_RELATIVE = 1e-9  # change of a force by rounding above which a closer bound is computed
DEPENDENT_RELATIVE = 1e-12  # of the largest energy: directions with less count as dependent
BLOCK_BYTES = 4e6  # of element matrices processed at once: fits the processor's cache
PEAK_MEMORY_FACTOR = 2.6  # times the bytes of all element matrices: the peak of a process
_mesh = keep_result(build_topology)


@dataclass(frozen=True)
class MeridianModel:
    """A section with its materials on one mesh: element matrices and the factorised system.

    Attributes
    ----------
    section, materials, interface
        What is modelled.
    mesh
        The elements, n of them.
    shapes
        The elements' shape functions, s of order p.
    corners
        The elements' corners, m, shape (n, 4, 2).
    geometry
        The elements' geometry at the Gauss points.
    law
        Material law of each element, shape (n,).
    condensed
        The elements' stiffness with the functions inside them eliminated.
    system
        The equations of the unknowns on corners and edges, factorised.
    films
        The films whose charges are wanted, inner and outer; None where none are, and then there are no film states.
    """

    section: Section
    materials: Materials
    interface: Interface
    mesh: Topology
    shapes: Shapes
    corners: Floats
    geometry: Geometry
    law: Isotropic
    condensed: Condensed
    system: System
    films: Films | None = None

    @cached_property
    def lift(self) -> Floats:
        """The elements' given displacements in each of the s states, see ``Numbering.lift``, shape (n, 8 p, s)."""
        if self.films is None:
            return self.system.numbering.lift
        film_lift = build_film_lift(self.section, self.mesh, self.corners, self.shapes.skeleton, self.films)
        return np.concatenate([self.system.numbering.lift, film_lift], axis=2)

    @cached_property
    def recovery(self) -> Floats:
        """Matrices that give the values of functions inside elements from those on corners and edges, (n, 2 (p-1)^2, 8 p)."""
        return self.condensed.compute_recovery()

    def build_blocks(self, chosen: Ints) -> Blocks:
        """Return the blocks of the stiffness matrices of the elements with indices ``chosen``; they are not cached."""
        return integrate_stiffness(self.geometry.select(chosen), self.shapes, self.law.select(chosen))

    def recover_values(self, edge: Floats) -> Floats:
        """Return all values of k displacement fields, shape (n, 2 s, k), from those on corners and edges, shape (n, 8 p, k).

        Each of the n elements has s functions, of which the first 4 p are on corners and edges; u_r comes before u_z.
        """
        n, s, m, k = len(edge), len(self.shapes.degrees), self.shapes.skeleton, edge.shape[-1]
        out = np.empty((n, 2, s, k))
        out[:, :, :m] = edge.reshape(n, 2, m, k)
        out[:, :, m:] = (self.recovery @ edge).reshape(n, 2, s - m, k)
        return out.reshape(n, 2 * s, k)


@dataclass(frozen=True)
class BaseStates:
    """The s states of a model: two base states and, with films, two film states.

    State 0 displaces the base of the inner block by one unit, state 1 that of the outer. States 2 and 3 are those of the inner
    and the outer film. From the states follow the forces on both films and their charges per unit displacement of each base.

    Attributes
    ----------
    model
        The model that was solved.
    v
        The unknowns of the states, shape (unknowns, s).
    edge
        The elements' values on corners and edges, without rigid shifts, shape (n, 8 p, s).
    shift
        These shifts along z, shape (n, s).
    products
        Energies of all states with the base states, shape (s, 2): F_ij, force on block i (0 inner, 1 outer) per unit displacement
        of base j, N/m, and below it the charges Q_ij of film i likewise, ``CHARGE_UNIT`` per m.
    rounding
        Bound on the rounding error of ``products``, shape (s, 2).
    residual
        The largest of the residuals of the solutions, relative to |K| |u|.
    """

    model: MeridianModel
    v: Floats
    edge: Floats
    shift: Floats
    products: Floats
    rounding: Floats
    residual: float

    @property
    def forces(self) -> Floats:
        """F_ij, force on block i (0 inner, 1 outer) per unit displacement of base j, N/m, shape (2, 2)."""
        return self.products[:2]

    @cached_property
    def values(self) -> Floats:
        """All values of the elements, without rigid shifts, shape (n, 2 functions, s)."""
        return self.model.recover_values(self.edge)

    @cached_property
    def last_degree_removal(self) -> tuple[Floats, Floats]:
        """Changes of the elements' values and forces where the states lose their last degree, both of shape (n, 8 p, s)."""
        stiffness, chosen = self.model.system.stiffness, find_values_of_degree(self.model, self.model.shapes.order)
        values, removed = np.zeros_like(self.edge), -self.edge[:, chosen]
        values[:, chosen] = removed
        return values, stiffness[:, :, chosen] @ removed  # a fifth of the whole product or less

    def compute_modulus_derivative(self, body: Body = Body.INCLUSION) -> Floats:
        """Return the derivatives of ``products`` by ln E of a body of blocks or tissue, shape (s, 2): their parts inside it."""
        inside = np.flatnonzero(self.model.mesh.body == body)
        u = self.edge[inside]
        return sum_products(u, self.model.system.stiffness[inside] @ u[..., :2])


def build_model(
    section: Section,
    materials: Materials,
    interface: Interface,
    fineness: MeridianFineness,
    *,
    kind: Kind | None = None,
    films: Films | None = None,
) -> MeridianModel:
    """Build the model of a section on one mesh: integrate, condense and factorise the stiffness.

    ``kind`` is the topology of the mesh; None for that which fits the section. ``films`` are those whose charges are wanted.

    Raises
    ------
    SolveError
        The mesh has a cell without area.
    LimitReached
        The mesh has too many cells for the limit of memory, or the time limit is exceeded.
    """
    mesh = _mesh(kind or find_kind(section, fineness.lean), fineness)
    functions = build_shapes(fineness.order)
    size = 16 * len(mesh.body) * (2 * len(functions.degrees)) ** 2
    check_memory("a finer mesh", PEAK_MEMORY_FACTOR * size)
    check_time("solving")
    get_workspace().make_room(PEAK_MEMORY_FACTOR * size)
    nodes = compute_nodes(section, mesh, functions.places)
    element_geometry = compute_geometry(nodes, functions)
    law = _collect_laws(mesh, materials)
    condensed = Condensed.from_blocks(integrate_elements(mesh, element_geometry, functions, law), len(mesh.body))
    system = System.from_stiffness(number_unknowns(mesh, fineness.order, interface), condensed.stiffness)
    return MeridianModel(
        section,
        materials,
        interface,
        mesh=mesh,
        shapes=functions,
        corners=nodes[:, functions.corners],
        geometry=element_geometry,
        law=law,
        condensed=condensed,
        system=system,
        films=films,
    )


def integrate_elements(mesh: Topology, geometry: Geometry, functions: Shapes, law: Isotropic) -> Iterator[Blocks]:
    """Yield the elements' stiffness matrices in order, rectangles first, in blocks that fit the processor's cache.

    Rectangles in one column of the mesh share integrals, so that their blocks are complete columns.
    """
    count, columns = max(1, int(BLOCK_BYTES / (8 * (2 * len(functions.degrees)) ** 2))), mesh.columns
    starts = [columns[0]]
    while starts[-1] < columns[-1]:  # complete columns, at least one
        column_end = columns[columns <= starts[-1] + count][-1]
        starts.append(column_end if column_end > starts[-1] else columns[columns > starts[-1]][0])
    for low, high in pairwise(starts):
        column_starts, chosen = columns[(columns >= low) & (columns <= high)] - low, slice(low, high)
        yield integrate_rectangles(geometry.select(chosen), functions, law.select(chosen), column_starts)
    for low in range(columns[-1], len(mesh.body), count):
        chosen = slice(low, low + count)
        yield integrate_stiffness(geometry.select(chosen), functions, law.select(chosen))


def solve_base_states(model: MeridianModel) -> BaseStates:
    """Solve the base states and, with films, the film states.

    The film forces F_ij are the energy products u_i^T K u_j of the two base states, shape (2, 2). A direct solution usually
    suffices; otherwise it is repeated with one step of iterative refinement. ``lift`` prescribes the displacements of the bases;
    ``values`` are the elements' displacements on corners and edges, ``shift`` their rigid shifts, ``unbalanced`` is K u - f.

    Raises
    ------
    SolveError
        The residual of the solution is too large to be trusted.
    """
    system = model.system
    # 1: a direct solution; 2: with one step of refinement, after which a residual above the maximum is an error
    for passes, max_residual in ((1, np.inf), (2, MAX_RESIDUAL_RELATIVE)):
        lift = model.lift
        solution = system.solve(np.zeros((system.numbering.unknowns, lift.shape[2])), lift, passes, max_residual)
        values, unbalanced = solution.values, solution.unbalanced
        products = sum_products(values, solution.loads[..., :2])
        # energy products of the states' remaining errors: changes of the products if the equations were met exactly
        residual_effects = np.abs(unbalanced.T @ system.factor.solve(unbalanced[:, :2]))
        is_negligible = np.all(residual_effects <= MAX_RESIDUAL_EFFECT_RELATIVE * np.abs(products))
        if solution.residual <= MAX_RESIDUAL_RELATIVE and is_negligible:
            break
    rounding = _bound_rounding(system.stiffness, values, products) + residual_effects
    return BaseStates(
        model, solution.v, edge=values, shift=solution.shift, products=products, rounding=rounding, residual=solution.residual
    )


def _bound_rounding(stiffness: Floats, values: Floats, products: Floats) -> Floats:
    """Return ten standard deviations of the products, shape (s, 2), for independent rounding errors of all matrix entries.

    An entry of a positive definite matrix is at most the root of the product of its two diagonal entries. That gives a looser
    bound from the diagonals alone, which is returned where it is below ``MAX_LOOSE_BOUND_RELATIVE``.

    Parameters
    ----------
    stiffness
        Of the elements, shape (n, 8 p, 8 p).
    values
        Elements' values in the states, shape (n, 8 p, s).
    products
        Energies of the states with the base states, shape (s, 2).
    """
    ten_roundings = 10 * np.finfo(float).eps
    diagonal = np.einsum("ek,eki->ei", np.diagonal(stiffness, axis1=1, axis2=2), values**2)
    loose_bound = ten_roundings * np.sqrt(diagonal.T @ diagonal[:, :2])
    if np.all(loose_bound <= MAX_LOOSE_BOUND_RELATIVE * np.abs(products)):
        return np.asarray(loose_bound)
    return np.asarray(ten_roundings * np.sqrt(sum_products(values**2, stiffness**2 @ values[..., :2] ** 2)))


def project_to_lower_order(states: BaseStates, vectors: Floats, degree: int, max_modulus_ratio: float = 1.0) -> Floats:
    """Project states and vectors, in energy, to the space of functions on corners and edges up to a polynomial degree.

    Returns the elements' values (n elements of order p), shape (n, 8 p, s + m) or, with ``max_modulus_ratio`` above 1,
    (n, 8 p, s + m + s).

    Parameters
    ----------
    states
        The s states on the whole space; their projections come first.
    vectors
        Elements' values of m vectors without a lift (the rigid shift of a block, see ``Numbering.lift``), shape (n, 8 p, m).
    degree
        The highest degree that is kept, at least 1.
    max_modulus_ratio
        A modulus of the inclusion, as a multiple of that of ``states``. Above 1 the states are solved there, too, and their
        differences from the first come last: they describe the strain of a nearly rigid inclusion.
    """
    system, lift = states.model.system, states.model.lift
    count = lift.shape[2]
    space = select_subspace(system.numbering, degree)
    lift_forces = -system.compute_lift_forces(lift)[space.unknowns]
    forces = system.assemble_forces(system.stiffness @ vectors)[space.unknowns]
    solution = space.factor(system.matrix).solve(np.hstack([lift_forces, forces]))
    if max_modulus_ratio > 1:
        matrix = system.numbering.assemble(system.stiffness * scale_inclusion(states.model, max_modulus_ratio))
        solution = np.hstack([solution, space.factor(matrix).solve(lift_forces) - solution[:, :count]])
    v = np.zeros((system.numbering.unknowns, solution.shape[1]))
    v[space.unknowns] = solution
    return np.concatenate([system.compute_values(v[:, :count], lift), system.compute_values(v[:, count:])], axis=2)


def approximate_lower_order(states: BaseStates) -> tuple[Floats, Floats]:
    """Approximate the projection of the states to the next lower degree (``project_to_lower_order``) without a factorisation.

    Returns the elements' values and forces of the difference of the approximate states from ``states``, both of shape
    (n, 8 p, s).

    From the states without their functions of the last degree one step of steepest descent reduces the distance in energy of
    all at once. Its direction comes from the factor of the whole space, which differs from that of the smaller
    space by the coupling between the last degree and the others; this is small unless Poisson's ratio is near 1/2.
    """
    system, removed = states.model.system, states.model.system.numbering.degrees == states.model.shapes.order
    values, forces = states.last_degree_removal
    residual = system.assemble_forces(forces)
    residual[removed] = 0.0
    v = system.factor.solve(residual)
    v[removed] = 0.0
    direction = system.compute_values(v)
    loads = system.stiffness @ direction
    step = np.linalg.lstsq(sum_products(direction, loads), sum_products(direction, forces), rcond=DEPENDENT_RELATIVE)[0]
    return values - direction @ step, forces - loads @ step


def scale_inclusion(model: MeridianModel, modulus_ratio: float) -> Floats:
    """Return factors of the elements' stiffness, shape (n, 1, 1): ``modulus_ratio`` in the inclusion, 1 elsewhere."""
    return np.where(model.mesh.body == Body.INCLUSION, modulus_ratio, 1.0)[:, None, None]


def find_values_of_degree(model: MeridianModel, degree: int) -> Ints:
    """Return the indices, among an element's 8 p values, of those whose corner or edge functions have the given degree."""
    # a function's degree is the larger of its degrees along both sides; the values of u_z follow those of u_r
    degrees = model.shapes.degrees[: model.shapes.skeleton].max(axis=1)
    return np.flatnonzero(np.tile(degrees, 2) == degree)


def sum_products(a: Floats, b: Floats) -> Floats:
    """Return the products a_i^T b_j summed over all elements, shape (i, j), of arrays a (n, size, i) and b (n, size, j)."""
    return np.asarray(a.reshape(-1, a.shape[-1]).T @ b.reshape(-1, b.shape[-1]))


def _collect_laws(mesh: Topology, materials: Materials) -> Isotropic:
    """Return the material law of each element, from the materials of the bodies."""
    bodies = list(materials)
    # position of each body in ``materials``
    number = np.zeros(len(Body), dtype=int)
    number[bodies] = np.arange(len(bodies))
    return Isotropic.from_materials(materials.values()).select(number[mesh.body])
