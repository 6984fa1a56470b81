"""Define the content of each part's drawing, in mm: section, view from above and dimensions."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

from geometry.cad.materials import PartMaterial, find_part_materials
from geometry.scenes.base_sizes import assume_sizes
from geometry.scenes.film import Bond
from geometry.scenes.probe import Probe
from geometry.workshop.outlines import (
    Millimetres,
    build_base_section,
    build_block,
    build_box,
    build_disc,
    build_open_ring,
    convert_to_mm,
    convert_to_polygon,
)
from geometry.workshop.sheet import DIAMETER_SIGN, Loop, Point, format_number
from geometry.workshop.tolerance import MACHINING_PROCESS, Budget, Tolerance, find_tolerance

Place = Literal["below", "left", "right", "plan"]
RATIO_DRAWINGS = ("inner", "outer", "assembly")  # drawings whose dimensions affect the ratio
CLOSURE_DIMENSIONS = ("inner_height", "outer_height")  # of a casting: measured from the cavity's floor to the lid
SEAT_ROUGHNESS = "Ra 0.8"  # of faces to which a film is bonded: peaks far below the thickness of film and adhesive
DRAWING_TITLES = {
    "inner": "Inner block",
    "outer": "Outer block",
    "film-inner": "Inner film",
    "film-outer": "Outer film",
    "base": "Base",
    "assembly": "Probe, assembly",
    "overview": "Probe, overview",
}


@dataclass(frozen=True)
class Measure:
    """A dimension.

    Attributes
    ----------
    name
        Name of the probe's dimension, such as "inner_radius".
    start, end
        Two points of the part, mm; the dimension is their horizontal distance, or, to the left or right of the section or in the
        plan, their vertical one.
    place
        Below the section, left or right of it, or right of the view from above.
    prefix
        Text before the number: a diameter sign, or empty.
    assumed
        Whether the scene does not give it.
    auxiliary
        Whether it follows from others, on this or a part's drawing; it stands in parentheses, without deviation (ISO 129-1).
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
        axis = 0 if self.place == "below" else 1
        return abs(self.end[axis] - self.start[axis])

    def find_tolerance(self, part: str, process: str, budget: Budget) -> Tolerance:
        """Return the dimension's tolerance on a part's drawing; the ratio limits only the blocks and their gap."""
        bound = budget.find_bound(self.name) if part in RATIO_DRAWINGS else None
        factor = 2 if self.prefix else 1  # a diameter may deviate by twice as much as its radius
        closure = self.name in CLOSURE_DIMENSIONS
        return find_tolerance(self.size, None if bound is None else factor * bound, process=process, closure=closure)


@dataclass(frozen=True)
class PartView:
    """The drawn lines and dimensions of a part, in its own coordinates: z upwards in the section, y in the view from above.

    Attributes
    ----------
    name
        Name of the part.
    cut
        Outlines in the section y = 0, each with the angle of its hatching in degrees.
    seen
        Visible lines behind the section.
    plan
        Outlines seen from above.
    hidden
        Radii of circles that are hidden in the view from above.
    plan_lines
        Lines seen from above.
    measures
        The dimensions.
    seats
        Points of faces that are bonded, and whether the faces point up.
    edge
        Radius of round lower edges, and the right one's centre; None for sharp edges.
    items
        Points of the parts of an assembly, from above, in the order of its list.
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


def build_part_views(probe: Probe, edge_radius: float = 0.0) -> dict[str, PartView]:
    """Return the views of all parts by name; ``edge_radius`` is that of the blocks' lower edges, m."""
    lengths = convert_to_mm(probe, edge_radius)
    open_sizes = {key.removeprefix("probe.") for key in assume_sizes(probe)}
    films = {}
    if probe.film is not None:
        assumed = "film.thickness" in open_sizes
        films = {"film-inner": _build_inner_film(lengths, assumed), "film-outer": _build_outer_film(lengths, assumed)}
    return {
        "inner": _build_inner(lengths),
        "outer": _build_outer(lengths),
        **films,
        "base": _build_base(lengths, open_sizes),
    }


def build_diameter(name: str, radius: float, z: float, assumed: bool = False, auxiliary: bool = False) -> Measure:
    """Return the dimension of a diameter, placed below the section."""
    return Measure(name, (-radius, z), (radius, z), "below", DIAMETER_SIGN, assumed, auxiliary)


