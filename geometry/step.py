"""STEP files of the parts and of their assembly, each read back and measured before it takes its place."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from itertools import combinations, pairwise
from pathlib import Path
from typing import Any

from geometry import solids
from geometry.errors import ExportError
from geometry.files import written_whole
from geometry.probe import Probe

ASSEMBLY = "probe"
"""Name of the assembly inside ``assembly.step``."""
TOLERANCE = 1e-6
"""Largest relative mismatch between a dimension read back and the parameters."""

_PARALLEL = 1e-12  # sine of the angle below which two directions count as parallel: OCC's own tolerance
Part = tuple[str, Any, tuple[float, float, float]]  # name, shape, colour as linear red, green and blue
Row = tuple[str, float, float, float]  # quantity, found, expected, and the size that the mismatch is relative to


@dataclass(frozen=True)
class Body:
    """What is measured of a solid and what is expected of it, in mm.

    Attributes:
        volume: in mm^3.
        ends: (z, area) of each plane face normal to z, from below.
        radii: of each cylindrical face about z, from the smallest.
        walls: (y, x of the centre, area) of each plane face normal to y.
        off_axis: largest distance of a cylinder's axis from the z axis.

    """

    volume: float
    ends: tuple[tuple[float, float], ...]
    radii: tuple[float, ...]
    walls: tuple[tuple[float, float, float], ...] = ()
    off_axis: float = 0.0


def export(probe: Probe, folder: Path) -> tuple[Path, ...]:
    """Write inner, outer, film-inner, film-outer, base and assembly ``.step`` (mm) into ``folder``; returns their paths.

    Every draft is read back and compared with the probe's parameters through formulas that know nothing of the CAD
    model; the files take their names only after all have passed, each of them whole.

    Raises:
        ExportError: a file does not hold what the parameters say, to ``TOLERANCE``; no file is left.
        InputError: see ``solids.base_sizes``.
        MissingLibrary: see ``solids.cadquery``.
        OSError: the folder cannot be written.

    """
    with _quiet(), ExitStack() as stack:
        shapes = solids.parts(probe)
        contents = {name: {name: shape} for name, shape in shapes.items()} | {"assembly": shapes}
        paths = {name: Path(folder, f"{name}.step") for name in contents}
        drafts = {name: stack.enter_context(written_whole(path)) for name, path in paths.items()}
        for name, content in contents.items():
            solids.built(paths[name].name, partial(_write, content, drafts[name]))
        solids.built("reading back", partial(_check, probe, drafts))
    return tuple(paths.values())


def expected_bodies(probe: Probe) -> dict[str, Body]:
    """Derive what each part must measure from the probe's parameters alone."""
    mm, groove = solids.MM, probe.groove
    r2, ri, ro = probe.inner_radius * mm, probe.hole_radius * mm, probe.tube_radius * mm
    h2, h1, t = probe.core_height * mm, probe.tube_height * mm, solids.film_thickness(probe) * mm
    a2, a1, cut = probe.inner_area * mm**2, probe.outer_area * mm**2, solids.groove_footprint(probe) * mm**2
    floor: tuple[tuple[float, float], ...] = ()
    depth = 0.0
    if groove is not None:
        depth = groove.depth * mm
        floor = ((h1 - depth, cut),)
    return {
        "inner": Body(a2 * h2, ((0, a2), (h2, a2)), (r2,)),
        "outer": Body(a1 * h1 - cut * depth, ((0, a1), *floor, (h1, a1 - cut)), (ri, ro), _walls(probe, depth)),
        "film-inner": Body(a2 * t, ((h2, a2), (h2 + t, a2)), (r2,)),
        "film-outer": Body((a1 - cut) * t, ((h1, a1 - cut), (h1 + t, a1 - cut)), (ri, ro), _walls(probe, t)),
        "base": _expected_base(probe),
    }


def _walls(probe: Probe, height: float) -> tuple[tuple[float, float, float], ...]:
    """Return the groove's two sides, from the hole at x_i = sqrt(Ri^2 - a^2) to the outside at x_o, a = width/2."""
    if probe.groove is None:
        return ()
    a, ri, ro = (size * solids.MM for size in (probe.groove.width / 2, probe.hole_radius, probe.tube_radius))
    x_i, x_o = (math.sqrt((radius - a) * (radius + a)) for radius in (ri, ro))
    area = height * (ro - ri) * (ro + ri) / (x_o + x_i)
    return ((-a, (x_i + x_o) / 2, area), (a, (x_i + x_o) / 2, area))


