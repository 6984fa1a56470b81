"""Sections of probe and tissue for tests of meridian meshes: at random over what is promised, and of special kinds."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st

from geometry.meridian.mesh import Topology, build_topology, compute_nodes
from geometry.meridian.mesh_lines import MeridianFineness
from geometry.meridian.mesh_lines import find_kind as kind_of
from geometry.meridian.section import LAYERS, STACKS, TISSUES, Body, Section
from solver.axisymmetric.sections import HALF_SPACE_SIZES
from solver.elements.quadrilateral import Geometry, compute_geometry
from solver.elements.shape_functions import build_shapes

COARSE = MeridianFineness(1, 2, 4)
few_examples, many_examples = (settings(derandomize=True, deadline=None, max_examples=count) for count in (100, 250))


def section(
    inner: Any = 5e-3,
    gap: Any = 1e-4,
    area_ratio: Any = 3.7,
    inner_height: Any = 1.0,
    outer_height: Any = 1.0,
    sphere: Any = 0.0,
    cover: Any = 1.0,
    below: Any = 5.0,
    beside: Any = 7.0,
    **layers: Any,
) -> Section:
    """A section by numbers that may be any positive ones: heights in inner radii, the sphere's radius in the tube's.

    ``cover`` and ``below`` are the tissue above and below the sphere in its diameters (without one, the tissue is ``below``
    tube radii deep), ``beside`` that beyond probe and sphere in the wider one's radii. Film and adhesive are lengths,
    the base's sizes are in tube radii, ``flange`` from the tube to the edge.
    """
    hole = inner + gap
    tube = (hole**2 + inner**2 / area_ratio) ** 0.5
    s = sphere * tube
    widest = s if np.real(s) > np.real(tube) else tube
    depth = 2 * s * (1 + cover + below) if sphere else below * tube
    sizes = {name: layers.get(name, 0.0) * tube for name in ("flange_thickness", "step_height")}
    flange = tube * (1 + layers["flange"]) if "flange" in layers else 0.0
    blocks = inner, hole, tube, inner * inner_height, inner * outer_height
    body = (s, s * (1 + 2 * cover)) if sphere else (0.0, 0.0)
    names = {"film": "film", "adhesive": "bond_to_base"}
    sizes |= {f"{block}_{names[key]}": layers[key] for block in ("inner", "outer") for key in names if key in layers}
    return Section(*blocks, widest * (1 + beside), depth, *body, flange_radius=flange, **sizes)


def draw_between(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(math.log(low), math.log(high)).map(math.exp)


BLOCKS = {
    "inner": draw_between(1e-4, 2e-2),
    "gap": draw_between(5e-6, 5e-3),
    "area_ratio": draw_between(0.05, 50),
    "inner_height": draw_between(0.05, 10),
    "outer_height": draw_between(0.05, 10),
    "beside": draw_between(0.02, HALF_SPACE_SIZES),
}
NO_SPHERE = {"below": draw_between(0.02, HALF_SPACE_SIZES)}
SPHERE = {"sphere": draw_between(0.05, 20), "cover": draw_between(0.005, 3), "below": draw_between(0.005, HALF_SPACE_SIZES)}
FILM = {"film": draw_between(1e-6, 1e-3)}
BASE = {"flange_thickness": draw_between(0.05, 2), "step_height": draw_between(0.05, 2)}
films = st.sampled_from([{}, FILM, FILM | {"adhesive": draw_between(1e-6, 1e-3)}])
bases = st.sampled_from([{}, BASE, BASE | {"flange": draw_between(0.02, 2)}])
numbers = st.tuples(st.sampled_from([NO_SPHERE, SPHERE, SPHERE]), films, bases).flatmap(
    lambda parts: st.fixed_dictionaries(BLOCKS | parts[0] | parts[1] | parts[2])
)

PAPER: dict[str, float] = {"sphere": 0.7, "cover": 0.5}
DEFAULTS = {"inner": 5e-3, "gap": 1e-4, "area_ratio": 3.7, "inner_height": 1.0, "outer_height": 1.0, "below": 5.0, "beside": 7.0}
ELASTIC = {"flange_thickness": 0.3, "step_height": 0.2, "flange": 0.25}
FILMS_AND_BASE = ELASTIC | {"film": 1.1e-4, "adhesive": 5e-5}
HAIRLINE = ELASTIC | {"gap": 1e-5, "area_ratio": 0.1, "inner_height": 0.5, "outer_height": 0.5, "sphere": 0.3}
FLAT = {"inner_height": 0.1, "outer_height": 0.1, "below": 1.0}
ROOMY = {"area_ratio": 1.0, "below": 1.0, "beside": 3.0}
# kinds that random numbers seldom meet
SPECIAL: dict[str, dict[str, float]] = {
    "the paper's": PAPER,
    "box in a gap of two columns and one": FLAT | {"gap": 2e-3, "area_ratio": 2.0, "sphere": 0.5},
    "box in a gap of one column and two": ROOMY | {"gap": 5e-3, "sphere": 0.3, "cover": 2.0},
    "box in a gap beyond the inner radius": FLAT | ROOMY | {"gap": 3e-3, "sphere": 0.5},
    "thin cover": PAPER | {"cover": 0.005, "below": 0.005},
    "sphere wider than the probe": {"sphere": 20.0, "cover": 0.005, "beside": 0.02},
    "sheet": {"below": 0.02, "beside": HALF_SPACE_SIZES},
    "half-space": {"below": HALF_SPACE_SIZES, "beside": HALF_SPACE_SIZES},
    "boss": PAPER | FILMS_AND_BASE | {"inner_height": 0.5},
    "recess": PAPER | FILMS_AND_BASE | {"inner_height": 1.5},
    "level base": PAPER | FILMS_AND_BASE,
    # lines across the gap numbered 20 and 21 beyond the inner radius: 0.15 of that is a whole number, or ends as a layer does
    "base twenty lines further": HAIRLINE | {"cover": 0.5},
    "base twenty-one lines further": HAIRLINE | {"cover": 0.1, "below": 1.0},
}
# depths of interfaces below the sphere's centre in its radii: on its side, near a pole, several at one, beyond the other
CROSSED: tuple[tuple[float, ...], ...] = (
    (0.0,),
    (-0.99,),
    (-1 + 1e-7,),
    (0.9999,),
    (-0.95, -0.9, -0.8),
    (-0.5, 0.5),
    (0.8, 1.0001),
    (-1.4, -0.83, -0.71, 0.84),
    (-1.01, -0.7, 0.1, 0.3, 0.99),
)


def crossed_section(depths: tuple[float, ...], **numbers: Any) -> Section:
    """A section with interfaces at depths below the sphere's centre, in its radii, those that are below the surface."""
    plain = section(**({"sphere": 0.7, "cover": 0.5} | numbers))
    planes = (plain.sphere_depth + depth * plain.sphere_radius for depth in depths)
    heights = np.diff([0.0, *(plane for plane in planes if plane > 0)])
    return replace(plain, **{body.name.lower(): height for body, height in zip(LAYERS, heights.tolist(), strict=False)})


