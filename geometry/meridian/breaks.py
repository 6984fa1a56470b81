"""Find the breaks of a meridian mesh, places that its lines must meet, and the numbers of cells between them."""

from __future__ import annotations

from itertools import pairwise
from math import ceil

import numpy as np

from geometry.common.arrays import Numeric
from geometry.meridian.crossed_sphere import count_terrain_interfaces
from geometry.meridian.grading import count_folds, grade_nodes, smooth_min
from geometry.meridian.section import Section
from geometry.meridian.sphere_box import SPHERE_CELL, Breaks, SphereBox

FOLDS_PER_CELL = 1.8  # e-folds by which cells may grow from one to the next on the coarsest mesh
# columns from each radius to the next: in all, and on either side of a box's edge between them
MIN_COLUMNS = {"axis": (3, (3, 2)), "inner edge": (2, (1, 1)), "inner": (3, (1, 1)), "hole": (3, (2, 2)), "tube": (4, (3, 3))}
MIN_COLUMNS |= {"hole edge": (3, (2, 2)), "tube edge": (2, (1, 1))}
MIN_COLUMNS |= {f"{wall} electrode": MIN_COLUMNS[f"{wall} edge"] for wall in ("inner", "hole", "tube")}
LEAN_COLUMN_SLACK = 0.3  # of a cell: columns under the tube's wall on a lean mesh may be short of the usual growth by so much
SURFACE_ROW_SURPLUS = (
    1.15  # cells more than the usual growth asks for in the rows under the surface of a lean mesh, but no more than 4
)
MAX_CUT_ASPECT_RATIO = (
    50.0  # tissue beside the blocks over an interval of heights: cells so long are not cut towards an interface's end
)
COLUMN_START_FRACTION = (
    0.9  # of the radius where an interface meets a sphere: columns that begin there come from no nearer to the axis
)
POLE_RADIUS_FRACTION = 0.05  # of a sphere's radius: rings nearer to its axis are at a pole
CapPlace = tuple[int, int, bool]
THIN_TISSUE_FEATURES = 12.0  # features of the blocks: under thinner tissue no lines end, as the corners' fields reach below it


def find_radial_breaks(s: Section, box: int | None, sphere: SphereBox | None) -> Breaks:
    """Return radii of the tissue's lines, graded to the blocks' corners, to a pole near the surface and to the tissue's side."""
    corner, side = s.corner_size, smooth_min(s.tissue_radius - s.tube_radius, s.tissue_depth)
    places = [0 * s.inner_radius, *s.block_radii.values(), s.tissue_radius]
    min_cells = [MIN_COLUMNS[name][0] for name in ("axis", *s.block_radii)]
    sizes = [None, *[corner] * (len(places) - 2), side]
    if sphere is not None and box is not None:
        sizes[0] = sphere.pole
        places.insert(box + 1, sphere.find_edge(s, box, places))
        sizes.insert(box + 1, SPHERE_CELL * sphere.radius)
        min_cells[box : box + 1] = MIN_COLUMNS[["axis", *s.block_radii][box]][1]
    return Breaks(places, sizes, min_cells)


def find_tissue_breaks(s: Section, sphere: SphereBox | None, thin: bool = False) -> Breaks:
    """Return the breaks of the tissue's levels: floor, interfaces, the sphere's box and surface, from below.

    Cells grow away from the surface. ``thin``, as in ``Kind``, allows fewer rows under the surface.
    """
    floor = smooth_min(s.tissue_radius - s.tube_radius, s.tissue_depth)
    zero, (interfaces_above, interfaces_across) = 0 * s.tissue_depth, s.interfaces_apart
    # each break: its height, the size of cells there, and the minimum number of cells between it and the one above
    planes = [(-depth, depth + s.corner_size, 2) for depth in s.interfaces]
    places = [(zero, s.corner_size, 0), *planes, (-s.tissue_depth, floor, 3)]
    if sphere is not None:
        places.insert(1 + interfaces_above, (sphere.high, sphere.above, 2))
        places.insert(2 + interfaces_above + interfaces_across, (sphere.low, sphere.below, 4 if not interfaces_across else 2))
    elif not planes:
        places[-1] = (-s.tissue_depth, floor, 6)
    heights, sizes, min_cells = (list(column) for column in zip(*places[::-1], strict=True))
    min_cells[-2] = max(min_cells[-2], 2 if thin else 4)  # the interval under the surface
    return Breaks(heights, sizes, min_cells[:-1])


def find_block_breaks(s: Section, height: Numeric) -> Breaks:
    """Return the breaks of the levels in a block of a height: its two ends, to which cells are graded."""
    return Breaks([0 * height, height], [s.corner_size, s.corner_size], [5])


