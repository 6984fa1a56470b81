"""Differentiate discrete energies exactly by every length, modulus and Poisson's ratio of a section.

Nodes are smooth functions of the lengths, and polynomial coefficients stay constant. With the nodes' velocity V, L = grad V, tau
= div V + V_r / r, w = 2 pi r dA and Lame's moduli, the energy a(u, v) = int w (2 mu eps:eps + lambda P_u P_v) of two states
changes by

    grad u:  -grad u L,      u_r / r:  -(u_r / r) V_r / r,      w:  w tau                                            (AX.5)
    d int w P_u P_v = int w [dD_u P_v + P_u dD_v + tau (D_u P_v + P_u D_v - P_u P_v)],  D = div u, P its projection  (AX.6)

Base states minimise the energy, so that nothing else changes their forces: no adjoint solve is needed. Node
velocities are derivatives by complex steps of the map from lengths to nodes.

Changes are linear in V: six numbers at each point, the energy-momentum tensor, are computed once for all lengths, and one matrix
product with all velocities gives the derivatives. The energy u^T K u of one state changes by

    d(u^T K u) = int w [tau (s : grad u + s_t u_r / r + lambda P (D - P)) - 2 s : (grad u L) - 2 s_t u_r V_r / r^2]   (AX.13)

with stresses s = 2 mu eps + lambda P in the meridian plane and s_t round the axis, the dilation D = div u and its projection P,
and w, tau and L of eq. AX.5. Where moduli change instead, two integrals suffice: int w s : eps is the energy itself, int w P^2
its factor of lambda.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from geometry.common.arrays import Bools, Floats, Ints
from geometry.meridian.mesh import compute_nodes
from geometry.meridian.section import Body
from solver.axisymmetric.base_states import MeridianModel
from solver.axisymmetric.film_states import CHARGE_VARIABLES, COMPLEX_STEP
from solver.axisymmetric.state_forms import StateForms
from solver.elements.shape_functions import Shapes
from solver.materials.linear import Isotropic

MAX_TENSOR_BYTES = 2e7  # tensors in memory at once


def list_variables(model: MeridianModel) -> tuple[str, ...]:
    """Return the names of a section's variables: ln of each length and modulus, Poisson's ratios and, of films, d_p and d33."""
    bodies = [body.name.lower() for body in model.materials]
    return (
        *model.section.lengths,
        *(f"{body}_youngs_modulus" for body in bodies),
        *(f"{body}_poisson_ratio" for body in bodies),
        *(CHARGE_VARIABLES if model.films is not None else ()),
    )


@dataclass(frozen=True)
class TotalDerivatives:
    """Derivatives of films' totals by all variables, for pairs of states u_1, u_2 and for changes of these pairs.

    With A the derivative of the stiffness by one variable, the total of film i changes by u_i^T A (u_1 + u_2).

    Attributes
    ----------
    totals
        u_i^T A (u_1 + u_2) of k pairs, shape (k, variables, 2).
    changes
        w_i^T A (u_1 + u_2) + u_i^T A (w_1 + w_2) of j changes w of the pairs, shape (j, variables, 2).
    """

    totals: Floats
    changes: Floats


def differentiate_totals(
    model: MeridianModel, basis: Floats, states: Floats, changes: Floats, inside: Body
) -> tuple[TotalDerivatives, TotalDerivatives]:
    """Return the derivatives of films' totals: the part of all bodies except ``inside``, and the part of ``inside``.

    Parameters
    ----------
    model
        Whose energies are differentiated.
    basis
        Values of m basis vectors in n elements with s functions, shape (n, 2 s, m).
    states
        Coefficients of k pairs (u_1, u_2) of states on the basis, shape (k, m, 2).
    changes
        Coefficients of j changes w of the pairs, shape (j, m, 2): one of each pair, or several of a single pair.
    inside
        The body whose part is returned separately.
    """
    forms = StateForms.choose_pairs(np.resize(states, changes.shape), changes, np.linalg.norm(basis, axis=(0, 1)))
    values = basis @ forms.states.reshape(basis.shape[-1], -1)
    values = values.reshape(*basis.shape[:2], *forms.states.shape[1:])
    velocities, mask = compute_velocities(model), model.mesh.body == inside

    def differentiate(part: Bools) -> TotalDerivatives:
        """Return the derivatives of the energies of the elements where ``part`` is true, shape (n,)."""
        totals, changed = forms.sum_forms(_differentiate_elements(model, values, np.flatnonzero(part), velocities))
        return TotalDerivatives(totals[: len(states)], changed)

    return differentiate(~mask), differentiate(mask)


def compute_velocities(model: MeridianModel) -> tuple[Floats, Floats]:
    """Return derivatives of the nodes by ln of each length at a fixed corner size of the mesh, and last by ln of that size.

    The corner size is that to which the mesh is graded at the blocks' corners. All nodes depend on it, so that it is treated
    once; at a fixed corner size most lengths move few elements.

    Returns
    -------
    tuple[Floats, Floats]
        Derivatives of the nodes, m, shape (lengths + 1, n, s, 2), and derivatives of ln of the corner size by ln of each length,
        shape (lengths,).
    """
    names, section = model.section.lengths, model.section
    # factors of each length and, last, of the corner size: row k has a complex step in column k alone
    steps = 1 + 1j * COMPLEX_STEP * np.eye(len(names) + 1)
    moved = {name: getattr(section, name) * steps[k] for k, name in enumerate(names)}
    displaced = replace(section, **moved, mesh_size=section.corner_size * steps[-1])
    free = replace(section, **{name: lengths[:-1] for name, lengths in moved.items()})
    by_lengths = compute_nodes(displaced, model.mesh, model.shapes.places).imag / COMPLEX_STEP
    return by_lengths, free.corner_size.imag / COMPLEX_STEP / section.corner_size


def _differentiate_elements(model: MeridianModel, states: Floats, chosen: Ints, velocities: tuple[Floats, Floats]) -> Floats:
    """Return derivatives of the totals u_i^T K (u_1 + u_2) of k pairs of states in some elements, shape (variables, 2, k).

    They follow from the energies of the sum S = u_1 + u_2 and of S with D = u_1 - u_2, as u_1 = (S + D) / 2, u_2 = (S - D) / 2.

    Parameters
    ----------
    model
        Whose energies are differentiated.
    states
        All values of the elements, shape (n, 2 s, 2, k).
    chosen
        Numbers of the elements.
    velocities
        See ``compute_velocities``.
    """
    if not chosen.size:
        return np.zeros((len(list_variables(model)), *states.shape[2:]))
    velocity, corner_size_derivatives = velocities
    points = EnergyPoints.from_elements(model, chosen)
    motions = points.compute_motions(velocity[:, chosen]).reshape(len(velocity), -1)
    element_values = states[chosen].reshape(len(chosen), 2, -1, *states.shape[2:]).transpose(3, 4, 1, 0, 2)
    values = np.empty((element_values.shape[1], 2, *element_values.shape[2:]))
    np.add(element_values[0], element_values[1], out=values[:, 0])
    np.subtract(element_values[0], element_values[1], out=values[:, 1])
    at_once = max(1, int(MAX_TENSOR_BYTES / (16 * motions.shape[1])))
    parts = [_differentiate_pairs(points, motions, values[low : low + at_once]) for low in range(0, len(values), at_once)]
    lengths, energy, volume = (np.concatenate(part) for part in zip(*parts, strict=True))  # (k, 2, ...)
    # chain rule: lengths also act through the corner size, the last column
    lengths = lengths[..., :-1] + lengths[..., -1:] * corner_size_derivatives
    # energies do not depend on d_p and d33
    no_charges = np.zeros((*lengths.shape[:-1], 0 if model.films is None else len(CHARGE_VARIABLES)))
    by_materials = _differentiate_by_materials(model, chosen, energy, volume)
    combined = np.concatenate([lengths, *by_materials, no_charges], axis=-1).transpose(2, 1, 0)
    # column 0 is of S with S, column 1 twice of S with D, see ``EnergyPoints.compute_tensors``
    total, difference = combined[:, 0] / 2, combined[:, 1] / 4
    return np.stack([total + difference, total - difference], axis=1)


def _differentiate_pairs(points: EnergyPoints, motions: Floats, values: Floats) -> tuple[Floats, Floats, Floats]:
    """Return derivatives of energies by lengths, the energies of the elements and their int w P_u P_v, for k pairs.

    Parameters
    ----------
    points
        Gauss points of e elements, q in each.
    motions
        Factors of the six tensors for each length, shape (lengths, 6 e q).
    values
        For each pair, S = u_1 + u_2 and D = u_1 - u_2, shape (k, 2, 2, e, s).

    Returns
    -------
    tuple[Floats, Floats, Floats]
        Shapes (k, 2, lengths), (k, 2, e) and (k, 2, e); second axis: of S alone, and twice of S with D.
    """
    tensors = np.empty((len(values), 2, 6, *points.weight.shape))
    volume = np.empty((len(values), 2, len(points.weight)))
    for pair, tensor, part in zip(values, tensors, volume, strict=True):
        part[:] = points.compute_tensors(pair, tensor)
    energy = (tensors[:, :, :3] @ np.ones(tensors.shape[-1])).sum(axis=2)
    lengths = tensors.reshape(2 * len(values), -1) @ motions.T  # one product for all pairs: each would read all motions again
    return lengths.reshape(len(values), 2, -1), energy, volume


def _differentiate_by_materials(model: MeridianModel, chosen: Ints, energy: Floats, volume: Floats) -> tuple[Floats, Floats]:
    """Return derivatives of the chosen elements' energies by ln E and by nu of every body, shape (..., bodies) each.

    ``energy`` and ``volume`` are the chosen elements' energies and int w P^2, shape (..., e); 2 mu and lambda depend on E and nu
    by eq. LW.1.
    """
    membership = (model.mesh.body[chosen][:, None] == np.array(list(model.materials))).astype(float)
    law = Isotropic.from_materials(model.materials.values())
    energies, volumetric = energy @ membership, volume @ membership  # of each body
    shear = (energies - law.dilation_modulus * volumetric) / (1 + law.poisson_ratio)
    return energies, law.dilation_modulus_by_poisson * volumetric - shear


@dataclass(frozen=True)
class EnergyPoints:
    """The q Gauss points of n elements, whose arrays have the shape (n, q).

    Attributes
    ----------
    shapes
        The elements' functions.
    derivatives
        d(x, y) / d(r, z) in the order x by r, x by z, y by r, y by z; x and y are the unit square's.
    curvature
        1 / r.
    weight
        w of the module's docstring: quadrature weight times 2 pi r.
    two_mu, lam
        2 mu and lambda, times w.
    inverse_mass
        Inverse of the pressures' mass matrix, by which dilations are projected, shape (n, pressures, pressures).
    """

    shapes: Shapes
    derivatives: tuple[Floats, ...]
    curvature: Floats
    weight: Floats
    two_mu: Floats
    lam: Floats
    inverse_mass: Floats

    @classmethod
    def from_elements(cls, model: MeridianModel, chosen: Ints) -> EnergyPoints:
        """Return the points of the elements with indices ``chosen`` of a model."""
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
        """Compute the energy-momentum tensors of two states, into ``out``, and return int w P_u P_v by element, shape (2, n).

        ``values`` are the states u, v, shape (2, 2, n, s); the results are of u alone, and twice of u and v. The six components
        in ``out``, (2, 6, n, q), are those that ``compute_motions`` gives the factors of: s_rr u_r,r + s_rz u_z,r, s_rz u_r,z +
        s_zz u_z,z, s_t u_r / r, s_rz u_r,r + s_zz u_z,r, s_rr u_r,z + s_rz u_z,z and lambda P (D - P), all times w; the sum of
        the first three is the energy.
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
        derivatives, value = self.shapes.derivative, self.shapes.value
        out = np.empty((7, len(values), *self.weight.shape))
        for k in (0, 1):
            self._transform_derivatives([values[:, k] @ derivative.T for derivative in derivatives], (out[2 * k], out[2 * k + 1]))
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
        """Return the factors of the tensors' components (eq. AX.13) as nodes move with velocities (k, n, s, 2); (k, 6, n, q).

        They are tau - 2 V_r,r, tau - 2 V_z,z, tau - 2 V_r / r, -2 V_r,z, -2 V_z,r and tau.
        """
        tangents, (along_r, along_z) = self.shapes.tangents, np.ascontiguousarray(np.moveaxis(velocity, -1, 0))
        out = np.empty((len(velocity), 6, *self.weight.shape))
        rr, zz, turn, rz, zr, tau = out.swapaxes(0, 1)
        self._transform_derivatives([along_r @ derivative.T for derivative in tangents], (rr, rz))
        self._transform_derivatives([along_z @ derivative.T for derivative in tangents], (zr, zz))
        np.multiply(along_r @ self.shapes.geometry.T, self.curvature, out=turn)
        np.add(rr, zz, out=tau)
        tau += turn
        out[:, :5] *= -2
        out[:, :3] += tau[:, None]
        return out

    def _transform_derivatives(self, derivatives: Sequence[Floats], out: Sequence[Floats]) -> None:
        """Convert derivatives by x and y (of the unit square) to derivatives by r and z, which are written into ``out``."""
        by_x, by_y = derivatives
        for x_derivative, y_derivative, target in zip(self.derivatives[:2], self.derivatives[2:], out, strict=True):
            np.multiply(x_derivative, by_x, out=target)
            target += y_derivative * by_y

    def _project(self, dilation: Floats) -> Floats:
        """Return the projections P of dilations D at the points, shape (k, n, q), onto the elements' pressures; same shape."""
        moments = (self.weight * dilation) @ self.shapes.pressure
        coefficients = (moments.transpose(1, 0, 2) @ self.inverse_mass).transpose(1, 0, 2)
        return np.asarray(np.ascontiguousarray(coefficients) @ self.shapes.pressure.T)


def _multiply_stresses(stresses: Floats, fields: Floats, out: Floats) -> Floats:
    """Multiply one state's stresses by another's fields, into ``out``, shape (6, n, q), and return it.

    ``stresses`` are as from ``_compute_stresses``, (5, n, q), ``fields`` as from ``_compute_fields``, (7, n, q); the products are
    the six components of ``compute_tensors``.
    """
    (radial, axial, hoop, shear, pushed), (rr, rz, zr, zz, turn, excess, _) = stresses, fields
    for k, (a, b, c, d) in {
        0: (radial, rr, shear, zr), 1: (axial, zz, shear, rz), 3: (axial, zr, shear, rr), 4: (radial, rz, shear, zz)
    }.items():  # fmt: skip
        np.multiply(a, b, out=out[k])
        out[k] += c * d
    np.multiply(hoop, turn, out=out[2])
    np.multiply(pushed, excess, out=out[5])
    return out
