"""Expand the effects of single tumours in one layer of a tissue.

The relative changes of the inner reading, the outer reading (of charges or stresses, as the scene reads) and the stiffness by one
tumour at the lateral distance rho from the probe's axis are

    e_c = diameter^3 sum_r phi_r(rho) psi_rc(depth, diameter, youngs_modulus)                             (RT.2)

with phi from a singular value decomposition of effects at Chebyshev points, and psi polynomials on ``TumourCube``.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from geometry.common.arrays import Floats, Ints
from solver.reading_tables.expansion import evaluate_cube_basis
from solver.reading_tables.tumour_ranges import TumourCube

FINE_STEPS = 4096  # of the linear interpolation of phi: its error is 1e-6 of the effect


@dataclass(frozen=True)
class LayerTable:
    """Effects of single tumours within one layer, eq. RT.2.

    Attributes
    ----------
    cube
        The tumours.
    scale, end
        The distance rho enters as sqrt(rho^2 + scale^2) - scale; effects are computed up to ``end`` and vanish at twice that, m.
    offset_functions
        phi_r at evenly spaced values of that coordinate, up to the one of 2 ``end``, shape (steps + 1, r).
    degrees, coefficients
        Degrees of the polynomials, shape (p, 3), and psi_rc per diameter^3, 1/m^3, as sums of these, shape (p, r, 3).
    error
        Root mean square error of the signals, RT.3, over held-out tumours, relative to that of the signals; of ln ratio and ln
        stiffness, shape (2,). It is of one tumour; several add their exchange of fields.
    scale_error
        The same of the model, which all signals of a scan have nearly alike, shape (2,): 0 in linear elasticity.
    worst_error
        The largest error of a held-out signal relative to the largest signal of its tumour, shape (2,).
    """

    cube: TumourCube
    scale: float
    end: float
    offset_functions: Floats
    degrees: Ints
    coefficients: Floats
    error: Floats = field(default_factory=lambda: np.zeros(2))
    scale_error: Floats = field(default_factory=lambda: np.zeros(2))
    worst_error: Floats = field(default_factory=lambda: np.zeros(2))

    def compute_effects(self, tumours: Floats, positions: Floats, with_gradients: bool = False) -> tuple[Floats, Floats]:
        """Return e_c of n tumours, (n, 5), at k positions, (n, k, 3), and its gradients by x and y of the probe, (n, k, 2, 3)."""
        x, y, depth, diameter, modulus = tumours.T
        basis = evaluate_cube_basis(self.cube.map_to_cube(depth, diameter, modulus), self.degrees)
        psi = basis @ self.coefficients.reshape(len(self.degrees), -1)
        psi *= diameter[:, None] ** 3
        psi = psi.reshape(len(tumours), *self.coefficients.shape[1:])
        distance = np.stack([positions[:, 0] - x[:, None], positions[:, 1] - y[:, None]])
        root = np.sqrt(distance[0] ** 2 + distance[1] ** 2 + self.scale**2)
        place = np.minimum((root - self.scale) / self._fine_step, FINE_STEPS - 1e-9)
        line = place.astype(np.intp)
        lower, change = self.offset_functions.take(line, axis=0), self._changes.take(line, axis=0)
        gradients = np.zeros(0)
        if with_gradients:
            by_place = change @ psi / self._fine_step
            gradients = (distance / root).transpose(1, 2, 0)[..., None] * by_place[:, :, None]
        change *= (place - line)[..., None]
        lower += change
        return lower @ psi, gradients

    @property
    def _fine_step(self) -> float:
        """Step of the coordinate of ``offset_functions``, m."""
        return float(np.hypot(2 * self.end, self.scale) - self.scale) / FINE_STEPS

    @cached_property
    def _changes(self) -> Floats:
        """Differences between neighbouring rows of ``offset_functions``."""
        return np.diff(self.offset_functions, axis=0)
