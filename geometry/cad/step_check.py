"""Read STEP files back, measure their parts, and compare these with the probe's parameters."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from itertools import combinations, pairwise
from pathlib import Path
from typing import TYPE_CHECKING

from geometry.cad import solids
from geometry.cad.parts_check import PartMeasures, compute_expected_bodies
from geometry.cad.step_reader import Part, read_rgb, read_step
from geometry.cad.step_writer import ASSEMBLY_NAME, find_colour
from geometry.common.errors import ExportError
from geometry.scenes.probe import Probe
from geometry.scenes.units import MM_PER_M

if TYPE_CHECKING:
    import cadquery


RELATIVE_TOLERANCE = 1e-6
"""Largest relative mismatch between a dimension read back and the parameters."""

MAX_PARALLEL_SINE = 1e-12  # sine of the angle below which two directions count as parallel: OCC's own tolerance
Row = tuple[str, float, float, float]  # quantity, found, expected, and the size that the mismatch is relative to


def check_files(probe: Probe, drafts: dict[str, Path], edge_radius: float = 0.0) -> None:
    """Compare the files of all parts and of the assembly, by their names, with the probe and the radius of its lower edges (m).

    Raises
    ------
    ExportError
        A file deviates from the parameters by more than ``RELATIVE_TOLERANCE``.
    """
    expected = compute_expected_bodies(probe, edge_radius)
    measured = {name: check_part_file(drafts[name], name, body) for name, body in expected.items()}
    _check_rows("inner.step and outer.step", _compare_parts(probe, measured))
    _check_assembly(drafts["assembly"], probe, expected)


def check_part_file(path: Path, name: str, expected: PartMeasures) -> PartMeasures:
    """Read a file of one part back and compare it; return its measures. Raises ``ExportError``."""
    (_, shape, _), *_ = _read_named(path, [name])
    return check_body(path.name, shape, expected)


def check_volume(path: Path, name: str, volume: float) -> None:
    """Raise ``ExportError`` unless a file holds one valid closed solid of this name and volume, mm^3."""
    (_, shape, _), *_ = _read_named(path, [name])
    _check_solid(path.name, shape)
    _check_rows(path.name, [("volume", shape.Volume(), volume, volume)])


def _check_assembly(path: Path, probe: Probe, expected: dict[str, PartMeasures]) -> None:
    """Compare names, colours, measures and positions of the parts in the assembly's file. Raises ``ExportError``."""
    parts = dict(zip(expected, _read_named(path, [f"{ASSEMBLY_NAME}/{name}" for name in expected]), strict=True))
    for name, (_, _, colour) in parts.items():
        _check_rows(
            path.name, [(f"{name}: colour", *pair, 1.0) for pair in zip(colour, read_rgb(find_colour(name)), strict=True)]
        )
    measured = {name: check_body(f"{path.name}: {name}", shape, expected[name]) for name, (_, shape, _) in parts.items()}
    _check_rows(path.name, _compare_parts(probe, measured))
    total = sum(body.volume for body in expected.values())
    _check_rows(path.name, [("volume", sum(body.volume for body in measured.values()), total, total)])
    for (first_name, (_, first, _)), (second_name, (_, second, _)) in combinations(parts.items(), 2):
        _check_apart(f"{path.name}: {first_name} and {second_name}", first, second)


def _read_named(path: Path, names: list[str]) -> list[Part]:
    """Return the parts in a file. Raises ``ExportError`` unless they have these names, in this order."""
    parts = read_step(path)
    if [name for name, _, _ in parts] != names:
        raise ExportError(f"{path.name}: parts = {[name for name, _, _ in parts]}, expected {names}")
    return parts


def _check_apart(file_label: str, first: cadquery.Shape, second: cadquery.Shape) -> None:
    """Raise ``ExportError`` if two parts have a common volume."""
    common = solids.call_modeller(file_label, lambda: first.intersect(second))
    scale = min(first.Volume(), second.Volume())
    _check_rows(file_label, [("common volume", sum(solid.Volume() for solid in common.Solids()), 0.0, scale)])


def check_body(file_label: str, shape: cadquery.Shape, expected: PartMeasures) -> PartMeasures:
    """Raise unless ``shape`` is one valid closed solid with the expected measures; return its measures."""
    _check_solid(file_label, shape)
    measured = _measure(file_label, shape)
    for key in ("ends", "radii", "walls", "edges"):
        count, expected_count = len(getattr(measured, key)), len(getattr(expected, key))
        if count != expected_count:
            raise ExportError(f"{file_label}: number of {key} = {count}, expected {expected_count}")
    _check_rows(file_label, _compare_measures(measured, expected))
    return measured


def _check_solid(file_label: str, shape: cadquery.Shape) -> None:
    """Raise ``ExportError`` unless a shape is one valid closed solid."""
    if shape.ShapeType() != "Solid" or not shape.isValid():
        raise ExportError(f"{file_label}: shape = {shape.ShapeType()}, valid = {shape.isValid()}, expected a valid Solid")
    closed = [shell.wrapped.Closed() for shell in shape.Shells()]
    if closed != [True]:
        raise ExportError(f"{file_label}: closed shells = {closed}, expected [True]")


