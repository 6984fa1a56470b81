"""Place the lines of a meridian mesh: radii, heights and fractions of rays as smooth functions of a section."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import accumulate
from math import isclose

import numpy as np

from geometry.common.arrays import Numeric
from geometry.meridian.breaks import (
    THIN_TISSUE_FEATURES,
    CapPlace,
    count_cells,
    count_lean_columns,
    count_lean_rings,
    count_lean_rows,
    find_block_breaks,
    find_cap_places,
    find_cut_ends,
    find_radial_breaks,
    find_tissue_breaks,
    join_intervals,
)
from geometry.meridian.crossed_sphere import BoxLines, Cap, CrossedBox, place_box_lines, spread_apart
from geometry.meridian.grading import grade_nodes
from geometry.meridian.section import FILMS, Body, Section
from geometry.meridian.sphere_box import SphereBox
from geometry.meridian.stack_fineness import LAYER_RATIO, StackFineness
from geometry.meridian.upper_levels import place_base_levels, place_bridge, place_stack_levels

MIN_CORNER_LAYERS = 3  # corner layers from which on films and bonds have two rows, each cut towards one corner
MAX_MERGING_CELLS = 2.0  # times the coarsest mesh's cells: beyond it no lines end, for the three columns under a gap were too few


@dataclass(frozen=True)
class Kind:
    """The features that determine a mesh's topology; ordinary designs with the same layers and box share one.

    Attributes
    ----------
    columns, rows
        Cells between neighbouring breaks of radii and of the tissue's levels on the coarsest mesh.
    blocks
        Rows of inner and outer block.
    rings
        Rings of cells between sphere and box, and between core and sphere.
    box
        How many of the section's ``block_radii`` the box round the sphere reaches beyond; None without a sphere.
    radii
        Names of the section's ``block_radii``, from the axis outwards.
    lean
        Whether cells are few where a scan of single counts found that they change nothing: under the tube's wall, across the box
        and below it, round the core; rows under the surface as many as their growth requires.
    layers
        Interfaces of the tissue above the sphere, across it and below it.
    caps
        Of interfaces that cross the sphere near its lower and its upper pole, each from the pole on: between which breaks of
        radii they meet it, how many eighths of the columns there lie nearer to the axis, and whether nearly at the pole.
    ends
        Whether cells are cut towards each interface's end at the tissue's side, from the surface downwards.
    thin
        Whether the tissue above sphere or floor is thin.
    stacks
        The layers on the inner and on the outer block, from the block upwards.
    base
        None for a rigid one, else the sign of inner less outer height, layers included.
    flange
        Whether an elastic base reaches beyond the tube.
    """

    columns: tuple[int, ...]
    rows: tuple[int, ...]
    blocks: tuple[int, int]
    rings: tuple[int, int]
    box: int | None
    layers: tuple[int, int, int]
    thin: bool
    stacks: tuple[tuple[Body, ...], ...]
    base: int | None
    flange: bool
    radii: tuple[str, ...] = ("inner", "hole", "tube")
    lean: bool = False
    ends: tuple[bool, ...] = ()
    caps: tuple[tuple[CapPlace, ...], ...] = ((), ())


@dataclass(frozen=True)
class MeridianFineness:
    """How fine a mesh is: a multiplier of the number of cells, 0.7 or more, geometric layers at each corner, polynomial order.

    ``lean`` is of ``Kind``. ``stack`` is the fineness of films and bonds; None where it follows from ``layers``.
    """

    cells: float
    layers: int
    order: int
    lean: bool = False
    stack: StackFineness | None = None

    def count(self, cells: int, minimum: int = 1) -> int:
        """Return the number of cells where the mesh with a multiplier of 1 has ``cells``.

        It is at least ``minimum``, or ``cells`` if that is less.
        """
        return max(min(cells, minimum), round(self.cells * cells))


@dataclass(frozen=True)
class MeshLines:
    """The lines of one mesh, or of many meshes of one layout at once.

    Attributes
    ----------
    radii
        Of the vertical lines, shape (..., radii).
    levels
        Heights z of the horizontal lines, shape (..., levels).
    outside, inside
        Where circles cut the rays from sphere to box and from core to sphere, 0 to 1, shape (..., circles).
    centre, sphere
        The sphere's height and radius, shape (...,).
    box
        The lines of the sphere's box, shape (..., radii, levels).
    """

    radii: Numeric
    levels: Numeric
    outside: Numeric
    inside: Numeric
    centre: Numeric
    sphere: Numeric
    box: BoxLines | None = None


class MeshTopology:
    """Numbers of the lines between which the cells lie; the same for all sections of a kind.

    Attributes
    ----------
    column
        Numbers of the radii called axis, inner, hole, tube, side, with a sphere box, and with round edges those where faces end,
        inner edge, hole edge and tube edge.
    row
        Numbers of the levels called floor, surface and, with a sphere, low and high (the box's).
    interfaces
        Numbers of the levels of the tissue's interfaces, from the surface downwards.
    merged
        Rows below the surface, by the number of their upper level, in which lines end: triples of columns become one, their
        middle meets the level ``middles`` within the row; the columns' four lines.
    inner, outer
        Numbers of the levels of each block from the surface to its base, film layers included.
    bridge, flange
        Numbers of the radii of an elastic base across the gap and from the tube to the flange's edge.
    boss
        Numbers of the levels of an elastic base between the lower and the higher film.
    base
        From there to the top.
    rings
        Number of rings of cells between sphere and box, and between core and sphere.
    crossed
        Lines of the box round a sphere that interfaces cross; None where none does.
    """

    def __init__(self, kind: Kind, fineness: MeridianFineness) -> None:
        """Assign numbers to the lines of all meshes of a kind that have this fineness."""
        n = fineness.count
        self.kind, self.fineness = kind, fineness
        names, levels = ["axis", *kind.radii, "side"], _list_level_names(kind.layers, kind.box is not None)
        if kind.box is not None:
            names.insert(kind.box + 1, "box")
        gap = range(names.index("inner"), names.index("hole"))
        self.split_gap = "box" in names and names.index("box") - 1 in gap
        # three columns below a gap become one; other numbers do not, but for a single one on each side of the box's edge
        self.merging = not kind.thin and fineness.cells < MAX_MERGING_CELLS
        self.columns = tuple(cells if k in gap and self.merging else n(cells, 3) for k, cells in enumerate(kind.columns))
        fewest = 2 if kind.lean or any(kind.layers) else 1  # two cells at least lie between any two singular corners
        self.rows, self.blocks = tuple(n(cells, fewest) for cells in kind.rows), tuple(map(n, kind.blocks))
        if kind.lean:
            self.rows = (*self.rows[:-1], n(kind.rows[-1], 4))
        self.rings = n(kind.rings[0], 2), n(kind.rings[1], 1 + kind.lean)
        self.column = dict(zip(names, np.cumsum([0, *self.columns]).tolist(), strict=True))
        self.row = dict(zip(levels, np.cumsum([0, *self.rows]).tolist(), strict=True))
        self.interfaces = [self.row[f"interface {k}"] for k in range(sum(kind.layers))]
        self.layer_rows = tuple(map(self._count_layer_rows, kind.stacks))
        top = self._number_levels(self.row["surface"] + 1)
        self.merged = self._find_merged()
        self.middles = dict(zip(self.merged, range(top, top + len(self.merged)), strict=True))
        self.box = self._build_box() if kind.box is not None else None
        self.crossed = self.box if kind.layers[1] else None

    @property
    def layer_ends(self) -> set[int]:
        """Numbers of the levels where a block, a film or a bond ends, above the tissue."""
        rows = zip((self.inner, self.outer), self.blocks, self.layer_rows, strict=True)
        return {levels[row] for levels, first, counts in rows for row in accumulate((first, *counts))}

    @property
    def electrodes(self) -> tuple[tuple[int, int], tuple[int, int]]:
        """Numbers of the radii at which the electrodes of the inner and the outer film begin and end."""
        inner, hole, tube = (self.column.get(f"{name} electrode", self.column[name]) for name in ("inner", "hole", "tube"))
        return (self.column["axis"], inner), (hole, tube)

    @property
    def faces(self) -> tuple[tuple[int, int], tuple[int, int]]:
        """Numbers of the radii at which the inner block's face begins and ends, and the tube's."""
        inner, hole, tube = (self.column.get(f"{name} edge", self.column[name]) for name in ("inner", "hole", "tube"))
        return (self.column["axis"], inner), (hole, tube)

    @property
    def top_layers(self) -> int:
        """Number of geometric layers at the upper ends of the blocks' walls, and at the walls of films and bonds."""
        return self.fineness.layers if self._stack is None else self._stack.layers

    @property
    def top_ratio(self) -> float:
        """Ratio of sizes from one layer to the next there."""
        return LAYER_RATIO if self._stack is None else self._stack.ratio

    @property
    def wall_strips(self) -> int:
        """Number of strips at the walls of films and bonds into which rows are cut before their corners are."""
        return 1 if self._stack is None else self._stack.strips

    @property
    def _stack(self) -> StackFineness | None:
        """The fineness of films and bonds; None without them, or where it follows from ``layers``."""
        return self.fineness.stack if any(self.kind.stacks) else None

    def _count_layer_rows(self, stack: tuple[Body, ...]) -> tuple[int, ...]:
        """Return the number of rows in each layer of a stack, see ``MIN_CORNER_LAYERS``."""
        if self.fineness.stack is not None:
            return self.fineness.stack.count_rows(stack)
        layers = self.fineness.layers
        rows = self.fineness.count(2) if layers >= MIN_CORNER_LAYERS else 1
        # a film that floats on a bond has hardly any singularity of its own: at first one row suffices
        return tuple(1 if body in FILMS and body != stack[-1] and layers == MIN_CORNER_LAYERS else rows for body in stack)

    def _find_merged(self) -> dict[int, list[tuple[int, ...]]]:
        """Return ``merged``: the groups of columns that become one, each by its four lines, by the row's upper level."""
        surface = self.row["surface"]
        inner, hole, tube = (self.column[name] for name in ("inner", "hole", "tube"))
        if not self.merging:
            return {}
        wide: list[tuple[int, ...]] = [(tube - 1, tube, tube + 1, tube + 2)]
        first = surface - self.fineness.count(1)  # rows grow thinner as cells multiply, the gap does not
        if hole - inner != 3 or self.split_gap:  # the box's edge goes down from between the gap's columns
            return {first - 1: wide}
        return {first: [(inner, inner + 1, inner + 2, hole)], first - 1: [(inner - 1, inner, hole, hole + 1), *wide]}

    def _build_box(self) -> CrossedBox:
        """Return the box round the sphere, perhaps crossed by interfaces; see ``geometry.meridian.crossed_sphere``.

        Some interfaces begin on the sphere at a column near a pole (``caps``), the others are rays to the box's side.
        """
        interfaces_above, interfaces_across, _ = self.kind.layers
        ended = {line for groups in self.merged.values() for group in groups for line in group[1:-1]}
        # below rows in which lines end
        lines = tuple(line for line in range(self.column["box"] + 1) if line not in ended)
        rows = self.interfaces[interfaces_above : interfaces_above + interfaces_across]
        ends, caps = np.cumsum([0, *self.columns]), []
        for places, sign, name, levels in zip(self.kind.caps, (-1, 1), ("low", "high"), (rows[::-1], rows), strict=True):
            wanted = [int(np.searchsorted(lines, ends[k] + eighths / 8 * self.columns[k])) for k, eighths, _ in places]
            starts, flat = spread_apart(wanted, len(lines) - 1), tuple(is_flat for *_, is_flat in places)
            caps.append(Cap(tuple(levels[: len(places)]), starts, flat, sign, self.row[name]))
        lower, upper = caps
        sides = rows[len(upper.rows) : len(rows) - len(lower.rows)]
        return CrossedBox(lines, tuple(sides[::-1]), (lower, upper))

    def _number_levels(self, first: int) -> int:
        """Assign numbers to levels above the surface, from ``first``, and radii beyond the tissue's; return the next level."""
        n, kind = self.fineness.count, self.kind
        middle, top = (first + sum(self.blocks[:k]) + sum(map(sum, self.layer_rows[:k])) for k in (1, 2))
        self.inner = (first - 1, *range(first, middle))
        self.outer = (first - 1, *range(middle, top))
        # rows of the boss and of the step, rows of the flange's thickness, columns from the tube to the flange's edge
        self.step, self.thick, self.overhang = n(4), n(4), n(4) * kind.flange
        self.bridge, self.flange, self.boss, self.base = (-1,), (-1,), (-1,), (-1,)
        if kind.base is None:
            return top
        extra = self.column["side"] + 1
        self.half = n(4)  # columns of either half of the bridge
        self.bridge = (self.column["inner"], *range(extra, extra + 2 * self.half - 1), self.column["hole"])
        extra += 2 * self.half - 1
        self.flange = (self.column["tube"], *range(extra, extra + self.overhang))
        if kind.base == 0:  # one level for both films' upper faces
            self.outer = (*self.outer[:-1], self.inner[-1])
        low, high = sorted((self.inner[-1], self.outer[-1]), reverse=kind.base > 0)
        if kind.base != 0:
            self.boss = (low, *range(top, top + self.step - 1), high)
            top += self.step - 1
        self.base = (high, *range(top, top + self.step + self.thick))
        return top + self.step + self.thick


def _list_level_names(layers: tuple[int, int, int], sphere: bool) -> list[str]:
    """Return the names of the tissue's breaks (levels that lines must meet) from the floor upwards.

    ``layers`` is as in ``Kind``; ``sphere``: whether there is one, whose box ends at the levels low and high.
    """
    interfaces_above, interfaces_across, _ = layers
    names = ["surface", *(f"interface {k}" for k in range(sum(layers))), "floor"]
    if sphere:
        names.insert(1 + interfaces_above, "high")
        names.insert(2 + interfaces_above + interfaces_across, "low")
    return names[::-1]


def find_kind(section: Section, lean: bool = False) -> Kind:
    """Return the kind of a section whose lengths are floats.

    ``lean`` asks for few cells, see ``Kind``; it has no effect where there is no sphere or where the blocks' edges are round.
    """
    s, sphere = section, SphereBox.from_section(section)
    box = None if sphere is None else sphere.find_widest_interval(s)
    base, (inner_top, outer_top) = None, s.top_heights
    if s.flange_thickness > 0:
        base = 0 if isclose(inner_top, outer_top) else 1 if inner_top > outer_top else -1
    blocks = tuple(count_cells(find_block_breaks(s, height))[0] for height in (s.inner_height, s.outer_height))
    rings = (0, 0) if sphere is None else tuple(count_cells(ring)[0] for ring in sphere.build_rings())
    thin = bool(s.under_blocks < THIN_TISSUE_FEATURES * s.block_size)
    interfaces_above, interfaces_across = s.interfaces_apart
    layers = interfaces_above, interfaces_across, len(s.interfaces) - interfaces_above - interfaces_across
    radii, levels = find_radial_breaks(s, box, sphere), find_tissue_breaks(s, sphere, thin)
    columns, rows = count_cells(radii), count_cells(levels)
    caps = find_cap_places(s, radii)
    # as ``spread_apart`` requires: two columns within the innermost radius for each interface that begins at a pole, and two more
    columns = max(columns[0], max(2 + 2 * len(cap) if cap else 0 for cap in caps)), *columns[1:]
    lean = lean and not s.edge_radius
    if lean and sphere is not None:
        columns, rings = count_lean_columns(columns, radii, box), count_lean_rings(rings, sphere.build_rings()[1])
        rows = count_lean_rows(levels, thin, wide=columns[1 + (box == 0)] != 3 or box == 1)
    return Kind(
        columns,
        rows,
        blocks=blocks,  # type: ignore[arg-type]
        rings=rings,  # type: ignore[arg-type]
        box=box,
        layers=layers,
        thin=thin,
        stacks=s.stacks,
        base=base,
        flange=bool(s.flange_radius > 0),
        radii=tuple(s.block_radii),
        lean=lean and sphere is not None,
        ends=find_cut_ends(s, levels, _list_level_names(layers, sphere is not None)),
        caps=caps,
    )


def place_lines(section: Section, layout: MeshTopology) -> MeshLines:
    """Place the lines of a layout for one section, or for an array of sections of its kind."""
    s, sphere, box = section, SphereBox.from_section(section), layout.kind.box
    levels = [join_intervals(find_tissue_breaks(s, sphere), layout.rows)]
    for k, height in enumerate((s.inner_height, s.outer_height)):
        levels.append(join_intervals(find_block_breaks(s, height), (layout.blocks[k],))[..., 1:])
        levels += place_stack_levels(s, height, layout.kind.stacks[k], layout.layer_rows[k])
    radii = [join_intervals(find_radial_breaks(s, box, sphere), layout.columns)]
    if layout.kind.base is not None:
        levels += place_base_levels(s, layout.kind.base, layout.step, layout.thick)
        radii.append(place_bridge(s, layout.kind.base, layout.half))
        if layout.kind.flange:
            radii.append(grade_nodes(s.tube_radius, s.flange_radius, layout.overhang, s.corner_size)[..., 1:])
    levels.append(_find_middles(levels[0], layout))
    rays: tuple[Numeric, ...] = (np.zeros(0), np.zeros(0), 0.0, 0.0)
    if sphere is not None:
        outside, inside = (join_intervals(ring, (cells,)) for ring, cells in zip(sphere.build_rings(), layout.rings, strict=True))
        centre, radius = -sphere.depth + 0 * sphere.radius, sphere.radius + 0 * sphere.depth
        rays = (outside, inside, centre, radius, place_core_lines(layout, radii[0], levels[0], sphere))
    return MeshLines(np.concatenate(radii, axis=-1), np.concatenate(levels, axis=-1), *rays)


def place_core_lines(layout: MeshTopology, radii: Numeric, levels: Numeric, sphere: SphereBox) -> BoxLines:
    """Return the lines of the box round the sphere and of the core inside it, ``MeshLines.box``.

    ``radii`` (..., radii) and ``levels`` (..., levels) are those of the tissue's lines. Where no interface crosses the sphere,
    rays are straight: only the core's points are given, and the other fields of ``BoxLines`` are None.
    """
    if layout.crossed is not None:
        return place_box_lines(layout.crossed, radii, levels, -sphere.depth, sphere.radius)
    columns, rows = slice(layout.column["box"] + 1), slice(layout.row["low"], layout.row["high"] + 1)
    inside = sphere.place_core(radii[..., columns], levels[..., rows])
    # the core has the rows low to high; rows of zeros outside them let it be indexed by the mesh's own levels
    core = tuple(np.zeros((*grid.shape[:-1], levels.shape[-1]), dtype=grid.dtype) for grid in inside)
    for target, grid in zip(core, inside, strict=True):
        target[..., rows] = grid
    return BoxLines(None, None, *core)


def _find_middles(levels: Numeric, layout: MeshTopology) -> Numeric:
    """Return the heights half-way up the rows in which lines end, shape (..., rows): where the ends of merging columns meet."""
    tops = list(layout.merged)
    return (levels[..., tops] + levels[..., [top - 1 for top in tops]]) / 2