def _expected_base(probe: Probe) -> Body:
    mm, sizes = solids.MM, solids.base_sizes(probe)
    ro, rf, rm = probe.tube_radius * mm, sizes.flange_radius * mm, (probe.inner_radius + probe.gap / 2) * mm
    low, side = (height * mm for height in solids.film_tops(probe))
    under = max(low, side) + sizes.step_height * mm
    top = under + sizes.thickness * mm
    middle, ring, flange = math.pi * rm**2, math.pi * (ro - rm) * (ro + rm), math.pi * rf**2
    ends = [(low, middle), (side, ring)] if low != side else [(low, math.pi * ro**2)]
    if rf > ro:
        ends.append((under, math.pi * (rf - ro) * (rf + ro)))
    volume = middle * (under - low) + ring * (under - side) + flange * (top - under)
    radii = {*((rm,) if low != side else ()), ro, rf}
    return Body(volume, tuple(sorted([*ends, (top, flange)])), tuple(sorted(radii)))


def _check(probe: Probe, drafts: dict[str, Path]) -> None:
    expected = expected_bodies(probe)
    found = {name: _check_part(drafts[name], name, body) for name, body in expected.items()}
    _compare("inner.step and outer.step", _between(probe, found))
    _check_assembly(drafts["assembly"], probe, expected)


def _check_part(path: Path, name: str, expected: Body) -> Body:
    (_, shape, _), *_ = _read_named(path, [name])
    return _check_body(path.name, shape, expected)


def _check_assembly(path: Path, probe: Probe, expected: dict[str, Body]) -> None:
    read = dict(zip(expected, _read_named(path, [f"{ASSEMBLY}/{name}" for name in expected]), strict=True))
    for name, (_, _, colour) in read.items():
        _compare(path.name, [(f"{name}: colour", *pair, 1.0) for pair in zip(colour, _rgb(_colour(name)), strict=True)])
    found = {name: _check_body(f"{path.name}: {name}", shape, expected[name]) for name, (_, shape, _) in read.items()}
    _compare(path.name, _between(probe, found))
    total = sum(body.volume for body in expected.values())
    _compare(path.name, [("volume", sum(body.volume for body in found.values()), total, total)])
    for (one, (_, first, _)), (other, (_, second, _)) in combinations(read.items(), 2):
        _check_apart(f"{path.name}: {one} and {other}", first, second)


def _read_named(path: Path, names: list[str]) -> list[Part]:
    read = _read(path)
    if [name for name, _, _ in read] != names:
        raise ExportError(f"{path.name}: parts = {[name for name, _, _ in read]}, expected {names}")
    return read


def _check_apart(where: str, first: Any, second: Any) -> None:
    common = solids.built(where, lambda: first.intersect(second))
    scale = min(first.Volume(), second.Volume())
    _compare(where, [("common volume", sum(solid.Volume() for solid in common.Solids()), 0.0, scale)])


def _check_body(where: str, shape: Any, expected: Body) -> Body:
    """Raise unless ``shape`` is one valid closed solid that measures what is expected; returns what it measures."""
    if shape.ShapeType() != "Solid" or not shape.isValid():
        raise ExportError(f"{where}: shape = {shape.ShapeType()}, valid = {shape.isValid()}, expected a valid Solid")
    closed = [shell.wrapped.Closed() for shell in shape.Shells()]
    if closed != [True]:
        raise ExportError(f"{where}: closed shells = {closed}, expected [True]")
    found = _measure(where, shape)
    for key in ("ends", "radii", "walls"):
        count, wanted = len(getattr(found, key)), len(getattr(expected, key))
        if count != wanted:
            raise ExportError(f"{where}: number of {key} = {count}, expected {wanted}")
    _compare(where, _rows(found, expected))
    return found


