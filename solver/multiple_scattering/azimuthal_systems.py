"""Solve elasticity in the meridian plane for fields that vary as cos m theta about the axis, with one system for each order m.

    u_r = U cos m theta,  u_theta = V sin m theta,  u_z = W cos m theta                            (MS.1)

with amplitudes U, V, W in the meridian plane; and the same rotated by a quarter of a wave, (sin, -cos, sin). For m > 0
the components are U + V, U - V and W: near the axis they behave as r^(m+1), r^(m-1) and r^m, so that each
either vanishes there or is free. Elements are those of the base states, with
the volumetric strain projected likewise (``solver/elements/quadrilateral.py``).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from geometry.common.arrays import Floats, Ints
from geometry.common.errors import SolveError
from solver.axisymmetric.base_states import MeridianModel
from solver.axisymmetric.condensed_system import MAX_RESIDUAL_RELATIVE
from solver.axisymmetric.dofs import Interface, Numbering, number_unknowns
from solver.elements.quadrilateral import Blocks, Geometry
from solver.elements.shape_functions import Shapes
from solver.linalg.cholesky import Factor, Pattern, factorise
from solver.materials.linear import Isotropic

MATRIX_ORDERS = (1, 2, 3)  # whose element matrices determine those of all others
BATCH_ELEMENTS = 8  # elements at once: their strains fit the processor's cache
# U, V and W from the components, for m = 0 and m > 0
COMPONENT_MATRICES = {
    0: np.array([[1.0, 0.0], [0.0, 0.0], [0.0, 1.0]]),
    1: np.array([[0.5, 0.5, 0.0], [0.5, -0.5, 0.0], [0.0, 0.0, 1.0]]),
}


@dataclass(frozen=True)
class Harmonic:
    """The linear system of one azimuthal order.

    Attributes
    ----------
    m
        The order.
    model
        The base states' model, whose mesh and materials it shares.
    boundary
        Elements with an edge on the tissue's boundary, shape (e,).
    stiffness
        Stiffness of these elements on corners and edges, shape (e, 4 c p, 4 c p), c components.
    numbering
        Numbering of the components on corners and edges.
    matrix
        Matrix of the system, shape (unknowns, unknowns).
    known
        An existing factor of the matrix, or None.
    pattern
        What the matrices of several orders share, of which PARDISO keeps one factor; None for an order of its own.
    """

    m: int
    model: MeridianModel
    boundary: Ints
    stiffness: Floats
    numbering: Numbering
    matrix: Any
    known: Factor | None = None
    pattern: Pattern | None = None

    @cached_property
    def factor(self) -> Factor:
        """Factor of the matrix, computed on first use."""
        return self.known or factorise(self.matrix, self.pattern)

    @property
    def amplitudes(self) -> Floats:
        """Matrix from the c components to U, V and W (rows), shape (3, c)."""
        return COMPONENT_MATRICES[min(self.m, 1)]

    def apply(self, data: Floats, _: bool) -> Floats:
        """Solve for forces as a response of ``lockstep``; see ``solve``."""
        return self.solve(data)

    def solve(self, forces: Floats) -> Floats:
        """Solve for the unknowns under k columns of forces, shape (unknowns, k) both, and check the residual.

        Raises
        ------
        SolveError
            The residual is too large.
        """
        v = self.factor.solve(forces)
        # weights of the k columns: each is scaled to norm 1 (1e-300 guards a zero column); cosines keep them from cancelling
        mix = np.cos(np.arange(1, forces.shape[1] + 1)) / np.maximum(np.linalg.norm(forces, axis=0), 1e-300)
        combination, force = v @ mix, forces @ mix  # check one combination: a single column is five times faster than two
        imbalance = np.linalg.norm(force - self.matrix.T @ combination)  # the matrix is symmetric; its transpose is read faster
        scale = np.linalg.norm(self._magnitude * np.abs(combination) + np.abs(force))
        residual = float(imbalance / scale) if scale > 0 else 0.0
        if not residual <= MAX_RESIDUAL_RELATIVE:
            raise SolveError(f"the linear system of order {self.m} was not solved: residual {residual:.1e}")
        return np.asarray(v)

    @cached_property
    def _magnitude(self) -> Floats:
        """Diagonal of the matrix, the largest entry of every row and column."""
        return np.asarray(self.matrix.diagonal())

    def compute_values(self, edge: Floats, recovery: Floats) -> Floats:
        """Return all values U, V, W of e elements for k solutions, shape (e, 3, s, k), with s functions per element.

        Parameters
        ----------
        edge
            The components on corners and edges, shape (e, 4 c p, k).
        recovery
            Matrix from these to the values inside the elements, see ``AzimuthalSystems.compute_recovery``.
        """
        e, k, c = len(edge), edge.shape[-1], self.amplitudes.shape[1]
        inside = recovery @ edge
        components = np.concatenate([edge.reshape(e, c, -1, k), inside.reshape(e, c, -1, k)], axis=2)
        return np.asarray(np.einsum("ac,ecsk->eask", self.amplitudes, components))


@dataclass(frozen=True)
class AzimuthalSystems:
    """Assembles the systems of all azimuthal orders.

    Element matrices are quadratic in m, eq. MS.3: those of m = 1, 2 and 3 determine all others (MS.2).

    Attributes
    ----------
    model
        The base states' model.
    interface
        How blocks and tissue are tied to each other: bonded or frictionless.
    boundary
        Elements with an edge on the tissue's boundary, shape (e,).
    """

    model: MeridianModel
    interface: Interface
    boundary: Ints
    _samples: dict[int, Floats] = field(default_factory=dict, repr=False)

    @property
    def bytes_per_order(self) -> float:
        """Bytes for one more order: its element matrices and, until these are cached, those of the three orders behind all."""
        orders = 4 - len(self._samples)
        return 8.0 * orders * len(self.model.mesh.body) * (3 * len(self.model.shapes.degrees)) ** 2

    def assemble_order(self, m: int) -> Harmonic:
        """Assemble the system of one order; order 0 (no torsion) is the base states' system."""
        model, base_system, boundary = self.model, self.model.system, self.boundary
        if m == 0:
            return Harmonic(
                0, model, boundary, base_system.stiffness[boundary], base_system.numbering, base_system.matrix, base_system.factor
            )
        parts = (slice(low, low + BATCH_ELEMENTS) for low in range(0, len(model.mesh.body), BATCH_ELEMENTS))
        skeleton = model.shapes.skeleton
        edges = np.concatenate(
            [Blocks.from_matrices(self._combine_orders(m, part), skeleton).condense().stiffness for part in parts]
        )
        numbered = number_unknowns(
            model.mesh, model.shapes.order, self.interface, min(m, 2)
        )  # higher orders vanish on the axis alike
        matrix, pattern = numbered.assemble(edges), self._pattern if m > 1 else None
        return Harmonic(m, model, boundary, edges[boundary], numbered, matrix, pattern=pattern)

    @cached_property
    def _pattern(self) -> Pattern:
        """The pattern of all orders above 1: to factorise again takes a tenth of an analysis, and a factor most of the memory."""
        return Pattern()

    def compute_recovery(self, m: int, elements: Ints) -> Floats:
        """Compute the matrix from values on corners and edges to values inside some elements, (e, c (p-1)^2, 4 c p)."""
        if m == 0:
            return self.model.condensed.compute_recovery(elements)
        return Blocks.from_matrices(self._combine_orders(m, elements), self.model.shapes.skeleton).condense().compute_recovery()

    def _combine_orders(self, m: int, part: slice | Ints) -> Floats:
        """Combine the element matrices of order m from those of orders 1, 2 and 3 (eq. MS.2), for some elements.

        The weights are those of the parabola through m = 1, 2 and 3.
        """
        if m <= len(MATRIX_ORDERS):
            return self._find_sample(m)[part]
        first, second, third = (self._find_sample(order)[part] for order in MATRIX_ORDERS)
        weights = (m - 2) * (m - 3) / 2, -(m - 1) * (m - 3), (m - 1) * (m - 2) / 2
        return np.asarray(weights[0] * first + weights[1] * second + weights[2] * third)

    def _find_sample(self, m: int) -> Floats:
        """Return the element matrices of order 1, 2 or 3, shape (n, 3, s, 3, s); they are cached."""
        if m not in self._samples:
            model, n, s = self.model, len(self.model.mesh.body), len(self.model.shapes.degrees)
            matrices = np.empty((n, 3, s, 3, s))
            for low in range(0, n, BATCH_ELEMENTS):
                part = np.arange(low, min(low + BATCH_ELEMENTS, n))
                matrices[part] = _compute_stiffness(model.geometry.select(part), model.shapes, model.law.select(part), m)
            self._samples[m] = matrices
        return self._samples[m]


