"""Compute the sizes of both blocks' moulds from the probe's numbers alone, by formulas that are independent of the CAD model.

A block stands in the lower half on its tissue end. The lower half contains its walls, and the pin that forms the tube's hole. The
parting plane is the film end: the upper half is a lid with the rib that forms the groove, a pouring hole and two vents. The walls
lean outwards by the draft angle, so that the block comes out upwards, and have their nominal radius at half the height. With the
linear shrinkage s, a length L_mould of the mould is larger than the block's length L:

    L_mould = L / (1 - s).   (WS.1)
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from geometry.cad.materials import PartMaterial
from geometry.cad.parts_check import compute_expected_bodies
from geometry.common.errors import InputError, Words
from geometry.scenes.probe import Probe, compute_groove_footprint
from geometry.workshop.outlines import Millimetres, convert_to_mm

DEFAULT_SHRINKAGE = 0.001
"""Linear shrinkage; assumed: makers state negligible shrinkage for platinum-cure silicones cast at room temperature."""
MAX_SHRINKAGE = 0.2
DEFAULT_DRAFT_RAD, MAX_DRAFT_RAD = math.radians(0.5), math.radians(10)
MAX_RELATIVE_GAP_CHANGE = 0.05  # of the gap, at either end: more draft of both walls would shift the contact limit
WALL_THICKNESS_MM, FLOOR_THICKNESS_MM, LID_THICKNESS_MM = 8.0, 4.0, 6.0  # mm: around the cavity, below it, above it
PIN_RADII_MM = (1.5, 1.0)  # mm; they differ, so that the halves fit in one orientation only
PIN_HEIGHT_MM, PIN_PLAY_MM = 3.0, 0.05  # mm
MOULD_MATERIAL = PartMaterial("mould material", "aluminium or printed resin that does not inhibit the cure")
MAX_POUR_RADIUS_MM, MAX_VENT_RADIUS_MM = 1.5, 0.5  # mm: radii of the holes, smaller where the block is narrow


@dataclass(frozen=True)
class MouldSizes:
    """The sizes of a mould, mm.

    Attributes
    ----------
    name
        Name of the block.
    inner, outer
        Radii of the cavity at its floor and at the parting plane; ``inner`` is 0 for the solid block.
    height
        Height of the cavity.
    edge
        Radius of the round edges at the floor.
    half_width, depth
        Half width and depth of the rib that forms the groove.
    pour, vent
        Radii of the holes in the lid.
    draft
        Draft angle of the walls, rad.
    shrinkage
        Linear shrinkage.
    """

    name: str
    inner: tuple[float, float]
    outer: tuple[float, float]
    height: float
    edge: float
    half_width: float
    depth: float
    pour: float
    vent: float
    draft: float
    shrinkage: float

    @property
    def outside(self) -> float:
        """Radius of both halves."""
        return self.outer[1] + WALL_THICKNESS_MM

    @property
    def hole_circle_radius(self) -> float:
        """Radius, mm, of the circle of the tube's pouring hole and vents; 0 for the solid block, poured at its centre."""
        return (self.inner[1] + self.outer[1]) / 2 if self.inner[1] else 0.0

    def compute_radii(self, z: float) -> tuple[float, float]:
        """Return the inner and outer radius of the cavity at height ``z``, above its round edges."""
        share = z / self.height
        return tuple(low + (high - low) * share for low, high in (self.inner, self.outer))  # type: ignore[return-value]


def choose_draft(probe: Probe, max_draft: float = DEFAULT_DRAFT_RAD) -> float:
    """Return the draft angle, rad: the requested one, or the largest that changes the gap by ``MAX_RELATIVE_GAP_CHANGE``.

    With h the height of the blocks, both leaning walls together narrow the gap by h tan(draft) at one end:

        tan(draft) <= 0.05 gap / h.   (WS.2)
    """
    return min(max_draft, math.atan(MAX_RELATIVE_GAP_CHANGE * probe.gap / max(probe.core_height, probe.tube_height)))


def compute_mould_sizes(
    probe: Probe, edge_radius: float = 0.0, shrinkage: float = DEFAULT_SHRINKAGE, draft: float = DEFAULT_DRAFT_RAD
) -> tuple[MouldSizes, ...]:
    """Return the moulds of the inner and the outer block.

    Parameters
    ----------
    probe
        The probe.
    edge_radius
        Radius of the blocks' lower edges, m.
    shrinkage
        Linear shrinkage of the elastomer while it cures.
    draft
        Largest draft angle of the walls, rad; see ``choose_draft``.

    Raises
    ------
    InputError
        Shrinkage or draft is outside its range.
    """
    if not 0 <= shrinkage <= MAX_SHRINKAGE:
        raise InputError("shrinkage", Words(f"{shrinkage:g}"), f"a number from 0 to {MAX_SHRINKAGE:g}: of every length")
    if not 0 <= draft <= MAX_DRAFT_RAD:
        raise InputError("draft", Words(f"{math.degrees(draft):g} deg"), "an angle with its unit, from 0 deg to 10 deg")
    angle = choose_draft(probe, draft)
    lengths = convert_to_mm(probe, edge_radius)
    inner = _compute_sizes("inner", lengths, (0.0, lengths.r2, lengths.h2), depth=0.0, draft=angle, shrinkage=shrinkage)
    return inner, _compute_sizes(
        "outer", lengths, (lengths.ri, lengths.ro, lengths.h1), depth=lengths.depth, draft=angle, shrinkage=shrinkage
    )