def _rows(found: Body, expected: Body) -> Iterator[Row]:
    """Yield volume, areas and radii; distances between neighbouring faces, among them every height, thickness and groove size."""
    yield "volume", found.volume, expected.volume, expected.volume
    for (z, area), (wanted_z, wanted) in zip(found.ends, expected.ends, strict=True):
        yield f"z of the face at {wanted_z:.6g} mm", z, wanted_z, expected.ends[-1][0]
        yield f"area of the face at z = {wanted_z:.6g} mm", area, wanted, wanted
    for (low, high), (from_z, to_z) in zip(pairwise(found.ends), pairwise(expected.ends), strict=True):
        length = to_z[0] - from_z[0]
        yield f"length from z = {from_z[0]:.6g} to {to_z[0]:.6g} mm", high[0] - low[0], length, length
    for radius, wanted in zip(found.radii, expected.radii, strict=True):
        yield "radius", radius, wanted, wanted
    for side, wanted_side in zip(found.walls, expected.walls, strict=True):
        for quantity, value, wish in zip(("y", "middle x", "area"), side, wanted_side, strict=True):
            yield f"{quantity} of the groove's side", value, wish, abs(wish)


def _between(probe: Probe, found: dict[str, Body]) -> Iterator[Row]:
    """Yield what holds between the parts: the area ratio, the gap and the common axis."""
    ratio = probe.inner_area / probe.outer_area if probe.area_ratio is None else probe.area_ratio
    yield "area ratio A2/A1", found["inner"].ends[0][1] / found["outer"].ends[0][1], ratio, ratio
    gap = probe.gap * solids.MM
    yield "gap", found["outer"].radii[0] - found["inner"].radii[0], gap, gap
    for name, body in found.items():
        yield f"{name}: distance of its axis from z", body.off_axis, 0.0, gap


def _compare(where: str, rows: Iterable[Row]) -> None:
    for quantity, found, expected, scale in rows:
        if not abs(found - expected) <= TOLERANCE * scale:  # so that NaN fails too
            raise ExportError(f"{where}: {quantity} = {found:.12g}, expected {expected:.12g} within {TOLERANCE:g} of {scale:.6g}")


def _measure(where: str, solid: Any) -> Body:
    from OCP.BRepAdaptor import BRepAdaptor_Surface

    ends, radii, walls, off_axis = [], [], [], 0.0
    for face in solid.Faces():
        kind, surface = face.geomType(), BRepAdaptor_Surface(face.wrapped)
        axis = surface.Plane().Axis() if kind == "PLANE" else surface.Cylinder().Axis() if kind == "CYLINDER" else None
        place, x, y, z = _origin_and_direction(axis)
        if kind == "PLANE" and math.hypot(x, y) < _PARALLEL:
            ends.append((place.Z(), face.Area()))
        elif kind == "CYLINDER" and math.hypot(x, y) < _PARALLEL:
            radii.append(surface.Cylinder().Radius())
            off_axis = max(off_axis, math.hypot(place.X(), place.Y()))
        elif kind == "PLANE" and math.hypot(x, z) < _PARALLEL:
            walls.append((place.Y(), face.Center().x, face.Area()))
        else:
            raise ExportError(f"{where}: a face = {kind} along ({x:.6g}, {y:.6g}, {z:.6g}), expected planes or cylinders along z")
    return Body(solid.Volume(), tuple(sorted(ends)), tuple(sorted(radii)), tuple(sorted(walls)), off_axis)


def _origin_and_direction(axis: Any) -> tuple[Any, float, float, float]:
    if axis is None:
        return None, math.nan, math.nan, math.nan
    direction = axis.Direction()
    return axis.Location(), direction.X(), direction.Y(), direction.Z()


def _write(shapes: dict[str, Any], path: Path) -> None:
    """Write one solid, or several as the components of an assembly, with their names and colours."""
    from OCP.IFSelect import IFSelect_ReturnStatus
    from OCP.STEPCAFControl import STEPCAFControl_Writer
    from OCP.TopLoc import TopLoc_Location
    from OCP.XCAFDoc import XCAFDoc_ColorType, XCAFDoc_DocumentTool

    document, writer = _document(), STEPCAFControl_Writer()
    tool, colours = XCAFDoc_DocumentTool.ShapeTool_s(document.Main()), XCAFDoc_DocumentTool.ColorTool_s(document.Main())
    whole = _named(tool.NewShape(), ASSEMBLY) if len(shapes) > 1 else None
    for name, shape in shapes.items():
        # the solid itself: wrapped in a compound, as cadquery's exporter has it, it reads back as a nameless assembly
        label = _named(tool.AddShape(shape.wrapped, False), name)
        colours.SetColor(label, _colour(name), XCAFDoc_ColorType.XCAFDoc_ColorSurf)
        if whole is not None:
            _named(tool.AddComponent(whole, label, TopLoc_Location()), name)
    tool.UpdateAssemblies()
    if not writer.Transfer(document) or writer.Write(str(path)) != IFSelect_ReturnStatus.IFSelect_RetDone:
        raise ExportError(f"{path.name}: the STEP writer stopped, expected a file in {path.parent.parent}")


