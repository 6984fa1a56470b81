"""Scattered fields on the boundary, as amplitudes of every azimuthal order, and what such amplitudes are to the modes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.resources import check_memory, check_time
from solver.inclusions.mode_sums import Sampler, Table, kept_bytes
from solver.inclusions.vector_modes import EVERY, Modes, stack
from solver.multiple_scattering.panels import Panels

STRESS = ((3, 8, 7), (8, 4, 6), (7, 6, 5))  # components of ``solver.inclusions.vector_modes.stack`` that are stresses xx .. zz
PLANE = (7, 6, 5, 0, 1, 2)  # those asked for on planes across z: xz, yz, zz and displacements
ROUND = (3, 8, 4, 7, 6, 0, 1, 2)  # and on the side: xx, xy, yy, xz, yz and displacements
_Piece = tuple[slice, slice, Floats]  # of a sampler: its points, the panels', what turns components to data


@dataclass(frozen=True)
class AzimuthalGrid:
    """Angles about the probe's axis at which fields are sampled: the half plane's y > 0 where they mirror, or all round.

    Attributes:
        count: number of angles.
        mirrored: whether fields are even about y = 0.
    """

    count: int
    mirrored: bool

    @property
    def orders(self) -> int:
        """Number of azimuthal orders that the angles tell apart."""
        return max(1, self.count - 1)

    @property
    def angles(self) -> Floats:
        """Shape (count,)."""
        return (np.arange(self.count) + 0.5) * (np.pi if self.mirrored else 2 * np.pi) / self.count

    @property
    def waves(self) -> Floats:
        """What makes amplitudes of values at the angles: (3, orders families, count), components along r, theta and z.

        Waves are (cos, sin, cos) of m theta and, unless mirrored, (sin, -cos, sin).
        """
        return _waves(self)


@lru_cache(maxsize=64)
def _waves(rounds: AzimuthalGrid) -> Floats:
    m = np.arange(rounds.orders)
    share = np.where(m == 0, 1, 2)[:, None] / rounds.count
    cos, sin = share * np.cos(np.outer(m, rounds.angles)), share * np.sin(np.outer(m, rounds.angles))
    families = np.array([[cos, sin, cos], [sin, -cos, sin]][: 1 if rounds.mirrored else 2])
    return np.ascontiguousarray(families.transpose(1, 2, 0, 3)).reshape(3, -1, rounds.count)


@dataclass(frozen=True)
class ModeSource:
    """A sphere's centre, m, shape (3,), and radius, m, and the outgoing modes about it."""

    centre: Floats
    radius: float
    modes: Modes


