"""Build the calibration fixture: a pin and a ring that each press on one block alone, and a sleeve that centres them on the base.

Pin and ring stand on carriers of the base's radius. The sleeve slides over the carrier and up over the base's rim, centres one on
the other, and slides down on the carrier again before the load is switched on; its slot lets the films' leads out. z = 0 is the
plane of the blocks' lower ends, as in ``geometry.cad.solids``, on which pin and ring press from below. Millimetres.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from geometry.cad import solids, step_check, step_writer
from geometry.cad.parts_check import PartMeasures
from geometry.cad.stamp import Stamp, build_stamp
from geometry.common.errors import InputError
from geometry.scenes.base_sizes import find_base_faces, find_base_sizes
from geometry.scenes.probe import Probe, compute_groove_footprint, format_mm
from geometry.scenes.units import MM_PER_M

if TYPE_CHECKING:
    import cadquery


RING_ALIGNMENT_MM = 0.05  # mm: of the ring's axis with the probe's
SLEEVE_PLAY_MM = 0.015  # mm between the sleeve and either rim, on the radius; turning centres each part to 0.01
EDGE_MARGIN_MM = 2 * RING_ALIGNMENT_MM  # of what presses to the edge of the block, so that the other one is never touched
CARRIER_RISE_MM = 2.0  # of pin and ring above their carrier
SLEEVE_GRIP_MM = 1.5  # of the sleeve on carrier and base
SLEEVE_WALL_MM, MIN_SLOT_MM, FOOT_HEIGHT_MM = 3.0, 3.0, 4.0  # the sleeve's wall, the minimum width of its slot, the foot's height
FIXTURE_PARTS = ("pin", "ring", "sleeve")


@dataclass(frozen=True)
class FixtureSizes:
    """Dimensions in mm.

    Attributes
    ----------
    pin
        Radius.
    ring
        Inner and outer radius of its face.
    carrier
        Radius, which is the base's.
    bore
        Radius of the sleeve's.
    sleeve
        Its length: grip, rise, blocks and films, grip.
    slot
        Its width.
    """

    pin: float
    ring: tuple[float, float]
    carrier: float
    bore: float
    sleeve: float
    slot: float


def find_fixture_sizes(probe: Probe) -> FixtureSizes:
    """Derive the fixture from the probe.

    Raises
    ------
    InputError
        A block is too narrow for what is aligned to 0.05 mm.
    """
    scale, base = MM_PER_M, find_base_sizes(probe)
    pin = probe.inner_radius * scale - EDGE_MARGIN_MM
    ring = probe.hole_radius * scale + EDGE_MARGIN_MM, probe.tube_radius * scale - EDGE_MARGIN_MM
    if pin < EDGE_MARGIN_MM:
        raise InputError(
            "probe.inner_radius", format_mm(probe.inner_radius), f"{2 * EDGE_MARGIN_MM:g} mm or more for a pin on it alone"
        )
    if ring[1] - ring[0] < EDGE_MARGIN_MM:
        wall = format_mm(probe.tube_radius - probe.hole_radius)
        raise InputError(
            "probe.outer_radius", f"a wall of {wall}", f"a wall of {3 * EDGE_MARGIN_MM:g} mm or more for a ring on it alone"
        )
    reach = (max(find_base_faces(probe)) + base.step_height) * scale
    slot = max(MIN_SLOT_MM, 0.0 if probe.groove is None else 2 * probe.groove.width * scale)
    carrier = base.flange_radius * scale
    return FixtureSizes(
        pin,
        ring,
        carrier,
        carrier + SLEEVE_PLAY_MM,
        SLEEVE_GRIP_MM + CARRIER_RISE_MM + reach + SLEEVE_GRIP_MM,
        min(slot, carrier),
    )


def build_fixture(probe: Probe) -> dict[str, cadquery.Solid]:
    """Build pin, ring and sleeve, sleeve where it centres; raises as ``solids.build_parts``, and as ``find_fixture_sizes``."""
    sizes = find_fixture_sizes(probe)
    builders = {"pin": _build_pin, "ring": _build_ring, "sleeve": _build_sleeve}
    return {name: solids.call_modeller(name, partial(builder, sizes)) for name, builder in builders.items()}


def build_writers(probe: Probe) -> dict[str, Callable[[Path], object]]:
    """Return by file name the function that writes a part as STEP, reads it back and measures it; raise as ``build_fixture``."""
    solids.load_cadquery()
    shapes, expected, stamp = build_fixture(probe), compute_expected_fixture(probe), build_stamp(probe)
    return {f"{name}.step": partial(_write, name, shapes[name], expected[name], stamp) for name in FIXTURE_PARTS}


def compute_expected_fixture(probe: Probe) -> dict[str, PartMeasures]:
    """Derive what each part must measure from its sizes alone: formulas that know nothing of the CAD model."""
    sizes = find_fixture_sizes(probe)
    low, top, foot = -CARRIER_RISE_MM - sizes.sleeve, -CARRIER_RISE_MM, math.pi * (sizes.carrier + SLEEVE_WALL_MM) ** 2
    body = math.pi * sizes.carrier**2
    carrier = foot * FOOT_HEIGHT_MM + body * sizes.sleeve
    faces, outside = (
        {"pin": math.pi * sizes.pin**2, "ring": math.pi * (sizes.ring[1] ** 2 - sizes.ring[0] ** 2)},
        sizes.carrier + SLEEVE_WALL_MM,
    )
    ends = ((low - FOOT_HEIGHT_MM, foot), (low, foot - body))
    radii = {"pin": (sizes.pin, sizes.carrier, outside), "ring": (*sizes.ring, sizes.carrier, outside)}
    inside = math.pi * sizes.ring[0] ** 2  # of the ring, a face of its own
    tops = {"pin": ((top, body - faces["pin"]),), "ring": ((top, inside), (top, body - faces["ring"] - inside))}
    blocks = {
        name: PartMeasures(carrier + face * CARRIER_RISE_MM, (*ends, *sorted(tops[name]), (0.0, face)), radii[name])
        for name, face in faces.items()
    }
    return blocks | {"sleeve": _compute_expected_sleeve(sizes)}


def _compute_expected_sleeve(sizes: FixtureSizes) -> PartMeasures:
    """Compute the measures of the sleeve: a tube whose slot removes |y| < a, x > 0 from the carrier's top upwards."""
    a, inner, outer, low = sizes.slot / 2, sizes.bore, sizes.bore + SLEEVE_WALL_MM, -CARRIER_RISE_MM - SLEEVE_GRIP_MM
    strip = compute_groove_footprint(inner, outer, a)
    annulus = math.pi * (outer**2 - inner**2)
    high = sizes.sleeve - SLEEVE_GRIP_MM
    x_i, x_o = math.sqrt(inner**2 - a**2), math.sqrt(outer**2 - a**2)
    wall = ((x_i + x_o) / 2, high * (x_o - x_i))
    ends = ((low, annulus), (-CARRIER_RISE_MM, strip), (low + sizes.sleeve, annulus - strip))
    return PartMeasures(annulus * sizes.sleeve - strip * high, ends, (inner, outer), ((-a, *wall), (a, *wall)))


