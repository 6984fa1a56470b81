"""Build the parts of the probe as cadquery solids, in millimetres.

z = 0 is the plane of the tissue's surface and z grows towards the base: the blocks stand on it. Between the blocks' film ends and
the base lie the films, each between its bonds, which are no parts, but take up height; the base of a probe without films lies on
the blocks. The groove runs along +x.
cadquery is imported by ``load_cadquery`` alone.
"""

from __future__ import annotations

import math
import warnings
from functools import partial
from types import ModuleType
from typing import TYPE_CHECKING, Protocol, TypeVar

from geometry.common.errors import ExportError, InputError, MissingLibrary
from geometry.common.interrupts import defer_signals
from geometry.common.limits import format_maximum_mm
from geometry.scenes.base_sizes import find_base_faces, find_base_sizes, find_film_levels
from geometry.scenes.probe import Probe, format_mm
from geometry.scenes.units import MM_PER_M

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    import cadquery

T = TypeVar("T")
Corner = tuple[float, float] | tuple[float, float, float]
QUARTER_BULGE = math.tan(math.pi / 8)  # bulge of a quarter of a circle, to the left

PART_COLOURS = {
    "inner": (0.86, 0.47, 0.20),
    "outer": (0.25, 0.51, 0.71),
    "film-inner": (0.93, 0.78, 0.22),
    "film-outer": (0.45, 0.72, 0.36),
    "base": (0.62, 0.64, 0.67),
    "pin": (0.72, 0.53, 0.04),
    "ring": (0.72, 0.53, 0.04),
    "sleeve": (0.50, 0.50, 0.55),
    **{f"mould-{block}-{half}": (0.75, 0.76, 0.80) for block in ("inner", "outer") for half in ("lower", "upper")},
}


class CadQuery(Protocol):
    """What is used of cadquery: its module is one."""

    exporters: ModuleType
    importers: ModuleType
    Workplane: type[cadquery.Workplane]
    Edge: type[cadquery.Edge]
    Face: type[cadquery.Face]
    Shape: type[cadquery.Shape]
    Solid: type[cadquery.Solid]
    Vector: type[cadquery.Vector]
    Wire: type[cadquery.Wire]


def load_cadquery() -> CadQuery:
    """Import cadquery and return it.

    Raises
    ------
    MissingLibrary
        A system library such as ``libGL.so.1`` is absent; the text names the package to install.
    """
    try:
        with (
            defer_signals(),  # libraries in C++ that are torn out of their start crash, or cannot start again
            warnings.catch_warnings(),
        ):  # a user cannot act on the messages of its dependencies while they load:
            warnings.simplefilter("ignore")  # pyparsing 3.3 warns of cadquery's grammar, SWIG's types of Python 3.12
            import cadquery
    except ImportError as fault:
        if ".so" not in str(fault):
            raise
        remedy = "install the system's OpenGL library: apt install libgl1 (Debian, Ubuntu), mesa-libGL (Fedora)"
        raise MissingLibrary(f"cadquery cannot be loaded ({_get_first_line(fault)}): {remedy}") from fault
    return cadquery


def build_inner_block(probe: Probe, edge_radius: float = 0.0) -> cadquery.Solid:
    """Build the solid cylinder, its lower edge round by ``edge_radius`` (m)."""
    return _build_block(0.0, probe.inner_radius, probe.core_height, edge_radius)


def build_outer_block(probe: Probe, edge_radius: float = 0.0) -> cadquery.Solid:
    """Build the tube, its lower edges round by ``edge_radius`` (m), with its groove at the film end.

    Raises
    ------
    ExportError
        The groove does not leave one body.
    InputError
        The groove reaches down into the round edges.
    """
    tube = _build_block(probe.hole_radius, probe.tube_radius, probe.tube_height, edge_radius)
    if probe.groove is None:
        return tube
    deepest = probe.tube_height - edge_radius
    if probe.groove.depth > deepest:
        reason = f"down to the round edges of {format_mm(edge_radius)}, see contact.edge_radius"
        raise InputError("probe.groove.depth", format_mm(probe.groove.depth), f"up to {format_maximum_mm(deepest)} ({reason})")
    return _cut_groove(tube, probe, probe.tube_height - probe.groove.depth, probe.tube_height + probe.groove.depth)


def build_inner_film(probe: Probe) -> cadquery.Solid:
    """Build the disc of film above the inner block."""
    return _build_ring(0.0, probe.inner_radius, *find_film_levels(probe)[0])


def build_outer_film(probe: Probe) -> cadquery.Solid:
    """Build the ring of film above the outer block, open above the groove so that the inner film's lead can leave.

    Raises
    ------
    ExportError
        The groove does not leave one body.
    """
    bottom, top = find_film_levels(probe)[1]
    ring, thickness = _build_ring(probe.hole_radius, probe.tube_radius, bottom, top), top - bottom
    return ring if probe.groove is None else _cut_groove(ring, probe, bottom - thickness, top + thickness)


def build_base(probe: Probe) -> cadquery.Solid:
    """Build the base; where blocks, with their films and bonds, differ in height its lower face steps in the middle of the gap.

    A boss reaches down to a lower inner film, a recess takes a higher one; both keep half the gap to the blocks.

    Raises
    ------
    InputError
        See ``find_base_sizes``.
    """
    sizes, radius, (low, side) = find_base_sizes(probe), probe.tube_radius, find_base_faces(probe)
    flange = max(low, side) + sizes.step_height
    middle, top = probe.inner_radius + probe.gap / 2, flange + sizes.thickness
    lower = [(0.0, low), (middle, low), (middle, side)] if low != side else [(0.0, low)]
    shoulder = [(radius, flange), (sizes.flange_radius, flange)] if sizes.flange_radius > radius else []
    return revolve([*lower, (radius, side), *shoulder, (sizes.flange_radius, top), (0.0, top)])


