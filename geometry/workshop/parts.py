"""What the drawing of each part shows: section, view from above and dimensions, all from the probe's numbers in mm."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from geometry.cad import solids
from geometry.cad.materials import PartMaterial, part_materials
from geometry.scenes.base_sizes import assumed_sizes, base_sizes
from geometry.scenes.probe import Probe
from geometry.workshop.outlines import base_section, block, box, disc, open_ring
from geometry.workshop.sheet import Loop, Point
from geometry.workshop.tolerance import MACHINING, Budget, Tolerance, tolerance

Place = Literal["below", "left", "right", "plan"]
BOUND = ("inner", "outer", "assembly")  # drawings whose dimensions move the ratio
CLOSURE = ("inner_height", "outer_height")  # of a casting: from the cavity's floor to the lid
SEAT = "Ra 0.8"  # of faces that a film is bonded to: peaks far below the film and its adhesive
TITLES = {
    "inner": "Inner block",
    "outer": "Outer block",
    "film-inner": "Inner film",
    "film-outer": "Outer film",
    "base": "Base",
    "assembly": "Probe, assembly",
}


@dataclass(frozen=True)
class Measure:
    """A dimension.

    Attributes:
        name: of the probe's dimension that it shows, such as "inner_radius".
        start, end: two points of the part whose horizontal or, to the left or right or in the plan, upright distance it is, mm.
        place: below the section, left or right of it, or right of the view from above.
        prefix: before the number: a diameter's sign, or nothing.
        assumed: whether the scene leaves it open.
        auxiliary: whether others give it, here or in a part's drawing; it stands in parentheses, without deviation (ISO 129-1).
    """

    name: str
    start: Point
    end: Point
    place: Place
    prefix: str = ""
    assumed: bool = False
    auxiliary: bool = False

    @property
    def size(self) -> float:
        """The distance in mm."""
        along = 0 if self.place == "below" else 1
        return abs(self.end[along] - self.start[along])

    def held(self, part: str, process: str, budget: Budget) -> Tolerance:
        """Return how the dimension is held on the drawing of a part, mm; the ratio binds the blocks and their gap alone."""
        bound = budget.bound(self.name) if part in BOUND else None
        factor = 2 if self.prefix else 1
        closure = self.name in CLOSURE
        return tolerance(self.size, None if bound is None else factor * bound, process=process, closure=closure)


@dataclass(frozen=True)
class PartView:
    """What is drawn of a part, in its own coordinates: z upwards in the section, y in the view from above.

    Attributes:
        name: of the part.
        cut: outlines that the section y = 0 cuts, each with the angle of its hatching in degrees.
        seen: lines behind the section.
        plan: outlines seen from above.
        hidden: radii of circles that are hidden there.
        plan_lines: lines seen from above.
        measures: the dimensions.
        seats: points of faces that are bonded, and whether they look up.
        edge: radius of round lower edges, and the right one's centre; None where they are sharp.
        items: points of the parts of an assembly, from above, in the order of its list.
    """

    name: str
    cut: tuple[tuple[Loop, float], ...]
    seen: tuple[tuple[Point, Point], ...] = ()
    plan: tuple[Loop, ...] = ()
    hidden: tuple[float, ...] = ()
    plan_lines: tuple[tuple[Point, Point], ...] = ()
    measures: tuple[Measure, ...] = ()
    seats: tuple[tuple[float, float, bool], ...] = ()
    edge: tuple[float, Point] | None = None
    items: tuple[Point, ...] = ()

    @property
    def reach(self) -> float:
        """Radius of the view from above, mm."""
        return max(math.hypot(x, y) for loop in self.plan for x, y, _ in loop)


@dataclass(frozen=True)
class Millimetres:
    """A probe's dimensions in mm: radii of inner block, hole and tube, heights, thickness of the films, groove, round edges."""

    r2: float
    ri: float
    ro: float
    h2: float
    h1: float
    t: float
    half_width: float
    depth: float
    edge: float

    @property
    def groove_ends(self) -> tuple[float, float]:
        """Where the groove's sides meet the hole's and the tube's wall: x."""
        inner, outer = (math.sqrt((radius - self.half_width) * (radius + self.half_width)) for radius in (self.ri, self.ro))
        return inner, outer


def millimetres(probe: Probe, edge_radius: float = 0.0) -> Millimetres:
    """Return a probe's dimensions in mm; 0 for a groove, films or round edges that it has not."""
    width, depth = (0.0, 0.0) if probe.groove is None else (probe.groove.width, probe.groove.depth)
    radii = probe.inner_radius, probe.hole_radius, probe.tube_radius
    heights = probe.core_height, probe.tube_height, solids.film_thickness(probe)
    return Millimetres(*(length * solids.MM for length in (*radii, *heights, width / 2, depth, edge_radius)))