def _build_pin(sizes: FixtureSizes) -> cadquery.Solid:
    """Build the pin, which presses on the inner block, on its carrier."""
    return solids.revolve([*_build_carrier_profile(sizes), (sizes.pin, -CARRIER_RISE_MM), (sizes.pin, 0.0), (0.0, 0.0)], 1.0)


def _build_ring(sizes: FixtureSizes) -> cadquery.Solid:
    """Build the ring, which presses on the outer block, on its carrier."""
    inner, outer = sizes.ring
    return solids.revolve(
        [
            *_build_carrier_profile(sizes),
            (outer, -CARRIER_RISE_MM),
            (outer, 0.0),
            (inner, 0.0),
            (inner, -CARRIER_RISE_MM),
            (0.0, -CARRIER_RISE_MM),
        ],
        1.0,
    )


def _build_carrier_profile(sizes: FixtureSizes) -> list[tuple[float, float]]:
    """Return the corners (r, z) of a carrier with its foot, from the axis below to its upper rim, mm."""
    low, foot = -CARRIER_RISE_MM - sizes.sleeve, sizes.carrier + SLEEVE_WALL_MM
    return [
        (0.0, low - FOOT_HEIGHT_MM),
        (foot, low - FOOT_HEIGHT_MM),
        (foot, low),
        (sizes.carrier, low),
        (sizes.carrier, -CARRIER_RISE_MM),
    ]


def _build_sleeve(sizes: FixtureSizes) -> cadquery.Solid:
    """Build the sleeve where it centres: gripping the carrier below, the base above."""
    cq, low, outer = solids.load_cadquery(), -CARRIER_RISE_MM - SLEEVE_GRIP_MM, sizes.bore + SLEEVE_WALL_MM
    top = low + sizes.sleeve
    tube = solids.revolve([(sizes.bore, low), (outer, low), (outer, top), (sizes.bore, top)], 1.0)
    tool = cq.Solid.makeBox(2 * outer, sizes.slot, sizes.sleeve, cq.Vector(0.0, -sizes.slot / 2, -CARRIER_RISE_MM))
    (piece,) = tube.cut(tool).Solids()
    return piece


def _write(name: str, shape: cadquery.Solid, expected: PartMeasures, stamp: Stamp, path: Path) -> None:
    """Write a part as STEP, read it back and compare it with its expected measures. Raises ``ExportError``."""
    with step_writer.silence_messages():
        step_writer.write_step({name: shape}, path, stamp)
        step_check.check_part_file(path, name, expected)
