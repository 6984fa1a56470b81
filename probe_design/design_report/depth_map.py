"""Map detection and resolution of start and optimum over depth and diameter, by the closed form."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Floats
from geometry.scenes.scene import Scene
from probe_design.design_search.population_objective import Resolved
from probe_design.design_search.variables import ProbeSizes, read_vector
from probe_design.populations.design_file import Design
from probe_design.populations.entries import Range
from probe_design.populations.population import MIN_COVER_PER_DIAMETER, PLACE_AXES, ScenePopulation, TumourDraw

GRID_LINES = 20  # depths, and diameters
DETECTION_THRESHOLD = 0.9  # probability at which a tumour counts as detected on the map
RANGE_WIDENING_FACTOR = 1.3  # times the ranges that the map shows


@dataclass(frozen=True)
class DepthMap:
    """Results of a probe for many depths (rows) and diameters (columns), with the population's means for all else.

    Attributes
    ----------
    depth, diameter
        Depths and diameters, m, shapes (k,) and (l,).
    probability
        Upper bound on the probability of detection, shape (k, l): that of a known tumour; NaN where none fits.
    contrast_sd
        Standard deviation of ln contrast, shape (k, l); NaN where none fits.
    """

    depth: Floats
    diameter: Floats
    probability: Floats
    contrast_sd: Floats

    def find_deepest(self, diameter: float) -> float | None:
        """Return the largest depth at which tumours are detected with ``DETECTION_THRESHOLD``, m; None if there is none.

        The tumours have the diameter of the map that is nearest to the given one, m.
        """
        column = self.probability[:, np.abs(self.diameter - diameter).argmin()]
        detected = self.depth[np.nan_to_num(column) >= DETECTION_THRESHOLD]
        return float(detected.max()) if len(detected) else None


def compute_depth_map(design: Design, scene: Scene, force: float) -> DepthMap:
    """Return the map of a scene's probe under a force, N, for the population, protocol and noise of a design file."""
    population = ScenePopulation.from_scene(design.scene, design.population)
    depth, diameter = (_build_axis(population.ranges[key]) for key in ("depth", "diameter"))
    z, d = (grid.ravel() for grid in np.meshgrid(depth, diameter, indexing="ij"))
    # z and d: depth and diameter at every point of the grid, shape (k l,)
    fits = z - d / 2 >= np.maximum(population.least_cover, MIN_COVER_PER_DIAMETER * d) * (1 - 1e-9)
    for interface in design.scene.tissue.interfaces:
        fits &= np.abs(z - interface) >= d / 2
    probability, contrast_sd = np.full(len(z), np.nan), np.full(len(z), np.nan)
    if fits.any():
        draw, sizes = _build_draw(population, z[fits], d[fits]), ProbeSizes.from_vector(read_vector(scene)[:, None])
        probes = sizes.build_parameters((scene.probe.inner.poisson_ratio, scene.probe.outer.poisson_ratio))
        objective = Resolved.from_draw(design, population, draw, scene.probe.tube_radius)

        def compute_force(totals: Floats) -> Floats:
            """Return the same force for every probe and tumour, shape (n, m)."""
            return np.full(totals.shape[:2], force)

        with np.errstate(all="ignore"):
            probability[fits] = objective.compute_detection(probes, compute_force)[0]
            contrast_sd[fits] = np.exp(objective.compute_log_sd(probes, compute_force)[0])
    shape = len(depth), len(diameter)
    return DepthMap(depth, diameter, probability.reshape(shape), contrast_sd.reshape(shape))


def _build_axis(given: Range) -> Floats:
    """Return the values of one axis of the map, evenly spaced in the logarithm, somewhat beyond the population's range."""
    return np.geomspace(min(given.values) / RANGE_WIDENING_FACTOR, max(given.values) * RANGE_WIDENING_FACTOR, GRID_LINES)


def _build_draw(population: ScenePopulation, depth: Floats, diameter: Floats) -> TumourDraw:
    """Return tumours of these depths and diameters, with the population's means for all else."""
    n, ranges, scene = len(depth), population.ranges, population.middle
    poisson_ratio = population.scene.inclusion[0].poisson_ratio if population.scene.inclusion else scene.tissue.poisson_ratio
    modulus, x, y = (np.full(n, ranges[key].middle) for key in ("object", *PLACE_AXES))
    return TumourDraw(population.scene, depth, diameter, modulus, x, y, poisson_ratio, np.zeros(n, dtype=int), (scene,))
