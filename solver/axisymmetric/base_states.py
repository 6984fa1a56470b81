"""The two base states of a scene: one block moved down against the base by one unit, the other not.

With a rigid base this is the base of one block moved and the other held. Film forces are energies of pairs of states,
F_ij = u_i^T K u_j: consistent reactions, which converge at twice the rate of the displacements. K is affine in every
Young's modulus, so the derivative of F_ij by the modulus of a body is the part of that energy inside it (the states
are their own adjoints).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from geometry.common.arrays import Floats, Ints
from geometry.common.resources import check_memory, check_time
from geometry.meridian.frame import Kind, MeridianFineness
from geometry.meridian.frame import kind as kind_of
from geometry.meridian.mesh import Topology, nodes, topology
from geometry.meridian.section import Body, Section
from geometry.scenes.probe import Material
from solver.axisymmetric.condensed_system import LARGEST_RESIDUAL, System
from solver.axisymmetric.dofs import Interface, numbering, subspace
from solver.elements.quadrilateral import Blocks, Condensed, Geometry, geometry, lame, matrices, stiffness
from solver.elements.rectangles import rectangles
from solver.elements.shape_functions import Shapes, shapes
from solver.linalg.workspace import current, kept

Materials = Mapping[Body, Material]
HIDDEN = 1e-12  # share of a force that rounding may change before the solution is refined
LITTLE = 1e-9  # share of a force that rounding may change before its bound is made a close one
DEPENDENT = 1e-12  # share of the largest below which a way in energy is none
BLOCK = 4e6  # bytes of the elements' matrices that are worked on at once: few enough for the processor's cache
WHOLE = 2.6  # times the bytes of all element matrices: what a process holds at most
_mesh = kept(topology)


@dataclass(frozen=True)
class MeridianModel:
    """A section with its materials on one mesh: element matrices and the factorised system.

    Attributes:
        section, materials, interface: what is modelled.
        mesh: the elements.
        shapes: their functions.
        at: their geometry.
        two_mu, lam: of each element, shape (n,).
        condensed: the elements' matrices without their insides.
        system: of the unknowns on corners and edges.
    """

    section: Section
    materials: Materials
    interface: Interface
    mesh: Topology
    shapes: Shapes
    at: Geometry
    two_mu: Floats
    lam: Floats
    condensed: Condensed
    system: System

    @cached_property
    def recovery(self) -> Floats:
        """What gives the values inside an element from those on corners and edges, shape (n, 2 (p-1)^2, 8 p)."""
        return self.condensed.recovery()

    def parts(self, chosen: Ints) -> tuple[Floats, Floats]:
        """Matrices of some elements per unit 2 mu and lambda, shape (e, 2 s, 2 s) both; u_r before u_z. They are not kept."""
        size = 2 * len(self.shapes.degrees)
        shear, volume = matrices(self.at.of(chosen), self.shapes)
        return shear.reshape(len(chosen), size, size), volume.reshape(len(chosen), size, size)

    def stiffness(self, chosen: Ints) -> Blocks:
        """Matrices of some elements with their moduli. They are not kept."""
        return stiffness(self.at.of(chosen), self.shapes, self.two_mu[chosen], self.lam[chosen])

    def whole(self, edge: Floats) -> Floats:
        """All values of the elements, (n, 2 s, k), from those on corners and edges, (n, 8 p, k)."""
        n, s, m, k = len(edge), len(self.shapes.degrees), self.shapes.skeleton, edge.shape[-1]
        out = np.empty((n, 2, s, k))
        out[:, :, :m] = edge.reshape(n, 2, m, k)
        out[:, :, m:] = (self.recovery @ edge).reshape(n, 2, s - m, k)
        return out.reshape(n, 2 * s, k)


@dataclass(frozen=True)
class BaseStates:
    """Film forces per unit displacement of the blocks.

    Attributes:
        model: what was solved.
        v: the unknowns of both states, shape (unknowns, 2).
        edge: the elements' values on corners and edges in both states, rigid shifts taken out, shape (n, 8 p, 2).
        shift: these shifts along z, shape (n, 2).
        forces: F_ij, force on block i (0 inner, 1 outer) per unit displacement of base j, N/m, shape (2, 2).
        rounding: bound on what rounding changes in ``forces``, shape (2, 2).
        residual: of both solutions, relative to |K| |u|, the larger.
    """

    model: MeridianModel
    v: Floats
    edge: Floats
    shift: Floats
    forces: Floats
    rounding: Floats
    residual: float

    @cached_property
    def own(self) -> Floats:
        """All values of the elements, rigid shifts taken out, shape (n, 2 s, 2)."""
        return self.model.whole(self.edge)

    def slope(self, body: Body = Body.INCLUSION) -> Floats:
        """Return dF_ij / d ln E of a body, N/m, shape (2, 2)."""
        inside = np.flatnonzero(self.model.mesh.body == body)
        u = self.edge[inside]
        return products(u, self.model.system.stiffness[inside] @ u)


def model(
    section: Section, materials: Materials, interface: Interface, fineness: MeridianFineness, kind: Kind | None = None
) -> MeridianModel:
    """Integrate, condense and factorise.

    Raises:
        SolveError: the mesh has a cell without area.
        LimitReached: it has too many cells for the limit of memory, or the time is over.
    """
    mesh = _mesh(kind or kind_of(section, fineness.lean), fineness)
    functions = shapes(fineness.order)
    size = 16 * len(mesh.body) * (2 * len(functions.degrees)) ** 2
    check_memory("a finer mesh", WHOLE * size)
    check_time("solving")
    current().make_room(WHOLE * size)
    at = geometry(nodes(section, mesh, functions.places), functions)
    two_mu, lam = _moduli(mesh, materials)
    whole = Condensed.of(integrated(mesh, at, functions, two_mu, lam), len(mesh.body))
    system = System.of(numbering(mesh, fineness.order, interface), whole.stiffness)
    return MeridianModel(
        section,
        materials,
        interface,
        mesh=mesh,
        shapes=functions,
        at=at,
        two_mu=two_mu,
        lam=lam,
        condensed=whole,
        system=system,
    )


def integrated(mesh: Topology, at: Geometry, functions: Shapes, two_mu: Floats, lam: Floats) -> Iterator[Blocks]:
    """Yield the elements' matrices in order, rectangles first, few enough at a time for the processor's cache."""
    count, columns = max(1, int(BLOCK / (8 * (2 * len(functions.degrees)) ** 2))), mesh.columns
    starts = [columns[0]]
    while starts[-1] < columns[-1]:  # whole columns, one at least
        fit = columns[columns <= starts[-1] + count][-1]
        starts.append(fit if fit > starts[-1] else columns[columns > starts[-1]][0])
    for low, high in pairwise(starts):
        some, one = columns[(columns >= low) & (columns <= high)] - low, slice(low, high)
        yield rectangles(at.of(one), functions, two_mu[one], lam[one], some)
    for low in range(columns[-1], len(mesh.body), count):
        one = slice(low, low + count)
        yield stiffness(at.of(one), functions, two_mu[one], lam[one])


def base_states(model: MeridianModel) -> BaseStates:
    """Solve both base states.

    Raises:
        SolveError: the residual of the solution is too large to be trusted.
    """
    system = model.system
    for passes, largest in ((1, np.inf), (2, LARGEST_RESIDUAL)):
        found = system.solve(np.zeros((system.numbering.unknowns, 2)), system.numbering.lift, passes, largest)
        own, unbalanced = found.own, found.unbalanced
        forces = products(own, found.loads)
        # what the forces would change if the equations were met exactly
        hidden = np.abs(unbalanced.T @ system.factor.solve(unbalanced))
        if found.residual <= LARGEST_RESIDUAL and np.all(hidden <= HIDDEN * np.abs(forces)):
            break
    rounding = _rounding(system.stiffness, own, forces) + hidden
    return BaseStates(model, found.v, edge=own, shift=found.shift, forces=forces, rounding=rounding, residual=found.residual)


def _rounding(stiffness: Floats, own: Floats, forces: Floats) -> Floats:
    """Ten standard deviations of the forces when every entry of the matrices carries an independent rounding error.

    No entry of a positive definite matrix is above the roots of both its diagonal ones, which is enough where little follows.
    """
    ten = 10 * np.finfo(float).eps
    diagonal = np.einsum("ek,eki->ei", np.diagonal(stiffness, axis1=1, axis2=2), own**2)
    most = ten * np.sqrt(diagonal.T @ diagonal)
    if np.all(most <= LITTLE * np.abs(forces)):
        return np.asarray(most)
    return np.asarray(ten * np.sqrt(products(own**2, stiffness**2 @ own**2)))


def lower_order(states: BaseStates, vectors: Floats, degree: int, stiffest: float = 1.0) -> Floats:
    """What of the space with edge functions up to a degree at most is nearest in energy, elements' values, (n, 8 p, 2 + m + 2).

    Args:
        states: on the whole space; theirs come first.
        vectors: of the elements' values without a lift, shape (n, 8 p, m).
        degree: at least 1.
        stiffest: a modulus of the inclusion, as a multiple of that of ``states``. Above 1 both states are solved for there, too,
            and what they differ by from the first comes last: there what an inclusion that is nearly rigid is strained by counts.
    """
    system, lift = states.model.system, states.model.system.numbering.lift
    space = subspace(system.numbering, degree)
    pushed = -system.lifted(lift)[space.unknowns]
    forces = system.add_up(system.stiffness @ vectors)[space.unknowns]
    found = space.factor(system.matrix).solve(np.hstack([pushed, forces]))
    if stiffest > 1:
        matrix = system.numbering.assemble(system.stiffness * in_inclusion(states.model, stiffest))
        found = np.hstack([found, space.factor(matrix).solve(pushed) - found[:, :2]])
    v = np.zeros((system.numbering.unknowns, found.shape[1]))
    v[space.unknowns] = found
    return np.concatenate([system.own(v[:, :2], lift), system.own(v[:, 2:])], axis=2)


def near_lower_order(states: BaseStates, degree: int) -> tuple[Floats, Floats]:
    """What is nearly as near as ``lower_order`` of both states, without another factorisation.

    Returns the elements' values and the forces of what they differ by from ``states``, (n, 8 p, 2) both.

    From the states without their functions of the last degree, ``degree`` + 1, one step of steepest descent of the distance in
    energy, of both at once. The whole's factor says where to: it differs from the smaller space's own by how much the last
    degree's functions strain what the others do, little but where Poisson's ratio is near 1/2.
    """
    system, outside = states.model.system, states.model.system.numbering.degrees > degree
    cut = states.edge.copy()
    cut[:, of_degree(states.model, degree + 1)] = 0.0
    forces = system.stiffness @ (cut - states.edge)
    left = system.add_up(forces)
    left[outside] = 0.0
    v = system.factor.solve(left)
    v[outside] = 0.0
    way = system.own(v)
    loads = system.stiffness @ way
    far = np.linalg.lstsq(products(way, loads), products(way, forces), rcond=DEPENDENT)[0]
    return cut - way @ far, forces - loads @ far


def in_inclusion(model: MeridianModel, time: float) -> Floats:
    """What multiplies the elements' stiffness where the inclusion's is multiplied, shape (n, 1, 1)."""
    return np.where(model.mesh.body == Body.INCLUSION, time, 1.0)[:, None, None]


def of_degree(model: MeridianModel, degree: int) -> Ints:
    """The elements' values that are of one degree on edges."""
    return np.flatnonzero(np.tile(_degrees(model), 2) == degree)


def _degrees(model: MeridianModel) -> Ints:
    return np.asarray(model.shapes.degrees[: model.shapes.skeleton].max(axis=1))


def products(a: Floats, b: Floats) -> Floats:
    """Return sums a_i^T b_j over all elements, of arrays (n, size, i) and (n, size, j), shape (i, j)."""
    return np.asarray(a.reshape(-1, a.shape[-1]).T @ b.reshape(-1, b.shape[-1]))


def _moduli(mesh: Topology, materials: Materials) -> tuple[Floats, Floats]:
    moduli, ratios = np.zeros(len(Body)), np.zeros(len(Body))
    for body, material in materials.items():
        moduli[body], ratios[body] = material.youngs_modulus, material.poisson_ratio
    return lame(moduli[mesh.body], ratios[mesh.body])
