"""Scattered fields on the boundaries of several layers of the tissue: each sphere's on that of the layer in which it lies."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from geometry.common.arrays import Floats
from solver.multiple_scattering.boundary_samples import ModeSamples
from solver.multiple_scattering.panels import Panels
from solver.multiple_scattering.rings import AzimuthalGrid
from solver.multiple_scattering.spheres import ScatteringSphere


@dataclass(frozen=True)
class LayerSamples:
    """What ``ModeSamples`` is of one material: amplitudes of several layers stand one below the other.

    Attributes:
        layers: numbers of those with spheres, rising.
        members: numbers of each one's spheres.
        parts: their fields on its boundary.
    """

    layers: tuple[int, ...]
    members: tuple[tuple[int, ...], ...]
    parts: tuple[ModeSamples, ...]

    @classmethod
    def of(cls, spheres: Sequence[ScatteringSphere], panels: Callable[[int], Panels], rounds: AzimuthalGrid) -> LayerSamples:
        """Sample the fields of some spheres, with the panels of the layer of a number."""
        layers = tuple(sorted({one.layer for one in spheres}))
        members = tuple(tuple(k for k, one in enumerate(spheres) if one.layer == layer) for layer in layers)
        parts = (
            ModeSamples([spheres[k].source for k in some], panels(layer), rounds, spheres[some[0]].two_mu)
            for layer, some in zip(layers, members, strict=True)
        )
        return cls(layers, members, tuple(parts))

    def check_room(self) -> None:
        """Raise ``LimitReached`` for spheres whose fields would hold more memory than is allowed."""
        for part in self.parts:
            part.check_room()

    def amplitudes(self, scattered: Sequence[Floats]) -> Floats:
        """See ``ModeSamples.amplitudes``; of n points of all layers."""
        some = [part.amplitudes([scattered[k] for k in own]) for part, own in zip(self.parts, self.members, strict=True)]
        return some[0] if len(some) == 1 else np.concatenate(some, axis=1)

    def works(self, weights: Floats) -> list[Floats]:
        """See ``ModeSamples.works``."""
        out: list[Floats] = [np.zeros(0)] * sum(len(own) for own in self.members)
        ends = np.cumsum([0, *(6 * len(part.panels.r) for part in self.parts)]).tolist()
        for part, own, (low, high) in zip(self.parts, self.members, pairwise(ends), strict=True):
            for k, work in zip(own, part.works(weights[:, low:high]), strict=True):
                out[k] = work
        return out