def part_views(probe: Probe, edge_radius: float = 0.0) -> dict[str, PartView]:
    """Return what is drawn of each part, by its name; ``edge_radius`` in m."""
    one = millimetres(probe, edge_radius)
    open_sizes = {key.removeprefix("probe.") for key in assumed_sizes(probe)}
    films = {}
    if probe.film is not None:
        assumed = "film.thickness" in open_sizes
        films = {"film-inner": _inner_film(one, assumed), "film-outer": _outer_film(one, assumed)}
    return {"inner": _inner(one), "outer": _outer(one), **films, "base": _base(probe, one, open_sizes)}


def diameter(name: str, radius: float, z: float, assumed: bool = False, auxiliary: bool = False) -> Measure:
    """Return a diameter, dimensioned below the section."""
    return Measure(name, (-radius, z), (radius, z), "below", "\N{LATIN CAPITAL LETTER O WITH STROKE}", assumed, auxiliary)


def _inner(one: Millimetres) -> PartView:
    height = Measure("inner_height", (-one.r2, 0), (-one.r2, one.h2), "left")
    return PartView(
        "inner",
        cut=((block(-one.r2, one.r2, one.h2, one.edge), 0.0),),
        plan=(disc(one.r2),),
        measures=(diameter("inner_radius", one.r2, one.edge), height),
        seats=((-one.r2 / 3, one.h2, True),),
        edge=_edge(one, one.r2),
    )


def _outer(one: Millimetres) -> PartView:
    low = one.h1 - one.depth
    seen = [((-one.ri, one.h1), (one.ri if not one.depth else one.groove_ends[0], one.h1)), ((-one.ri, 0.0), (one.ri, 0.0))]
    measures = [diameter("hole_radius", one.ri, one.edge), diameter("outer_radius", one.ro, one.edge)]
    measures.append(Measure("outer_height", (-one.ro, 0), (-one.ro, one.h1), "left"))
    lines: list[tuple[Point, Point]] = []
    if one.depth:
        near, far = one.groove_ends
        seen += [((near, one.h1), (far, one.h1)), ((far, low), (far, one.h1)), ((near, low), (near, one.h1))]
        lines = [((near, side), (far, side)) for side in (-one.half_width, one.half_width)]
        measures.append(Measure("groove_depth", (one.ro, low), (far, one.h1), "right"))
        measures.append(Measure("groove_width", (far, -one.half_width), (far, one.half_width), "plan"))
    walls = block(-one.ro, -one.ri, one.h1, one.edge), block(one.ri, one.ro, low, one.edge)
    return PartView(
        "outer",
        cut=tuple((wall, 90.0) for wall in walls),
        seen=tuple(seen),
        plan=(disc(one.ri), disc(one.ro)),
        plan_lines=tuple(lines),
        measures=tuple(measures),
        seats=((-(one.ri + one.ro) / 2, one.h1, True),),
        edge=_edge(one, one.ro),
    )


def _edge(one: Millimetres, radius: float) -> tuple[float, Point] | None:
    return (one.edge, (radius - one.edge, one.edge)) if one.edge else None


def _inner_film(one: Millimetres, assumed: bool) -> PartView:
    top = one.h2 + one.t
    thickness = Measure("film_thickness", (-one.r2, one.h2), (-one.r2, top), "left", assumed=assumed)
    measures = diameter("inner_radius", one.r2, one.h2), thickness
    return PartView("film-inner", ((box(-one.r2, one.r2, one.h2, top), 0.0),), plan=(disc(one.r2),), measures=measures)


def _outer_film(one: Millimetres, assumed: bool) -> PartView:
    top = one.h1 + one.t
    measures = [diameter("hole_radius", one.ri, one.h1), diameter("outer_radius", one.ro, one.h1)]
    measures.append(Measure("film_thickness", (-one.ro, one.h1), (-one.ro, top), "left", assumed=assumed))
    left, right = box(-one.ro, -one.ri, one.h1, top), box(one.ri, one.ro, one.h1, top)
    seen = (((-one.ri, one.h1), (one.ri, one.h1)), ((-one.ri, top), (one.ri, top)))
    if not one.depth:
        return PartView("film-outer", ((left, 0.0), (right, 0.0)), seen, (disc(one.ri), disc(one.ro)), measures=tuple(measures))
    near, far = one.groove_ends
    measures.append(Measure("groove_width", (far, -one.half_width), (far, one.half_width), "plan"))
    ends = tuple(((x, one.h1), (x, top)) for x in (near, far))
    sides = ((-one.ri, one.h1), (far, one.h1)), ((-one.ri, top), (far, top))
    plan = (open_ring(one.ri, one.ro, one.half_width),)
    return PartView("film-outer", ((left, 0.0),), (*sides, *ends), plan, measures=tuple(measures))