def _build_inner(lengths: Millimetres) -> PartView:
    """Return the view of the inner block."""
    height = Measure("inner_height", (-lengths.r2, 0), (-lengths.r2, lengths.h2), "left")
    return PartView(
        "inner",
        cut=((build_block(-lengths.r2, lengths.r2, lengths.h2, lengths.edge), 0.0),),
        plan=(build_disc(lengths.r2),),
        measures=(build_diameter("inner_radius", lengths.r2, lengths.edge), height),
        seats=((-lengths.r2 / 3, lengths.h2, True),),
        edge=_find_edge(lengths, lengths.r2),
    )


def _build_outer(lengths: Millimetres) -> PartView:
    """Return the view of the outer block, with its groove if it has one."""
    low = lengths.h1 - lengths.depth  # height of the groove's floor
    seen = [
        ((-lengths.ri, lengths.h1), (lengths.ri if not lengths.depth else lengths.groove_ends[0], lengths.h1)),
        ((-lengths.ri, 0.0), (lengths.ri, 0.0)),
    ]
    measures = [build_diameter("hole_radius", lengths.ri, lengths.edge), build_diameter("outer_radius", lengths.ro, lengths.edge)]
    measures.append(Measure("outer_height", (-lengths.ro, 0), (-lengths.ro, lengths.h1), "left"))
    lines: list[tuple[Point, Point]] = []
    if lengths.depth:
        inner_x, outer_x = lengths.groove_ends
        seen += [
            ((inner_x, lengths.h1), (outer_x, lengths.h1)),
            ((outer_x, low), (outer_x, lengths.h1)),
            ((inner_x, low), (inner_x, lengths.h1)),
        ]
        lines = [((inner_x, side), (outer_x, side)) for side in (-lengths.half_width, lengths.half_width)]
        measures.append(Measure("groove_depth", (lengths.ro, low), (outer_x, lengths.h1), "right"))
        measures.append(Measure("groove_width", (outer_x, -lengths.half_width), (outer_x, lengths.half_width), "plan"))
    walls = (
        build_block(-lengths.ro, -lengths.ri, lengths.h1, lengths.edge),
        build_block(lengths.ri, lengths.ro, low, lengths.edge),
    )
    return PartView(
        "outer",
        cut=tuple((wall, 90.0) for wall in walls),
        seen=tuple(seen),
        plan=(build_disc(lengths.ri), build_disc(lengths.ro)),
        plan_lines=tuple(lines),
        measures=tuple(measures),
        seats=((-(lengths.ri + lengths.ro) / 2, lengths.h1, True),),
        edge=_find_edge(lengths, lengths.ro),
    )


def _find_edge(lengths: Millimetres, radius: float) -> tuple[float, Point] | None:
    """Return ``PartView.edge`` of a block with this outer radius, mm."""
    return (lengths.edge, (radius - lengths.edge, lengths.edge)) if lengths.edge else None


def _build_inner_film(lengths: Millimetres, assumed: bool) -> PartView:
    """Return the view of the inner film; ``assumed``: whether the scene leaves its thickness open."""
    bottom, top = lengths.z2, lengths.z2 + lengths.t2
    thickness = Measure("film_thickness", (-lengths.r2, bottom), (-lengths.r2, top), "left", assumed=assumed)
    measures = build_diameter("inner_radius", lengths.r2, bottom), thickness
    return PartView(
        "film-inner",
        ((build_box(-lengths.r2, lengths.r2, bottom, top), 0.0),),
        plan=(build_disc(lengths.r2),),
        measures=measures,
    )


