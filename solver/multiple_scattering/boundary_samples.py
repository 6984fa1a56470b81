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
from solver.multiple_scattering.panels import Panels
from solver.multiple_scattering.rings import AzimuthalGrid, ModeSource, Rings, build_rings


@dataclass(frozen=True)
class ModeSamples:
    """Samples of the outgoing modes of some spheres on the boundary.

    Attributes
    ----------
    sources
        The spheres.
    panels
        n points on the boundary's meridian.
    rounds
        Angles at which fields are sampled at most.
    two_mu
        2 mu of the tissue, with its shear modulus mu, Pa.
    """

    sources: Sequence[ModeSource]
    panels: Panels
    rounds: AzimuthalGrid
    two_mu: float

    def check_memory_limit(self) -> None:
        """Raise ``LimitReached`` if the spheres' fields on the boundary would exceed the memory limit."""
        points = sum(item.count for item in self._rings)
        kept = sum(count_cached_bytes(item.modes.harmonics, points) for item in self.sources)
        check_memory(f"reflections of {len(self.sources)} tumours (fewer take less)", kept)

    def compute_amplitudes(self, scattered: Sequence[Floats]) -> Floats:
        """Compute amplitudes of tractions (outward normal) and displacements, shape (orders, 6 n, families k).

        Parameters
        ----------
        scattered
            Outgoing coefficients about each sphere, (modes, k), m.
        """
        k, orders = scattered[0].shape[1], self.rounds.orders
        amplitudes = np.zeros((orders, 6, len(self.panels.r), self.rounds.families, k))
        sums = [
            {key: group.sums(c) for key, group in sphere_parts.items()}
            for sphere_parts, c in zip(self._stacks, scattered, strict=True)
        ]
        for number, group in enumerate(self._rings):
            total = np.asarray(
                sum(
                    self._sample_values(number, source, sphere_parts[group.components])
                    for source, sphere_parts in enumerate(sums)
                )
            )
            fields = group.rounds.waves[None] @ total.transpose(1, 0, 2, 3).reshape(2, 3, group.rounds.count, -1)
            fields = fields.reshape(6, group.rounds.orders, group.rounds.families, k, -1)
            amplitudes[: group.rounds.orders, :, group.part] = fields.transpose(1, 0, 4, 2, 3)
        return amplitudes.reshape(orders, 6 * len(self.panels.r), -1)

    def works(self, weights: Floats) -> list[Floats]:
        """Apply the transpose of ``compute_amplitudes``: products of every outgoing mode of each sphere with weights, (modes, k).

        Parameters
        ----------
        weights
            Weights of the first orders, shape (some orders, 6 n, families k).
        """
        parts = weights.reshape(len(weights), 6, len(self.panels.r), self.rounds.families, -1).transpose(1, 0, 3, 4, 2)
        sums: list[dict[tuple[int, ...], Any]] = [dict.fromkeys(sphere_parts, 0.0) for sphere_parts in self._stacks]
        for number, group in enumerate(self._rings):
            group_weights = np.ascontiguousarray(parts[:, : group.rounds.orders, ..., group.part])
            waves = group.rounds.waves[None, :, : group_weights.shape[1] * group_weights.shape[2]]
            fields = waves.transpose(0, 1, 3, 2) @ group_weights.reshape(2, 3, waves.shape[2], -1)
            values = fields.reshape(6, group.rounds.count, -1, group_weights.shape[-1]).transpose(1, 0, 2, 3)
            for source, sphere_parts in enumerate(sums):
                sphere_parts[group.components] = sphere_parts[group.components] + self._apply_transpose(number, source, values)
        pairs = zip(self._stacks, sums, strict=True)
        return [
            np.sum([stacks[key].adjoint(total) for key, total in sphere_parts.items()], axis=0) for stacks, sphere_parts in pairs
        ]

    def _sample_values(self, number: int, source: int, sums: Floats) -> Floats:
        """Sample one sphere's tractions and displacements along r, theta and z on some rings, shape (angles, 6, k, n)."""
        ring, k = self._rings[number], sums.shape[-1]
        sampled = self._samplers[source][number].evaluate_sums(sums)
        values = np.empty((ring.rounds.count, 6, k, sampled.shape[2] // ring.rounds.count))
        for columns, turn in ring.turn_matrices:
            turned = sampled.reshape(*sampled.shape[:2], ring.rounds.count, -1)[..., columns].transpose(2, 0, 1, 3)
            values[..., columns] = (turn @ turned.reshape(len(turn), len(sampled), -1)).reshape(len(turn), 6, k, -1)
        values[:, :3] *= self.two_mu / self.sources[source].radius
        return values

    def _apply_transpose(self, number: int, source: int, values: Floats) -> Floats:
        """Apply the transpose of ``_sample_values``."""
        ring, (angles, _, k, n) = self._rings[number], values.shape
        scaled = values * np.repeat([self.two_mu / self.sources[source].radius, 1.0], 3)[:, None, None]
        sampler = self._samplers[source][number]
        components = np.empty((sampler.stack.components, k, angles, n))
        for columns, turn in ring.turn_matrices:
            turned = turn.transpose(0, 2, 1) @ scaled[..., columns].reshape(angles, 6, -1)
            components[..., columns] = turned.reshape(angles, len(components), k, -1).transpose(1, 2, 0, 3)
        return sampler.adjoint_of(components.reshape(len(components), k, -1))

    @cached_property
    def _rings(self) -> list[Rings]:
        return build_rings(self.panels, self.sources, self.rounds)

    @cached_property
    def _stacks(self) -> list[dict[tuple[int, ...], Stack]]:
        """Mode sums of each sphere, for all sets of sampled components."""
        sampled = {ring.components for ring in self._rings}
        return [
            {components: build_stack(source.modes, "outgoing", components) for components in sampled} for source in self.sources
        ]

    @cached_property
    def _samplers(self) -> list[list[Sampler]]:
        """Samplers of each sphere on all rings."""
        samplers: list[list[Sampler]] = []
        points = np.concatenate([ring.compute_points(self.panels) for ring in self._rings])
        ends = np.cumsum([0, *(ring.count for ring in self._rings)]).tolist()
        for source, stacks in zip(self.sources, self._stacks, strict=True):
            check_time("reflections")
            table = Table(source.modes.harmonics, "outgoing", (points - source.centre) / source.radius)
            parts = (slice(*pair) for pair in pairwise(ends))
            pairs = zip(self._rings, parts, strict=True)
            samplers.append([Sampler(stacks[ring.components], table, part, ring.flat) for ring, part in pairs])
        return samplers
