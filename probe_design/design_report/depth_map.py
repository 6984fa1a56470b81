"""Start beside optimum over depth and diameter: what is found and what is told, by the closed form."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Floats
from geometry.scenes.scene import Scene
from probe_design.design_search.heights import design_of
from probe_design.design_search.steered_population import SteeredDesigns
from probe_design.populations.design_file import Design
from probe_design.populations.population import COVER, ScenePopulation, TumourDraw
from probe_design.populations.ranges import Range
from probe_design.populations.tables import Objective

LINES = 20  # depths, and diameters
SURE = 0.9  # probability at which a tumour counts as surely found
WIDER = 1.3  # times the ranges that the map shows


@dataclass(frozen=True)
class DepthMap:
    """One probe over tumours of many depths (rows) and diameters (columns), all else in the middle of the population.

    Attributes:
        depth, diameter: m, shapes (k,) and (l,).
        probability: that a known tumour is found, an upper bound, shape (k, l); NaN where it does not fit.
        contrast_sd: standard deviation of ln contrast, likewise.
    """

    depth: Floats
    diameter: Floats
    probability: Floats
    contrast_sd: Floats

    def deepest(self, diameter: float) -> float | None:
        """Return the largest depth at which tumours of a diameter are detected with 90 %, m; None if there is none."""
        column = self.probability[:, np.abs(self.diameter - diameter).argmin()]
        found = self.depth[np.nan_to_num(column) >= SURE]
        return float(found.max()) if len(found) else None


def depth_map(design: Design, scene: Scene, force: float) -> DepthMap:
    """Return the map of a scene's probe under a force, N."""
    population = ScenePopulation.of(design.scene, design.population)
    depth, diameter = (_shown(population.ranges[key]) for key in ("depth", "diameter"))
    z, d = (one.ravel() for one in np.meshgrid(depth, diameter, indexing="ij"))
    fits = z - d / 2 >= np.maximum(population.least_cover, COVER * d) * (1 - 1e-9)
    for interface in design.scene.tissue.interfaces:
        fits &= np.abs(z - interface) >= d / 2
    found, told = np.full(len(z), np.nan), np.full(len(z), np.nan)
    shape, probe = (len(depth), len(diameter)), scene.probe
    at = design_of(scene), (probe.inner.poisson_ratio, probe.outer.poisson_ratio), force
    if fits.any():
        draw = _draw(population, z[fits], d[fits])
        found[fits] = _steered(design, population, draw, scene, "detection").each(*at)
        told[fits] = _steered(design, population, draw, scene, "resolved").contrast_sd(*at)
    return DepthMap(depth, diameter, found.reshape(shape), told.reshape(shape))


def _shown(given: Range) -> Floats:
    return np.geomspace(min(given.values) / WIDER, max(given.values) * WIDER, LINES)


def _draw(population: ScenePopulation, depth: Floats, diameter: Floats) -> TumourDraw:
    n, ranges, scene = len(depth), population.ranges, population.middle
    own = population.scene.inclusion[0].poisson_ratio if population.scene.inclusion else scene.tissue.poisson_ratio
    modulus, x = (np.full(n, ranges[key].middle) for key in ("object", "x"))
    return TumourDraw(population.scene, depth, diameter, modulus, x, own, np.zeros(n, dtype=int), (scene,))


def _steered(design: Design, population: ScenePopulation, draw: TumourDraw, scene: Scene, maximise: str) -> SteeredDesigns:
    asked = design.model_copy(update={"objective": Objective(maximise=maximise)})  # type: ignore[arg-type]
    return SteeredDesigns.over(asked, population, draw, scene.probe.tube_radius)
