"""Define draws of a population as arrays: spheres, each in its own tissue."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Floats, Ints
from solver.layers.stack import TissueLayer


@dataclass(frozen=True)
class TumourDraws:
    """m spheres, each in its own tissue; SI.

    Attributes
    ----------
    radius, depth, x, y
        Radii and positions of the spheres, m, shape (m,).
    youngs_modulus, poisson_ratio
        Elastic constants of the spheres, shape (m,).
    tissue
        Layers from the surface downwards and the tissue's own material, each thickness (of the last the floor's depth, or None on
        half-spaces), modulus and Poisson's ratio, shape (layers + 1, 3, m).
    bounded
        Whether the tissue has a floor; if not, the last thickness is ignored.
    """

    radius: Floats
    depth: Floats
    x: Floats
    y: Floats
    youngs_modulus: Floats
    poisson_ratio: Floats
    tissue: Floats
    bounded: bool

    @property
    def layers(self) -> Ints:
        """The layer that holds each centre, 0 the first, shape (m,)."""
        faces = np.cumsum(self.tissue[:-1, 0], axis=0)
        return np.asarray((faces <= self.depth).sum(axis=0))

    def select(self, which: Ints) -> TumourDraws:
        """Return some of the draws."""
        return TumourDraws(
            self.radius[which],
            self.depth[which],
            self.x[which],
            self.y[which],
            self.youngs_modulus[which],
            self.poisson_ratio[which],
            self.tissue[:, :, which],
            self.bounded,
        )

    @property
    def hosts(self) -> tuple[Floats, Floats]:
        """Modulus and Poisson's ratio of the tissue around each sphere, shapes (m,)."""
        column = np.arange(len(self.radius))
        return self.tissue[self.layers, 1, column], self.tissue[self.layers, 2, column]

    @property
    def tissues(self) -> tuple[Floats, Ints]:
        """The distinct tissues, shape (layers + 1, 3, u), and the number of each draw's tissue, shape (m,)."""
        flat = self.tissue.reshape(-1, len(self.radius))
        distinct, which = np.unique(flat, axis=1, return_inverse=True)
        return distinct.reshape(*self.tissue.shape[:2], -1), np.asarray(which).reshape(-1)


def build_layers(tissue: Floats, bounded: bool) -> list[TissueLayer]:
    """Build the layers of n tissues given as an array (layers + 1, 3, n)."""
    *upper, (depth, modulus, poisson) = tissue
    thicknesses = sum((layer[0] for layer in upper), start=0 * depth)
    return [TissueLayer(*layer) for layer in upper] + [TissueLayer(depth - thicknesses if bounded else None, modulus, poisson)]