def _build_outer_film(lengths: Millimetres, assumed: bool) -> PartView:
    """Return the view of the outer film, open above a groove; ``assumed``: whether the scene leaves its thickness open."""
    bottom, top = lengths.z1, lengths.z1 + lengths.t1
    measures = [build_diameter("hole_radius", lengths.ri, bottom), build_diameter("outer_radius", lengths.ro, bottom)]
    name = "film_thickness" if format_number(lengths.t1) == format_number(lengths.t2) else "outer_film_thickness"
    measures.append(Measure(name, (-lengths.ro, bottom), (-lengths.ro, top), "left", assumed=assumed))
    left, right = build_box(-lengths.ro, -lengths.ri, bottom, top), build_box(lengths.ri, lengths.ro, bottom, top)
    seen = (((-lengths.ri, bottom), (lengths.ri, bottom)), ((-lengths.ri, top), (lengths.ri, top)))
    if not lengths.depth:
        return PartView(
            "film-outer",
            ((left, 0.0), (right, 0.0)),
            seen,
            (build_disc(lengths.ri), build_disc(lengths.ro)),
            measures=tuple(measures),
        )
    inner_x, outer_x = lengths.groove_ends
    measures.append(Measure("groove_width", (outer_x, -lengths.half_width), (outer_x, lengths.half_width), "plan"))
    ends = tuple(((x, bottom), (x, top)) for x in (inner_x, outer_x))
    sides = ((-lengths.ri, bottom), (outer_x, bottom)), ((-lengths.ri, top), (outer_x, top))
    plan = (build_open_ring(lengths.ri, lengths.ro, lengths.half_width),)
    return PartView("film-outer", ((left, 0.0),), (*sides, *ends), plan, measures=tuple(measures))


def _build_base(lengths: Millimetres, open_sizes: set[str]) -> PartView:
    """Return the view of the base; ``open_sizes`` are the keys below ``probe`` that the scene leaves open."""
    low, side, middle = lengths.low, lengths.side, lengths.middle
    rf, flange_bottom, top = lengths.rf, lengths.flange_bottom, lengths.top
    wide, bottom = rf > lengths.ro, min(low, side)
    measures = [build_diameter("boss_radius", middle, low)] if low != side else []
    measures.append(build_diameter("outer_radius", lengths.ro, side))
    measures += [build_diameter("flange_radius", rf, flange_bottom, "base.flange_radius" in open_sizes)] if wide else []
    thickness = Measure("base_thickness", (rf, flange_bottom), (rf, top), "right", assumed="base.thickness" in open_sizes)
    measures.append(thickness)
    if flange_bottom > max(low, side):
        assumed = "base.step_height" in open_sizes
        # from the higher film end, that of the boss if the boss is a recess
        start = (lengths.ro, side) if side >= low else (middle, low)
        measures.append(Measure("step_height", start, (lengths.ro, flange_bottom), "right", assumed=assumed))
    if low != side:
        measures.append(Measure("height_step", (-middle, low), (-lengths.ro, side), "left"))
    if bottom < flange_bottom:
        measures.append(Measure("base_height", (-lengths.ro, bottom), (-rf, top), "left", auxiliary=True))
    return PartView(
        "base",
        cut=((build_base_section(lengths), 0.0),),
        plan=(build_disc(rf),),
        hidden=(*((lengths.ro,) if wide else ()), *((middle,) if low != side else ())),
        measures=tuple(measures),
        seats=((-middle * 0.8, low, False),),
    )


ASSEMBLY_ITEMS = ("base", "film-outer", "film-inner", "outer", "inner")
"""The parts from above, as the assembly's list numbers them; films only where there are any."""
HATCH_ANGLES_DEG = {"inner": 0.0, "outer": 90.0, "film-inner": 0.0, "film-outer": 0.0, "base": 90.0}


def build_assembly_view(probe: Probe, edge_radius: float = 0.0) -> PartView:
    """Return the view of the whole probe."""
    lengths, alone = convert_to_mm(probe, edge_radius), build_part_views(probe, edge_radius)
    top, rf = lengths.top, lengths.rf
    tips = {  # points inside the parts at which the lines of the item numbers end
        "base": (0.6 * lengths.ro, top - 0.3 * (top - lengths.h1)),
        "film-outer": ((sum(lengths.groove_ends) if lengths.depth else lengths.ri + lengths.ro) / 2, lengths.z1 + lengths.t1 / 2),
        "film-inner": (0.8 * lengths.r2, lengths.z2 + lengths.t2 / 2),
        "outer": ((lengths.ri + lengths.ro) / 2, 0.6 * (lengths.h1 - lengths.depth)),
        "inner": (0.7 * lengths.r2, 0.3 * lengths.h2),
    }
    heights = [Measure("outer_height", (-lengths.ro, 0), (-lengths.ro, lengths.h1), "left", auxiliary=True)]
    if lengths.h2 != lengths.h1:
        heights.append(Measure("inner_height", (-lengths.r2, 0), (-lengths.r2, lengths.h2), "left", auxiliary=True))
    heights += _list_stack_heights(lengths)
    heights.append(Measure("total_height", (-lengths.ro, 0), (-rf, top), "left", auxiliary=True))
    widths = [build_diameter("outer_radius", lengths.ro, lengths.edge, auxiliary=True)]
    widths += [build_diameter("flange_radius", rf, top, auxiliary=True)] if rf > lengths.ro else []
    # if a block is cast the gap follows from both radii, and is an auxiliary dimension
    cast = any(find_part_materials(probe)[block].process != MACHINING_PROCESS for block in ("inner", "outer"))
    gap = Measure("gap", (lengths.r2, lengths.edge), (lengths.ri, lengths.edge), "below", auxiliary=cast)
    return PartView(
        "assembly",
        cut=tuple((loop, HATCH_ANGLES_DEG[name]) for name, view in alone.items() for loop, _ in view.cut),
        # without the first two lines, which run across the hole, where the inner parts hide them
        seen=tuple(line for name in ("outer", "film-outer") if name in alone for line in alone[name].seen[2:]),
        plan=(build_disc(rf),),
        hidden=(lengths.r2, lengths.ri, *((lengths.ro,) if rf > lengths.ro else ())),
        measures=(*heights, gap, *widths),
        items=tuple(tips[name] for name in ASSEMBLY_ITEMS if name in alone),
    )


