"""Describe the tumours that a table covers, and map those of each layer to the cube on which their effects are expanded.

The coordinates, each from -1 to 1, are such that effects of first order are smooth in them:

- the logarithm of the depth between the shallowest and the largest depth for the diameter, straight lines;
- the logarithm of the diameter;
- the strength q = (c - 1) / (1 + beta (c - 1)) of the contrast c = mu_object / mu_host of the shear moduli, in which the effect
  of the deviatoric strain is linear (Eshelby), with beta = 2 (4 - 5 nu) / (15 (1 - nu)) of the host.                       (RT.1)
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from itertools import pairwise

import numpy as np

from geometry.common.arrays import Floats, Numeric
from geometry.common.errors import InputError, Refusal, Words
from geometry.scenes.probe import Material, format_mm
from geometry.scenes.scene_tables import Tissue
from solver.inclusions.tumours import Strata
from solver.materials.linear import Isotropic

MIN_COVER_PER_DIAMETER = 0.1  # of a tumour's diameter: closer to a face its reflections are not resolved by the table's nodes
CENTRE_PER_DIAMETER = 0.5 + MIN_COVER_PER_DIAMETER  # of a centre from a face, at least
ROUNDING_RELATIVE = 1e-6  # of the ranges: numbers that are on a limit but for rounding are allowed


@dataclass(frozen=True)
class TumourRanges:
    """Lowest and highest numbers of the tumours, SI units.

    Attributes
    ----------
    depth, diameter, youngs_modulus
        Lower and upper limits; equal ones for a single value.
    poisson_ratio
        Of all tumours.
    min_cover
        Smallest distance of a tumour from the surface, m; a tenth of the diameter at any rate, and from interfaces of layers.
    """

    depth: tuple[float, float]
    diameter: tuple[float, float]
    youngs_modulus: tuple[float, float]
    poisson_ratio: float = 0.45
    min_cover: float = 0.5e-3

    def __post_init__(self) -> None:
        """Check the ranges.

        Raises
        ------
        InputError
            A limit is not positive and finite, or the lower one is above the upper one.
        """
        for name in ("depth", "diameter", "youngs_modulus"):
            low, high = getattr(self, name)
            if not 0 < low <= high < np.inf:
                raise InputError(name, (low, high), "a lower and an upper limit, positive and in this order")
        if not -1 < self.poisson_ratio < 0.5:
            raise InputError("poisson_ratio", self.poisson_ratio, "a number above -1 and below 0.5")
        if not 0 <= self.min_cover < np.inf:
            raise InputError("min_cover", self.min_cover, "a length, m, not negative")


@dataclass(frozen=True)
class TumourCube:
    """Tumours that lie wholly within one layer of a tissue, and their map to the cube [-1, 1]^3.

    Attributes
    ----------
    ranges
        Of these tumours: the depths of the smallest, diameters up to the largest that fits, the cover below ``ceiling``.
    host
        The material around them.
    ceiling, floor
        Depths of the interface above the tumours (0: the surface) and of the face below them, m; inf in a half-space.
    """

    ranges: TumourRanges
    host: Material
    ceiling: float
    floor: float

    @classmethod
    def from_layer(cls, ranges: TumourRanges, host: Material, ceiling: float, floor: float) -> TumourCube | None:
        """Return the tumours of ranges that lie within a layer, None without any."""
        (low, high), (smallest, largest) = ranges.depth, ranges.diameter
        cover = max(ranges.min_cover - ceiling, 0.0)
        largest = min(
            largest,
            (floor - low) / CENTRE_PER_DIAMETER,
            (high - ceiling) / CENTRE_PER_DIAMETER,
            (high - ceiling - cover) / 0.5,
            (floor - ceiling) / (2 * CENTRE_PER_DIAMETER),
            (floor - ceiling - cover) / (0.5 + CENTRE_PER_DIAMETER),
        )
        if largest < smallest * (1 - ROUNDING_RELATIVE):
            return None
        diameters = (smallest, max(smallest, largest))
        cube = cls(replace(ranges, diameter=diameters, min_cover=cover), host, ceiling, floor)
        deepest = float(cube.compute_deepest(smallest))
        depths = (min(float(cube.compute_shallowest(smallest)), deepest), deepest)
        return replace(cube, ranges=replace(cube.ranges, depth=depths))

    def compute_cover(self, diameter: Numeric) -> Numeric:
        """Return the smallest allowed distance between a tumour and the face above it, m."""
        return np.maximum(self.ranges.min_cover, MIN_COVER_PER_DIAMETER * diameter)

    def compute_shallowest(self, diameter: Numeric) -> Numeric:
        """Return the smallest allowed depth of a tumour's centre, m."""
        return np.maximum(self.ranges.depth[0], self.ceiling + diameter / 2 + self.compute_cover(diameter))

    def compute_deepest(self, diameter: Numeric) -> Numeric:
        """Return the largest allowed depth of a tumour's centre, m."""
        return np.minimum(self.ranges.depth[1], self.floor - CENTRE_PER_DIAMETER * diameter)

    def compute_bottom(self, diameter: Numeric) -> Numeric:
        """Return the depth at which the cube ends, a straight line in the diameter at or below the largest allowed depth, m."""
        deepest = self.ranges.depth[1]
        if self.compute_deepest(self.ranges.diameter[1]) >= deepest * (1 - ROUNDING_RELATIVE):
            return deepest + 0 * diameter
        return self.floor - CENTRE_PER_DIAMETER * diameter

    def compute_strength(self, youngs_modulus: Numeric) -> Numeric:
        """Return the strength of tumours, eq. RT.1."""
        beta, host_modulus = self._deviatoric
        contrast = youngs_modulus / (2 * (1 + self.ranges.poisson_ratio) * host_modulus)
        return (contrast - 1) / (1 + beta * (contrast - 1))

    def map_from_cube(self, points: Floats) -> tuple[Floats, Floats, Floats]:
        """Return depths and diameters, m, and Young's moduli, Pa, of points of the cube, shape (n, 3)."""
        shares = (points.T + 1) / 2
        low, high = self.ranges.diameter
        diameter = low * (high / low) ** shares[1]
        top, bottom = self._compute_top(diameter), self.compute_bottom(diameter)
        weakest, strongest = (self.compute_strength(value) for value in self.ranges.youngs_modulus)
        strength, (beta, host_modulus) = weakest + (strongest - weakest) * shares[2], self._deviatoric
        contrast = 1 + strength / (1 - beta * strength)
        return top * (bottom / top) ** shares[0], diameter, 2 * (1 + self.ranges.poisson_ratio) * host_modulus * contrast

    def map_to_cube(self, depth: Floats, diameter: Floats, youngs_modulus: Floats) -> Floats:
        """Return the points of the cube of tumours, shape (..., 3)."""
        (low, high), top, bottom = self.ranges.diameter, self._compute_top(diameter), self.compute_bottom(diameter)
        weakest, strongest = (self.compute_strength(value) for value in self.ranges.youngs_modulus)
        pairs = (
            (np.log(depth / top), np.log(bottom / top)),
            (np.log(diameter / low), np.log(high / low)),
            (self.compute_strength(youngs_modulus) - weakest, strongest - weakest),
        )
        columns = [2 * np.divide(part, whole, out=np.full_like(depth, 0.5), where=whole > 1e-12) - 1 for part, whole in pairs]
        return np.asarray(np.clip(np.stack(columns, axis=-1), -1, 1))  # where the depths of a diameter are one, rounding is not

    @property
    def _deviatoric(self) -> tuple[float, float]:
        """Return beta of eq. RT.1 and the host's shear modulus, Pa."""
        nu, law = self.host.poisson_ratio, Isotropic.from_material(self.host)
        return 2 * (4 - 5 * nu) / (15 * (1 - nu)), law.shear_modulus

    def _compute_top(self, diameter: Numeric) -> Numeric:
        """Return the depth at which the cube begins, a straight line in the diameter at or above the smallest allowed depth.

        The smallest allowed depth has kinks, which an expansion in polynomials would resolve slowly.
        """
        lowest, (low, high) = self.ranges.depth[0], self.ranges.diameter
        if self.compute_shallowest(high) <= lowest * (1 + ROUNDING_RELATIVE):
            return lowest + 0 * diameter
        cover, share = self.ranges.min_cover, 0.5
        if cover < MIN_COVER_PER_DIAMETER * low:
            cover, share = 0.0, CENTRE_PER_DIAMETER
        return self.ceiling + cover + share * diameter