def _named(label: Any, name: str) -> Any:
    from OCP.TCollection import TCollection_ExtendedString
    from OCP.TDataStd import TDataStd_Name

    TDataStd_Name.Set_s(label, TCollection_ExtendedString(name))
    return label


def _colour(name: str) -> Any:
    from OCP.Quantity import Quantity_Color, Quantity_TypeOfColor

    return Quantity_Color(*solids.COLOURS[name], Quantity_TypeOfColor.Quantity_TOC_sRGB)


def _read(path: Path) -> list[Part]:
    """Name, shape and colour of every part in a STEP file that declares millimetres."""
    from OCP.IFSelect import IFSelect_ReturnStatus
    from OCP.STEPCAFControl import STEPCAFControl_Reader

    unit = re.search(rb"LENGTH_UNIT\(\)[^;]*?SI_UNIT\(([^)]*)\)", path.read_bytes())
    if unit is None or unit[1] != b".MILLI.,.METRE.":
        raise ExportError(f"{path.name}: unit = {unit and unit[1].decode()}, expected .MILLI.,.METRE.")
    reader, document = STEPCAFControl_Reader(), _document()
    if reader.ReadFile(str(path)) != IFSelect_ReturnStatus.IFSelect_RetDone or not reader.Transfer(document):
        raise ExportError(f"{path.name}: the STEP reader stopped, expected a readable file")
    return _parts(document)


def _document() -> Any:
    from OCP.TCollection import TCollection_ExtendedString
    from OCP.TDocStd import TDocStd_Document
    from OCP.XCAFApp import XCAFApp_Application

    document = TDocStd_Document(TCollection_ExtendedString("XmlXCAF"))
    XCAFApp_Application.GetApplication_s().InitDocument(document)
    return document


def _parts(document: Any) -> list[Part]:
    from OCP.TDF import TDF_Label, TDF_LabelSequence
    from OCP.XCAFDoc import XCAFDoc_DocumentTool, XCAFDoc_ShapeTool

    labels = TDF_LabelSequence()
    XCAFDoc_DocumentTool.ShapeTool_s(document.Main()).GetFreeShapes(labels)
    found = []
    for label in _each(labels):
        components = TDF_LabelSequence()
        XCAFDoc_ShapeTool.GetComponents_s(label, components)
        for placed in _each(components):
            part = TDF_Label()
            XCAFDoc_ShapeTool.GetReferredShape_s(placed, part)
            found.append(_part(f"{_name(label)}/{_name(part)}", part, placed))
        if components.IsEmpty():
            found.append(_part(_name(label), label, label))
    return found


def _each(labels: Any) -> list[Any]:
    return [labels.Value(index + 1) for index in range(labels.Length())]


def _part(name: str, label: Any, placed: Any) -> Part:
    from OCP.Quantity import Quantity_Color
    from OCP.XCAFDoc import XCAFDoc_ColorTool, XCAFDoc_ColorType, XCAFDoc_ShapeTool

    colour = Quantity_Color()
    kinds = (XCAFDoc_ColorType.XCAFDoc_ColorSurf, XCAFDoc_ColorType.XCAFDoc_ColorGen)
    coloured = any(XCAFDoc_ColorTool.GetColor_s(label, kind, colour) for kind in kinds)
    shape = solids.cadquery().Shape.cast(XCAFDoc_ShapeTool.GetShape_s(placed))
    return name, shape, _rgb(colour) if coloured else (math.nan,) * 3


def _name(label: Any) -> str:
    from OCP.TDataStd import TDataStd_Name

    name = TDataStd_Name()
    return name.Get().ToExtString() if label.FindAttribute(TDataStd_Name.GetID_s(), name) else ""


def _rgb(colour: Any) -> tuple[float, float, float]:
    return colour.Red(), colour.Green(), colour.Blue()


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep OCC's own messages off stdout, where the program prints its JSON."""
    solids.cadquery()
    from OCP.Message import Message

    messenger = Message.DefaultMessenger_s()
    printers = list(messenger.Printers())
    for printer in printers:
        messenger.RemovePrinter(printer)
    try:
        yield
    finally:
        for printer in printers:
            messenger.AddPrinter(printer)
