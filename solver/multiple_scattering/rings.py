"""Place the points on top, side and bottom of a tissue layer at which scattered fields are sampled, and angles about the axis.

Scattered fields are smooth there, unlike the response, whose mesh is fine at the blocks' corners. Polynomials on panels that are
graded from the axis outwards represent them with far fewer points than the edges of elements have.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import pairwise

import numpy as np

from geometry.common.arrays import Floats
from geometry.meridian.section import Section
from solver.inclusions.vector_modes import ALL_COMPONENTS
from solver.multiple_scattering.spheres import ScatteringSphere

MIN_PANEL_RELATIVE = 1.4  # minimum panel in outer radii, times the order of the elements
PANEL_GROWTH = 0.4  # of panels, per distance from the axis
MIN_SIDE_PANEL_RELATIVE, MIN_FLOOR_PANEL_RELATIVE = 0.4, 0.3  # minimum panels on side and bottom, per radius and depth
EXTRA_POINTS = 4  # points of a panel beyond the order of the elements
STRESS_COMPONENTS = (
    (3, 8, 7),
    (8, 4, 6),
    (7, 6, 5),
)  # components of ``solver.inclusions.vector_modes.build_stack`` that are stresses xx .. zz
PLANE_COMPONENTS = (7, 6, 5, 0, 1, 2)  # sampled on planes normal to z: xz, yz, zz and displacements
SIDE_COMPONENTS = (3, 8, 4, 7, 6, 0, 1, 2)  # sampled on the side: xx, xy, yy, xz, yz and displacements


@dataclass(frozen=True)
class PanelLine:
    """Gauss points of panels along a line.

    Attributes
    ----------
    ends
        Ends of the panels, rising, m, shape (n + 1,).
    points
        Number of points of each panel.
    """

    ends: Floats
    points: int

    @classmethod
    def from_length(cls, length: float, step: float, points: int) -> PanelLine:
        """Build panels of at least ``step`` that grow with the distance from 0, up to ``length``, m."""
        ends = [0.0]
        while ends[-1] < length:
            ends.append(ends[-1] + max(step, PANEL_GROWTH * ends[-1]))
        return cls(np.array(ends) * length / ends[-1], points)

    @cached_property
    def places(self) -> Floats:
        """Positions of all points along the line, m."""
        middle, half = (self.ends[1:] + self.ends[:-1]) / 2, np.diff(self.ends) / 2
        return (middle[:, None] + half[:, None] * self._nodes).ravel()

    def build_interpolation(self, places: Floats) -> Floats:
        """Return the matrix that interpolates from values at the points to other places along the line, shape (*places, points).

        In each panel it is the Lagrange polynomial through the panel's points.
        """
        panel = np.clip(np.searchsorted(self.ends, places, side="right") - 1, 0, len(self.ends) - 2)
        low, high = self.ends[panel], self.ends[panel + 1]
        x, nodes = (2 * places - low - high) / (high - low), self._nodes
        weights = np.zeros((*places.shape, len(self.ends) - 1, self.points))
        for k, node in enumerate(nodes):
            other_nodes = np.delete(nodes, k)
            values = np.prod((x[..., None] - other_nodes) / (node - other_nodes), axis=-1)
            np.put_along_axis(weights[..., k], panel[..., None], values[..., None], axis=-1)
        return weights.reshape(*places.shape, len(self.places))

    @cached_property
    def _nodes(self) -> Floats:
        """Gauss points on the interval from -1 to 1."""
        return np.asarray(np.polynomial.legendre.leggauss(self.points)[0])


@dataclass(frozen=True)
class Panels:
    """Points on a layer's boundary, in the order top (of the uppermost layer the surface), side, bottom: n of them.

    Attributes
    ----------
    surface, floor
        Along r on top and bottom.
    side
        Along the depth below the top.
    section
        Section of the tissue.
    top, bottom
        Depths of the layer's faces, m.
    """

    surface: PanelLine
    side: PanelLine
    floor: PanelLine
    section: Section
    top: float
    bottom: float

    @classmethod
    def from_section(cls, section: Section, order: int, layer: int = 0) -> Panels:
        """Build panels for elements of an order on a layer by its number; the tissue below all layers has the last number."""
        top, bottom = [0.0, *section.interfaces, section.tissue_depth][layer : layer + 2]
        step, points = MIN_PANEL_RELATIVE / order * section.tube_radius, order + EXTRA_POINTS
        floor_step = max(step, MIN_FLOOR_PANEL_RELATIVE * section.tissue_depth) if layer == len(section.interfaces) else step
        steps = step, max(step, MIN_SIDE_PANEL_RELATIVE * section.tissue_radius), floor_step
        lengths = section.tissue_radius, bottom - top, section.tissue_radius
        surface, side, floor = (
            PanelLine.from_length(length, panel_step, points) for length, panel_step in zip(lengths, steps, strict=True)
        )
        return cls(surface, side, floor, section, top, bottom)

    @cached_property
    def parts(self) -> tuple[slice, slice, slice]:
        """Slices of surface, side and bottom among the n points."""
        a, b, c = (len(line.places) for line in (self.surface, self.side, self.floor))
        return slice(0, a), slice(a, a + b), slice(a + b, a + b + c)

    @cached_property
    def r(self) -> Floats:
        """Radii of the points, m, shape (n,)."""
        at_side = np.full_like(self.side.places, self.section.tissue_radius)
        return np.concatenate([self.surface.places, at_side, self.floor.places])

    @cached_property
    def z(self) -> Floats:
        """Heights of the points, m, shape (n,)."""
        at_top, at_floor = np.full_like(self.surface.places, -self.top), np.full_like(self.floor.places, -self.bottom)
        return np.concatenate([at_top, -(self.top + self.side.places), at_floor])


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
        """Number of azimuthal orders that the angles resolve: a wave needs two angles round the axis, one in half a turn."""
        return max(1, self.count - 1 if self.mirrored else self.count // 2)

    @property
    def families(self) -> int:
        """Number of wave families: one if fields are mirror-symmetric, else two."""
        return 1 if self.mirrored else 2

    @property
    def angles(self) -> Floats:
        """Angles, rad, shape (count,)."""
        return (np.arange(self.count) + 0.5) * (np.pi if self.mirrored else 2 * np.pi) / self.count

    def repeat_points(self, r: Floats, z: Floats) -> Floats:
        """Return points of a meridian, (n,) each, at all angles, angle by angle, m, shape (count n, 3)."""
        angles = self.angles[:, None]
        return np.stack([r * np.cos(angles), r * np.sin(angles), z + 0 * angles], axis=-1).reshape(-1, 3)

    @property
    def waves(self) -> Floats:
        """Matrix from values at the angles to amplitudes of waves, (3, orders families, count), for components r, theta and z.

        Waves are (cos, sin, cos) of m theta and, unless mirrored, (sin, -cos, sin).
        """
        return _compute_waves(self)


@lru_cache(maxsize=64)
def _compute_waves(rounds: AzimuthalGrid) -> Floats:
    """Compute ``AzimuthalGrid.waves``; grids of equal values share them."""
    m = np.arange(rounds.orders)
    factor = np.where(m == 0, 1, 2)[:, None] / rounds.count
    cos, sin = factor * np.cos(np.outer(m, rounds.angles)), factor * np.sin(np.outer(m, rounds.angles))
    families = np.array([[cos, sin, cos], [sin, -cos, sin]][: rounds.families])
    return np.ascontiguousarray(families.transpose(1, 2, 0, 3)).reshape(3, -1, rounds.count)


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
        return self.rounds.repeat_points(panels.r[self.part], panels.z[self.part])


def build_rings(panels: Panels, spheres: Sequence[ScatteringSphere], rounds: AzimuthalGrid) -> list[Rings]:
    """Build the rings of surface, side and bottom; for a single angle, one ring with all points.

    Parameters
    ----------
    panels
        The points of the meridian.
    spheres
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
        needed = np.max([_count_angles(sphere, panels.r[part], panels.z[part]) for sphere in spheres], axis=0)
        for run in _split_runs(needed):
            count = min(rounds.count, int(np.ceil(needed[run].max())) * (1 if rounds.mirrored else 2))
            grid = AzimuthalGrid(count, rounds.mirrored)
            matrices = ((slice(None), build_turn_matrices(grid)[number][..., components]),)
            points = slice(part.start + run.start, part.start + run.stop)
            result.append(Rings(points, grid, components, number != 1, matrices))
    return result