def find_cap_places(s: Section, radii: Breaks) -> tuple[tuple[CapPlace, ...], ...]:
    """Return ``Kind.caps`` (where the interfaces begin on the sphere, see there) of a section whose lengths are floats.

    ``radii`` are the breaks of the tissue's radii.
    """
    interfaces_above, interfaces_across = s.interfaces_apart
    if not interfaces_across:
        return (), ()
    sines = (s.sphere_depth - np.array(s.interfaces[interfaces_above : interfaces_above + interfaces_across])) / s.sphere_radius
    upper, lower = count_terrain_interfaces(np.arcsin(sines))
    rings = s.sphere_radius * np.sqrt(1 - sines**2)  # radii of the circles where interfaces meet the sphere
    places = tuple(
        (*_find_place(COLUMN_START_FRACTION * ring, radii), bool(ring < POLE_RADIUS_FRACTION * s.sphere_radius)) for ring in rings
    )
    return places[::-1][:lower], places[:upper]


def _find_place(radius: float, radii: Breaks) -> tuple[int, int]:
    """Return in which interval between breaks a radius lies, and how many eighths of its cells lie nearer to the axis."""
    k = min(int(np.searchsorted(radii.places, radius)), len(radii.places) - 1) - 1
    (low, high), (a, b) = radii.places[k : k + 2], radii.sizes[k : k + 2]
    # the middles of eight cells: the odd ones of 17 nodes
    return k, int(np.searchsorted(grade_nodes(low, high, 16, a, b)[1::2], radius))


def count_cells(breaks: Breaks) -> tuple[int, ...]:
    """Return the numbers of cells between the breaks on the coarsest mesh."""
    return tuple(max(minimum, ceil(grown)) for grown, minimum in zip(_count_folds(breaks), breaks.min_cells, strict=True))


def _count_folds(breaks: Breaks) -> list[float]:
    """Return the numbers of cells, not rounded, between the breaks that their growth alone requires."""
    ends = zip(pairwise(breaks.places), pairwise(breaks.sizes), strict=True)
    return [count_folds(*places, *sizes) / FOLDS_PER_CELL for places, sizes in ends]


def find_cut_ends(s: Section, levels: Breaks, names: list[str]) -> tuple[bool, ...]:
    """Return whether cells are cut towards each interface's end at the tissue's side, from the surface downwards.

    They are unless they would be too long for their height. ``names`` are those of ``levels``, both from below.
    """
    heights = [high - low for low, high in pairwise(levels.places)]
    side_width = s.tissue_radius - s.tube_radius
    planes = (k for k, name in enumerate(names) if name.startswith("interface"))
    return tuple(bool(side_width < MAX_CUT_ASPECT_RATIO * min(heights[k - 1 : k + 1])) for k in planes)[::-1]


def count_lean_columns(columns: tuple[int, ...], breaks: Breaks, box: int | None) -> tuple[int, ...]:
    """Return the numbers of columns, that under the tube's wall reduced to two where two nearly suffice.

    It stays where the sphere's box ends under the wall (``box`` is 2).
    """
    wall = 2 + (box in (0, 1))  # the wall's interval: one later where the box's edge adds a break before it
    is_narrow = box != 2 and _count_folds(breaks)[wall] < 2 + LEAN_COLUMN_SLACK
    return *columns[:wall], 2 if is_narrow else columns[wall], *columns[wall + 1 :]


def count_lean_rows(breaks: Breaks, thin: bool, wide: bool) -> tuple[int, ...]:
    """Return the numbers of rows of a lean mesh, from below: as many as growth requires, with a minimum.

    The minimum under the surface is 2 for ``thin`` tissue, else 4 if ``wide``, else 3 or 4.
    """
    *lower, top = _count_folds(breaks)
    min_rows = 2 if thin else 4 if wide else max(3, min(4, ceil(top + SURFACE_ROW_SURPLUS)))
    return *(max(2, ceil(growth)) for growth in lower), max(min_rows, ceil(top))


def count_lean_rings(rings: tuple[int, ...], core: Breaks) -> tuple[int, int]:
    """Return the numbers of rings: outside the sphere as given, between core and sphere as many as growth requires."""
    return rings[0], ceil(_count_folds(core)[0])


def join_intervals(breaks: Breaks, cells: tuple[int, ...]) -> Numeric:
    """Return the nodes on all intervals between breaks, shape (..., sum(cells) + 1).

    ``cells`` has the number in each interval.
    """
    ends = zip(pairwise(breaks.places), pairwise(breaks.sizes), cells, strict=True)
    pieces = [grade_nodes(low, high, n, a, b) for (low, high), (a, b), n in ends]
    return np.concatenate([pieces[0], *(piece[..., 1:] for piece in pieces[1:])], axis=-1)
