"""Compute the energy-momentum tensor at the Gauss points: the change of a state's energy as points move.

By eqs. AX.5, AX.6 the energy u^T K u of one state changes linearly with the velocity V,

    d(u^T K u) = int w [tau (s : grad u + s_t u_r / r + lambda P (D - P)) - 2 s : (grad u L) - 2 s_t u_r V_r / r^2]   (AX.13)

with stresses s = 2 mu eps + lambda P in the meridian plane and s_t round the axis, the dilation D = div u and its projection P,
and w, tau and L of eq. AX.5. Where moduli change instead, two integrals suffice: int w s : eps is the energy itself, int w P^2
its factor of lambda.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Floats, Ints
from solver.axisymmetric.base_states import MeridianModel
from solver.elements.shape_functions import Shapes


@dataclass(frozen=True)
class EnergyPoints:
    """The q Gauss points of n elements, whose arrays have the shape (n, q).

    Attributes
    ----------
    shapes
        The elements' functions.
    slopes
        d(x, y) / d(r, z) in the order x by r, x by z, y by r, y by z; x and y are the unit square's.
    curvature
        1 / r.
    weight
        w.
    two_mu, lam
        Times w.
    inverse_mass
        Of the pressures, shape (n, pressures, pressures).
    """

    shapes: Shapes
    slopes: tuple[Floats, ...]
    curvature: Floats
    weight: Floats
    two_mu: Floats
    lam: Floats
    inverse_mass: Floats

    @classmethod
    def from_elements(cls, model: MeridianModel, chosen: Ints) -> EnergyPoints:
        """Return the points of some elements of a model."""
        geometry, shapes, law = model.geometry.select(chosen), model.shapes, model.law.select(chosen)
        pressures = shapes.pressure.shape[1]
        return cls(
            shapes,
            tuple(np.ascontiguousarray(geometry.inverse[..., k, axis]) for k in (0, 1) for axis in (0, 1)),
            curvature=1 / geometry.radius,
            weight=geometry.weight,
            two_mu=geometry.weight * law.two_mu[:, None],
            lam=geometry.weight * law.dilation_modulus[:, None],
            inverse_mass=np.asarray(
                np.linalg.inv((geometry.weight @ shapes.mass).reshape(-1, pressures, pressures)), dtype=float
            ),
        )

    def compute_tensors(self, values: Floats, out: Floats) -> Floats:
        """Compute the tensors that motions multiply, into ``out``, and return each element's int w P_u P_v, shape (2, n).

        ``values`` are the states u, v, shape (2, 2, n, s); the results are of u alone, and twice of u and v. The six of ``out``,
        (2, 6, n, q), are s_rr u_r,r + s_rz u_z,r, s_rz u_r,z + s_zz u_z,z, s_t u_r / r, s_rz u_r,r + s_zz u_z,r, s_rr u_r,z +
        s_rz u_z,z and lambda P (D - P), all times w; the sum of the first three is the energy.
        """
        fields = self._compute_fields(values)
        stresses, u, v = self._compute_stresses(fields), fields[:, 0], fields[:, 1]
        _multiply_stresses(stresses[:, 0], u, out[0])
        _multiply_stresses(stresses[:, 0], v, out[1])
        out[1] += _multiply_stresses(stresses[:, 1], u, np.empty_like(out[1]))
        pressed = self.weight * u[6]
        return np.stack([np.einsum("nq,nq->n", pressed, u[6]), 2 * np.einsum("nq,nq->n", pressed, v[6])])

    def _compute_fields(self, values: Floats) -> Floats:
        """Return u_r,r, u_r,z, u_z,r, u_z,z, u_r / r, D - P and P of states (k, 2, n, s), shape (7, k, n, q)."""
        slopes, value = self.shapes.slope, self.shapes.value
        out = np.empty((7, len(values), *self.weight.shape))
        for k in (0, 1):
            self._transform_slopes([values[:, k] @ slope.T for slope in slopes], (out[2 * k], out[2 * k + 1]))
        np.multiply(values[:, 0] @ value.T, self.curvature, out=out[4])
        np.add(out[0], out[3], out=out[5])
        out[5] += out[4]
        out[6] = self._project(out[5])
        out[5] -= out[6]
        return out

    def _compute_stresses(self, fields: Floats) -> Floats:
        """Return s_rr, s_zz, s_t, s_rz and lambda P, times w, from fields (7, k, n, q), shape (5, k, n, q)."""
        out = np.empty((5, *fields.shape[1:]))
        np.multiply(self.lam, fields[6], out=out[4])
        for target, strain in zip(out[:3], (fields[0], fields[3], fields[4]), strict=True):
            np.multiply(self.two_mu, strain, out=target)
            target += out[4]
        np.add(fields[1], fields[2], out=out[3])
        out[3] *= self.two_mu / 2
        return out

    def compute_motions(self, velocity: Floats) -> Floats:
        """Return the factors of the tensors as nodes move with velocities (k, n, s, 2), shape (k, 6, n, q)."""
        tangents, (along_r, along_z) = self.shapes.tangents, np.ascontiguousarray(np.moveaxis(velocity, -1, 0))
        out = np.empty((len(velocity), 6, *self.weight.shape))
        rr, zz, turn, rz, zr, tau = out.swapaxes(0, 1)
        self._transform_slopes([along_r @ slope.T for slope in tangents], (rr, rz))
        self._transform_slopes([along_z @ slope.T for slope in tangents], (zr, zz))
        np.multiply(along_r @ self.shapes.geometry.T, self.curvature, out=turn)
        np.add(rr, zz, out=tau)
        tau += turn
        out[:, :5] *= -2
        out[:, :3] += tau[:, None]
        return out

    def _transform_slopes(self, slopes: Sequence[Floats], out: Sequence[Floats]) -> None:
        """Convert derivatives by x and y to derivatives by r and z, into ``out``."""
        by_x, by_y = slopes
        for x_slope, y_slope, target in zip(self.slopes[:2], self.slopes[2:], out, strict=True):
            np.multiply(x_slope, by_x, out=target)
            target += y_slope * by_y

    def _project(self, dilation: Floats) -> Floats:
        """Project dilations, (k, n, q), onto the pressures."""
        moments = (self.weight * dilation) @ self.shapes.pressure
        coefficients = (moments.transpose(1, 0, 2) @ self.inverse_mass).transpose(1, 0, 2)
        return np.asarray(np.ascontiguousarray(coefficients) @ self.shapes.pressure.T)


def _multiply_stresses(stresses: Floats, fields: Floats, out: Floats) -> Floats:
    """Multiply one state's stresses by another's fields, into the six products of ``out``, shape (6, n, q)."""
    (radial, axial, hoop, shear, pushed), (rr, rz, zr, zz, turn, excess, _) = stresses, fields
    for k, (a, b, c, d) in {
        0: (radial, rr, shear, zr), 1: (axial, zz, shear, rz), 3: (axial, zr, shear, rr), 4: (radial, rz, shear, zz)
    }.items():  # fmt: skip
        np.multiply(a, b, out=out[k])
        out[k] += c * d
    np.multiply(hoop, turn, out=out[2])
    np.multiply(pushed, excess, out=out[5])
    return out
