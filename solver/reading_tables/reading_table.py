"""Predict readings over many candidate tumours from a table of low rank, built once for a probe on its tissue.

The relative changes of the inner reading, the outer reading (of charges or stresses, as the scene reads) and the stiffness by one
tumour at the lateral distance rho from the probe's axis are

    e_c = diameter^3 sum_r phi_r(rho) psi_rc(depth, diameter, youngs_modulus)                             (RT.2)

with phi from a singular value decomposition of effects at Chebyshev points, and psi polynomials on ``TumourCube``. Effects of
several tumours add. The signals of a scan against tissue without tumours are

    ln(1 + e_inner) - ln(1 + e_outer)   of the ratio,     ln(1 + e_stiffness)   of the stiffness            (RT.3)

The stiffness is the force per indentation, and so minus the change of ln indentation at a given force.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from geometry.common.arrays import Bools, Floats, Ints
from geometry.common.errors import InputError, Refusal, Words
from geometry.scenes.probe import format_mm
from geometry.scenes.scene import Scene
from solver.reading_tables.expansion import evaluate_cube_basis
from solver.reading_tables.tumour_ranges import ROUNDING_RELATIVE, TumourCube

CHUNK = 512  # candidates at once, whose arrays fit the processor's cache
FINE_STEPS = 4096  # of the linear interpolation of phi: its error is 1e-6 of the effect
MIN_DISTANCE_M = 0.5e-3  # between the surfaces of two tumours: closer ones exchange fields that a sum of effects leaves out


@dataclass(frozen=True)
class ReadingTable:
    """Readings over tumours within ranges, eqs. RT.2 and RT.3.

    Attributes
    ----------
    cube
        The tumours that the table covers.
    scene
        The probe on its tissue.
    scale, end
        The distance rho enters as sqrt(rho^2 + scale^2) - scale; effects are computed up to ``end`` and vanish at twice that, m.
    offset_functions
        phi_r at evenly spaced values of that coordinate, up to the one of 2 ``end``, shape (steps + 1, r).
    degrees, coefficients
        Degrees of the polynomials, shape (p, 3), and psi_rc per diameter^3, 1/m^3, as sums of these, shape (p, r, 3).
    error
        Root mean square error of the signals over held-out tumours, relative to that of the signals; of ln ratio and ln
        stiffness, shape (2,). It is of one tumour; several add their exchange of fields.
    scale_error
        The same of the model, which all signals of a scan have nearly alike, shape (2,): 0 in linear elasticity.
    worst_error
        The largest error of a held-out signal relative to the largest signal of its tumour, shape (2,).
    """

    cube: TumourCube
    scene: Scene
    scale: float
    end: float
    offset_functions: Floats
    degrees: Ints
    coefficients: Floats
    error: Floats = field(default_factory=lambda: np.zeros(2))
    scale_error: Floats = field(default_factory=lambda: np.zeros(2))
    worst_error: Floats = field(default_factory=lambda: np.zeros(2))

    def predict(self, tumours: Floats, positions: Floats) -> Floats:
        """Return the changes of ln ratio and ln stiffness against tissue without tumours.

        Parameters
        ----------
        tumours
            n candidates of m tumours each: x, y, depth, diameter in m, Young's modulus in Pa; shape (n, m, 5).
        positions
            x and y of the probe's axis, m, shape (k, 2).

        Returns
        -------
        Floats
            Shape (n, k, 2).

        Raises
        ------
        InputError
            A number is not finite, or outside the table's ranges.
        Refusal
            Several tumours together would take all of a film's load, so that the ratio has no logarithm.
        """
        tumours, positions = self._check(tumours, positions)
        signals = np.empty((len(tumours), len(positions), 2))
        for start in range(0, len(tumours), CHUNK):
            effects = self._sum_effects(tumours[start : start + CHUNK], positions)[0]
            signals[start : start + CHUNK] = _combine(effects)
        return signals

    def slopes(self, tumours: Floats, positions: Floats) -> Floats:
        """Return the derivatives of ``predict`` with respect to x and y of the probe, 1/m, shape (n, k, 2, 2).

        The last axis is x, y; parameters and errors raised as of ``predict``.
        """
        tumours, positions = self._check(tumours, positions)
        slopes = np.empty((len(tumours), len(positions), 2, 2))
        for start in range(0, len(tumours), CHUNK):
            effects, gradients = self._sum_effects(tumours[start : start + CHUNK], positions, with_gradients=True)
            _combine(effects)  # refuses effects without a logarithm
            relative = gradients / (1 + effects)[..., None, :]
            slopes[start : start + CHUNK, :, 0] = relative[..., 0] - relative[..., 1]
            slopes[start : start + CHUNK, :, 1] = relative[..., 2]
        return slopes

    def is_allowed(self, tumours: Floats) -> Bools:
        """Return whether candidates, shape (n, m, 5), lie within the ranges, have their cover, are inside the tissue and apart.

        Shape (n,). Tumours closer than ``MIN_DISTANCE_M`` count as touching.
        """
        tumours = np.asarray(tumours, dtype=float)
        x, y, diameter = tumours[..., 0], tumours[..., 1], tumours[..., 3]
        allowed = np.all(np.isfinite(tumours), axis=(1, 2)) & np.all(self._find_covered(tumours), axis=1)
        tissue, radius = self.scene.tissue, diameter / 2
        if tissue.shape == "cylinder":
            allowed &= np.all(np.hypot(x, y) + radius < tissue.radius, axis=1)
        elif tissue.shape == "block":
            inside = (np.abs(x) + radius < tissue.length / 2) & (np.abs(y) + radius < tissue.breadth / 2)
            allowed &= np.all(inside, axis=1)
        for i in range(tumours.shape[1]):
            for j in range(i):
                distance = np.linalg.norm(tumours[:, i, :3] - tumours[:, j, :3], axis=1)
                allowed &= distance - radius[:, i] - radius[:, j] >= MIN_DISTANCE_M
        return np.asarray(allowed)

    def with_errors(self, error: Floats, scale_error: Floats, worst_error: Floats) -> ReadingTable:
        """Return the table with measured errors."""
        return replace(self, error=error, scale_error=scale_error, worst_error=worst_error)

    def _find_covered(self, tumours: Floats) -> Bools:
        """Return whether each tumour of shape (..., 5) lies within the ranges and has its cover, shape (...)."""
        ranges, (depth, diameter, modulus) = self.cube.ranges, np.moveaxis(tumours[..., 2:], -1, 0)
        covered = depth >= self.cube.compute_shallowest(diameter) * (1 - ROUNDING_RELATIVE)
        for values, (low, high) in ((depth, ranges.depth), (diameter, ranges.diameter), (modulus, ranges.youngs_modulus)):
            covered &= (values >= low * (1 - ROUNDING_RELATIVE)) & (values <= high * (1 + ROUNDING_RELATIVE))
        return np.asarray(covered)

    def _check(self, tumours: Floats, positions: Floats) -> tuple[Floats, Floats]:
        """Return both as arrays, and refuse shapes, numbers that are not finite, and tumours outside the ranges."""
        tumours, positions = np.asarray(tumours, dtype=float), np.asarray(positions, dtype=float)
        if tumours.ndim != 3 or tumours.shape[2] != 5:
            raise InputError("tumours", Words(f"an array of shape {tumours.shape}"), "(candidates, tumours of each, 5)")
        if positions.ndim != 2 or positions.shape[1] != 2:
            raise InputError("positions", Words(f"an array of shape {positions.shape}"), "(positions, 2)")
        if not (np.all(np.isfinite(tumours)) and np.all(np.isfinite(positions))):
            raise InputError("tumours and positions", Words("not all finite"), "finite numbers")
        covered = self._find_covered(tumours)
        if not np.all(covered):
            depth, diameter, modulus = tumours[~covered][0, 2:].tolist()
            ranges, given = self.cube.ranges, f"{format_mm(diameter)} at {format_mm(depth)}, {modulus / 1e3:.4g} kPa"
            pairs = (("depths", ranges.depth, 1e3, "mm"), ("diameters", ranges.diameter, 1e3, "mm"))
            limits = [f"{name} {low * unit:.4g} to {high * unit:.4g} {text}" for name, (low, high), unit, text in pairs]
            moduli = " to ".join(f"{modulus / 1e3:.4g}" for modulus in ranges.youngs_modulus)
            shallowest = f"this one at {self.cube.compute_shallowest(diameter) * 1e3:.4g} mm or deeper"
            raise InputError("tumours", Words(given), f"{', '.join(limits)} and {moduli} kPa, {shallowest}")
        return tumours, positions

    def _sum_effects(self, tumours: Floats, positions: Floats, with_gradients: bool = False) -> tuple[Floats, Floats]:
        """Return the sums of e_c over the tumours, (n, k, 3), and their gradients by x and y of the probe, 1/m, (n, k, 2, 3)."""
        n, k = len(tumours), len(positions)
        effects, gradients = np.zeros((n, k, 3)), np.zeros((n, k, 2, 3) if with_gradients else 0)
        step = self._fine_step
        for number in range(tumours.shape[1]):
            x, y, depth, diameter, modulus = tumours[:, number].T
            basis = evaluate_cube_basis(self.cube.map_to_cube(depth, diameter, modulus), self.degrees)
            psi = basis @ self.coefficients.reshape(len(self.degrees), -1)
            psi *= diameter[:, None] ** 3
            psi = psi.reshape(n, -1, 3)
            distance = np.stack([positions[:, 0] - x[:, None], positions[:, 1] - y[:, None]])
            root = np.sqrt(distance[0] ** 2 + distance[1] ** 2 + self.scale**2)
            place = np.minimum((root - self.scale) / step, FINE_STEPS - 1e-9)
            line = place.astype(np.intp)
            lower, change = self.offset_functions.take(line, axis=0), self._changes.take(line, axis=0)
            if with_gradients:
                by_place = change @ psi / step
                gradients += (distance / root).transpose(1, 2, 0)[..., None] * by_place[:, :, None]
            change *= (place - line)[..., None]
            lower += change
            effects += lower @ psi
        return effects, gradients

    @property
    def _fine_step(self) -> float:
        """Step of the coordinate of ``offset_functions``, m."""
        return float(np.hypot(2 * self.end, self.scale) - self.scale) / FINE_STEPS

    @cached_property
    def _changes(self) -> Floats:
        """Differences between neighbouring rows of ``offset_functions``."""
        return np.diff(self.offset_functions, axis=0)


def _combine(effects: Floats) -> Floats:
    """Return the signals of eq. RT.3 for effects e_c, shape (..., 3): shape (..., 2)."""
    factors = 1 + effects
    if np.any(factors <= 0):
        raise Refusal("tumours", Words("a film reads nothing, or changes its sign, over them"), "weaker or fewer tumours")
    return np.log(np.stack([factors[..., 0] / factors[..., 1], factors[..., 2]], axis=-1))
