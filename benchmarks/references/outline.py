"""Build the reference code's outline and mesh: the meridian plane of probe, layers, base and tissue.

The tissue lies below z = 0, lengths are in inner radii. On each block lie its film and, above it, its adhesive, both as
wide as the block. The elastic base is that of ``geometry.cad.solids``: a step of the tube's radius below a flange; where the
two stacks differ in height its lower face steps in the middle of the gap. Without ``[probe.film]`` blocks meet the base.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import accumulate, pairwise
from typing import Any

import ngsolve as ngs
import numpy as np
from netgen.geom2d import SplineGeometry
from netgen.meshing import MeshingParameters

from geometry import Film, Probe, Scene
from geometry.scenes.base_sizes import find_base_sizes

OUTSIDE, TISSUE, INCLUSION, INNER, OUTER, FILM, ADHESIVE, BASE = range(8)
LAYERS = tuple(range(8, 16))  # of the tissue, from the surface downwards
_NAMES = ["tissue", "inclusion", "inner", "outer", "film", "adhesive", "base", *(f"layer{k}" for k in range(8))]
NAMES = dict(enumerate(_NAMES, 1))
ENDS = ("end_inner", "end_outer")  # the blocks' film ends, where the film forces are taken
SINGULAR = {"contact", "bottom", "layer", "top", "lower", *ENDS}  # the edges that end in singular corners


@dataclass(frozen=True)
class Refinement:
    """One mesh: element size over local feature size, polynomial order, geometric layers at the corners."""

    size: float
    order: int
    layers: int


@dataclass(frozen=True)
class Edge:
    """A straight edge or, with ``centre``, an arc about a point on the axis, at most a quarter; lengths in inner radii."""

    start: tuple[float, float]
    end: tuple[float, float]
    left: int
    right: int
    name: str = "free"
    centre: float | None = None

    def point(self, t: float) -> np.ndarray:
        """Return the point at parameter 0 <= t <= 1."""
        a, b = np.array(self.start), np.array(self.end)
        if self.centre is None:
            return np.asarray(a + t * (b - a))
        (low, high), radius = self.angles(), math.dist(self.start, (0.0, self.centre))
        angle = low + t * (high - low)
        return np.array([radius * math.cos(angle), self.centre + radius * math.sin(angle)])

    def angles(self) -> tuple[float, float]:
        """Angles of an arc's ends above the horizon."""
        low, high = (math.atan2(p[1] - (self.centre or 0.0), p[0]) for p in (self.start, self.end))
        return low, high

    def distance(self, p: np.ndarray) -> float:
        """Distance of a point with r >= 0 from the edge."""
        a, b = np.array(self.start), np.array(self.end)
        if self.centre is not None:
            if not min(self.angles()) <= math.atan2(p[1] - self.centre, p[0]) <= max(self.angles()):  # an end is nearest
                return min(math.dist(p, a), math.dist(p, b))
            return float(abs(math.hypot(p[0], p[1] - self.centre) - math.hypot(a[0], a[1] - self.centre)))
        t = np.clip((p - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
        return float(np.hypot(*(p - a - t * (b - a))))


def outline(scene: Scene) -> list[Edge]:
    """Return the meridian plane's edges, r >= 0.

    Raises
    ------
    ValueError
        The scene is not axisymmetric, its tissue has no end, or its contact may open.
    """
    off_axis = len(scene.inclusion) > 1 or any(body.x or body.y or body.diameter is None for body in scene.inclusion)
    off_axis = off_axis or scene.placement != type(scene.placement)() or scene.probe.groove is not None
    if off_axis or scene.tissue.shape != "cylinder" or scene.contact.interface == "unilateral":
        raise ValueError("the reference takes tissue in a cylinder, one sphere on the axis, no groove, no lift-off")
    return tissue(scene) + blocks(scene.probe)


def tissue(scene: Scene) -> list[Edge]:
    """Return the edges of tissue, its layers and inclusion, those under the blocks included."""
    unit, body = scene.probe.inner_radius, scene.tissue
    assert body.shape == "cylinder"  # outline has asked
    r2, r3, rt, bottom = (x / unit for x in (scene.probe.hole_radius, scene.probe.tube_radius, body.radius, -body.depth))
    planes = [-depth / unit for depth in accumulate(layer.thickness for layer in body.layer)]
    top = count_planes_below(planes, 0.0)
    edges = [
        Edge((0, 0), (1, 0), INNER, top, "contact"),
        Edge((1, 0), (r2, 0), OUTSIDE, top),
        Edge((r2, 0), (r3, 0), OUTER, top, "contact"),
        Edge((r3, 0), (rt, 0), OUTSIDE, top),
        *(Edge((rt, a), (rt, b), OUTSIDE, count_planes_below(planes, a)) for a, b in pairwise([0, *planes, bottom])),
        Edge((rt, bottom), (0, bottom), OUTSIDE, TISSUE, "bottom"),
    ]
    if not scene.inclusion:
        edges += [Edge((0, z), (rt, z), LAYERS[k], count_planes_below(planes, z), "interface") for k, z in enumerate(planes)]
        return [
            *edges,
            *(Edge((0, b), (0, a), OUTSIDE, count_planes_below(planes, a), "axis") for a, b in pairwise([0, *planes, bottom])),
        ]
    radius, centre = scene.inclusion[0].diameter / 2 / unit, -scene.inclusion[0].depth / unit  # type: ignore[operator]
    return [*edges, *draw_sphere_edges(radius, centre, planes, rt, bottom)]


def draw_sphere_edges(radius: float, centre: float, planes: list[float], rt: float, bottom: float) -> list[Edge]:
    """Return the edges of a sphere, of the axis and of the interfaces, which end at the sphere where they meet it."""
    reach = {z: math.sqrt(max(0.0, radius**2 - (z - centre) ** 2)) for z in planes}
    edges = [Edge((reach[z], z), (rt, z), LAYERS[k], count_planes_below(planes, z), "interface") for k, z in enumerate(planes)]
    ends = sorted({0, bottom, centre - radius, centre + radius, *(z for z in planes if reach[z] == 0)})
    for a, b in pairwise(ends):
        edges.append(Edge((0, a), (0, b), OUTSIDE, INCLUSION if a == centre - radius else count_planes_below(planes, b), "axis"))
    ring = {centre - radius: 0.0, centre: radius, centre + radius: 0.0} | {z: r for z, r in reach.items() if r}
    for a, b in pairwise(sorted(ring)):
        edges.append(Edge((ring[a], a), (ring[b], b), INCLUSION, count_planes_below(planes, b), "sphere", centre))
    return edges


def count_planes_below(planes: list[float], z: float) -> int:
    """Return the body of the tissue under a height."""
    k = sum(plane >= z for plane in planes)
    return LAYERS[k] if k < len(planes) else TISSUE


def blocks(probe: Probe) -> list[Edge]:
    """Return the edges of blocks, films, adhesives and base."""
    unit, elastic = probe.inner_radius, not probe.base.rigid
    radii = ((0.0, 1.0), (probe.hole_radius / unit, probe.tube_radius / unit))
    edges, tops = [], []
    for body, height, (a, b), end in zip((INNER, OUTER), (probe.core_height, probe.tube_height), radii, ENDS, strict=True):
        bodies, levels = [body, *layers(probe.film)], [0.0, height / unit]
        levels += [(height + upper) / unit for upper in stack(probe.film)]
        for current, low, high, upper in zip(
            bodies, levels, levels[1:], [*bodies[1:], BASE if elastic else OUTSIDE], strict=False
        ):
            name = end if current == body else "layer" if upper not in (OUTSIDE, BASE) else "top" if not elastic else "layer"
            edges.append(Edge((a, low), (a, high), OUTSIDE, current, "free" if a else "axis"))
            edges.append(Edge((a, high), (b, high), upper, current, name))
            edges.append(Edge((b, high), (b, low), OUTSIDE, current))
        tops.append(levels[-1])
    return edges + (base(probe, tops) if elastic else [])


def layers(film: Film | None) -> list[int]:
    """Return the bodies on each block."""
    return [] if film is None else [FILM, ADHESIVE] if find_bond_thickness(film) > 0 else [FILM]


def find_bond_thickness(film: Film) -> float:
    """Return the thickness of the bond to the base, m; a bond to the block, or an outer film of its own, is not modelled here."""
    assert film.bond_to_block is None
    assert film.outer is None
    return 0.0 if film.bond_to_base is None else film.bond_to_base.thickness


def stack(film: Film | None) -> list[float]:
    """Return the heights of the layers' upper faces over the block's end, in m."""
    return [] if film is None else [film.thickness, film.thickness + find_bond_thickness(film)][: len(layers(film))]


def base(probe: Probe, tops: list[float]) -> list[Edge]:
    """Return the free edges of the elastic base, its axis and its upper face."""
    unit, measures, (low, side) = probe.inner_radius, find_base_sizes(probe), tops
    if math.isclose(low, side, rel_tol=1e-14):
        side = low
    r2, r3, wide = (radius / unit for radius in (probe.hole_radius, probe.tube_radius, measures.flange_radius))
    middle = (1.0 + r2) / 2
    flange = max(low, side) + measures.step_height / unit
    top = flange + measures.thickness / unit
    between = [(1.0, tops[0]), (r2, tops[1])] if low == side else [(1.0, low), (middle, low), (middle, side), (r2, side)]
    shoulder = [(r3, flange), (wide, flange)] if wide > r3 else []
    outside = [(r3, tops[1]), *shoulder, (wide, top)]
    edges = [Edge(p, q, BASE, OUTSIDE, "lower") for line in (between, outside) for p, q in pairwise(line)]
    return [*edges, Edge((0, top), (wide, top), OUTSIDE, BASE, "top"), Edge((0, tops[0]), (0, top), OUTSIDE, BASE, "axis")]


def held(probe: Probe) -> list[str]:
    """Return the names of the edges that do not move."""
    return ["bottom", *(ENDS if probe.base.rigid and probe.film is None else ["top"])]


def sizes(edges: list[Edge], size: float) -> list[tuple[float, float, float]]:
    """Return mesh sizes (r, z, h) along the edges: ``size`` times the distance to the next edge of the same body."""
    point_sizes: list[tuple[float, float, float]] = []
    for edge in edges:
        t, bodies, length = 0.0, {edge.left, edge.right} - {OUTSIDE}, math.dist(edge.start, edge.end)
        neighbours = [o for o in edges if bodies & {o.left, o.right} and not {edge.start, edge.end} & {o.start, o.end}]
        while t < 1.0:
            for s in (t, 1.0 - t):  # from both ends, for an end may have the smaller features
                p = edge.point(s)
                point_sizes.append((float(p[0]), float(p[1]), size * min([0.5 * length, *(o.distance(p) for o in neighbours)])))
            t += 0.3 * min(point_sizes[-1][2], point_sizes[-2][2]) / length
    return point_sizes


def make_mesh(scene: Scene, refinement: Refinement) -> ngs.Mesh:
    """Build the mesh of a scene with a sphere or none."""
    return build_mesh(outline(scene), refinement)


def build_mesh(edges: list[Edge], refinement: Refinement) -> ngs.Mesh:
    """Build the graded, curved mesh with geometric layers at every corner of the probe and of the tissue's bottom.

    Likewise where interfaces meet the sphere.
    """
    geometry = SplineGeometry()
    singular = {p for edge in edges if edge.name in SINGULAR for p in (edge.start, edge.end) if p[0] > 0}
    singular |= {edge.start for edge in edges if edge.name == "interface" and edge.start[0] > 0}  # on the sphere
    points = {p: None for edge in edges for p in (edge.start, edge.end)}
    index = {p: geometry.AddPoint(*p, hpref=float(p in singular)) for p in points}
    for edge in edges:
        shape: list[Any] = ["line", index[edge.start], index[edge.end]]
        if edge.centre is not None:
            (low, high), c = edge.angles(), np.array([0.0, edge.centre])
            corner = c + (edge.point(0.5) - c) / math.cos((high - low) / 2)  # where the tangents at both ends meet
            shape = ["spline3", index[edge.start], geometry.AddPoint(*corner), index[edge.end]]
        geometry.Append(shape, leftdomain=edge.left, rightdomain=edge.right, bc=edge.name)
    for number, name in NAMES.items():
        geometry.SetMaterial(number, name)
    parameters = MeshingParameters(maxh=1e9, grading=0.5 * refinement.size)
    for r, z, h in sizes(edges, refinement.size):
        parameters.RestrictH(r, z, 0.0, h)
    mesh = ngs.Mesh(geometry.GenerateMesh(mp=parameters))
    mesh.RefineHP(refinement.layers)
    mesh.Curve(refinement.order)
    return mesh
