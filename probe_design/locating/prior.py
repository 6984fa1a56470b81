"""Describe what is known of the tumours of a patient before the readings.

A tumour is a point of the unit cube, one coordinate for each quantity of the population that varies: x and y are uniform over
their ranges, ln diameter and ln modulus over theirs (lists: every value equally probable), and ln depth from the depth that
leaves the least cover above this diameter, or the range's lower end where that is deeper, to the range's upper end. Tumours are
independent, inside the tissue, and apart from each other.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from scipy.stats import qmc

from geometry.common.arrays import Bools, Floats
from geometry.common.errors import InputError, Words
from geometry.common.percent import format_percent
from geometry.scenes.probe import format_mm
from geometry.scenes.scene import Scene
from geometry.scenes.tissue_sides import compute_side_distance
from probe_design.populations.design_file import Design
from probe_design.populations.entries import Range
from probe_design.populations.population import MIN_COVER_PER_DIAMETER, ScenePopulation
from solver.inclusions.tumours import Strata
from solver.reading_tables.reading_table import are_apart

TUMOUR_QUANTITIES = ("x", "y", "depth", "diameter", "youngs_modulus")  # columns of an array of tumours
FRACTION_SAMPLES = 2**14  # of the prior, from which the allowed fraction is computed: its error is below 0.01
MIN_ALLOWED_FRACTION = 0.01  # of the sets drawn, fewer of which would not show where tumours may lie


class ForwardModel(Protocol):
    """What the inference needs of a table of readings, see ``solver.reading_tables``."""

    @property
    def error(self) -> Floats:
        """Relative error of each predicted change of ln ratio and ln stiffness by itself, shape (2,)."""
        ...

    @property
    def scale_error(self) -> Floats:
        """Relative error that all changes have alike, shape (2,)."""
        ...

    def predict(self, tumours: Floats, positions: Floats) -> Floats:
        """Return changes of ln ratio and ln stiffness, shape (n, k, 2), by tumours (n, m, 5) at positions (k, 2)."""
        ...

    def slopes(self, tumours: Floats, positions: Floats) -> Floats:
        """Return the derivatives of ``predict`` with respect to x and y of the probe, 1/m, shape (n, k, 2, 2)."""
        ...


@dataclass(frozen=True)
class TumourPrior:
    """Tumours of a population as points of a cube.

    Attributes
    ----------
    ranges
        Of x, y, depth, diameter and Young's modulus, in the order of ``TUMOUR_QUANTITIES``; SI units.
    least_cover
        Smallest distance of a tumour from the surface, m; a tenth of its diameter at any rate.
    scene
        The tissue without tumours, whose sides and bottom a tumour does not reach.
    numbers
        Probability of each number of tumours, from none on.
    poisson_ratio
        Of all tumours.
    """

    ranges: tuple[Range, ...]
    least_cover: float
    scene: Scene
    numbers: Floats
    poisson_ratio: float

    @classmethod
    def from_design(cls, design: Design, positions: Floats) -> TumourPrior:
        """Return the prior of a design file, by default with places among the readings at ``positions``, m, shape (k, 2).

        Raises
        ------
        InputError
            The shallowest tumour lies deeper than the deepest.
        """
        given, population = design.population, ScenePopulation.from_scene(design.scene, design.population)
        inclusion = design.scene.inclusion[0] if design.scene.inclusion else None
        x_range = given.x or _span(positions[:, 0])
        if given.y is not None:
            y_range = given.y
        elif np.ptp(positions[:, 1]) > 0:
            y_range = given.x or _span(positions[:, 1])
        else:
            y_range = Range((inclusion.y if inclusion else float(positions[0, 1]),), log=False)
        places = tuple(_widen(place_range, given.margin) for place_range in (x_range, y_range))
        numbers = (population.ranges[name] for name in ("depth", "diameter", "object"))
        prior = cls((*places, *numbers), given.least_cover, population.middle, given.number_prior, population.poisson_ratio)
        deepest, largest = max(prior.ranges[2].values), max(prior.ranges[3].values)
        if not prior._find_shallowest(np.array(largest)) < deepest * (1 + 1e-12):
            allowed = (
                f"{format_mm(float(prior._find_shallowest(np.array(largest))))} or more, under which the largest tumour fits"
            )
            raise InputError("population.depth", format_mm(deepest), allowed)
        return prior

    @cached_property
    def free(self) -> tuple[int, ...]:
        """Indices in ``TUMOUR_QUANTITIES`` of the quantities that vary."""
        return tuple(index for index, value_range in enumerate(self.ranges) if not value_range.is_single)

    @cached_property
    def strata(self) -> Strata:
        """The layers of the tissue, and the tissue below them."""
        return Strata.from_tissue(self.scene.tissue)

    def transform(self, points: Floats) -> Floats:
        """Return tumours, shape (..., 5), for points of the cube, shape (..., d)."""
        fractions = np.full((*points.shape[:-1], len(self.ranges)), 0.5)
        fractions[..., list(self.free)] = points
        columns = [part.compute_quantiles(fractions[..., index]) for index, part in enumerate(self.ranges)]
        depth_range = self.ranges[2]
        if depth_range.continuous:
            deepest = max(depth_range.values)
            shallowest = np.minimum(np.maximum(self._find_shallowest(columns[3]), depth_range.values[0]), deepest)
            columns[2] = shallowest * (deepest / shallowest) ** fractions[..., 2]
        return np.stack(np.broadcast_arrays(*columns), axis=-1)

    def find_allowed(self, tumours: Floats) -> Bools:
        """Return which sets of tumours, shape (n, m, 5), fit the tissue and do not touch each other, shape (n,)."""
        x, y, depth, diameter, _ = np.moveaxis(tumours, -1, 0)
        radius, tissue = diameter / 2, self.scene.tissue
        fits = depth - self._find_shallowest(diameter) > -1e-9
        for face in tissue.interfaces:
            fits &= np.abs(depth - face) - radius >= MIN_COVER_PER_DIAMETER * diameter
        fits &= radius < np.minimum(compute_side_distance(tissue, x, y), tissue.bottom - depth)
        return np.asarray(fits.all(axis=1) & are_apart(tumours))

    def draw(self, count: int, number: int, seed: int) -> Floats:
        """Return a Sobol sample of the cube for sets of ``number`` tumours, shape (count, number, d); count is a power of two."""
        if not self.free:
            return np.zeros((count, number, 0))
        points = qmc.Sobol(number * len(self.free), seed=seed).random(count)
        return np.clip(points, 1e-9, 1 - 1e-9).reshape(count, number, len(self.free))

    def compute_allowed_fraction(self, number: int) -> float:
        """Return the fraction of sets of tumours in the cube that fit, by which the evidence is divided.

        Raises
        ------
        InputError
            Hardly any fit.
        """
        fraction = float(np.mean(self.find_allowed(self.transform(self.draw(FRACTION_SAMPLES, number, 0)))))
        if fraction < MIN_ALLOWED_FRACTION:
            share = format_percent(fraction)
            if number == 1:
                raise InputError("population", Words(f"{share} of the tumours fit"), "ranges of which more fit the tissue")
            given = Words(f"{number}, of which {share} of the sets that were drawn fit beside one another")
            allowed = f"at most {number - 1}, or places over a wider range: [population] y or margin"
            raise InputError("population.tumours", given, allowed)
        return fraction

    def compute_contrast(self, tumours: Floats) -> Floats:
        """Return ln contrast of tumours (..., 5): of Young's modulus to that of the layer that holds each, shape (...)."""
        moduli = np.array([material.youngs_modulus for material in self.strata.materials])
        return np.asarray(np.log(tumours[..., 4] / moduli[self.strata.find_layer(tumours[..., 2])]))

    def describe(self) -> dict[str, Any]:
        """Return the lower and upper end of each quantity's range, SI units."""
        return {name: [min(part.values), max(part.values)] for name, part in zip(TUMOUR_QUANTITIES, self.ranges, strict=True)}

    def _find_shallowest(self, diameter: Floats) -> Floats:
        """Return the smallest depth of centres under the least cover, m."""
        return np.asarray(diameter / 2 + np.maximum(self.least_cover, MIN_COVER_PER_DIAMETER * diameter))


def _span(coordinates: Floats) -> Range:
    """Return the range from the smallest to the largest of some coordinates."""
    low, high = float(coordinates.min()), float(coordinates.max())
    return Range((low, high), low < high, log=False)


def _widen(place_range: Range, margin: float) -> Range:
    """Return a range of places widened at both ends; a list of places stays as it is."""
    if not place_range.continuous:
        return place_range
    low, high = place_range.values
    return Range((low - margin, high + margin), True, log=False)