def build_parts(probe: Probe, edge_radius: float = 0.0) -> dict[str, cadquery.Solid]:
    """Build all solids, by their names: inner, outer, film-inner and film-outer where there are films, base.

    Parameters
    ----------
    probe
        The probe to be built.
    edge_radius
        Of the blocks' lower edges in m, a scene's ``contact.edge_radius``; 0: sharp.

    Raises
    ------
    ExportError
        The modeller cannot build a part, as with sizes near its tolerance of 1e-7 mm.
    InputError
        See ``build_outer_block`` and ``find_base_sizes``.
    MissingLibrary
        See ``load_cadquery``.
    """
    load_cadquery()
    films = {} if probe.film is None else {"film-inner": build_inner_film, "film-outer": build_outer_film}
    blocks = {
        "inner": partial(build_inner_block, edge_radius=edge_radius),
        "outer": partial(build_outer_block, edge_radius=edge_radius),
    }
    builders: dict[str, Callable[[Probe], cadquery.Solid]] = {**blocks, **films, "base": build_base}
    return {name: call_modeller(name, partial(builder, probe)) for name, builder in builders.items()}


def call_modeller(name: str, make: Callable[[], T]) -> T:
    """Call ``make`` and turn the modeller's own exceptions into ``ExportError`` naming the part."""
    try:
        return make()
    except Exception as fault:  # OCP's exceptions have no common base, only their module's name
        modellers = type(fault).__module__.startswith("OCP") or type(fault) is ValueError
        if not modellers:
            raise
        raise ExportError(f"{name}: the modeller fails: {type(fault).__name__} {_get_first_line(fault)}".rstrip()) from fault


def _build_ring(inner: float, outer: float, bottom: float, top: float) -> cadquery.Solid:
    """Build a ring between two radii and two heights, m; a disc if ``inner`` is 0."""
    return revolve([(inner, bottom), (outer, bottom), (outer, top), (inner, top)])


def _build_block(inner: float, outer: float, top: float, edge: float) -> cadquery.Solid:
    """Build a ring that stands on z = 0, its lower edges rounded with radius ``edge``; a disc, of ``inner`` 0, has one edge."""
    if edge == 0:
        return _build_ring(inner, outer, 0.0, top)
    foot: list[Corner] = [(inner, edge, QUARTER_BULGE), (inner + edge, 0.0)] if inner > 0 else [(0.0, 0.0)]
    return revolve([*foot, (outer - edge, 0.0, QUARTER_BULGE), (outer, edge), (outer, top), (inner, top)])


def revolve(profile: Sequence[Corner], scale: float = MM_PER_M, side: int = 1) -> cadquery.Solid:
    """Build one solid of revolution about z from its closed profile: exact where booleans would leave tolerances.

    Parameters
    ----------
    profile
        Corners (r, z), some with the bulge of the arc to the next corner, tan(angle/4), positive to the left.
    scale
        Millimetres of their unit of length.
    side
        Whether the surfaces' seam lies at +x (1), where a groove removes it, or at -x (-1).
    """
    cq, edges = load_cadquery(), []
    points = [(scale * corner[0], scale * corner[1]) for corner in profile]
    for corner, (r, z), (next_r, next_z) in zip(profile, points, [*points[1:], points[0]], strict=True):
        bulge = corner[2] if len(corner) == 3 else 0.0
        middle = (r + next_r + bulge * (next_z - z)) / 2, (z + next_z - bulge * (next_r - r)) / 2
        start, halfway, end = (cq.Vector(side * x, 0, y) for x, y in ((r, z), middle, (next_r, next_z)))
        edges.append(cq.Edge.makeThreePointArc(start, halfway, end) if bulge else cq.Edge.makeLine(start, end))
    face = cq.Face.makeFromWires(cq.Wire.assembleEdges(edges))
    return cq.Solid.revolve(face, 360.0, cq.Vector(0, 0, 0), cq.Vector(0, 0, 1))


def _cut_groove(tube: cadquery.Solid, probe: Probe, bottom: float, top: float) -> cadquery.Solid:
    """Cut the groove between two heights, m, out of a tube or film; raise ``ExportError`` unless one body is left."""
    cq, groove = load_cadquery(), probe.groove
    assert groove is not None  # the callers ask
    a, far, low = groove.width / 2 * MM_PER_M, 1.5 * probe.tube_radius * MM_PER_M, bottom * MM_PER_M
    # a wedge from the axis to the hole's wall, whose corners are computed here: a groove almost as wide as the hole meets
    # the wall at an angle so small that OCC, left to find the corner, is off by more than its tolerance
    wall = math.sqrt((probe.hole_radius * MM_PER_M - a) * (probe.hole_radius * MM_PER_M + a))
    outline = [cq.Vector(x, y, low) for x, y in ((0.0, 0.0), (wall, -a), (far, -a), (far, a), (wall, a))]
    face = cq.Face.makeFromWires(cq.Wire.makePolygon(outline, close=True))
    tool = cq.Solid.extrudeLinear(face, cq.Vector(0, 0, (top - bottom) * MM_PER_M))
    pieces = tube.cut(tool).Solids()
    if len(pieces) != 1:
        raise ExportError(f"outer: bodies left by the groove = {len(pieces)}, expected 1 (groove {format_mm(groove.width)} wide)")
    return pieces[0]


def _get_first_line(fault: Exception) -> str:
    """Return the first line of an exception's text."""
    return str(fault).strip().split("\n", 1)[0]