special = pytest.mark.parametrize("case", [pytest.param(case, id=name) for name, case in SPECIAL.items()])


def mesh_of(s: Section, fineness: MeridianFineness = COARSE) -> Topology:
    return build_topology(kind_of(s, fineness.lean), fineness)


def geometry_of(s: Section, mesh: Topology, order: int) -> Geometry:
    return compute_geometry(compute_nodes(s, mesh, build_shapes(order).places), build_shapes(order))


def ring(low: float, high: float) -> float:
    return math.pi * (high - low) * (high + low)


def volumes(s: Section) -> dict[Body, float]:
    """Of all bodies by closed forms; tissue with what is in it."""
    discs = ring(0, s.inner_radius), ring(s.hole_radius, s.tube_radius)
    volumes_m3 = {Body.TISSUE: ring(0, s.tissue_radius) * s.tissue_depth, Body.INCLUSION: 4 / 3 * math.pi * s.sphere_radius**3}
    volumes_m3 |= {Body.INNER: discs[0] * s.inner_height, Body.OUTER: discs[1] * s.outer_height}
    layers = zip(discs, STACKS, strict=True)
    volumes_m3 |= {body: disc * getattr(s, body.name.lower()) for disc, stack in layers for body in stack}
    if s.flange_thickness:
        high, middle = max(s.inner_height, s.outer_height), (s.inner_radius + s.hole_radius) / 2
        boss = ring(0, middle) * (high - s.inner_height) + ring(middle, s.tube_radius) * (high - s.outer_height)
        whole = ring(0, max(s.flange_radius, s.tube_radius)) * s.flange_thickness
        volumes_m3[Body.BASE] = boss + ring(0, s.tube_radius) * s.step_height + whole
    return {body: volume for body, volume in volumes_m3.items() if volume}


def of_probe(mesh: Topology) -> np.ndarray:
    return ~np.isin(mesh.body, (*TISSUES, Body.INCLUSION))


def rounding(s: Section) -> float:
    sizes = s.tissue_radius + s.tissue_depth, s.inner_height + s.outer_height + s.flange_thickness + s.step_height
    return 8 * np.finfo(float).eps * sum(sizes)
