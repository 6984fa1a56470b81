"""Set up the equations of a probe on tissue on tetrahedra: supports, rigid motions of the base, stiffness and loads.

The blocks' unknowns are their displacements minus the base's rigid motion, which causes no strain, so that stiff blocks add no
rounding errors. In the tissue that motion appears, as a lift, at the nodes that the blocks share with it. With the stiffness K
and the unknowns v of a state,

    K v = -K_tissue lift,    F_ij = u_i^T K u_j,  u = v in the blocks, v + lift in the tissue       (SO.3)

where F_ij is the consistent reaction of the base: the sum of the nodal forces that hold it, weighted by its motion.

Films whose charges are wanted add two states, eq. MS.12: in these the upper ends of the blocks, which are held in the others,
have the displacement w (``solver/multiple_scattering/stack_motion.py``). The products of the film states with the others are
charges.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from geometry.common.arrays import Floats, Ints
from geometry.tetra.tet_mesh import MeshBody, TetMesh
from solver.linalg.conjugate_gradients import Stiffness
from solver.materials.linear import Isotropic
from solver.solid.body_stiffness import Part, assemble, integrate_part
from solver.solid.regions import number_elements

STATE_NAMES = ("inner", "outer", "tilt")
PLANE_TOLERANCE_RELATIVE = 1e-7  # of the mesh's size: nodes closer to a plane lie in it
BLOCK_BODIES = (MeshBody.INNER, MeshBody.OUTER, MeshBody.GROOVE)


@dataclass(frozen=True)
class Solid:
    """An integrated mesh, for any materials and any choice of bodies.

    Attributes
    ----------
    mesh
        The mesh as it was given.
    nodes
        Nodes; those of the blocks' ends are doubled where they slide on the tissue, shape (n, 3).
    elements
        Elements of these nodes, shape (t, 10).
    body
        Number of the ``Region`` of each element, (t,).
    twin
        For each node, the node that carries its u_z, shape (n,).
    parts
        Stiffness of each body.
    """

    mesh: TetMesh
    nodes: Floats
    elements: Ints
    body: Ints
    twin: Ints
    parts: Mapping[int, Part]

    @classmethod
    def from_mesh(cls, mesh: TetMesh, frictionless: bool = False, like: Solid | None = None) -> Solid:
        """Integrate the stiffness of a mesh; each element's dilation is its mean, which avoids locking near nu = 1/2.

        Parameters
        ----------
        mesh
            The mesh.
        frictionless
            Whether the blocks slide on the tissue; otherwise they are bonded to it.
        like
            A solid of the same elements and kind, from which the parts of bodies with unmoved nodes are copied; or None.

        Raises
        ------
        SolveError
            An element is turned inside out.
        """
        nodes, elements, twin = (
            _split_sliding_nodes(mesh) if frictionless else (mesh.nodes, mesh.elements, np.arange(len(mesh.nodes)))
        )
        body = number_elements(mesh)
        parts = {} if like is None else like.find_unmoved_parts(nodes)
        parts |= {int(b): integrate_part(nodes, elements[body == b], averaged=True) for b in np.unique(body) if b not in parts}
        return cls(mesh, nodes, elements=elements, body=body, twin=twin, parts=parts)

    def find_unmoved_parts(self, nodes: Floats) -> dict[int, Part]:
        """Return the parts whose nodes all equal the given nodes of another solid with the same elements."""
        moved = (nodes != self.nodes).any(axis=1)
        return {body: part for body, part in self.parts.items() if not moved[self.elements[self.body == body]].any()}

    def find_nodes(self, bodies: Iterable[int]) -> NDArray[np.bool_]:
        """Return the mask of nodes that belong to some bodies, shape (n,)."""
        inside = np.zeros(len(self.nodes), dtype=bool)
        inside[self.elements[np.isin(self.body, list(bodies))]] = True
        return inside


def _split_sliding_nodes(mesh: TetMesh) -> tuple[Floats, Ints, Ints]:
    """Double the nodes between blocks and tissue, so that the blocks can slide.

    Returns nodes and elements of the doubled mesh and ``Solid.twin``: for a doubled node, the tissue's node.
    """
    block = np.isin(mesh.body, BLOCK_BODIES)
    shared = np.intersect1d(mesh.elements[block], mesh.elements[~block])
    block_nodes = np.arange(len(mesh.nodes))
    block_nodes[shared] = len(block_nodes) + np.arange(len(shared))
    elements = mesh.elements.copy()
    elements[block] = block_nodes[elements[block]]
    return np.vstack([mesh.nodes, mesh.nodes[shared]]), elements, np.concatenate([np.arange(len(mesh.nodes)), shared])


@dataclass(frozen=True)
class Supports:
    """Unknowns of some bodies of a solid, and the lifts of the three states.

    A lift is a known displacement that is added to the unknowns: here the base's motion, see eq. SO.3.

    Attributes
    ----------
    number
        Unknown of each displacement, or -1, shape (n, 3).
    lift
        Displacements of the tissue's nodes that the base's motions set, shape (n, 3, 3), the last the state.
    motion
        The base's rigid motion at every node, for output, shape (n, 3, 3).
    """

    number: Ints
    lift: Floats
    motion: Floats

    @property
    def unknowns(self) -> int:
        """Size of the system."""
        return int(self.number.max()) + 1

    @classmethod
    def from_bodies(cls, solid: Solid, bodies: Iterable[int]) -> Supports:
        """Return the supports of a solid of which only ``bodies`` are present.

        The blocks' tops and the tissue's bottom are fixed and, on a half mesh, the plane of symmetry y = 0 in y.
        """
        nodes, tolerance = solid.nodes, PLANE_TOLERANCE_RELATIVE * float(np.ptp(solid.nodes, axis=0).max())
        inner, outer = solid.find_nodes([MeshBody.INNER]), solid.find_nodes({MeshBody.OUTER, MeshBody.GROOVE} & set(bodies))
        fixed = np.zeros(nodes.shape, dtype=bool)
        for block in (inner, outer):
            fixed[block & (nodes[:, 2] > nodes[block, 2].max(initial=-np.inf) - tolerance)] = True
        fixed[nodes[:, 2] < nodes[:, 2].min() + tolerance] = True
        if solid.mesh.half:
            fixed[np.abs(nodes[:, 1]) < tolerance, 1] = True
        fixed[~solid.find_nodes(bodies)] = True  # nodes of absent bodies have no unknowns
        # number of the displacement that stands for each: u_z of a sliding node is that of its twin
        owner = 3 * np.arange(len(nodes))[:, None] + np.arange(3)
        owner[:, 2] = 3 * solid.twin + 2
        number = np.full(nodes.size, -1)
        free = np.setdiff1d(owner, owner[fixed])
        number[free] = np.arange(len(free))
        motion = _compute_motions(solid, inner, outer)
        lift = np.zeros((nodes.size, 3))
        lift[owner[inner | outer].ravel()] = motion[inner | outer].reshape(-1, 3)
        tissue = solid.find_nodes(set(bodies) - set(BLOCK_BODIES))
        return cls(number[owner], np.where(tissue[:, None, None], lift[owner], 0.0), motion)


def _compute_motions(solid: Solid, inner: NDArray[np.bool_], outer: NDArray[np.bool_]) -> Floats:
    """Return the three unit motions at every node of the blocks, masks ``inner`` and ``outer``; zero elsewhere.

    They are: inner block down, outer block down, rotation about y (a positive angle lowers the side +x). Shape (n, 3, 3): node,
    axis, motion.
    """
    nodes, motions = solid.nodes, np.zeros((len(solid.nodes), 3, 3))
    motions[inner, 2, 0], motions[outer, 2, 1] = -1.0, -1.0
    block = inner | outer
    height = nodes[block, 2] - nodes[inner, 2].max()  # the base rotates about a point at the inner block's top
    motions[block, 0, 2], motions[block, 2, 2] = height, -nodes[block, 0]
    return motions


@dataclass(frozen=True)
class Problem:
    """A solid with its laws, supports and stiffness; bodies without a law are absent.

    Attributes
    ----------
    solid, laws
        Integrated mesh and linear laws.
    supports
        Unknowns and lifts.
    matrix
        Stiffness, N/m; of half the solid, if the mesh is a half.
    film_lift
        Displacements of the blocks' upper ends in the film states, zero elsewhere, shape (3 n, 2); None without film states.
    """

    solid: Solid
    laws: Mapping[int, Isotropic]
    supports: Supports
    matrix: Stiffness
    film_lift: Floats | None = None

    @classmethod
    def assemble(
        cls,
        solid: Solid,
        laws: Mapping[int, Isotropic],
        supports: Supports | None = None,
        film_lift: Floats | None = None,
    ) -> Problem:
        """Assemble the problem of a solid whose bodies have these laws; problems with the same bodies may share supports."""
        supports = supports or Supports.from_bodies(solid, laws)
        return cls(solid, laws, supports, Stiffness(assemble(solid.parts, laws, supports.number)), film_lift)

    @property
    def symmetry_factor(self) -> float:
        """Factor from forces on the mesh to those on the whole: 2 for a half mesh, else 1."""
        return 2.0 if self.solid.mesh.half else 1.0

    def compute_displacements(self, v: Floats, body: int) -> Floats:
        """Return the displacements (3 n, k) that strain a body, from unknowns v (unknowns, k): u of eq. SO.3."""
        return self.expand(v) + self.get_lift(body)

    def get_lift(self, body: int) -> Floats:
        """Return the lifts of all s states that strain a body, shape (3 n, s): the base's motion or, in blocks, a film's."""
        motion = self.supports.lift.reshape(-1, len(STATE_NAMES))
        in_block = body in BLOCK_BODIES
        base_lift = np.zeros_like(motion) if in_block else motion
        if self.film_lift is None:
            return base_lift
        return np.hstack([base_lift, self.film_lift if in_block else np.zeros_like(self.film_lift)])

    @cached_property
    def loads(self) -> Floats:
        """Right-hand sides of the s states, -K lift, shape (unknowns, s)."""
        lift = self.supports.lift.reshape(-1, len(STATE_NAMES))
        tissue, blocks = (
            [body for body in self.laws if body in self.solid.parts and (body in BLOCK_BODIES) == in_block]
            for in_block in (False, True)
        )
        forces = self.compute_forces(tissue, lift)
        if self.film_lift is not None:
            forces = np.hstack([forces, self.compute_forces(blocks, self.film_lift)])
        return self.restrict(-forces)

    def compute_forces(self, bodies: Iterable[int], displacements: Floats) -> Floats:
        """Return the nodal forces of some bodies, N, for displacements of all nodes, m, shape (3 n, k) both."""
        forces = (self.solid.parts[body].compute_forces(self.laws[body], displacements) for body in bodies)
        return sum(forces, start=np.zeros_like(displacements))

    def expand(self, v: Floats) -> Floats:
        """Expand unknowns (unknowns, k) to all displacements (3 n, k), zero where they are fixed."""
        number = self.supports.number.ravel()
        return np.where(number[:, None] >= 0, v[np.maximum(number, 0)], 0.0)

    def restrict(self, forces: Floats) -> Floats:
        """Restrict nodal forces (3 n, k) to the unknowns, (unknowns, k)."""
        number = self.supports.number.ravel()
        free = np.flatnonzero(number >= 0)
        gather = sp.csr_array((np.ones(len(free)), (number[free], free)), shape=(self.supports.unknowns, len(number)))
        return np.asarray(gather @ forces)

    def compute_energy(self, body: int, v: Floats) -> Floats:
        """Return v_i^T K_b v_j, twice the elastic energy of pairs of states in one body of the whole solid, shape (k, k)."""
        u = self.compute_displacements(v, body)
        return np.asarray(self.symmetry_factor * (u.T @ self.compute_forces([body], u)))
