r"""Place the lines and rays of the box round a sphere that interfaces of the tissue cross.

An interface that meets the sphere steeply, on its side, is one of the rays from the sphere's centre to the box's side; rays
near it are turned about the centre where they meet the sphere, so that the interface stays level. Near a pole such rays would
lie along the interface. There the sphere's cap (its surface about the pole) and, from where they begin on it, the interfaces are
called the terrain: upright columns of cells stand on it. Each interface begins on the sphere at one column, so that the rows of
cells below it end there in a point. The lowest of these interfaces is the box's top

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

FEW_LAYERS, MANY_LAYERS = 3, 8  # where an interface meets the sphere; at a pole more would be as thin as rounding errors
MIN_TERRAIN_ANGLE_RAD, MAX_RAY_ANGLE_RAD = (
    np.pi / 6,
    np.pi / 3,
)  # angles above the horizon between which an interface may be a ray or a part of the terrain


def count_terrain_interfaces(angles: Numeric) -> tuple[int, int]:
    """Return how many interfaces are terrain at the upper and at the lower pole; those between them are rays.

    Interfaces close to each other are of the same sort: rays and terrain are parted at the widest gap between angles.

    Parameters
    ----------
    angles
        Angles above the horizontal, seen from the sphere's centre, at which interfaces meet the sphere, falling, shape (n,).
    """
    upper = _count_at_pole(angles)
    return upper, _count_at_pole(-angles[upper:][::-1])


def _count_at_pole(angles: Numeric) -> int:
    """Return how many interfaces are terrain at the pole from which on ``angles`` are listed, falling, shape (n,).

    Above ``MAX_RAY_ANGLE_RAD`` all are, below ``MIN_TERRAIN_ANGLE_RAD`` none is; the widest gap between these limits decides.
    """
    if (
        not len(angles) or angles[0] < MIN_TERRAIN_ANGLE_RAD
    ):  # upright columns are better than turned rays where there is a choice
        return 0
    ends = np.clip(np.concatenate([angles, [-np.pi / 2]]), MIN_TERRAIN_ANGLE_RAD, MAX_RAY_ANGLE_RAD)
    # rounded so that gaps that are equal but for rounding errors are equal: argmax then returns the first
    return 1 + int(np.argmax(np.round(ends[:-1] - ends[1:], 9)))


def spread_apart(wanted: list[int], last: int) -> tuple[int, ...]:
    """Return rising numbers from 1 to ``last`` - 1, near the ``wanted`` rising numbers of columns and at least two apart.

    So no cell touches the columns at which two interfaces begin. ``last`` has to be at least twice the number of ``wanted``.
    """
    numbers: list[int] = []
    for k, target in enumerate(wanted):
        # the upper limit leaves two columns for each number that follows
        lower, upper = (numbers[-1] + 2 if numbers else 1), last - 1 - 2 * (len(wanted) - 1 - k)
        numbers.append(min(max(target, lower), upper))
    return tuple(numbers)


@dataclass(frozen=True)
class Cap:
    """The interfaces that are terrain at one pole of the sphere, listed from the pole on.

    Attributes
    ----------
    rows
        Numbers of their levels (horizontal lines of the mesh).
    starts
        For each, the place in ``CrossedBox.lines`` of the column at which it begins on the sphere.
    flat
        For each, whether it meets the sphere so near to the pole that cells there get only ``FEW_LAYERS``.
    sign
        1 at the upper pole, -1 at the lower.
    end
        Number of the level of the box's end at this pole.
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
    """The box round the sphere, by the numbers of its lines in the mesh.

    Attributes
    ----------
    lines
        Of the radii (vertical lines) in the box, from the axis.
    sides
        Of the levels of interfaces that are rays to the box's side, from below.
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
        """Maximum numbers of layers of cells where terrain interfaces begin, by the numbers of radius and level there."""
        return {
            (self.lines[start], row): FEW_LAYERS if flat else MANY_LAYERS
            for cap in self.caps
            for row, start, flat in zip(cap.rows, cap.starts, cap.flat, strict=True)
        }

    def flatten(self, levels: Numeric) -> tuple[Numeric, Numeric, float]:
        """Return an evenly spaced drawing of the box, from which ``geometry.meridian.mesh.compute_labels`` labels elements.

        Returns
        -------
        tuple[Numeric, Numeric, float]
            The ``levels`` of the box's lower end, of the interfaces that cross the sphere and of its upper end; the heights at
            which they are drawn; the radius of the sphere drawn between them.
        """
        lower, upper = self.caps
        # over the radius: heights between which the interfaces at the lower pole, at the sides and at the upper pole are drawn
        rows, spans = (lower.rows, self.sides, upper.rows[::-1]), ((-0.9, -0.4), (-0.3, 0.3), (0.4, 0.9))
        knots = levels[[lower.end, *(row for part in rows for row in part), upper.end]]
        radius = 0.4 * (knots[-1] - knots[0])
        places = np.concatenate(
            [np.linspace(low, high, len(part) + 2)[1:-1] for part, (low, high) in zip(rows, spans, strict=True)]
        )
        return knots, np.concatenate([knots[:1], (knots[0] + knots[-1]) / 2 + radius * places, knots[-1:]]), radius


@dataclass(frozen=True)
class BoxLines:
    """Where the lines of the box lie, all of the shape (..., radii, levels); values beyond the box's sides are not used.

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

    Rays to the box's side have a bend on the sphere's surface: the points where they meet it are turned about the centre by s v,
    |s| < 1, with v = acos(radius / distance), the angle to the tangent from the ray's end (ME.3). s is linear in the ray's angle
    between interfaces and corners. A corner's ray is not turned where none is, else at most half-way from the next interface to
    the terrain. On the terrain beyond the sphere the angles on the sphere are linear in those on the terrain.

    Parameters
    ----------
    box
        Numbers of its lines.
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
    edge, rows = plain[..., -1:], np.array(box.rows)  # the box's outer radius; the levels between which rays end on its side
    ray_angles = np.arctan(heights[..., rows] / edge)
    sides = np.array(box.sides, dtype=np.intp)
    level = np.arcsin(heights[..., sides] / radius)  # angles at which these interfaces meet the sphere
    ends = []
    for cap, k in zip(box.caps, (0, -1), strict=True):  # k: first or last of the rays to the side, the one to the corner
        part = slice(cap.last, None) if cap.sign > 0 else slice(None, cap.last + 1)
        angles, terrain = _place_cap(cap, plain, heights, radius)
        box_radii[..., part] = terrain[..., None]
        box_radii[..., cap.end] = plain  # the box's own end is not moved
        pole, first_outside = (angles[..., cap.starts[-1]], cap.starts[-1]) if cap.starts else (cap.sign * np.pi / 2, 0)
        corner = ray_angles[..., k]
        if len(sides):
            # ``sign`` makes the lower pole an upper one, for which smooth_min needs positive angles
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
    """Return values (..., lines, levels) placed at the radii ``lines`` (numbers) of an array for all radii up to the box's edge.

    The other radii, of lines that end above the box, have 0. ``kind`` is the result's dtype.
    """
    expanded = np.zeros((*values.shape[:-2], lines[-1] + 1, values.shape[-1]), dtype=kind)
    expanded[..., lines, :] = values
    return expanded