def _count_angles(sphere: ScatteringSphere, r: Floats, z: Floats) -> Floats:
    """Return the number of angles in a half plane that resolve a sphere's field on rings.

    A field from a ring of radius d (``offset``) decays on another ring, of radius r and at a distance s (``distance``), as
    exp(-m x) with order m, where sinh(x / 2) = s / (2 sqrt(r d)); 3 / x orders are resolved, plus six. A sphere's outgoing modes
    vary as sharply as the field of a source 0.8 radii from its centre, so that s is counted from there.
    """
    offset = float(np.hypot(*sphere.centre[:2]))
    distance = np.hypot(r - offset, z - sphere.centre[2]) - 0.8 * sphere.radius
    return np.asarray(3 / (2 * np.arcsinh(distance / (2 * np.sqrt(np.maximum(r * offset, 1e-12 * sphere.radius**2))))) + 6)


def _split_runs(needed: Floats) -> list[slice]:
    """Split a line's points into up to three runs: the middle one contains all that need over half of the maximum of angles."""
    dense = np.flatnonzero(needed > needed.max() / 2)
    ends = [0, int(dense[0]), int(dense[-1]) + 1, len(needed)]
    return [slice(low, high) for low, high in pairwise(ends) if high > low]


@lru_cache(maxsize=64)
def build_turn_matrices(rounds: AzimuthalGrid) -> tuple[Floats, Floats, Floats]:
    """Build matrices from components of ``vector_modes.build_stack`` to tractions and displacements along r, theta, z.

    Returns one matrix, (angles, 6, 9), each for surface, side and bottom.
    """
    cos, sin, unit = np.cos(rounds.angles), np.sin(rounds.angles), np.ones(rounds.count)
    rotation, radial, vertical = np.zeros((rounds.count, 3, 3)), np.zeros((rounds.count, 3, 9)), np.zeros((rounds.count, 3, 9))
    rotation[:, 0, 0], rotation[:, 0, 1], rotation[:, 1, 0], rotation[:, 1, 1], rotation[:, 2, 2] = cos, sin, -sin, cos, unit
    for i in range(3):
        for j, direction_cosine in enumerate((cos, sin)):
            radial[:, i, STRESS_COMPONENTS[i][j]] = direction_cosine
        vertical[:, i, STRESS_COMPONENTS[i][2]] = unit
    displacements = np.concatenate([rotation, np.zeros((rounds.count, 3, 6))], axis=2)
    surface, side, floor = (
        np.concatenate([rotation @ tractions, displacements], axis=1) for tractions in (vertical, radial, -vertical)
    )
    return surface, side, floor
