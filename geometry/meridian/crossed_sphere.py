r"""Place the lines and rays of the box round a sphere that interfaces of the tissue cross.

An interface that meets the sphere steeply, on its side, is one of the rays from the sphere's centre to the box's side; rays
near it are turned about the centre where they meet the sphere, so that it stays level. Near a pole such rays would lie along the
interface. There the sphere's cap and the interfaces are a terrain, above which columns stand upright: each interface begins on
the sphere at one column, so that the rows of cells below it end there in a point. The lowest of them is the box's top

        high  +----+----+----+--------+
              |    |    |    |        |      strips: columns on the cap
              | __-+-_  |    |        |      or on an interface
        top   |/   |  \\-P----+--------+ h     P: where it begins
              |  sphere |\\ w | edge   |      w: cells that end at P
              |         | \\  |        |

and rays from the centre end on it. Below the lower pole it is the same upside down.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from geometry.common.arrays import Ints, Numeric
from geometry.meridian.grading import smooth_min
from geometry.meridian.sphere_box import CORE_REACH

FEW_LAYERS, MANY_LAYERS = 3, 8  # at rings: beside a pole heights there are no more than roundings
MIN_TERRAIN_ANGLE_RAD, MAX_RAY_ANGLE_RAD = (
    np.pi / 6,
    np.pi / 3,
)  # angles above the horizon between which an interface may be a ray or a part of the terrain


def count_terrain_interfaces(angles: Numeric) -> tuple[int, int]:
    """Return how many interfaces are terrain above the upper and below the lower pole, the others are rays.

    Interfaces close to each other are of the same sort: between the two the widest gap is chosen.

    Parameters
    ----------
    angles
        Above the horizon at which interfaces meet the sphere, falling, shape (n,).
    """
    upper = _count_at_pole(angles)
    return upper, _count_at_pole(-angles[upper:][::-1])


def _count_at_pole(angles: Numeric) -> int:
    if (
        not len(angles) or angles[0] < MIN_TERRAIN_ANGLE_RAD
    ):  # upright columns are better than turned rays where there is a choice
        return 0
    ends = np.clip(np.concatenate([angles, [-np.pi / 2]]), MIN_TERRAIN_ANGLE_RAD, MAX_RAY_ANGLE_RAD)
    return 1 + int(np.argmax(np.round(ends[:-1] - ends[1:], 9)))


def spread_apart(wanted: list[int], last: int) -> tuple[int, ...]:
    """Return rising numbers from 1 to ``last`` - 1 near those wanted, two apart at least.

    No cell touches two interfaces' beginnings then. ``last`` is twice their number or more.
    """
    numbers: list[int] = []
    for k, target in enumerate(wanted):
        lower, upper = (numbers[-1] + 2 if numbers else 1), last - 1 - 2 * (len(wanted) - 1 - k)
        numbers.append(min(max(target, lower), upper))
    return tuple(numbers)


@dataclass(frozen=True)
class Cap:
    """Interfaces that are terrain at one pole, from the pole on.

    Attributes
    ----------
    rows
        Numbers of their levels.
    starts
        Numbers of the box's columns at which they begin, among ``CrossedBox.lines``.
    flat
        Whether each meets the sphere so near to the pole that little is cut towards it.
    sign
        1 at the upper pole, -1 at the lower.
    end
        The level of the box's end at this pole.
    """

    rows: tuple[int, ...]
    starts: tuple[int, ...]
    flat: tuple[bool, ...]
    sign: int
    end: int

    @property
    def last(self) -> int:
        """The level at which rays end."""
        return self.rows[-1] if self.rows else self.end


@dataclass(frozen=True)
class CrossedBox:
    """Numbers of lines.

    Attributes
    ----------
    lines
        Of the box's radii.
    sides
        Of the levels of interfaces that are rays, from below.
    caps
        Lower and upper.
    """

    lines: tuple[int, ...]
    sides: tuple[int, ...]
    caps: tuple[Cap, Cap]

    @property
    def rows(self) -> range:
        """Levels from where rays end below to where they end above."""
        low, high = (cap.last for cap in self.caps)
        return range(low, high + 1)

    @property
    def tips(self) -> dict[tuple[int, int], int]:
        """Lines that meet where an interface begins on the sphere near a pole, and how many layers cells there have at most."""
        return {
            (self.lines[start], row): FEW_LAYERS if flat else MANY_LAYERS
            for cap in self.caps
            for row, start, flat in zip(cap.rows, cap.starts, cap.flat, strict=True)
        }

    def flatten(self, levels: Numeric) -> tuple[Numeric, Numeric, float]:
        """Return levels from the box's lower end to its upper, heights to draw them at, and the radius of a sphere that fits."""
        lower, upper = self.caps
        rows, spans = (lower.rows, self.sides, upper.rows[::-1]), ((-0.9, -0.4), (-0.3, 0.3), (0.4, 0.9))
        knots = levels[[lower.end, *(row for part in rows for row in part), upper.end]]
        radius = 0.4 * (knots[-1] - knots[0])
        places = np.concatenate(
            [np.linspace(low, high, len(part) + 2)[1:-1] for part, (low, high) in zip(rows, spans, strict=True)]
        )
        return knots, np.concatenate([knots[:1], (knots[0] + knots[-1]) / 2 + radius * places, knots[-1:]]), radius


