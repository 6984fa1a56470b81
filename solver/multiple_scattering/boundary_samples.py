"""Sample scattered fields on the boundary as amplitudes of every azimuthal order, and the transpose of this map."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.resources import check_memory, check_time
from solver.inclusions.mode_sums import Sampler, Stack, Table, count_cached_bytes
from solver.inclusions.vector_modes import build_stack
from solver.multiple_scattering.rings import AzimuthalGrid, Panels, Rings, build_rings
from solver.multiple_scattering.spheres import ScatteringSphere


@dataclass(frozen=True)
class ModeSamples:
    """Samples of the outgoing modes of some spheres on the boundary of the layer in which they lie.

    Attributes
    ----------
    spheres
        Spheres in one layer of the tissue.
    panels
        n points on the boundary's meridian.
    rounds
        Angles at which fields are sampled at most.
    """

    spheres: Sequence[ScatteringSphere]
    panels: Panels
    rounds: AzimuthalGrid

    def check_memory_limit(self) -> None:
        """Raise ``LimitReached`` if the spheres' fields on the boundary would exceed the memory limit."""
        points = sum(item.count for item in self._rings)
        cached_bytes = sum(count_cached_bytes(sphere.modes.harmonics, points) for sphere in self.spheres)
        check_memory(f"reflections of {len(self.spheres)} tumours (fewer take less)", cached_bytes)

    def compute_amplitudes(self, scattered: Sequence[Floats]) -> Floats:
        """Compute the amplitudes of all azimuthal orders of tractions (outward normal) and displacements on the boundary.

        Their shape is (orders, 6 n, families k): three tractions and three displacements at n points, for each family of waves.

        Parameters
        ----------
        scattered
            Outgoing coefficients about each sphere, (modes, k), m.
        """
        k, orders = scattered[0].shape[1], self.rounds.orders
        amplitudes = np.zeros((orders, 6, len(self.panels.r), self.rounds.families, k))
        sums = [
            {components: stack.compute_sums(c) for components, stack in stacks.items()}
            for stacks, c in zip(self._stacks, scattered, strict=True)
        ]
        for number, group in enumerate(self._rings):
            samples = (self._sample_values(number, j, sphere_sums[group.components]) for j, sphere_sums in enumerate(sums))
            total = np.asarray(sum(samples))
            fields = group.rounds.waves[None] @ total.transpose(1, 0, 2, 3).reshape(2, 3, group.rounds.count, -1)
            fields = fields.reshape(6, group.rounds.orders, group.rounds.families, k, -1)
            amplitudes[: group.rounds.orders, :, group.part] = fields.transpose(1, 0, 4, 2, 3)
        return amplitudes.reshape(orders, 6 * len(self.panels.r), -1)

    def compute_works(self, weights: Floats) -> list[Floats]:
        """Apply the transpose of ``compute_amplitudes``: products of each sphere's outgoing modes with weights, (modes, k).

        Parameters
        ----------
        weights
            Weights of the first orders, shape (some orders, 6 n, families k).
        """
        parts = weights.reshape(len(weights), 6, len(self.panels.r), self.rounds.families, -1).transpose(1, 0, 3, 4, 2)
        sums: list[dict[tuple[int, ...], Any]] = [dict.fromkeys(stacks, 0.0) for stacks in self._stacks]
        for number, group in enumerate(self._rings):
            group_weights = np.ascontiguousarray(parts[:, : group.rounds.orders, ..., group.part])
            waves = group.rounds.waves[None, :, : group_weights.shape[1] * group_weights.shape[2]]
            fields = waves.transpose(0, 1, 3, 2) @ group_weights.reshape(2, 3, waves.shape[2], -1)
            values = fields.reshape(6, group.rounds.count, -1, group_weights.shape[-1]).transpose(1, 0, 2, 3)
            for j, sphere_sums in enumerate(sums):
                sphere_sums[group.components] = sphere_sums[group.components] + self._apply_transpose(number, j, values)
        return [
            np.sum([stacks[components].apply_transpose(total) for components, total in sphere_sums.items()], axis=0)
            for stacks, sphere_sums in zip(self._stacks, sums, strict=True)
        ]

    def _sample_values(self, number: int, j: int, sums: Floats) -> Floats:
        """Sample tractions and displacements along r, theta and z of sphere j on rings, shape (angles, 6, k, n).

        ``number`` is that of the rings in ``_rings``; ``sums`` are those of ``Stack.compute_sums``.
        """
        ring, k = self._rings[number], sums.shape[-1]
        sampled = self._samplers[j][number].evaluate_sums(sums)
        values = np.empty((ring.rounds.count, 6, k, sampled.shape[2] // ring.rounds.count))
        for columns, rotation in ring.turn_matrices:
            rotated = sampled.reshape(*sampled.shape[:2], ring.rounds.count, -1)[..., columns].transpose(2, 0, 1, 3)
            values[..., columns] = (rotation @ rotated.reshape(len(rotation), len(sampled), -1)).reshape(len(rotation), 6, k, -1)
        values[:, :3] *= self.spheres[j].two_mu / self.spheres[j].radius  # modes give stress in units of 2 mu / R
        return values

    def _apply_transpose(self, number: int, j: int, values: Floats) -> Floats:
        """Apply the transpose of ``_sample_values`` to values (angles, 6, k, n); return the shape of ``Stack.compute_sums``."""
        ring, (angles, _, k, n) = self._rings[number], values.shape
        scaled = values * np.repeat([self.spheres[j].two_mu / self.spheres[j].radius, 1.0], 3)[:, None, None]
        sampler = self._samplers[j][number]
        components = np.empty((sampler.stack.components, k, angles, n))
        for columns, rotation in ring.turn_matrices:
            rotated = rotation.transpose(0, 2, 1) @ scaled[..., columns].reshape(angles, 6, -1)
            components[..., columns] = rotated.reshape(angles, len(components), k, -1).transpose(1, 2, 0, 3)
        return sampler.apply_transpose(components.reshape(len(components), k, -1))

    @cached_property
    def _rings(self) -> list[Rings]:
        """Rings of the sampled points."""
        return build_rings(self.panels, self.spheres, self.rounds)

    @cached_property
    def _stacks(self) -> list[dict[tuple[int, ...], Stack]]:
        """Mode sums of each sphere, for all sets of sampled components."""
        sampled = {ring.components for ring in self._rings}
        return [
            {components: build_stack(sphere.modes, "outgoing", components) for components in sampled} for sphere in self.spheres
        ]

    @cached_property
    def _samplers(self) -> list[list[Sampler]]:
        """Samplers of each sphere on all rings."""
        samplers: list[list[Sampler]] = []
        points = np.concatenate([ring.compute_points(self.panels) for ring in self._rings])
        ends = np.cumsum([0, *(ring.count for ring in self._rings)]).tolist()
        for sphere, stacks in zip(self.spheres, self._stacks, strict=True):
            check_time("reflections")
            table = Table(sphere.modes.harmonics, "outgoing", (points - sphere.centre) / sphere.radius)
            parts = (slice(*pair) for pair in pairwise(ends))
            pairs = zip(self._rings, parts, strict=True)
            samplers.append([Sampler(stacks[ring.components], table, part, ring.flat) for ring, part in pairs])
        return samplers


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
    def from_spheres(cls, spheres: Sequence[ScatteringSphere], panels: Sequence[Panels], rounds: AzimuthalGrid) -> LayerSamples:
        """Build the samples of some spheres; ``panels`` are the sample points of all layers."""
        layers = tuple(sorted({sphere.layer for sphere in spheres}))
        members = tuple(tuple(k for k, sphere in enumerate(spheres) if sphere.layer == layer) for layer in layers)
        parts = (
            ModeSamples([spheres[k] for k in numbers], panels[layer], rounds)
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
        """Apply the transpose of ``compute_amplitudes``; see ``ModeSamples.compute_works``."""
        works: list[Floats] = [np.zeros(0)] * sum(len(numbers) for numbers in self.members)
        ends = np.cumsum([0, *(6 * len(part.panels.r) for part in self.parts)]).tolist()
        for part, numbers, (low, high) in zip(self.parts, self.members, pairwise(ends), strict=True):
            for k, work in zip(numbers, part.compute_works(weights[:, low:high]), strict=True):
                works[k] = work
        return works