def build_cubes(ranges: TumourRanges, tissue: Tissue) -> tuple[TumourCube, ...]:
    """Return the tumours of ranges within each layer of a tissue that holds any, from the surface downwards.

    Raises
    ------
    Refusal
        No tumour lies wholly within a layer and under its cover, or the deepest and largest reaches the tissue's bottom.
    """
    strata, bottom = Strata.from_tissue(tissue), tissue.bottom
    (shallowest, deepest), (smallest, largest) = ranges.depth, ranges.diameter
    lowest = bottom - CENTRE_PER_DIAMETER * largest
    if deepest > lowest:
        allowed = f"up to {format_mm(max(float(lowest), 0.0))}, so that the largest tumour lies above the tissue's bottom"
        raise Refusal("population.depth", format_mm(deepest), allowed)
    layers = zip(strata.materials, pairwise((0.0, *strata.interfaces, bottom)), strict=True)
    cubes = [TumourCube.from_layer(ranges, host, *faces) for host, faces in layers]
    if not any(cubes):
        given = Words(f"{format_mm(shallowest)} to {format_mm(deepest)}")
        allowed = f"depths at which a tumour of {format_mm(smallest)} lies within one layer and under its cover"
        raise Refusal("population.depth", given, allowed)
    return tuple(filter(None, cubes))


def list_ranges(ranges: TumourRanges) -> str:
    """Return all numbers of ranges as a text, which a cache's key contains."""
    return repr([(part.name, getattr(ranges, part.name)) for part in fields(ranges)])
