"""Scattered fields on the boundary: amplitudes of every azimuthal order of tractions and displacements there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from geometry.grading import Floats
from solver.boundary import Boundary, Edges
from solver.multipoles import Modes, Sampler

STRESS = ((0, 5, 4), (5, 1, 3), (4, 3, 2))  # places of xx, yy, zz, yz, xz, xy in the tensor


@dataclass(frozen=True)
class Rounds:
    """Angles about the probe's axis at which fields are sampled: the half plane's y > 0 where they mirror, or all round.

    Attributes:
        count: number of angles.
        mirrored: whether fields are even about y = 0.
    """

    count: int
    mirrored: bool

    @cached_property
    def angles(self) -> Floats:
        """Shape (count,)."""
        return (np.arange(self.count) + 0.5) * (np.pi if self.mirrored else 2 * np.pi) / self.count

    def waves(self, m: int, angles: Floats) -> Floats:
        """Shapes round the axis of U, V and W, for the even and, unless mirrored, the odd family: (families, 3, angles)."""
        cos, sin = np.cos(m * angles), np.sin(m * angles)
        families = [[cos, sin, cos], [sin, -cos, sin]]
        return np.array(families[: 1 if self.mirrored else 2])

    def amplitudes(self, values: Floats, m: int) -> Floats:
        """Amplitudes of order m of values (e, q, count, 3, k) along r, theta and z, shape (e, q, 3, families k)."""
        share = (1 if m == 0 else 2) / self.count
        parts = share * np.einsum("fct,eqtck->eqcfk", self.waves(m, self.angles), values)
        return np.asarray(parts.reshape(*parts.shape[:3], -1))


@dataclass(frozen=True)
class Source:
    """A sphere's centre, m, shape (3,), and radius, m, and the outgoing modes about it."""

    centre: Floats
    radius: float
    modes: Modes


@dataclass(frozen=True)
class Samples:
    """What outgoing modes of some spheres are on the boundary, for many sets of coefficients.

    Attributes:
        sources: the spheres.
        boundary: edges of the mesh.
        rounds: angles at which fields are sampled.
        two_mu: of the tissue, Pa.
    """

    sources: Sequence[Source]
    boundary: Boundary
    rounds: Rounds
    two_mu: float

    def values(self, scattered: Sequence[Floats]) -> tuple[Floats, Floats, Floats, Floats]:
        """Tractions on surface and side, displacements of ends and floor, along r, theta and z, (e, q, angles, 3, k) each.

        Args:
            scattered: outgoing coefficients about each sphere, (modes, k), m.
        """
        b = self.boundary
        surface, side = self._tractions(scattered)
        moves = sum(sampler.displacement(c) for sampler, c in zip(self._moved, scattered, strict=True))
        ends, floor = self._split(np.asarray(moves), b.ends, b.floor)
        return surface, side, ends, floor

    def _tractions(self, scattered: Sequence[Floats]) -> tuple[Floats, Floats]:
        top, side = np.zeros(1), np.zeros(1)
        for source, on_top, beside, c in zip(self.sources, self._on_surface, self._on_side, scattered, strict=True):
            top = top + on_top.upward(c) * (self.two_mu / source.radius)
            side = side + beside.both(c)[1] * (self.two_mu / source.radius)
        tensor = side[:, STRESS]
        along = np.broadcast_to(self.rounds.angles, (*self.boundary.side.r.shape, self.rounds.count)).reshape(-1, 1, 1)
        outward = np.cos(along) * tensor[:, 0] + np.sin(along) * tensor[:, 1]
        return self._split(np.concatenate([top, outward]), self.boundary.surface, self.boundary.side)

    def _split(self, values: Floats, first: Edges, second: Edges) -> tuple[Floats, Floats]:
        """Cartesian values (n, 3, k) at the points of two sets of edges as components along r, theta and z."""
        cut = first.r.size * self.rounds.count
        one, two = (
            self._turned(part.reshape(*edges.r.shape, self.rounds.count, 3, -1))
            for part, edges in ((values[:cut], first), (values[cut:], second))
        )
        return one, two

    def _turned(self, values: Floats) -> Floats:
        cos, sin = np.cos(self.rounds.angles)[:, None], np.sin(self.rounds.angles)[:, None]
        x, y, z = np.moveaxis(values, -2, 0)
        return np.stack([cos * x + sin * y, cos * y - sin * x, z], axis=-2)

    @cached_property
    def _on_surface(self) -> list[Sampler]:
        return self._samplers(self.boundary.surface)

    @cached_property
    def _on_side(self) -> list[Sampler]:
        return self._samplers(self.boundary.side)

    @cached_property
    def _moved(self) -> list[Sampler]:
        return self._samplers(self.boundary.ends, self.boundary.floor)

    def _samplers(self, *edges: Edges) -> list[Sampler]:
        points = np.concatenate([self._points(some) for some in edges])
        return [Sampler(one.modes, (points - one.centre) / one.radius, "outgoing") for one in self.sources]

    def _points(self, edges: Edges) -> Floats:
        cos, sin = np.cos(self.rounds.angles), np.sin(self.rounds.angles)
        r, z = edges.r[..., None], edges.z[..., None]
        return np.stack(np.broadcast_arrays(r * cos, r * sin, z), axis=-1).reshape(-1, 3)
