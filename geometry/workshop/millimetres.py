"""Convert a probe's dimensions to mm, named by the letters of its section; drawings, patterns and moulds use them."""

from __future__ import annotations

import math
from dataclasses import dataclass

from geometry.cad import solids
from geometry.scenes.base_sizes import base_sizes
from geometry.scenes.probe import Probe
from geometry.scenes.units import MM_PER_M


@dataclass(frozen=True)
class Millimetres:
    """A probe's dimensions in mm; 0 for a groove, films or round edges that it does not have.

    Attributes
    ----------
    r2, ri, ro
        Radii of the inner block, the hole and the tube.
    h2, h1
        Heights of the inner and the outer block.
    t
        Thickness of the films.
    half_width, depth
        Half the groove's width, and its depth.
    edge
        Radius of the blocks' lower edges.
    low, side
        Heights of the base's lower faces over the inner and the outer block.
    rf
        Radius of the flange; that of the tube without a flange.
    flange_bottom, top
        Heights of the flange's lower and upper face.
    """

    r2: float
    ri: float
    ro: float
    h2: float
    h1: float
    t: float
    half_width: float
    depth: float
    edge: float
    low: float
    side: float
    rf: float
    flange_bottom: float
    top: float

    @property
    def middle(self) -> float:
        """Radius of the middle of the gap, where the base's lower face steps."""
        return (self.r2 + self.ri) / 2

    @property
    def groove_ends(self) -> tuple[float, float]:
        """Where the groove's sides meet the hole's and the tube's wall: x."""
        inner, outer = (math.sqrt((radius - self.half_width) * (radius + self.half_width)) for radius in (self.ri, self.ro))
        return inner, outer


def convert_to_mm(probe: Probe, edge_radius: float = 0.0) -> Millimetres:
    """Return a probe's dimensions in mm; ``edge_radius`` is that of the blocks' lower edges, m.

    Raises
    ------
    InputError
        See ``geometry.scenes.base_sizes.base_sizes``.
    """
    sizes, (low, side), mm = base_sizes(probe), solids.find_film_tops(probe), MM_PER_M
    flange_bottom = max(low, side) * mm + sizes.step_height * mm
    return Millimetres(
        r2=probe.inner_radius * mm,
        ri=probe.hole_radius * mm,
        ro=probe.tube_radius * mm,
        h2=probe.core_height * mm,
        h1=probe.tube_height * mm,
        t=solids.film_thickness(probe) * mm,
        half_width=0.0 if probe.groove is None else probe.groove.width / 2 * mm,
        depth=0.0 if probe.groove is None else probe.groove.depth * mm,
        edge=edge_radius * mm,
        low=low * mm,
        side=side * mm,
        rf=sizes.flange_radius * mm,
        flange_bottom=flange_bottom,
        top=flange_bottom + sizes.thickness * mm,
    )