@dataclass(frozen=True)
class ModeSamples:
    """Outgoing modes of some spheres on the boundary.

    Attributes:
        sources: the spheres.
        panels: n points on the boundary's meridian.
        rounds: angles at which fields are sampled.
        two_mu: of the tissue, Pa.
    """

    sources: Sequence[ModeSource]
    panels: Panels
    rounds: AzimuthalGrid
    two_mu: float

    def check_room(self) -> None:
        """Raise ``LimitReached`` for spheres whose fields on the boundary would hold more memory than is allowed."""
        points = self.rounds.count * len(self.panels.r)
        kept = sum(kept_bytes(one.modes.harmonics, points) for one in self.sources)
        check_memory(f"reflections of {len(self.sources)} tumours (fewer take less)", kept)

    def amplitudes(self, scattered: Sequence[Floats]) -> Floats:
        """Amplitudes of tractions by the outward normal and displacements, shape (orders, 6 n, families k).

        Args:
            scattered: outgoing coefficients about each sphere, (modes, k), m.
        """
        total = sum(self._values(number, c) for number, c in enumerate(scattered))
        fields = self.rounds.waves[None] @ np.asarray(total).transpose(1, 0, 2, 3).reshape(2, 3, self.rounds.count, -1)
        n, orders = len(self.panels.r), self.rounds.orders
        fields = fields.reshape(6, orders, -1, scattered[0].shape[1], n)
        return np.ascontiguousarray(fields.transpose(1, 0, 4, 2, 3)).reshape(orders, 6 * n, -1)

    def works(self, weights: Floats) -> list[Floats]:
        """The transpose of ``amplitudes``: products of each sphere's every outgoing mode with weights, (modes, k).

        Args:
            weights: of the first orders, shape (some orders, 6 n, families k).
        """
        some, n, families = len(weights), len(self.panels.r), 1 if self.rounds.mirrored else 2
        parts = weights.reshape(some, 6, n, families, -1).transpose(1, 0, 3, 4, 2)
        flat = np.ascontiguousarray(parts).reshape(2, 3, some * families, -1)
        fields = self.rounds.waves[None, :, : some * families].transpose(0, 1, 3, 2) @ flat
        values = fields.reshape(6, self.rounds.count, -1, n).transpose(1, 0, 2, 3)
        return [self._work(number, values) for number in range(len(self.sources))]

    def _values(self, number: int, coefficients: Floats) -> Floats:
        """Tractions and displacements along r, theta and z of one sphere, shape (angles, 6, k, n)."""
        angles, k, n = self.rounds.count, coefficients.shape[1], len(self.panels.r)
        out = np.empty((angles, 6, k, n))
        for sampler, pieces in self._samplers[number]:
            sampled = sampler.values(coefficients)
            for columns, part, turn in pieces:
                turned = sampled[..., columns].reshape(len(sampled), k, angles, -1).transpose(2, 0, 1, 3)
                out[..., part] = (turn @ turned.reshape(angles, len(sampled), -1)).reshape(angles, 6, k, -1)
        out[:, :3] *= self.two_mu / self.sources[number].radius
        return out

    def _work(self, number: int, values: Floats) -> Floats:
        """The transpose of ``_values``, (modes, k)."""
        angles, _, k, _ = values.shape
        scaled = values * np.repeat([self.two_mu / self.sources[number].radius, 1.0], 3)[:, None, None]
        total = np.zeros((len(self.sources[number].modes), k))
        for sampler, pieces in self._samplers[number]:
            components = np.empty((sampler.stack.components, k, sampler.count))
            for columns, part, turn in pieces:
                turned = turn.transpose(0, 2, 1) @ scaled[..., part].reshape(angles, 6, -1)
                components[..., columns] = (
                    turned.reshape(angles, len(components), k, -1).transpose(1, 2, 0, 3).reshape(len(components), k, -1)
                )
            total += sampler.adjoint(components)
        return total

    @cached_property
    def _samplers(self) -> list[list[tuple[Sampler, list[_Piece]]]]:
        """For each sphere those of surface, side and floor, or for a single angle, where there is little to save, one of all."""
        points, kinds = _points(self.panels, self.rounds), [(PLANE, True), (ROUND, False), (PLANE, True)]
        pieces = list(zip(self.panels.parts, turns(self.rounds), strict=True))
        groups = [(*kind, [piece]) for kind, piece in zip(kinds, pieces, strict=True)]
        if self.rounds.count == 1:
            groups = [(EVERY, False, pieces)]
        samplers: list[list[tuple[Sampler, list[_Piece]]]] = []
        for one in self.sources:
            check_time("reflections")
            table = Table(one.modes.harmonics, "outgoing", (points - one.centre) / one.radius)
            samplers.append([self._sampler(one.modes, table, *group) for group in groups])
        return samplers

    def _sampler(
        self, modes: Modes, table: Table, components: tuple[int, ...], flat: bool, pieces: Sequence[tuple[slice, Floats]]
    ) -> tuple[Sampler, list[_Piece]]:
        """One for some parts of the boundary that follow each other."""
        angles, low, high = self.rounds.count, pieces[0][0].start, pieces[-1][0].stop
        sampler = Sampler(stack(modes, "outgoing", components), table, slice(low * angles, high * angles), flat)
        columns = [slice((part.start - low) * angles, (part.stop - low) * angles) for part, _ in pieces]
        return sampler, [(at, part, turn[..., components]) for at, (part, turn) in zip(columns, pieces, strict=True)]


@lru_cache(maxsize=64)
def turns(rounds: AzimuthalGrid) -> tuple[Floats, Floats, Floats]:
    """From the components of ``vector_modes.stack`` to tractions and displacements along r, theta, z: (angles, 6, 9).

    On surface, side and floor.
    """
    cos, sin, one = np.cos(rounds.angles), np.sin(rounds.angles), np.ones(rounds.count)
    turn, across, up = np.zeros((rounds.count, 3, 3)), np.zeros((rounds.count, 3, 9)), np.zeros((rounds.count, 3, 9))
    turn[:, 0, 0], turn[:, 0, 1], turn[:, 1, 0], turn[:, 1, 1], turn[:, 2, 2] = cos, sin, -sin, cos, one
    for i in range(3):
        for j, share in enumerate((cos, sin)):
            across[:, i, STRESS[i][j]] = share
        up[:, i, STRESS[i][2]] = one
    moved = np.concatenate([turn, np.zeros((rounds.count, 3, 6))], axis=2)
    surface, side, floor = (np.concatenate([turn @ pressed, moved], axis=1) for pressed in (up, across, -up))
    return surface, side, floor


def _points(panels: Panels, rounds: AzimuthalGrid) -> Floats:
    """The parts of the boundary one after the other, each angle by angle, shape (angles n, 3)."""
    cos, sin = np.cos(rounds.angles)[:, None], np.sin(rounds.angles)[:, None]
    parts = [(panels.r[part], panels.z[part]) for part in panels.parts]
    return np.concatenate([np.stack([r * cos, r * sin, z + 0 * cos], axis=-1).reshape(-1, 3) for r, z in parts])
