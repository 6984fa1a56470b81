"""Sample scattered fields on the boundaries of several layers: each sphere's field on the boundary of its own layer."""

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
    """Samples of fields in several layers, one ``ModeSamples`` per layer; their amplitudes are stacked.

    Attributes:
        layers: numbers of the layers with spheres, rising.
        members: indices of each layer's spheres.
        parts: samples on each layer's boundary.
    """

    layers: tuple[int, ...]
    members: tuple[tuple[int, ...], ...]
    parts: tuple[ModeSamples, ...]

    @classmethod
    def of(cls, spheres: Sequence[ScatteringSphere], panels: Callable[[int], Panels], rounds: AzimuthalGrid) -> LayerSamples:
        """Build the samples of some spheres; ``panels`` gives the sample points of a layer by its number."""
        layers = tuple(sorted({one.layer for one in spheres}))
        members = tuple(tuple(k for k, one in enumerate(spheres) if one.layer == layer) for layer in layers)
        parts = (
            ModeSamples([spheres[k].source for k in some], panels(layer), rounds, spheres[some[0]].two_mu)
            for layer, some in zip(layers, members, strict=True)
        )
        return cls(layers, members, tuple(parts))

    def check_room(self) -> None:
        """Raise ``LimitReached`` if the spheres' fields would exceed the memory limit."""
        for part in self.parts:
            part.check_room()

    def amplitudes(self, scattered: Sequence[Floats]) -> Floats:
        """Compute the amplitudes at the n points of all layers; see ``ModeSamples.compute_amplitudes``."""
        some = [part.amplitudes([scattered[k] for k in own]) for part, own in zip(self.parts, self.members, strict=True)]
        return some[0] if len(some) == 1 else np.concatenate(some, axis=1)

    def works(self, weights: Floats) -> list[Floats]:
        """Apply the transpose of ``compute_amplitudes``; see ``ModeSamples.works``."""
        out: list[Floats] = [np.zeros(0)] * sum(len(own) for own in self.members)
        ends = np.cumsum([0, *(6 * len(part.panels.r) for part in self.parts)]).tolist()
        for part, own, (low, high) in zip(self.parts, self.members, pairwise(ends), strict=True):
            for k, work in zip(own, part.works(weights[:, low:high]), strict=True):
                out[k] = work
        return out
