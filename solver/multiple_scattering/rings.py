"""Choose the angles about the probe's axis at which fields of all orders are sampled on the boundary."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np

from geometry.common.arrays import Floats
from solver.inclusions.vector_modes import ALL_COMPONENTS, Modes
from solver.multiple_scattering.panels import Panels

STRESS_COMPONENTS = (
    (3, 8, 7),
    (8, 4, 6),
    (7, 6, 5),
)  # components of ``solver.inclusions.vector_modes.build_stack`` that are stresses xx .. zz
PLANE_COMPONENTS = (7, 6, 5, 0, 1, 2)  # sampled on planes normal to z: xz, yz, zz and displacements
SIDE_COMPONENTS = (3, 8, 4, 7, 6, 0, 1, 2)  # sampled on the side: xx, xy, yy, xz, yz and displacements


@dataclass(frozen=True)
class AzimuthalGrid:
    """Angles about the probe's axis at which fields are sampled: the half plane's y > 0 where they mirror, or all round.

    Attributes
    ----------
    count
        Number of angles.
    mirrored
        Whether fields are even about y = 0.
    """

    count: int
    mirrored: bool

    @property
    def orders(self) -> int:
        """Number of azimuthal orders that the angles resolve."""
        return max(1, self.count - 1 if self.mirrored else self.count // 2)

    @property
    def families(self) -> int:
        """Number of wave families: one if fields are mirror-symmetric, else two."""
        return 1 if self.mirrored else 2

    @property
    def angles(self) -> Floats:
        """Angles, rad, shape (count,)."""
        return (np.arange(self.count) + 0.5) * (np.pi if self.mirrored else 2 * np.pi) / self.count

    @property
    def waves(self) -> Floats:
        """Matrix from values at the angles to amplitudes: (3, orders families, count), components along r, theta and z.

        Waves are (cos, sin, cos) of m theta and, unless mirrored, (sin, -cos, sin).
        """
        return _compute_waves(self)


@lru_cache(maxsize=64)
def _compute_waves(rounds: AzimuthalGrid) -> Floats:
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
class Rings:
    """Points of the boundary's meridian, repeated at angles about the axis: fewer angles where fields are smooth.

    Attributes
    ----------
    part
        Slice of the panels' points.
    rounds
        The angles.
    components
        Sampled components, of ``solver.inclusions.vector_modes.build_stack``.
    flat
        Whether all points have one z.
    turn_matrices
        Slices of the points with matrices from components to tractions and displacements, (angles, 6, components).
    """

    part: slice
    rounds: AzimuthalGrid
    components: tuple[int, ...]
    flat: bool
    turn_matrices: tuple[tuple[slice, Floats], ...]

    @property
    def count(self) -> int:
        """Number of points at all angles."""
        return self.rounds.count * int(self.part.stop - self.part.start)

    def compute_points(self, panels: Panels) -> Floats:
        """Return the points, angle by angle, m, shape (count, 3)."""
        r, z, angles = panels.r[self.part], panels.z[self.part], self.rounds.angles[:, None]
        return np.stack([r * np.cos(angles), r * np.sin(angles), z + 0 * angles], axis=-1).reshape(-1, 3)


def build_rings(panels: Panels, sources: Sequence[ModeSource], rounds: AzimuthalGrid) -> list[Rings]:
    """Build the rings of surface, side and floor; for a single angle, one ring with all points.

    Parameters
    ----------
    panels
        The points of the meridian.
    sources
        Spheres whose outgoing modes are sampled.
    rounds
        Maximum number of angles.
    """
    parts = panels.parts
    if rounds.count == 1:
        return [
            Rings(
                slice(0, len(panels.r)),
                rounds,
                ALL_COMPONENTS,
                False,
                tuple(zip(parts, build_turn_matrices(rounds), strict=True)),
            )
        ]
    result: list[Rings] = []
    for number, (part, components) in enumerate(zip(parts, (PLANE_COMPONENTS, SIDE_COMPONENTS, PLANE_COMPONENTS), strict=True)):
        needed = np.max([_count_angles(source, panels.r[part], panels.z[part]) for source in sources], axis=0)
        for run in _split_runs(needed):
            count = min(rounds.count, int(np.ceil(needed[run].max())) * (1 if rounds.mirrored else 2))
            grid = AzimuthalGrid(count, rounds.mirrored)
            turned = ((slice(None), build_turn_matrices(grid)[number][..., components]),)
            points = slice(part.start + run.start, part.start + run.stop)
            result.append(Rings(points, grid, components, number != 1, turned))
    return result


def _count_angles(source: ModeSource, r: Floats, z: Floats) -> Floats:
    """Return the number of angles in a half plane that resolve a sphere's field on rings.

    A field from a ring of radius d decays on another ring, of radius r and at a distance s, as exp(-m x) with order m, where
    sinh(x / 2) = s / (2 sqrt(r d)); 3 / x orders are resolved, plus six. A sphere's outgoing modes are as sharp as those of a
    source 0.8 radii from its centre.
    """
    offset = float(np.hypot(*source.centre[:2]))
    distance = np.hypot(r - offset, z - source.centre[2]) - 0.8 * source.radius
    return np.asarray(3 / (2 * np.arcsinh(distance / (2 * np.sqrt(np.maximum(r * offset, 1e-12 * source.radius**2))))) + 6)


def _split_runs(needed: Floats) -> list[slice]:
    """Split the points into those that need more than half of the maximum number of angles, and those before and after."""
    dense = np.flatnonzero(needed > needed.max() / 2)
    ends = [0, int(dense[0]), int(dense[-1]) + 1, len(needed)]
    return [slice(low, high) for low, high in pairwise(ends) if high > low]


@lru_cache(maxsize=64)
def build_turn_matrices(rounds: AzimuthalGrid) -> tuple[Floats, Floats, Floats]:
    """Build matrices from components of ``vector_modes.build_stack`` to tractions and displacements along r, theta, z.

    Returns one matrix, (angles, 6, 9), each for surface, side and floor.
    """
    cos, sin, unit = np.cos(rounds.angles), np.sin(rounds.angles), np.ones(rounds.count)
    turn, radial, vertical = np.zeros((rounds.count, 3, 3)), np.zeros((rounds.count, 3, 9)), np.zeros((rounds.count, 3, 9))
    turn[:, 0, 0], turn[:, 0, 1], turn[:, 1, 0], turn[:, 1, 1], turn[:, 2, 2] = cos, sin, -sin, cos, unit
    for i in range(3):
        for j, share in enumerate((cos, sin)):
            radial[:, i, STRESS_COMPONENTS[i][j]] = share
        vertical[:, i, STRESS_COMPONENTS[i][2]] = unit
    displacements = np.concatenate([turn, np.zeros((rounds.count, 3, 6))], axis=2)
    surface, side, floor = (np.concatenate([turn @ pressed, displacements], axis=1) for pressed in (vertical, radial, -vertical))
    return surface, side, floor