@dataclass(frozen=True)
class BoxLines:
    """Where they lie, all of the shape (..., radii, levels); what is beyond the box's sides counts nothing.

    Attributes
    ----------
    across
        Radii of the box's points.
    met
        Angles above the horizon at which the rays to them, or the columns below or above them, meet the sphere.
    core_radii, core_heights
        Of the core's points, above the centre.
    """

    across: Numeric
    met: Numeric
    core_radii: Numeric
    core_heights: Numeric


def place_box_lines(box: CrossedBox, radii: Numeric, levels: Numeric, centre: Numeric, radius: Numeric) -> BoxLines:
    """Return where a box's lines lie.

    Rays to the box's side do not pass through the sphere: they are turned by s v, |s| < 1, with v = acos(radius / distance), the
    angle to the tangent (ME.3). s is linear in the ray's angle between interfaces and corners. A corner's ray is not turned where
    none is, else at most half-way from the next interface to the terrain. On the terrain beyond the sphere the
    angles on the sphere are linear in those on the terrain.

    Parameters
    ----------
    box
        Its numbers.
    radii
        Of all radii, shape (..., radii).
    levels
        Of all levels, shape (..., levels).
    centre
        The sphere's height, shape (...,).
    radius
        The sphere's, shape (...,).
    """
    lines, count = np.array(box.lines), levels.shape[-1]
    centre, radius = (np.asarray(value)[..., None] for value in (centre, radius))
    heights, plain = levels - centre, radii[..., lines]
    kind = np.result_type(plain, heights, radius)
    box_radii, met, core_radii, core_heights = (np.zeros((*plain.shape, count), dtype=kind) for _ in range(4))
    box_radii[:] = plain[..., None]
    edge, rows = plain[..., -1:], np.array(box.rows)
    ray_angles = np.arctan(heights[..., rows] / edge)
    sides = np.array(box.sides, dtype=np.intp)
    level = np.arcsin(heights[..., sides] / radius)
    ends = []
    for cap, k in zip(box.caps, (0, -1), strict=True):
        part = slice(cap.last, None) if cap.sign > 0 else slice(None, cap.last + 1)
        angles, terrain = _place_cap(cap, plain, heights, radius)
        box_radii[..., part] = terrain[..., None]
        box_radii[..., cap.end] = plain
        pole, first_outside = (angles[..., cap.starts[-1]], cap.starts[-1]) if cap.starts else (cap.sign * np.pi / 2, 0)
        corner = ray_angles[..., k]
        if len(sides):
            corner = pole - cap.sign * smooth_min(cap.sign * (pole - corner), cap.sign * (pole - level[..., k]) / 2)
        own_angles = np.pi / 2 * cap.sign - np.arctan(terrain[..., first_outside:] / heights[..., [cap.last]])
        pole = np.asarray(pole)[..., None]
        angles[..., first_outside:] = pole + (own_angles - pole) * (corner[..., None] - pole) / (own_angles[..., -1:] - pole)
        met[..., part] = angles[..., None]
        ends.append(corner)
    widest = np.arccos(radius / (edge**2 + heights[..., rows] ** 2) ** 0.5)
    level = np.concatenate([ends[0][..., None], level, ends[1][..., None]], axis=-1)
    met[..., -1, rows] = ray_angles + widest * _compute_turns(ray_angles, widest, [0, *(sides - rows[0]), len(rows) - 1], level)
    core = _place_core(met[..., rows], CORE_REACH * radius)
    core_radii[..., rows], core_heights[..., rows] = core
    return BoxLines(*(_expand_radii(value, lines, kind) for value in (box_radii, met, core_radii, core_heights)))