def _place_cap(cap: Cap, radii: Numeric, heights: Numeric, radius: Numeric) -> tuple[Numeric, Numeric]:
    """Return where the columns at one pole stand: the angles at which they meet the sphere, and their radii on the terrain.

    The terrain is the sphere's cap and, outside it, the interfaces that begin on the cap. A column at which an interface begins
    stands where that interface meets the sphere; those between are moved in proportion.
    Angles, above the horizontal, are 0 for columns beyond the last interface's beginning, which do not meet the sphere.

    Parameters
    ----------
    cap
        The interfaces that begin at this pole.
    radii
        Of the box's columns, shape (..., columns), from the axis to the box's side.
    heights
        Of all levels above the sphere's centre, shape (..., levels).
    radius
        Of the sphere, shape (..., 1).

    Returns
    -------
    tuple[Numeric, Numeric]
        Angles and radii, both of the shape (..., columns).
    """
    starts = (0, *cap.starts, radii.shape[-1] - 1)
    rings = (radius**2 - heights[..., list(cap.rows)] ** 2) ** 0.5
    # radii where the columns ``starts`` are to stand: axis, circles where interfaces meet the sphere, the box's side
    targets = np.concatenate([0 * radius, rings, radii[..., -1:] + 0 * radius], axis=-1)
    pieces = []
    for k, (first, last) in enumerate(pairwise(starts)):
        span = radii[..., first:last]
        share = (span - span[..., :1]) / (radii[..., [last]] - span[..., :1])  # from 0 at the first column to 1 at the last
        pieces.append(targets[..., [k]] + share * (targets[..., [k + 1]] - targets[..., [k]]))
    terrain = np.concatenate([*pieces, targets[..., -1:]], axis=-1)
    on_sphere = cap.starts[-1] if cap.starts else 0
    angles = 0 * terrain
    angles[..., : on_sphere + 1] = cap.sign * np.arccos(terrain[..., : on_sphere + 1] / radius)
    return angles, terrain