def _compute_sizes(
    name: str, lengths: Millimetres, block: tuple[float, float, float], *, depth: float, draft: float, shrinkage: float
) -> MouldSizes:
    """Return the mould of one block; ``block`` are its hole's radius (0: none), its outer radius and its height, mm.

    ``depth`` is that of its groove; ``draft`` is in rad.
    """
    grown = 1 / (1 - shrinkage)
    inner, outer, height = (length * grown for length in block)
    lean = height / 2 * math.tan(draft)  # change of radius from half the height, where it is nominal, to either end
    wide = outer - inner
    return MouldSizes(
        name,
        inner=(inner + lean, inner - lean) if inner else (0.0, 0.0),
        outer=(outer - lean, outer + lean),
        height=height,
        edge=lengths.edge * grown,
        half_width=lengths.half_width * grown if depth else 0.0,
        depth=depth * grown,
        pour=min(MAX_POUR_RADIUS_MM, 0.25 * wide),
        vent=min(MAX_VENT_RADIUS_MM, 0.1 * wide),
        draft=draft,
        shrinkage=shrinkage,
    )


def compute_cavity_volume(mould: MouldSizes) -> float:
    """Return the volume of the closed mould's cavity, mm^3: frusta, less the round edges and the rib.

    A frustum of radii a, b and height h has the volume V. Below it, the round edges are cut from a cylinder of the wall's radius.

        V = pi h (a^2 + a b + b^2) / 3.   (WS.3)
    """
    (inner, outer), e = mould.compute_radii(mould.edge), mould.edge
    walls = [
        _compute_frustum_volume(low, high, mould.height - e) for low, high in ((outer, mould.outer[1]), (inner, mould.inner[1]))
    ]
    foot = math.pi * (outer**2 - inner**2) * e
    # side: 1 where the edge lies inside the wall's radius, -1 where it lies outside
    for radius, side in ((outer, 1), *(((inner, -1),) if inner else ())):  # Pappus, see geometry.cad.parts_check
        foot -= math.tau * ((radius - side * e) * (1 - math.pi / 4) * e**2 + side * e**3 / 6)
    return walls[0] - walls[1] + foot - compute_rib_volume(mould)


def _compute_frustum_volume(low: float, high: float, height: float) -> float:
    """Return the volume of a frustum with these radii, eq. WS.3."""
    return math.pi * height * (low**2 + low * high + high**2) / 3


def compute_rib_volume(mould: MouldSizes) -> float:
    """Return the rib's volume, mm^3: its footprint, eq. SC.1, between the leaning walls, integrated over its depth."""
    if not mould.depth:
        return 0.0
    nodes, weights = np.polynomial.legendre.leggauss(8)
    heights = mould.height - mould.depth / 2 * (1 - nodes)
    return float(
        mould.depth
        / 2
        * sum(
            w * compute_groove_footprint(*mould.compute_radii(z), mould.half_width) for z, w in zip(heights, weights, strict=True)
        )
    )


def compute_holes_volume(mould: MouldSizes) -> float:
    """Return the volume of the lid's pouring hole and vents, mm^3, which become sprues."""
    return math.pi * (mould.pour**2 + 2 * mould.vent**2) * LID_THICKNESS_MM


def compute_half_volumes(mould: MouldSizes) -> dict[str, float]:
    """Return the volumes of both halves, mm^3: the blanks, less the cavity and the holes, with pins and rib."""
    cylinder = math.pi * mould.outside**2
    pins = sum(math.pi * radius**2 for radius in PIN_RADII_MM) * PIN_HEIGHT_MM
    holes = sum(math.pi * (radius + PIN_PLAY_MM) ** 2 for radius in PIN_RADII_MM) * (PIN_HEIGHT_MM + 0.5)
    rib = compute_rib_volume(mould)
    lower = cylinder * (mould.height + FLOOR_THICKNESS_MM) - compute_cavity_volume(mould) - rib + pins
    return {"lower": lower, "upper": cylinder * LID_THICKNESS_MM - holes - compute_holes_volume(mould) + rib}


def compute_block_volume(probe: Probe, name: str, edge_radius: float = 0.0) -> float:
    """Return the volume of a block of the scene, mm^3."""
    return compute_expected_bodies(probe, edge_radius)[name].volume
