"""Bodies and mesh of the three-dimensional reference code: probe, cylinder or block of tissue, layers, tumours, the half y > 0.

The tissue lies below z = 0, the probe's axis is x = y = 0, lengths are in inner radii. Interfaces of layers cut tumours into
pieces: what surrounds a piece is one material.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import ngsolve as ngs
import numpy as np
from netgen import occ
from netgen.meshing import MeshingParameters
from scipy.spatial import KDTree

from benchmarks.references.outline import Refinement
from geometry import Inclusion, Material, Scene
from geometry.scenes.fit_check import compute_semi_axes

LAYER = 0.125  # thickness of the layer of elements at the rims, over that of the elements it is cut from
FLAT_TOLERANCE = 1e-4  # more than the margins of the shapes' bounding boxes, less than their sizes
CUT_SIZE = 0.15  # least size at an interface, where it cuts a tumour
THIN_LAYER_FACTOR = 3.0  # thicknesses of a layer that elements near tumours and probe may be long


@dataclass(frozen=True)
class Slab:
    """A layer of the tissue or, last, its own material: the heights between which it lies, in inner radii."""

    name: str
    top: float
    bottom: float
    material: Material


def slabs(scene: Scene) -> list[Slab]:
    """Return the tissue's materials from the surface downwards."""
    tissue, unit = scene.tissue, scene.probe.inner_radius
    assert tissue.shape != "half-space"  # check has asked
    heights = [-depth / unit for depth in (0.0, *tissue.interfaces, tissue.depth)]
    names = [*(f"layer{k}" for k in range(len(tissue.layer))), "tissue"]
    spans = zip(names, pairwise(heights), (*tissue.layer, tissue), strict=True)
    return [Slab(name, top, bottom, material) for name, (top, bottom), material in spans]


def piece(tumour: int, slab: Slab) -> str:
    """Return the name of what of a tumour lies in a slab."""
    return f"tumour{tumour}in{slab.name}"


def check(scene: Scene) -> None:
    """Raise ValueError if the code does not take the scene."""
    probe, tissue = scene.probe, scene.tissue
    unlike = probe.film is not None or probe.groove is not None or not probe.base.rigid or scene.contact.interface == "unilateral"
    for body in scene.inclusion:
        unlike |= body.surface is not None or bool(body.y) or any(body.orientation[k] % 180 for k in (0, 2))
    if unlike or tissue.shape != "cylinder" or scene.placement != type(scene.placement)():
        raise ValueError(
            "the reference takes a cylinder about the probe's axis, tumours at y = 0, a rigid base, no film, no groove"
        )


def surface_points(body: Inclusion, unit: float, count: int = 6000) -> np.ndarray:
    """Return points spread over an ellipsoid's surface, in inner radii."""
    k = np.arange(count) + 0.5
    z, angle = 1 - 2 * k / count, k * math.pi * (1 + math.sqrt(5))
    sphere = np.stack([np.sqrt(1 - z**2) * np.cos(angle), np.sqrt(1 - z**2) * np.sin(angle), z])
    return np.asarray((np.array(compute_semi_axes(body)) @ sphere).T + np.array([body.x, 0.0, -body.depth])) / unit


def tumour(body: Inclusion, unit: float) -> Any:
    """Return an ellipsoid as a shape, in inner radii."""
    axes, centre = np.array(compute_semi_axes(body)) / unit, occ.Pnt(body.x / unit, 0.0, -body.depth / unit)
    radii = np.linalg.norm(axes, axis=0)
    if body.diameter is not None:
        return occ.Sphere(centre, float(radii[0]))
    along, across = axes[:, 2] / radii[2], axes[:, 0] / radii[0]
    frame = occ.Axes(centre, occ.Vec(*along), occ.Vec(*across))
    return occ.Ellipsoid(frame, *(float(radii[k]) for k in (2, 0, 1)))


def place(scene: Scene) -> list[Inclusion]:
    """Return the tumours with their x from the probe's axis."""
    return [body.model_copy(update={"x": body.x - scene.placement.x}) for body in scene.inclusion]


def _span_block(scene: Scene) -> tuple[float, float, float]:
    """Return x from, x to and y to of a block of tissue, from the probe's axis, in inner radii."""
    tissue, unit, x = scene.tissue, scene.probe.inner_radius, scene.placement.x
    assert tissue.shape == "block"
    return (-tissue.length / 2 - x) / unit, (tissue.length / 2 - x) / unit, tissue.breadth / 2 / unit


def layer(scene: Scene, slab: Slab) -> Any:
    """Return a layer of the tissue without its tumours as a shape, in inner radii."""
    if scene.tissue.shape == "cylinder":
        radius = scene.tissue.radius / scene.probe.inner_radius
        return occ.Cylinder(occ.Pnt(0, 0, slab.bottom), occ.Z, radius, slab.top - slab.bottom)
    left, right, breadth = _span_block(scene)
    return occ.Box(occ.Pnt(left, -breadth, slab.bottom), occ.Pnt(right, breadth, slab.top))


