"""Scattered fields on the boundary: amplitudes of every azimuthal order of tractions and displacements there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

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
        parts = self._parts
        found = [np.zeros(1)] * len(parts)
        for source, sampler, c in zip(self.sources, self._samplers, scattered, strict=True):
            pascal = self.two_mu / source.radius
            found[0] = found[0] + sampler.upward(c, parts[0]) * pascal
            found[1] = found[1] + sampler.both(c, parts[1])[1] * pascal
            found[2], found[3] = (found[k] + sampler.displacement(c, parts[k]) for k in (2, 3))
        found[1] = self._outward(found[1])
        first, second, third, fourth = (self._turned(one, edges) for one, edges in zip(found, self._edges, strict=True))
        return first, second, third, fourth

    def _outward(self, stress: Floats) -> Floats:
        """Traction on the side, (n, 3, k), from stresses xx .. xy, (n, 6, k)."""
        tensor, side = stress[:, STRESS], self.boundary.side
        angles = np.broadcast_to(self.rounds.angles, (*side.r.shape, self.rounds.count)).reshape(-1, 1, 1)
        return np.asarray(np.cos(angles) * tensor[:, 0] + np.sin(angles) * tensor[:, 1])

    def _turned(self, values: Floats, edges: Edges) -> Floats:
        """Cartesian values (n, 3, k) at the points of some edges as components along r, theta and z."""
        cos, sin = np.cos(self.rounds.angles)[:, None], np.sin(self.rounds.angles)[:, None]
        x, y, z = np.moveaxis(values.reshape(*edges.r.shape, self.rounds.count, 3, -1), -2, 0)
        return np.stack([cos * x + sin * y, cos * y - sin * x, z], axis=-2)

    @property
    def _edges(self) -> tuple[Edges, Edges, Edges, Edges]:
        b = self.boundary
        return b.surface, b.side, b.ends, b.floor

    @cached_property
    def _parts(self) -> tuple[slice, ...]:
        """Where the points of each of ``_edges`` stand among all."""
        ends = np.cumsum([0, *(edges.r.size * self.rounds.count for edges in self._edges)]).tolist()
        return tuple(slice(*pair) for pair in pairwise(ends))

    @cached_property
    def _samplers(self) -> list[Sampler]:
        points = np.concatenate([self._points(some) for some in self._edges])
        return [Sampler(one.modes, (points - one.centre) / one.radius, "outgoing") for one in self.sources]

    def _points(self, edges: Edges) -> Floats:
        cos, sin = np.cos(self.rounds.angles), np.sin(self.rounds.angles)
        r, z = edges.r[..., None], edges.z[..., None]
        return np.stack(np.broadcast_arrays(r * cos, r * sin, z), axis=-1).reshape(-1, 3)