def _expand_radii(values: Numeric, lines: Ints, kind: Numeric) -> Numeric:
    """Expand numbers of the box's lines to all radii up to its edge."""
    expanded = np.zeros((*values.shape[:-2], lines[-1] + 1, values.shape[-1]), dtype=kind)
    expanded[..., lines, :] = values
    return expanded


def _place_cap(cap: Cap, radii: Numeric, heights: Numeric, radius: Numeric) -> tuple[Numeric, Numeric]:
    """Return the angles at which columns meet the sphere, up to the last interface's, and the radii on the terrain.

    Columns at which interfaces begin stand there; those between are moved in proportion.
    """
    starts = (0, *cap.starts, radii.shape[-1] - 1)
    rings = (radius**2 - heights[..., list(cap.rows)] ** 2) ** 0.5
    targets = np.concatenate([0 * radius, rings, radii[..., -1:] + 0 * radius], axis=-1)
    pieces = []
    for k, (first, last) in enumerate(pairwise(starts)):
        span = radii[..., first:last]
        share = (span - span[..., :1]) / (radii[..., [last]] - span[..., :1])
        pieces.append(targets[..., [k]] + share * (targets[..., [k + 1]] - targets[..., [k]]))
    terrain = np.concatenate([*pieces, targets[..., -1:]], axis=-1)
    on_sphere = cap.starts[-1] if cap.starts else 0
    angles = 0 * terrain
    angles[..., : on_sphere + 1] = cap.sign * np.arccos(terrain[..., : on_sphere + 1] / radius)
    return angles, terrain


def _compute_turns(ray_angles: Numeric, widest: Numeric, breaks: list[int], met: Numeric) -> Numeric:
    """Return s of rays to the box's side; at interfaces and corners, ``breaks``, they meet the sphere at the angles ``met``."""
    ends, turns = (met - ray_angles[..., breaks]) / widest[..., breaks], 0 * ray_angles * widest
    for k, (first, last) in enumerate(pairwise(breaks)):
        span = slice(first, last + 1)
        share = (ray_angles[..., span] - ray_angles[..., [first]]) / (ray_angles[..., [last]] - ray_angles[..., [first]])
        turns[..., span] = ends[..., [k]] + share * (ends[..., [k + 1]] - ends[..., [k]])
    return turns


def _place_core(met: Numeric, reach: Numeric) -> tuple[Numeric, Numeric]:
    """Return radii and heights of the core: corners on the rays to the box's corners, level rows and straight sides."""
    side = met[..., -1, :]
    (low, bottom), (high, top) = ((reach * np.cos(side[..., [k]]), reach * np.sin(side[..., [k]])) for k in (0, -1))
    slant = (high - low) / (top - bottom)
    ray_length = (low - slant * bottom) / (np.cos(side) - slant * np.sin(side))
    z, edge = (ray_length * np.sin(side))[..., None, :], (ray_length * np.cos(side))[..., None, :]
    height_fraction = (z - z[..., :1]) / (z[..., -1:] - z[..., :1])
    lower_ratio, upper_ratio = ((_cotangent(met[..., k]) / _cotangent(side[..., [k]]))[..., None] for k in (0, -1))
    return edge * (lower_ratio + height_fraction * (upper_ratio - lower_ratio)), z + 0 * lower_ratio


def _cotangent(angle: Numeric) -> Numeric:
    return np.cos(angle) / np.sin(angle)
