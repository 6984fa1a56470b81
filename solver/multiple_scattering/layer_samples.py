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

    Attributes
    ----------
    layers
        Numbers of the layers with spheres, rising.
    members
        Indices of each layer's spheres.
    parts
        Samples on each layer's boundary.
    """

    layers: tuple[int, ...]
    members: tuple[tuple[int, ...], ...]
    parts: tuple[ModeSamples, ...]

    @classmethod
    def from_spheres(
        cls, spheres: Sequence[ScatteringSphere], panels: Callable[[int], Panels], rounds: AzimuthalGrid
    ) -> LayerSamples:
        """Build the samples of some spheres; ``panels`` gives the sample points of a layer by its number."""
        layers = tuple(sorted({sphere.layer for sphere in spheres}))
        members = tuple(tuple(k for k, sphere in enumerate(spheres) if sphere.layer == layer) for layer in layers)
        parts = (
            ModeSamples([spheres[k].source for k in numbers], panels(layer), rounds, spheres[numbers[0]].two_mu)
            for layer, numbers in zip(layers, members, strict=True)
        )
        return cls(layers, members, tuple(parts))

    def check_memory_limit(self) -> None:
        """Raise ``LimitReached`` if the spheres' fields would exceed the memory limit."""
        for part in self.parts:
            part.check_memory_limit()

    def compute_amplitudes(self, scattered: Sequence[Floats]) -> Floats:
        """Compute the amplitudes at the n points of all layers; see ``ModeSamples.compute_amplitudes``."""
        amplitudes = [
            part.compute_amplitudes([scattered[k] for k in numbers])
            for part, numbers in zip(self.parts, self.members, strict=True)
        ]
        return amplitudes[0] if len(amplitudes) == 1 else np.concatenate(amplitudes, axis=1)

    def compute_work(self, weights: Floats) -> list[Floats]:
        """Apply the transpose of ``compute_amplitudes``; see ``ModeSamples.works``."""
        works: list[Floats] = [np.zeros(0)] * sum(len(numbers) for numbers in self.members)
        ends = np.cumsum([0, *(6 * len(part.panels.r) for part in self.parts)]).tolist()
        for part, numbers, (low, high) in zip(self.parts, self.members, pairwise(ends), strict=True):
            for k, work in zip(numbers, part.works(weights[:, low:high]), strict=True):
                works[k] = work
        return works
