"""What presses on one block alone while a probe is calibrated: a pin, a ring, and the sleeve that centres them on the base.

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
from typing import Any

from geometry.cad import solids, step_check, step_writer
from geometry.cad.parts_check import PartMeasures
from geometry.cad.stamp import Stamp, stamp_of
from geometry.common.errors import InputError
from geometry.scenes.base_sizes import base_sizes
from geometry.scenes.probe import Probe, mm

ALIGNED = 0.05  # mm: of the ring's axis with the probe's
PLAY = 0.015  # mm between the sleeve and either rim, on the radius; turning centres each part to 0.01
MARGIN = 2 * ALIGNED  # of what presses to the edge of the block, so that the other one is never touched
RISE = 2.0  # of pin and ring above their carrier
GRIP = 1.5  # of the sleeve on carrier and base
WALL, SLOT, FOOT = 3.0, 3.0, 4.0  # the sleeve's wall, the least width of its slot, the foot's height
NAMES = ("pin", "ring", "sleeve")


@dataclass(frozen=True)
class FixtureSizes:
    """Dimensions in mm.

    Attributes:
        pin: radius.
        ring: inner and outer radius of its face.
        carrier: radius, which is the base's.
        bore: radius of the sleeve's.
        sleeve: its length: grip, rise, blocks and films, grip.
        slot: its width.
    """

    pin: float
    ring: tuple[float, float]
    carrier: float
    bore: float
    sleeve: float
    slot: float


def fixture_sizes(probe: Probe) -> FixtureSizes:
    """Derive the fixture from the probe.

    Raises:
        InputError: a block is too narrow for what is aligned to 0.05 mm.
    """
    scale, base = solids.MM, base_sizes(probe)
    pin = probe.inner_radius * scale - MARGIN
    ring = probe.hole_radius * scale + MARGIN, probe.tube_radius * scale - MARGIN
    if pin < MARGIN:
        raise InputError("probe.inner_radius", mm(probe.inner_radius), f"{2 * MARGIN:g} mm or more for a pin on it alone")
    if ring[1] - ring[0] < MARGIN:
        wall = mm(probe.tube_radius - probe.hole_radius)
        raise InputError("probe.outer_radius", f"a wall of {wall}", f"a wall of {3 * MARGIN:g} mm or more for a ring on it alone")
    reach = (max(probe.core_height, probe.tube_height) + solids.film_thickness(probe) + base.step_height) * scale
    slot = max(SLOT, 0.0 if probe.groove is None else 2 * probe.groove.width * scale)
    carrier = base.flange_radius * scale
    return FixtureSizes(pin, ring, carrier, carrier + PLAY, GRIP + RISE + reach + GRIP, min(slot, carrier))


def fixture(probe: Probe) -> dict[str, Any]:
    """Build pin, ring and sleeve, sleeve where it centres; raises as ``solids.build_parts``, and as ``find_fixture_sizes``."""
    sizes = fixture_sizes(probe)
    builders = {"pin": _pin, "ring": _ring, "sleeve": _sleeve}
    return {name: solids.built(name, partial(builder, sizes)) for name, builder in builders.items()}


def writers(probe: Probe) -> dict[str, Callable[[Path], object]]:
    """Return by file name what writes each part as STEP, reads it back and measures it; raises as ``build_fixture``."""
    solids.cadquery()
    shapes, expected, stamp = fixture(probe), expected_fixture(probe), stamp_of(probe)
    return {f"{name}.step": partial(_write, name, shapes[name], expected[name], stamp) for name in NAMES}


def expected_fixture(probe: Probe) -> dict[str, PartMeasures]:
    """Derive what each part must measure from its sizes alone: formulas that know nothing of the CAD model."""
    one = fixture_sizes(probe)
    low, top, foot = -RISE - one.sleeve, -RISE, math.pi * (one.carrier + WALL) ** 2
    body = math.pi * one.carrier**2
    carrier = foot * FOOT + body * one.sleeve
    faces, outside = {"pin": math.pi * one.pin**2, "ring": math.pi * (one.ring[1] ** 2 - one.ring[0] ** 2)}, one.carrier + WALL
    ends = ((low - FOOT, foot), (low, foot - body))
    radii = {"pin": (one.pin, one.carrier, outside), "ring": (*one.ring, one.carrier, outside)}
    inside = math.pi * one.ring[0] ** 2  # of the ring, a face of its own
    tops = {"pin": ((top, body - faces["pin"]),), "ring": ((top, inside), (top, body - faces["ring"] - inside))}
    blocks = {
        name: PartMeasures(carrier + face * RISE, (*ends, *sorted(tops[name]), (0.0, face)), radii[name])
        for name, face in faces.items()
    }
    return blocks | {"sleeve": _expected_sleeve(one)}


def _expected_sleeve(one: FixtureSizes) -> PartMeasures:
    """Compute measures of a tube with a slot along x from the carrier's top upwards: it takes |y| < a, x > 0."""
    a, inner, outer, low = one.slot / 2, one.bore, one.bore + WALL, -RISE - GRIP
    strip = 2 * (_under(outer, a) - _under(inner, a))
    annulus = math.pi * (outer**2 - inner**2)
    high = one.sleeve - GRIP
    x_i, x_o = math.sqrt(inner**2 - a**2), math.sqrt(outer**2 - a**2)
    wall = ((x_i + x_o) / 2, high * (x_o - x_i))
    ends = ((low, annulus), (-RISE, strip), (low + one.sleeve, annulus - strip))
    return PartMeasures(annulus * one.sleeve - strip * high, ends, (inner, outer), ((-a, *wall), (a, *wall)))


def _under(radius: float, a: float) -> float:
    """Return the area of the strip 0 < y < a, x > 0 of a disc."""
    return (a * math.sqrt(radius**2 - a**2) + radius**2 * math.asin(a / radius)) / 2


def _pin(one: FixtureSizes) -> Any:
    return _revolved([*_carrier(one), (one.pin, -RISE), (one.pin, 0.0), (0.0, 0.0)])


def _ring(one: FixtureSizes) -> Any:
    inner, outer = one.ring
    return _revolved([*_carrier(one), (outer, -RISE), (outer, 0.0), (inner, 0.0), (inner, -RISE), (0.0, -RISE)])


def _revolved(profile: list[tuple[float, float]]) -> Any:
    return solids.revolved([(radius / solids.MM, height / solids.MM) for radius, height in profile])


def _carrier(one: FixtureSizes) -> list[tuple[float, float]]:
    low, foot = -RISE - one.sleeve, one.carrier + WALL
    return [(0.0, low - FOOT), (foot, low - FOOT), (foot, low), (one.carrier, low), (one.carrier, -RISE)]


def _sleeve(one: FixtureSizes) -> Any:
    """Build the sleeve where it centres: gripping the carrier below, the base above."""
    cq, low, outer = solids.cadquery(), -RISE - GRIP, one.bore + WALL
    top = low + one.sleeve
    tube = _revolved([(one.bore, low), (outer, low), (outer, top), (one.bore, top)])
    tool = cq.Solid.makeBox(2 * outer, one.slot, one.sleeve, cq.Vector(0.0, -one.slot / 2, -RISE))
    (piece,) = tube.cut(tool).Solids()
    return piece


def _write(name: str, shape: Any, expected: PartMeasures, stamp: Stamp, path: Path) -> None:
    with step_writer.quiet():
        step_writer.write({name: shape}, path, stamp)
        step_check.check_alone(path, name, expected)