def _compute_stiffness(geometry: Geometry, shapes: Shapes, law: Isotropic, m: int) -> Floats:
    """Compute the stiffness matrices of n elements for order m > 0, shape (n, 3, s, 3, s): 3 components, s functions."""
    n = len(geometry.radius)
    strain, dilation = _compute_strains(geometry, shapes, m)
    weight = geometry.weight / 2  # the mean of cos^2 m theta and of sin^2 m theta about the axis is 1/2
    size = strain.shape[-1]
    flat = (strain * np.sqrt(weight)[:, :, None, None]).reshape(n, -1, size)
    shear = flat.transpose(0, 2, 1) @ flat
    weighted = weight[..., None] * shapes.pressure
    moments = weighted.transpose(0, 2, 1) @ dilation
    mass = weighted.transpose(0, 2, 1) @ shapes.pressure  # the volumetric strain is projected on the pressure functions
    volume = moments.transpose(0, 2, 1) @ np.linalg.solve(mass, moments)
    stiffness = law.two_mu[:, None, None] * shear + law.dilation_modulus[:, None, None] * volume
    return np.asarray(stiffness.reshape(n, 3, -1, 3, size // 3))


def _compute_strains(geometry: Geometry, shapes: Shapes, m: int) -> tuple[Floats, Floats]:
    """Compute strains (n, q, 6, 3 s) and dilation (n, q, 3 s) at q points of n elements, per value of 3 s functions.

    The rows are those of MS.3, where ,r and ,z are derivatives; shears are times sqrt(1/2), so that squares add up to eps:eps.

    rr = U,r;  zz = W,z;  hoop = (U + m V) / r;  rz = U,z + W,r;  r theta = V,r - (V + m U) / r;  theta z = V,z - m W / r   (MS.3)
    """
    d_r, d_z = geometry.turn_derivatives(*shapes.derivative)
    value_over_radius = shapes.value / geometry.radius[..., None]
    n, q, s = d_r.shape
    strain = np.zeros((n, q, 6, 3, s))
    shear_factor = np.sqrt(0.5)
    strain[:, :, 0, 0], strain[:, :, 1, 2] = d_r, d_z
    strain[:, :, 2, 0], strain[:, :, 2, 1] = value_over_radius, m * value_over_radius
    strain[:, :, 3, 0], strain[:, :, 3, 2] = shear_factor * d_z, shear_factor * d_r
    strain[:, :, 4, 0], strain[:, :, 4, 1] = -shear_factor * m * value_over_radius, shear_factor * (d_r - value_over_radius)
    strain[:, :, 5, 1], strain[:, :, 5, 2] = shear_factor * d_z, -shear_factor * m * value_over_radius
    # the components are U + V and U - V in place of U and V
    plus, minus = (strain[:, :, :, 0] + strain[:, :, :, 1]) / 2, (strain[:, :, :, 0] - strain[:, :, :, 1]) / 2
    strain[:, :, :, 0], strain[:, :, :, 1] = plus, minus
    flat = strain.reshape(n, q, 6, 3 * s)
    return flat, flat[:, :, :3].sum(axis=2)