def _list_stack_heights(lengths: Millimetres) -> list[Measure]:
    """Return the heights between block and base of films that have bonds; of both blocks together where they are the same."""
    stacks = {
        "outer_stack_height": (lengths.ro, lengths.h1, lengths.side, lengths.t1),
        "inner_stack_height": (lengths.r2, lengths.h2, lengths.low, lengths.t2),
    }
    heights = [
        Measure(name, (-radius, bottom), (-radius, top), "left", auxiliary=True)
        for name, (radius, bottom, top, thickness) in stacks.items()
        if format_number(top - bottom) != format_number(thickness)
    ]
    return heights[:1] if len({format_number(height.size) for height in heights}) == 1 else heights


def build_overview(probe: Probe, edge_radius: float = 0.0) -> PartView:
    """Return the view of the whole probe with the dimensions that the sections of its parts show, all as auxiliary ones."""
    assembly, alone = build_assembly_view(probe, edge_radius), build_part_views(probe, edge_radius)
    drawn = [measure for view in (assembly, *alone.values()) for measure in view.measures if measure.place != "plan"]
    measures = {measure.name: replace(measure, auxiliary=True) for measure in drawn}
    return replace(assembly, name="overview", measures=tuple(measures.values()))


def build_section_outlines(probe: Probe, edge_radius: float = 0.0) -> dict[str, list[list[Point]]]:
    """Return the polygons (x, z), mm, in which the plane y = 0 cuts each part; round edges (radius in m) are chords."""
    views = build_part_views(probe, edge_radius)
    return {name: [convert_to_polygon(loop) for loop, _ in view.cut] for name, view in views.items()}


def list_parts(probe: Probe, materials: Mapping[str, PartMaterial]) -> tuple[str, ...]:
    """Return the lines of the assembly's list, in the order of its items, and below them those on bonds."""
    names = [name for name in ASSEMBLY_ITEMS if probe.film is not None or not name.startswith("film")]
    parts = tuple(f"{item}  {DRAWING_TITLES[name]}: {materials[name].text}" for item, name in enumerate(names, start=1))
    return (*parts, *_list_bonds(probe))


def _list_bonds(probe: Probe) -> list[str]:
    """Return a line on the bonds of both films, or one on those of each where they differ; none without bonds."""
    films = () if probe.film is None else probe.film.by_block
    sides = [(("base", film.bond_to_base), ("block", film.bond_to_block)) for film in films]
    texts = [", ".join(f"to the {side} with {text}" for side, bond in pairs if (text := describe_bond(bond))) for pairs in sides]
    titles = ("Film",) if len(set(texts)) == 1 else (DRAWING_TITLES["film-inner"], DRAWING_TITLES["film-outer"])
    return [f"{title} bonded {text}" for title, text in zip(titles, texts, strict=False) if text]


def describe_bond(bond: Bond | None) -> str | None:
    """Return what a bond with a thickness is, in words; None for a rigid one."""
    if bond is None or bond.is_rigid:
        return None
    thickness = f"{format_number(1e3 * bond.thickness)} mm"
    return f"{thickness} of bond" if bond.name is None else f"{bond.name} ({thickness})"