def shape(scene: Scene) -> Any:
    """Return the half y > 0 of all bodies, named."""
    probe, unit = scene.probe, scene.probe.inner_radius
    r2, r3, deep = probe.hole_radius / unit, probe.tube_radius / unit, -slabs(scene)[-1].bottom
    wide = 2 * scene.tissue.radius / unit if scene.tissue.shape == "cylinder" else 2 * math.hypot(*_span_block(scene))
    heights = (probe.core_height / unit, probe.tube_height / unit)
    half = occ.Box(occ.Pnt(-wide, 0, -2 * deep), occ.Pnt(wide, wide, 2 * deep))
    origin = occ.Pnt(0, 0, 0)
    inner = occ.Cylinder(origin, occ.Z, 1.0, heights[0])
    outer = occ.Cylinder(origin, occ.Z, r3, heights[1]) - occ.Cylinder(origin, occ.Z, r2, heights[1])
    parts = [("inner", inner), ("outer", outer)]
    tumours = [tumour(inclusion, unit) for inclusion in place(scene)]
    for slab in slabs(scene):
        tissue = layer(scene, slab)
        parts += [(piece(k, slab), each * tissue) for k, each in enumerate(tumours)]
        for each in tumours:
            tissue = tissue - each
        parts.append((slab.name, tissue))
    bodies = []
    for name, whole in parts:
        for cut in (whole * half).solids:
            cut.mat(name)
            bodies.append(cut)
    glued = occ.Glue(bodies)
    for face in glued.faces:
        low, high = face.bounding_box
        level = high[2] - low[2] < FLAT_TOLERANCE
        bottom = level and high[2] < FLAT_TOLERANCE - deep
        tests = {"mirror": high[1] < FLAT_TOLERANCE, "bottom": bottom, "end": level and low[2] > FLAT_TOLERANCE}
        tests["top"] = level and abs(high[2]) < FLAT_TOLERANCE and high[0] > 1.001 * r3  # the tissue's, beside the probe
        tests["side"] = low[2] > -FLAT_TOLERANCE and not level and high[0] > r3 - FLAT_TOLERANCE  # the outer block's
        tests["free"] = True
        face.name = next(name for name, is_match in tests.items() if is_match)
    for edge in glued.edges:
        low, high = edge.bounding_box
        rim = max(abs(low[2]), abs(high[2])) < FLAT_TOLERANCE and high[1] > FLAT_TOLERANCE and high[0] < 1.001 * r3
        edge.hpref = float(rim)
    return glued


def sizes(scene: Scene, size: float) -> list[tuple[float, float, float, float]]:
    """Return mesh sizes (x, y, z, h): near the tumours by their distance to surface and neighbours, at the rims by both."""
    unit, probe = scene.probe.inner_radius, scene.probe
    r2, r3 = probe.hole_radius / unit, probe.tube_radius / unit
    clouds = [surface_points(body, unit) for body in place(scene)]
    point_sizes = []
    for k, (body, cloud) in enumerate(zip(scene.inclusion, clouds, strict=True)):
        distance = -cloud[:, 2]
        for other in clouds[:k] + clouds[k + 1 :]:
            distance = np.minimum(distance, KDTree(other).query(cloud)[0])
        radius = min(body.diameters or (body.diameter or 0.0,)) / 2 / unit
        point_sizes.append(np.column_stack([cloud, np.minimum(1.2 * distance, 0.8 * radius)]))
    tree = KDTree(np.concatenate(clouds))
    for radius, count in ((1.0, 240), (r2, 240), (r3, 300)):  # the rims
        angle = np.linspace(0, math.pi, count)
        rim = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), 0 * angle])
        point_sizes.append(np.column_stack([rim, np.clip(0.7 * tree.query(rim)[0], 0.02, 0.3)]))
    x, y = np.meshgrid(np.linspace(-2 * r3, 2 * r3, 241), np.linspace(0, 2 * r3, 121))
    for slab in slabs(scene):
        top = np.column_stack([x.ravel(), y.ravel(), slab.top + 0 * x.ravel()])
        distance = np.maximum(tree.query(top)[0], CUT_SIZE)
        point_sizes.append(np.column_stack([top, np.minimum(1.2 * distance, THIN_LAYER_FACTOR * (slab.top - slab.bottom))]))
    return [(a, b, c, h * size) for a, b, c, h in np.concatenate(point_sizes) if b >= 0]


def make_mesh(scene: Scene, refinement: Refinement) -> ngs.Mesh:
    """Build the curved mesh: tetrahedra sized by the distances between tumours, surface and rims, prisms round the rims."""
    parameters = MeshingParameters(maxh=2.5 * refinement.size, grading=0.5)
    for x, y, z, h in sizes(scene, refinement.size):
        parameters.RestrictH(x, y, z, float(h))
    mesh = ngs.Mesh(occ.OCCGeometry(shape(scene)).GenerateMesh(mp=parameters))
    mesh.RefineHP(refinement.layers, LAYER)
    mesh.Curve(refinement.order)
    return mesh
