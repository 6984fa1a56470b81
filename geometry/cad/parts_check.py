"""Compute the expected measures of each part from the probe's parameters alone, by formulas independent of the CAD model."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from geometry.scenes.base_sizes import find_base_sizes
from geometry.scenes.probe import Probe
from geometry.scenes.units import MM_PER_M


@dataclass(frozen=True)
class PartMeasures:
    """Measured or expected sizes of a solid, in mm.

    Attributes
    ----------
    volume
        In mm^3.
    ends
        (z, area) of each plane face normal to z, from below.
    radii
        Of each cylindrical face about z, from the smallest.
    walls
        (y, x of the centre, area) of each plane face normal to y.
    off_axis
        Largest distance of a cylinder's or torus's axis from the z axis.
    edges
        (radius of the circle of centres, edge radius, z of that circle, area) of each toroidal face about z.
    """

    volume: float
    ends: tuple[tuple[float, float], ...]
    radii: tuple[float, ...]
    walls: tuple[tuple[float, float, float], ...] = ()
    off_axis: float = 0.0
    edges: tuple[tuple[float, float, float, float], ...] = ()


def compute_expected_bodies(probe: Probe, edge_radius: float = 0.0) -> dict[str, PartMeasures]:
    """Compute the expected measures of each part from the probe's parameters and the radius of its lower edges (m)."""
    mm, groove = MM_PER_M, probe.groove
    r2, ri, ro = probe.inner_radius * mm, probe.hole_radius * mm, probe.tube_radius * mm
    h2, h1 = probe.core_height * mm, probe.tube_height * mm
    a2, a1, cut = probe.inner_area * mm**2, probe.outer_area * mm**2, probe.groove_footprint * mm**2
    floor: tuple[tuple[float, float], ...] = ()
    depth = 0.0
    if groove is not None:
        depth = groove.depth * mm
        floor = ((h1 - depth, cut),)
    films = {}
    if probe.film is not None:
        (l2, t2, _), (l1, t1, _) = _list_stack_thicknesses(probe)  # of the bond to the block and of the film, inner and outer
        films["film-inner"] = PartMeasures(a2 * t2, ((h2 + l2, a2), (h2 + l2 + t2, a2)), (r2,))
        faces, ring = ((h1 + l1, a1 - cut), (h1 + l1 + t1, a1 - cut)), (a1 - cut) * t1
        films["film-outer"] = PartMeasures(ring, faces, (ri, ro), _list_groove_walls(probe, t1))
    inner = PartMeasures(a2 * h2, ((0, a2), (h2, a2)), (r2,))
    outer = PartMeasures(a1 * h1 - cut * depth, ((0, a1), *floor, (h1, a1 - cut)), (ri, ro), _list_groove_walls(probe, depth))
    return {
        "inner": _subtract_round_edges(inner, edge_radius * mm),
        "outer": _subtract_round_edges(outer, edge_radius * mm),
        **films,
        "base": _compute_expected_base(probe),
    }


def _list_stack_thicknesses(probe: Probe) -> list[list[float]]:
    """Return the thicknesses of bond, film and bond on the inner and on the outer block, from the block upwards, mm."""
    films = () if probe.film is None else probe.film.by_block
    return [[layer.thickness * MM_PER_M for layer in film.stack] for film in films]


def _subtract_round_edges(block: PartMeasures, e: float) -> PartMeasures:
    """Subtract a block's round lower edges, by Pappus' theorems; the last of its radii is its rim, another its hole.

    What a quarter disc leaves of its square has the area (1 - pi/4) e^2, and the moment e^3/6 about the side through the arc's
    centre; the arc itself has the length pi e/2 and the moment e^2.
    """
    if e == 0:
        return block
    sides = [(radius - side * e, side) for radius, side in zip(block.radii[::-1], (1, -1), strict=False)]  # of the arcs' centres
    volume = sum(math.tau * (centre * (1 - math.pi / 4) * e**2 + side * e**3 / 6) for centre, side in sides)
    face = sum(math.pi * e * (2 * centre + side * e) for centre, side in sides)
    edges = sorted((centre, e, e, math.tau * (centre * math.pi / 2 * e + side * e**2)) for centre, side in sides)
    (z, area), *other_ends = block.ends
    return replace(block, volume=block.volume - volume, ends=((z, area - face), *other_ends), edges=tuple(edges))


def _list_groove_walls(probe: Probe, height: float) -> tuple[tuple[float, float, float], ...]:
    """Return the groove's two sides, from the hole at x_i = sqrt(Ri^2 - a^2) to the outside at x_o, a = width/2."""
    if probe.groove is None:
        return ()
    a, ri, ro = (size * MM_PER_M for size in (probe.groove.width / 2, probe.hole_radius, probe.tube_radius))
    x_i, x_o = (math.sqrt((radius - a) * (radius + a)) for radius in (ri, ro))
    area = height * (ro - ri) * (ro + ri) / (x_o + x_i)
    return ((-a, (x_i + x_o) / 2, area), (a, (x_i + x_o) / 2, area))


def _compute_expected_base(probe: Probe) -> PartMeasures:
    """Compute the measures of the base, whose shape ``geometry.cad.solids.build_base`` describes."""
    mm, sizes = MM_PER_M, find_base_sizes(probe)
    ro, rf, rm = probe.tube_radius * mm, sizes.flange_radius * mm, (probe.inner_radius + probe.gap / 2) * mm
    low, side = (height * mm for height in (probe.core_height, probe.tube_height))
    if probe.film is not None:
        low, side = (height + sum(stack) for height, stack in zip((low, side), _list_stack_thicknesses(probe), strict=True))
    low = side if math.isclose(low, side, rel_tol=1e-14) else low
    flange_bottom = max(low, side) + sizes.step_height * mm
    top = flange_bottom + sizes.thickness * mm
    middle, ring, flange = math.pi * rm**2, math.pi * (ro - rm) * (ro + rm), math.pi * rf**2
    ends = [(low, middle), (side, ring)] if low != side else [(low, math.pi * ro**2)]
    if rf > ro:
        ends.append((flange_bottom, math.pi * (rf - ro) * (rf + ro)))
    volume = middle * (flange_bottom - low) + ring * (flange_bottom - side) + flange * (top - flange_bottom)
    radii = {*((rm,) if low != side else ()), ro, rf}
    return PartMeasures(volume, tuple(sorted([*ends, (top, flange)])), tuple(sorted(radii)))
