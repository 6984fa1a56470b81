"""Compute forces and tangents of all elements at finite strain, with pressures and interior values eliminated.

The elements are those of ``solver/elements/quadrilateral.py``: Qp displacements and P(p-1) pressures. The pressure is an unknown
of Newton's method, eliminated from the linear system element by element but not from the equations. (Mean dilatation, which
eliminates it there, takes three times the iterations at nu = 0.499 and fails at 0.4999.)
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from geometry.common.arrays import Floats
from solver.elements.quadrilateral import Geometry
from solver.elements.shape_functions import Shapes
from solver.elements.unit_square import UnitSquare
from solver.materials.hyperelastic import TT, Hyperelastic, Stress, compute_distortion, compute_volume_change


@dataclass(frozen=True)
class ElementValues:
    """Coefficients of the n elements' functions.

    Attributes
    ----------
    u
        Displacements, m, shape (n, 2 s) for s functions: u_r before u_z.
    p
        Pressures, Pa, shape (n, m) for m functions.
    """

    u: Floats
    p: Floats


@dataclass(frozen=True)
class Elimination:
    """Elimination of pressures and interior values from the tangent of one state.

    Attributes
    ----------
    inner_by_edge
        Derivative of interior values with respect to values on corners and edges, (n, i, 8 p).
    pressure_by_u
        Derivative of the pressures with respect to all displacements, (n, m, 2 s).
    inner_by_force
        Derivative of interior values with respect to forces on them, (n, i, i).
    pressure_by_gap
        Derivative of the pressures with respect to the volume residual, (n, m, m).
    """

    inner_by_edge: Floats
    pressure_by_u: Floats
    inner_by_force: Floats
    pressure_by_gap: Floats


@dataclass(frozen=True)
class Balance:
    """Forces of all elements in a state, with pressures and interior values eliminated.

    Attributes
    ----------
    forces
        Forces on the values on corners and edges, shape (n, 8 p).
    internal
        Forces before the elimination, shape (n, 2 s).
    inner, pressure
        Newton corrections of interior values and pressures with corners and edges fixed, (n, i) and (n, m).
    """

    forces: Floats
    internal: Floats
    inner: Floats
    pressure: Floats


@dataclass(frozen=True)
class Elements:
    """The elements of a mesh: all that does not change as they deform.

    Attributes
    ----------
    shapes
        Shape functions.
    material
        Material of each element.
    square
        Geometry of the elements, mapped from the unit square.
    """

    shapes: Shapes
    material: Hyperelastic
    square: UnitSquare

    @classmethod
    def from_geometry(cls, geometry: Geometry, functions: Shapes, material: Hyperelastic) -> Elements:
        """Build the elements from their geometry, shape functions and materials."""
        return cls(functions, material, UnitSquare.from_geometry(geometry, functions))

    def build_rest_values(self) -> ElementValues:
        """Return the displacements and pressures of the undeformed elements: zeros."""
        n = len(self.square.weight)
        return ElementValues(np.zeros((n, 2 * len(self.shapes.degrees))), np.zeros((n, self.shapes.pressure.shape[1])))

    def compute_min_volume_ratio(self, u: Floats) -> float:
        """Return the minimum volume ratio J = det F of all Gauss points."""
        return 1 + float(compute_volume_change(self.square.compute_gradients(u)).min())

    def find_max_distortions(self, u: Floats) -> list[float]:
        """Return the largest I - 3 of eq. LW.2 in the elements of each law that is not neo-Hookean."""
        return self.material.find_max_distortions(self.square.compute_gradients(u)) if self.material.laws else []

    def compute_max_stretch(self, u: Floats) -> float:
        """Return the maximum |lambda - 1| of the principal stretches lambda at all Gauss points."""
        h = self.square.compute_gradients(u)
        a, b, c, d = (h[k] + identity for k, identity in enumerate((1.0, 0.0, 0.0, 1.0)))
        plus, minus = np.hypot(a + d, b - c) / 2, np.hypot(a - d, b + c) / 2  # singular values: plus + minus, plus - minus
        return float(max(np.abs(plus + minus - 1).max(), np.abs(plus - minus - 1).max(), np.abs(h[TT]).max()))

    def compute_distortions(self, u: Floats) -> Floats:
        """Return I - 3 of eq. LW.2 at all Gauss points, shape (n, q)."""
        return compute_distortion(self.square.compute_gradients(u))

    def compute_energies(self, state: ElementValues) -> Floats:
        """Return the energy stored about each Gauss point, J, shape (n, q)."""
        stored = self.material.compute_energy_density(self.square.compute_gradients(state.u), state.p @ self.shapes.pressure.T)
        return np.asarray(self.square.weight * stored)

    def compute_energy(self, state: ElementValues) -> float:
        """Return the stored energy, J."""
        return float(self.compute_energies(state).sum())

    def linearise(self, state: ElementValues) -> tuple[Balance, Floats, Elimination]:
        """Linearise the elements' equations about a state and eliminate pressures and interior values.

        Returns the forces, the stiffness on corners and edges, shape (n, 8 p, 8 p), and the elimination, with which ``move``
        recovers what was eliminated. In the body, e stands for corners and edges and i for the interior.
        """
        stress, p = self.material.compute_stress(self.square.compute_gradients(state.u)), state.p @ self.shapes.pressure.T
        dilation, compliance = self.material.compute_dilation(p)
        N, w, m = self.shapes.pressure, self.square.weight, self.shapes.pressure.shape[1]
        # across: volume change of each pressure function by the displacements; mass: compliance between pressures
        across = self.square.sum_moments(w * self.square.turn_stress(stress.cofactor))
        mass = ((w * compliance) @ self._pressures).reshape(-1, m, m)
        by_gap = np.asarray(np.linalg.inv(mass), dtype=float)
        by_u = by_gap @ across
        K = self.square.sum_stiffness(self._compute_turned_tangent(stress, p)) + across.transpose(0, 2, 1) @ by_u
        (ee, ei), (_, ii) = self._split_blocks(K)
        by_force = np.asarray(-np.linalg.inv(ii), dtype=float)
        by_edge = by_force @ ei.transpose(0, 2, 1)
        elimination = Elimination(by_edge, by_u, by_force, by_gap)
        balance = self._eliminate(self._compute_forces(stress, p), (w * (stress.change - dilation)) @ N, elimination)
        return balance, ee + ei @ by_edge, elimination

    def balance(self, state: ElementValues, elimination: Elimination) -> Balance:
        """Return the forces in a state, with pressures and interior values eliminated as in another state nearby."""
        stress, p = self.material.compute_stress(self.square.compute_gradients(state.u)), state.p @ self.shapes.pressure.T
        gap = (self.square.weight * (stress.change - self.material.compute_dilation(p)[0])) @ self.shapes.pressure
        return self._eliminate(self._compute_forces(stress, p), gap, elimination)

    def compute_modulus_derivative(self, state: ElementValues, elimination: Elimination, target: Floats) -> Floats:
        """Return the derivative of the forces on corners and edges, (n, 8 p), with respect to ln E of the target.

        The target is the tumour whose Young's modulus E varies. ``target`` is the fraction of each element, shape (n, 1), or of
        each Gauss point's circle about the axis, (n, q), that lies in it. ``elimination`` is that of the same state.

        At fixed strain and fixed pressure p, with J, U and its conjugate U* of eq. LW.3,

            d stress / d ln E = stress without the pressure's part,   d (dU*/dp) / d ln E = -p d2U*/dp2     (CT.1)
        """
        stress, p = self.material.compute_stress(self.square.compute_gradients(state.u)), state.p @ self.shapes.pressure.T
        compliance = self.material.compute_dilation(p)[1]
        weight = self.square.weight * target
        gap = (weight * p * compliance) @ self.shapes.pressure
        return self._eliminate(
            self.square.sum_forces(self.square.turn_stress(weight * stress.first_piola)), gap, elimination
        ).forces

    def move(
        self,
        state: ElementValues,
        elimination: Elimination,
        edge: Floats,
        balance: Balance | None = None,
        step_fraction: float = 1.0,
    ) -> ElementValues:
        """Return the elements' values after corners and edges move; interior values and pressures follow.

        Parameters
        ----------
        state
            The values before.
        elimination
            Elimination at that state.
        edge
            Change of the values on corners and edges, m, shape (n, 8 p).
        balance
            Forces at that state: interior values and pressures then also take their Newton corrections. None: they only follow.
        step_fraction
            Factor of the whole step.
        """
        inner = (elimination.inner_by_edge @ edge[..., None])[..., 0]
        if balance is not None:
            inner += balance.inner
        n, m = len(edge), self.shapes.skeleton
        step = np.concatenate([edge.reshape(n, 2, m), inner.reshape(n, 2, -1)], axis=2).reshape(n, -1)
        pressure = (elimination.pressure_by_u @ step[..., None])[..., 0]
        if balance is not None:
            pressure += balance.pressure
        return ElementValues(state.u + step_fraction * step, state.p + step_fraction * pressure)

    @cached_property
    def _pressures(self) -> Floats:
        """Products of the pressure functions at the Gauss points, shape (q, m m)."""
        N = self.shapes.pressure
        return np.asarray((N[:, :, None] * N[:, None]).reshape(len(N), -1))

    def _compute_forces(self, stress: Stress, p: Floats) -> Floats:
        """Return the forces on all displacement values, (n, 2 s), of stresses and of pressures p at Gauss points, Pa, (n, q)."""
        return self.square.sum_forces(self.square.turn_stress(self.square.weight * (stress.first_piola + p * stress.cofactor)))

    def _compute_turned_tangent(self, stress: Stress, p: Floats) -> Floats:
        """Return the derivative of the stresses at fixed pressure p, Pa, (n, q), for ``UnitSquare.sum_stiffness``.

        Shape (5, 5, n, q): components rX, rY, zX, zY, N of the unit square's coordinates, quadrature weights included. For the
        four terms see ``Stress``.
        """
        square, w = self.square, self.square.weight
        c, h = square.turn_stress(stress.cofactor), square.turn_stress(w * stress.cofactor_coefficient)
        D = np.empty((5, *c.shape))
        for i in range(5):
            for j in range(i, 5):
                D[i, j] = c[i] * h[j]
                D[i, j] += h[i] * c[j]
        if stress.bend is not None:
            x = square.turn_stress(stress.distortion)
            for i in range(5):
                D[i, i:] += w * stress.bend * x[i] * x[i:]
        unit = w * stress.identity_coefficient * square.turn_unit_matrix()  # entries rX rX, rX rY, rY rY and N N
        D[0, 0] += unit[0]
        D[2, 2] += unit[0]
        D[0, 1] += unit[1]
        D[2, 3] += unit[1]
        D[1, 1] += unit[2]
        D[3, 3] += unit[2]
        D[4, 4] += unit[3]
        # d2J/dh2: the hoop stretch couples in-plane gradients; their cofactors over it couple them to the hoop
        volume = w * (stress.hessian_coefficient + p)
        flat = volume * stress.F[TT] * (square.xr * square.yz - square.xz * square.yr)
        D[0, 3] += flat
        D[1, 2] -= flat
        D[:4, 4] += volume * square.inverse_radius / stress.F[TT] * c[:4]
        D[4, 2:4] = D[2:4, 4]
        return D

    def _split_blocks(self, K: Floats) -> tuple[tuple[Floats, Floats], tuple[Floats, Floats]]:
        """Split stiffness matrices, (n, 2 s, 2 s), into ((ee, ei), (ie, ii)): e for corners and edges, i for the interior."""
        n, m = len(K), self.shapes.skeleton
        parts = K.reshape(n, 2, K.shape[1] // 2, 2, -1)
        e, i = slice(0, m), slice(m, None)

        def take_block(a: slice, b: slice) -> Floats:
            """Return the block of the functions ``a`` (rows) and ``b`` (columns) of all elements, shape (n, rows, columns)."""
            part = parts[:, :, a, :, b]
            return part.reshape(n, 2 * part.shape[2], -1)

        return (take_block(e, e), take_block(e, i)), (take_block(i, e), take_block(i, i))

    def _eliminate(self, internal: Floats, gap: Floats, elimination: Elimination) -> Balance:
        """Eliminate pressures and interior values from forces, (n, 2 s), and volume residuals, (n, m)."""
        n, m = len(gap), self.shapes.skeleton
        pressure = (elimination.pressure_by_gap @ gap[..., None])[..., 0]
        parts = (internal + (gap[:, None] @ elimination.pressure_by_u)[:, 0]).reshape(n, 2, -1)
        edge, inside = parts[:, :, :m].reshape(n, -1), parts[:, :, m:].reshape(n, -1)
        inner = (elimination.inner_by_force @ inside[..., None])[..., 0]
        return Balance(edge + (inside[:, None] @ elimination.inner_by_edge)[:, 0], internal, inner, pressure)