def _compute_turns(ray_angles: Numeric, widest: Numeric, breaks: list[int], met: Numeric) -> Numeric:
    """Return s of eq. ME.3 for rays to the box's side, shape (..., rays).

    Parameters
    ----------
    ray_angles
        Angles of the rays' ends, seen from the sphere's centre, shape (..., rays).
    widest
        Angle v of eq. ME.3 for each ray, shape (..., rays).
    breaks
        Places among the rays of the interfaces and of the box's corners, rising.
    met
        Angles at which the rays ``breaks`` meet the sphere, shape (..., breaks).
    """
    ends, turns = (met - ray_angles[..., breaks]) / widest[..., breaks], 0 * ray_angles * widest
    for k, (first, last) in enumerate(pairwise(breaks)):
        span = slice(first, last + 1)
        share = (ray_angles[..., span] - ray_angles[..., [first]]) / (ray_angles[..., [last]] - ray_angles[..., [first]])
        turns[..., span] = ends[..., [k]] + share * (ends[..., [k + 1]] - ends[..., [k]])
    return turns


def _place_core(met: Numeric, reach: Numeric) -> tuple[Numeric, Numeric]:
    """Return radii and heights of the core's points above the centre: its corners on the rays to the box's corners.

    Its rows are level and its side is straight, so that it is a trapezium. ``met`` (..., radii, levels) are the angles at which
    the rays meet the sphere; ``reach`` (..., 1) is the distance of the core's corners from the centre.
    """
    side = met[..., -1, :]
    (low, bottom), (high, top) = ((reach * np.cos(side[..., [k]]), reach * np.sin(side[..., [k]])) for k in (0, -1))
    slant = (high - low) / (top - bottom)  # of the core's side: change of radius with height
    ray_length = (low - slant * bottom) / (np.cos(side) - slant * np.sin(side))
    z, edge = (ray_length * np.sin(side))[..., None, :], (ray_length * np.cos(side))[..., None, :]
    height_fraction = (z - z[..., :1]) / (z[..., -1:] - z[..., :1])
    # along the lower and the upper row, radii over the row's end as the rays to the box's end have them; linear between the rows
    lower_ratio, upper_ratio = (
        (_compute_cotangent(met[..., k]) / _compute_cotangent(side[..., [k]]))[..., None] for k in (0, -1)
    )
    return edge * (lower_ratio + height_fraction * (upper_ratio - lower_ratio)), z + 0 * lower_ratio


def _compute_cotangent(angle: Numeric) -> Numeric:
    return np.cos(angle) / np.sin(angle)
