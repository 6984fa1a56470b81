"""Predict readings over many candidate tumours from tables of low rank, built once for a probe on its tissue.

A tumour lies wholly within a layer, and each layer has a table of its own, eq. RT.2. Effects of several tumours add.
The signals of a scan against tissue without tumours are

    ln(1 + e_inner) - ln(1 + e_outer)   of the ratio,     ln(1 + e_stiffness)   of the stiffness            (RT.3)

The stiffness is the force per indentation, and so minus the change of ln indentation at a given force.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np

from geometry.common.arrays import Bools, Floats, Ints
from geometry.common.errors import InputError, Refusal, Words
from geometry.scenes.probe import format_mm
from geometry.scenes.scene import Scene
from geometry.scenes.tissue_sides import compute_side_distance
from solver.reading_tables.layer_table import LayerTable
from solver.reading_tables.tumour_ranges import ROUNDING_RELATIVE, TumourRanges

CHUNK = 512  # candidates at once, whose arrays fit the processor's cache
MIN_DISTANCE_M = 0.5e-3  # between the surfaces of two tumours: closer ones exchange fields that a sum of effects leaves out


def are_apart(tumours: Floats) -> Bools:
    """Return in which candidates, shape (n, m, 5), all tumours are ``MIN_DISTANCE_M`` or more apart, shape (n,)."""
    apart, radius = np.ones(len(tumours), dtype=bool), tumours[..., 3] / 2
    for first, second in combinations(range(tumours.shape[1]), 2):
        distance = np.linalg.norm(tumours[:, first, :3] - tumours[:, second, :3], axis=1)
        apart &= distance >= radius[:, first] + radius[:, second] + MIN_DISTANCE_M
    return apart


@dataclass(frozen=True)
class ReadingTable:
    """Readings over tumours within ranges, eq. RT.3.

    Attributes
    ----------
    scene
        The probe on its tissue.
    ranges
        Of the tumours.
    layers
        Tables of the layers that hold any of them, from the surface downwards.
    """

    scene: Scene
    ranges: TumourRanges
    layers: tuple[LayerTable, ...]

    @cached_property
    def error(self) -> Floats:
        """Largest error of a layer's table, as ``LayerTable.error``, shape (2,)."""
        return np.asarray(np.max([layer.error for layer in self.layers], axis=0))

    @cached_property
    def scale_error(self) -> Floats:
        """Largest error of a layer's model, as ``LayerTable.scale_error``, shape (2,)."""
        return np.asarray(np.max([layer.scale_error for layer in self.layers], axis=0))

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
            signals[start : start + CHUNK] = combine_effects(effects)
        return signals

    def slopes(self, tumours: Floats, positions: Floats) -> Floats:
        """Return the derivatives of ``predict`` with respect to x and y of the probe, 1/m, shape (n, k, 2, 2).

        The last axis is x, y; parameters and errors raised as of ``predict``.
        """
        tumours, positions = self._check(tumours, positions)
        slopes = np.empty((len(tumours), len(positions), 2, 2))
        for start in range(0, len(tumours), CHUNK):
            effects, gradients = self._sum_effects(tumours[start : start + CHUNK], positions, with_gradients=True)
            combine_effects(effects)  # refuses effects without a logarithm
            relative = gradients / (1 + effects)[..., None, :]
            slopes[start : start + CHUNK, :, 0] = relative[..., 0] - relative[..., 1]
            slopes[start : start + CHUNK, :, 1] = relative[..., 2]
        return slopes

    def is_allowed(self, tumours: Floats) -> Bools:
        """Return whether candidates, shape (n, m, 5), lie within the ranges, have their cover, are inside the tissue and apart.

        Shape (n,). Tumours closer than ``MIN_DISTANCE_M`` count as touching.
        """
        tumours = np.asarray(tumours, dtype=float)
        x, y, radius = tumours[..., 0], tumours[..., 1], tumours[..., 3] / 2
        fits = self._find_covered(tumours) & (radius < compute_side_distance(self.scene.tissue, x, y))
        return np.asarray(np.all(np.isfinite(tumours), axis=(1, 2)) & np.all(fits, axis=1) & are_apart(tumours))

    def _find_covered(self, tumours: Floats) -> Bools:
        """Return whether each tumour of shape (..., 5) lies within the ranges, a layer and under its cover, shape (...)."""
        depth, diameter, modulus = np.moveaxis(tumours[..., 2:], -1, 0)
        low, high = 1 - ROUNDING_RELATIVE, 1 + ROUNDING_RELATIVE
        covered = np.zeros(depth.shape, dtype=bool)
        for cube in (layer.cube for layer in self.layers):
            covered |= (depth >= cube.compute_shallowest(diameter) * low) & (depth <= cube.compute_deepest(diameter) * high)
        for values, limits in ((diameter, self.ranges.diameter), (modulus, self.ranges.youngs_modulus)):
            covered &= (values >= limits[0] * low) & (values <= limits[1] * high)
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
            ranges, given = self.ranges, f"{format_mm(diameter)} at {format_mm(depth)}, {modulus / 1e3:.4g} kPa"
            pairs = (("depths", ranges.depth, 1e3, "mm"), ("diameters", ranges.diameter, 1e3, "mm"))
            limits = [f"{name} {low * unit:.4g} to {high * unit:.4g} {text}" for name, (low, high), unit, text in pairs]
            moduli = " to ".join(f"{modulus / 1e3:.4g}" for modulus in ranges.youngs_modulus)
            cover = f"a cover of {format_mm(ranges.min_cover)} and of a tenth of the diameter, also to interfaces of layers"
            raise InputError("tumours", Words(given), f"{', '.join(limits)} and {moduli} kPa, {cover}")
        return tumours, positions

    def _sum_effects(self, tumours: Floats, positions: Floats, with_gradients: bool = False) -> tuple[Floats, Floats]:
        """Return the sums of e_c over the tumours, (n, k, 3), and their gradients by x and y of the probe, 1/m, (n, k, 2, 3)."""
        n, k = len(tumours), len(positions)
        effects, gradients = np.zeros((n, k, 3)), np.zeros((n, k, 2, 3) if with_gradients else 0)
        for number in range(tumours.shape[1]):
            single = tumours[:, number]
            for layer, rows in zip(self.layers, self._divide(single[:, 2]), strict=True):
                layer_effects, layer_gradients = layer.compute_effects(single[rows], positions, with_gradients)
                effects[rows] += layer_effects
                if with_gradients:
                    gradients[rows] += layer_gradients
        return effects, gradients

    def _divide(self, depth: Floats) -> list[Ints | slice]:
        """Return the rows of the tumours at depths, shape (n,), that each layer holds."""
        if len(self.layers) == 1:
            return [slice(None)]
        numbers = np.searchsorted([layer.cube.floor for layer in self.layers[:-1]], depth, side="right")
        return [np.flatnonzero(numbers == number) for number in range(len(self.layers))]


def combine_effects(effects: Floats) -> Floats:
    """Return the signals of eq. RT.3 for effects e_c, shape (..., 3): shape (..., 2)."""
    factors = 1 + effects
    if np.any(factors <= 0):
        raise Refusal("tumours", Words("a film reads nothing, or changes its sign, over them"), "weaker or fewer tumours")
    return np.log(np.stack([factors[..., 0] / factors[..., 1], factors[..., 2]], axis=-1))
