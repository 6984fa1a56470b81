"""Elements at finite strain: forces and tangents of all of them, pressure and inside eliminated.

The pair is that of ``solver/axisymmetric/quadrilateral.py``, Qp displacements and P(p-1) pressures, the pressure an unknown of
Newton's method: eliminated from the linear system element by element, never from the equations (mean dilatation, which does that,
takes three times the iterations at nu = 0.499 and fails at 0.4999).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Bools, Floats, Ints
from solver.axisymmetric.quadrilateral import Geometry, gradients
from solver.axisymmetric.shape_functions import Shapes
from solver.contact.hyperelasticity import Hyperelastic, change_of_volume


@dataclass(frozen=True)
class ElementValues:
    """Values of all elements: of displacements, (n, 2 s), u_r before u_z, and of pressures, (n, m)."""

    u: Floats
    p: Floats


@dataclass(frozen=True)
class Tangent:
    """Newton's equations of all elements with pressure and inside eliminated.

    Attributes:
        forces: on the values on corners and edges, shape (n, 8 p, k).
        stiffness: of these, shape (n, 8 p, 8 p).
        internal: forces before the elimination, as which a state out of balance shows, shape (n, 2 s).
        inner, inner_by_edge: change of the inside with no and with unit change of corners and edges, (n, i, k) and (n, i, 8 p).
        pressure, pressure_by_u: likewise of the pressures, by all displacements, (n, m, k) and (n, m, 2 s).
    """

    forces: Floats
    stiffness: Floats
    internal: Floats
    inner: Floats
    inner_by_edge: Floats
    pressure: Floats
    pressure_by_u: Floats


@dataclass(frozen=True)
class Elements:
    """What does not change as the elements deform.

    Attributes:
        shapes: their functions.
        material: theirs.
        weight: of the Gauss points, 2 pi r dA, shape (n, q).
        gradient: from values to displacement gradients, shape (n, q, 5, 2 s).
        edge, inner: which values are those of corners and edges, and which of the inside.
    """

    shapes: Shapes
    material: Hyperelastic
    weight: Floats
    gradient: Floats
    edge: Ints
    inner: Ints

    @classmethod
    def of(cls, at: Geometry, functions: Shapes, material: Hyperelastic) -> Elements:
        """Tabulate the functions' gradients."""
        n, q, s, m = *at.weight.shape, len(functions.degrees), functions.skeleton
        unit = np.broadcast_to(np.eye(2 * s).reshape(1, 2, s, 2 * s), (n, 2, s, 2 * s))
        slopes, hoop = gradients(at, functions, unit)
        gradient = np.stack([*slopes, hoop], axis=2)
        assert gradient.shape == (n, q, 5, 2 * s)
        edge = np.concatenate([np.arange(m), s + np.arange(m)])
        return cls(functions, material, at.weight, gradient, edge, np.setdiff1d(np.arange(2 * s), edge))

    def at_rest(self) -> ElementValues:
        """Nothing deformed."""
        n, size = len(self.weight), self.gradient.shape[-1]
        return ElementValues(np.zeros((n, size)), np.zeros((n, self.shapes.pressure.shape[1])))

    def gradients(self, u: Floats) -> Floats:
        """Displacement gradients of values u (n, 2 s), shape (n, q, 5)."""
        n, q, five, size = self.gradient.shape
        return np.asarray((self.gradient.reshape(n, q * five, size) @ u[:, :, None]).reshape(n, q, five))

    def least_volume(self, u: Floats) -> float:
        """The smallest J of all Gauss points."""
        return 1 + float(change_of_volume(self.gradients(u)).min())

    def largest_stretch(self, u: Floats) -> float:
        """The largest |lambda - 1| of the principal stretches lambda at all Gauss points."""
        h = self.gradients(u)
        a, b, c, d = (h[..., k] + one for k, one in enumerate((1.0, 0.0, 0.0, 1.0)))
        plus, minus = np.hypot(a + d, b - c) / 2, np.hypot(a - d, b + c) / 2  # singular values: plus + minus, plus - minus
        return float(max(np.abs(plus + minus - 1).max(), np.abs(plus - minus - 1).max(), np.abs(h[..., 4]).max()))

    def energy(self, state: ElementValues) -> float:
        """Stored energy, J."""
        return float((self.weight * self.material.stored(self.gradients(state.u), state.p @ self.shapes.pressure.T)).sum())

    def tangent(self, state: ElementValues, target: Bools | None = None) -> Tangent:
        """Linearise about a state.

        A second column of ``forces`` is their derivative by ln E of the ``target`` elements, shape (n,): at one strain and one
        pressure

            d stress / d ln E = stress without the pressure's share,   d (dU*/dp) / d ln E = -p d2U*/dp2     (CT.3)
        """
        n, q, five, size = self.gradient.shape
        P, A, change, cof, second = self.material.stress(self.gradients(state.u))
        N, w = self.shapes.pressure, self.weight
        p = state.p @ N.T
        dilation, compliance = self.material.dilation(p)
        flat = self.gradient.reshape(n, q * five, size)
        turned = flat.transpose(0, 2, 1)
        forces = (turned @ (w[..., None] * (P + p[..., None] * cof)).reshape(n, -1, 1))[..., 0]
        D = w[..., None, None] * (A + p[..., None, None] * second)
        K = turned @ (D @ self.gradient).reshape(n, q * five, size)
        across = turned @ ((w[..., None] * cof)[..., None] * N[:, None, :]).reshape(n, q * five, -1)
        mass = (N.T * (w * compliance)[:, None, :]) @ N
        gap, residual = ((w * (change - dilation)) @ N)[..., None], forces[..., None]
        if target is not None:
            by_modulus = (turned @ (w[..., None] * P).reshape(n, -1, 1)) * target[:, None, None]
            residual = np.concatenate([residual, by_modulus], axis=2)
            gap = np.concatenate([gap, ((w * p * compliance) @ N * target[:, None])[..., None]], axis=2)
        k = gap.shape[-1]
        both = np.linalg.solve(mass, np.concatenate([gap, across.transpose(0, 2, 1)], axis=2))
        pressure, by_u = both[..., :k], both[..., k:]
        residual = residual + across @ pressure
        return self._inside_out(K + across @ by_u, residual, forces, pressure, by_u)

    def _inside_out(self, K: Floats, residual: Floats, internal: Floats, pressure: Floats, by_u: Floats) -> Tangent:
        """Eliminate the values inside the elements."""
        e, i = self.edge, self.inner
        across = K[:, i][:, :, e]
        both = -np.linalg.solve(K[:, i][:, :, i], np.concatenate([residual[:, i], across], axis=2))
        k = residual.shape[-1]
        inner, by_edge = both[..., :k], both[..., k:]
        stiffness = K[:, e][:, :, e] + across.transpose(0, 2, 1) @ by_edge
        forces = residual[:, e] + across.transpose(0, 2, 1) @ inner
        return Tangent(forces, (stiffness + stiffness.transpose(0, 2, 1)) / 2, internal, inner, by_edge, pressure, by_u)

    def moved(self, state: ElementValues, tangent: Tangent, edge: Floats, share: float = 1.0) -> ElementValues:
        """Return a state after a ``share`` of Newton's step, whose part on corners and edges is ``edge``, (n, 8 p)."""
        step = np.empty_like(state.u)
        step[:, self.edge] = edge
        step[:, self.inner] = tangent.inner[..., 0] + (tangent.inner_by_edge @ edge[..., None])[..., 0]
        pressure = tangent.pressure[..., 0] + (tangent.pressure_by_u @ step[..., None])[..., 0]
        return ElementValues(state.u + share * step, state.p + share * pressure)