def _compare_measures(measured: PartMeasures, expected: PartMeasures) -> Iterator[Row]:
    """Yield volume, areas and radii; distances between neighbouring faces, among them every height, thickness and groove size."""
    yield "volume", measured.volume, expected.volume, expected.volume
    farthest = max(abs(z) for z, _ in expected.ends)
    for (z, area), (expected_z, expected_area) in zip(measured.ends, expected.ends, strict=True):
        yield f"z of the face at {expected_z:.6g} mm", z, expected_z, farthest
        yield f"area of the face at z = {expected_z:.6g} mm", area, expected_area, expected_area
    for (low, high), (from_z, to_z) in zip(pairwise(measured.ends), pairwise(expected.ends), strict=True):
        length = to_z[0] - from_z[0]
        yield f"length from z = {from_z[0]:.6g} to {to_z[0]:.6g} mm", high[0] - low[0], length, length
    for radius, expected_radius in zip(measured.radii, expected.radii, strict=True):
        yield "radius", radius, expected_radius, expected_radius
    for side, expected_side in zip(measured.walls, expected.walls, strict=True):
        for quantity, value, wish in zip(("y", "middle x", "area"), side, expected_side, strict=True):
            yield f"{quantity} of the groove's side", value, wish, abs(wish)
    for edge, expected_edge in zip(measured.edges, expected.edges, strict=True):
        for quantity, value, wish in zip(("centres' radius", "radius", "z", "area"), edge, expected_edge, strict=True):
            yield f"{quantity} of a round edge", value, wish, wish


def _compare_parts(probe: Probe, measured: dict[str, PartMeasures]) -> Iterator[Row]:
    """Yield the measures that involve two parts: the area ratio, the gap and the common axis."""
    ratio = probe.inner_area / probe.outer_area if probe.area_ratio is None else probe.area_ratio
    # of the faces that look up, the groove's floor among them: round edges leave these whole
    inner, outer = (sum(area for _, area in measured[name].ends[1:]) for name in ("inner", "outer"))
    yield "area ratio A2/A1", inner / outer, ratio, ratio
    gap = probe.gap * MM_PER_M
    yield "gap", measured["outer"].radii[0] - measured["inner"].radii[0], gap, gap
    for name, body in measured.items():
        yield f"{name}: distance of its axis from z", body.off_axis, 0.0, gap


def _check_rows(file_label: str, rows: Iterable[Row]) -> None:
    """Raise ``ExportError`` for the first row that differs by more than ``RELATIVE_TOLERANCE`` of its size."""
    for quantity, measured, expected, scale in rows:
        if not abs(measured - expected) <= RELATIVE_TOLERANCE * scale:  # so that NaN fails too
            raise ExportError(
                f"{file_label}: {quantity} = {measured:.12g}, expected {expected:.12g} within {RELATIVE_TOLERANCE:g} of "
                f"{scale:.6g}"
            )


def _measure(file_label: str, solid: cadquery.Shape) -> PartMeasures:
    """Return the measures of a solid. Raises ``ExportError`` for a face that no part of a probe has."""
    from OCP.BRepAdaptor import BRepAdaptor_Surface
    from OCP.gp import gp_Ax1

    ends, radii, walls, edges, off_axis = [], [], [], [], 0.0
    for face in solid.Faces():
        kind, surface = face.geomType(), BRepAdaptor_Surface(face.wrapped)
        shape = {"PLANE": surface.Plane, "CYLINDER": surface.Cylinder, "TORUS": surface.Torus}.get(kind)
        # a plane's axis is its normal; NaN, for other kinds of faces, passes none of the comparisons below
        axis = gp_Ax1() if shape is None else shape().Axis()
        place, direction = axis.Location(), axis.Direction()
        x, y, z = (direction.X(), direction.Y(), direction.Z()) if shape is not None else (math.nan,) * 3
        if kind == "PLANE" and math.hypot(x, y) < MAX_PARALLEL_SINE:
            ends.append((place.Z(), face.Area()))
        elif kind == "CYLINDER" and math.hypot(x, y) < MAX_PARALLEL_SINE:
            radii.append(surface.Cylinder().Radius())
            off_axis = max(off_axis, math.hypot(place.X(), place.Y()))
        elif kind == "TORUS" and math.hypot(x, y) < MAX_PARALLEL_SINE:
            edges.append((surface.Torus().MajorRadius(), surface.Torus().MinorRadius(), place.Z(), face.Area()))
            off_axis = max(off_axis, math.hypot(place.X(), place.Y()))
        elif kind == "PLANE" and math.hypot(x, z) < MAX_PARALLEL_SINE:
            walls.append((place.Y(), face.Center().x, face.Area()))
        else:
            allowed = "planes, cylinders or tori along z"
            raise ExportError(f"{file_label}: a face = {kind} along ({x:.6g}, {y:.6g}, {z:.6g}), expected {allowed}")
    return PartMeasures(
        solid.Volume(), tuple(sorted(ends)), tuple(sorted(radii)), tuple(sorted(walls)), off_axis, tuple(sorted(edges))
    )