def _base(probe: Probe, one: Millimetres, open_sizes: set[str]) -> PartView:
    sizes = base_sizes(probe)
    low, side = (height * solids.MM for height in solids.film_tops(probe))
    rf, middle = sizes.flange_radius * solids.MM, (one.r2 + one.ri) / 2
    under = max(low, side) + sizes.step_height * solids.MM
    top = under + sizes.thickness * solids.MM
    wide, bottom = rf > one.ro, min(low, side)
    measures = [diameter("boss_radius", middle, low)] if low != side else []
    measures.append(diameter("outer_radius", one.ro, side))
    measures += [diameter("flange_radius", rf, under, "base.flange_radius" in open_sizes)] if wide else []
    thickness = Measure("base_thickness", (rf, under), (rf, top), "right", assumed="base.thickness" in open_sizes)
    measures.append(thickness)
    if under > max(low, side):
        assumed = "base.step_height" in open_sizes
        # from the higher film end, which is the boss's where that is a recess
        start = (one.ro, side) if side >= low else (middle, low)
        measures.append(Measure("step_height", start, (one.ro, under), "right", assumed=assumed))
    if low != side:
        measures.append(Measure("height_step", (-middle, low), (-one.ro, side), "left"))
    if bottom < under:
        measures.append(Measure("base_height", (-one.ro, bottom), (-rf, top), "left", auxiliary=True))
    return PartView(
        "base",
        cut=((base_section(probe), 0.0),),
        plan=(disc(rf),),
        hidden=(*((one.ro,) if wide else ()), *((middle,) if low != side else ())),
        measures=tuple(measures),
        seats=((-middle * 0.8, low, False),),
    )


ITEMS = ("base", "film-outer", "film-inner", "outer", "inner")
"""The parts from above, as the assembly's list numbers them; films only where there are any."""
ANGLES = {"inner": 0.0, "outer": 90.0, "film-inner": 0.0, "film-outer": 0.0, "base": 90.0}


def assembly_view(probe: Probe, edge_radius: float = 0.0) -> PartView:
    """Return what is drawn of the whole probe."""
    one, alone = millimetres(probe, edge_radius), part_views(probe, edge_radius)
    base = base_section(probe)
    top, rf = max(z for _, z, _ in base), max(x for x, _, _ in base)
    tips = {
        "base": (0.6 * one.ro, top - 0.3 * (top - one.h1)),
        "film-outer": ((sum(one.groove_ends) if one.depth else one.ri + one.ro) / 2, one.h1 + one.t / 2),
        "film-inner": (0.8 * one.r2, one.h2 + one.t / 2),
        "outer": ((one.ri + one.ro) / 2, 0.6 * (one.h1 - one.depth)),
        "inner": (0.7 * one.r2, 0.3 * one.h2),
    }
    heights = [Measure("outer_height", (-one.ro, 0), (-one.ro, one.h1), "left", auxiliary=True)]
    if one.h2 != one.h1:
        heights.append(Measure("inner_height", (-one.r2, 0), (-one.r2, one.h2), "left", auxiliary=True))
    heights.append(Measure("total_height", (-one.ro, 0), (-rf, top), "left", auxiliary=True))
    widths = [diameter("outer_radius", one.ro, one.edge, auxiliary=True)]
    widths += [diameter("flange_radius", rf, top, auxiliary=True)] if rf > one.ro else []
    # the gap of blocks of which one is cast follows from both castings, and is no dimension of its own
    cast = any(part_materials(probe)[block].process != MACHINING for block in ("inner", "outer"))
    gap = Measure("gap", (one.r2, one.edge), (one.ri, one.edge), "below", auxiliary=cast)
    return PartView(
        "assembly",
        cut=tuple((loop, ANGLES[name]) for name, view in alone.items() for loop, _ in view.cut),
        seen=tuple(line for name in ("outer", "film-outer") if name in alone for line in alone[name].seen[2:]),
        plan=(disc(rf),),
        hidden=(one.r2, one.ri, *((one.ro,) if rf > one.ro else ())),
        measures=(*heights, gap, *widths),
        items=tuple(tips[name] for name in ITEMS if name in alone),
    )


def parts_list(probe: Probe, materials: Mapping[str, PartMaterial]) -> tuple[str, ...]:
    """Return the lines of the assembly's list, in the order of its items."""
    names = [name for name in ITEMS if probe.film is not None or not name.startswith("film")]
    return tuple(f"{item}  {TITLES[name]}: {materials[name].text}" for item, name in enumerate(names, start=1))
