"""Evaluate displacements and strains of base states anywhere in tissue without inclusions.

Points are located by ``tissue_elements.py``; the polynomials are then evaluated directly, so that strains are as accurate as the
elements.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from geometry.common.arrays import Bools, Floats, Ints
from solver.axisymmetric.base_states import BaseStates
from solver.axisymmetric.tissue_elements import TissueElements
from solver.elements.quadrilateral import compute_dilations
from solver.elements.shape_functions import evaluate_functions, evaluate_legendre, evaluate_pressures

POINTS_PER_CHUNK = 20_000  # evaluated at once, which limits the memory


@dataclass(frozen=True)
class Strains:
    """Displacements and strains of the s states at m points, per unit of each (see ``BaseStates``); last axis: the state.

    Attributes
    ----------
    displacement
        u_r, u_z, m per unit, shape (m, 2, s).
    strain
        eps_rr, eps_zz, eps_hoop and eps_rz (half the engineering shear) per unit, shape (m, 4, s).
    dilation
        Their sum as the elements project it, shape (m, s): near incompressibility the sum itself oscillates.
    """

    displacement: Floats
    strain: Floats
    dilation: Floats


@dataclass(frozen=True)
class TissueField:
    """The s states, without an inclusion, as functions of position."""

    states: BaseStates

    @property
    def count(self) -> int:
        """The number of states s: two base states and, with films, two film states."""
        return len(self.states.products)

    @cached_property
    def elements(self) -> TissueElements:
        """The tissue's elements, in which points are located."""
        return TissueElements(self.states.model.section, self.states.model.mesh)

    def evaluate(self, r: Floats, z: Floats) -> Strains:
        """Evaluate at points 0 <= r <= tissue radius, -tissue depth <= z <= 0 (z out of the tissue), arrays of one shape (m,).

        Raises
        ------
        InputError
            A point lies outside the tissue, or there is an inclusion.
        """
        points = np.stack(np.broadcast_arrays(np.atleast_1d(r), np.atleast_1d(z)), axis=-1).astype(float)
        self.elements.check_points(points)
        parts = [self._evaluate_chunk(points[low : low + POINTS_PER_CHUNK]) for low in range(0, len(points), POINTS_PER_CHUNK)]
        if not parts:
            return Strains(*(np.zeros((0, *shape, self.count)) for shape in ((2,), (4,), ())))
        return Strains(*(np.concatenate(part) for part in zip(*parts, strict=True)))

    def _evaluate_chunk(self, points: Floats) -> tuple[Floats, Floats, Floats]:
        """Return displacements, strains and projected dilations, as in ``Strains``, at points (m, 2)."""
        element, places, jacobian = self.elements.locate(points)
        model, legendre = self.states.model, evaluate_legendre(places, self.states.model.shapes.order)
        value, (by_u, by_v) = evaluate_functions(places, model.shapes.degrees, legendre)
        # the Jacobian dr/du, dr/dv; dz/du, dz/dv, and from it derivatives of the s functions by r and z
        (ru, rv), (zu, zv) = jacobian.transpose(1, 2, 0)[..., None]
        determinant = ru * zv - rv * zu
        derivatives = np.stack([value, (zv * by_u - zu * by_v) / determinant, (ru * by_v - rv * by_u) / determinant], axis=1)
        u, by_r, by_z = (derivatives @ self._values[element]).reshape(-1, 3, 2, self.count).transpose(1, 0, 2, 3)
        radius = points[:, :1]
        hoop = np.where(radius > 0, u[:, 0] / np.where(radius > 0, radius, 1.0), by_r[:, 0])  # u_r / r -> u_r,r on the axis
        strain = np.stack([by_r[:, 0], by_z[:, 1], hoop, (by_z[:, 0] + by_r[:, 1]) / 2], axis=1)
        pressed = evaluate_pressures(places, model.shapes.order, legendre)
        dilation = (pressed[:, None] @ self._find_dilation_coefficients(element))[:, 0]
        return u + self.states.shift[element][:, None] * [[0.0], [1.0]], strain, dilation

    @cached_property
    def _values(self) -> Floats:
        """The elements' values by function, u_r and u_z of all s states, shape (n, functions, 2 s)."""
        values = self.states.values.reshape(len(self.states.values), 2, -1, self.count)
        return np.ascontiguousarray(values.transpose(0, 2, 1, 3)).reshape(len(values), -1, 2 * self.count)

    def _find_dilation_coefficients(self, element: Ints) -> Floats:
        """Return the coefficients of the states' projected dilations on the k pressure functions of m elements, (m, k, s).

        Those of an element are computed when first needed: few tumours lie in few elements.
        """
        model, (coefficients, is_known) = self.states.model, self._dilation_coefficients
        new = np.unique(element[~is_known[element]])
        if len(new):
            values = self.states.values[new].reshape(len(new), 2, -1, self.count)
            table = compute_dilations(model.geometry.select(new), model.shapes)[:, :, ::2]
            coefficients[new] = np.einsum("nkcs,ncsi->nki", table, values, optimize=True)
            is_known[new] = True
        return coefficients[element]

    @cached_property
    def _dilation_coefficients(self) -> tuple[Floats, Bools]:
        """Coefficients of all n elements, shape (n, k, s), and which are computed already, shape (n,)."""
        n, pressures = len(self.states.values), self.states.model.shapes.pressure.shape[1]
        return np.zeros((n, pressures, self.count)), np.zeros(n, dtype=bool)
