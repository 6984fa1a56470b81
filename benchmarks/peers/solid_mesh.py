"""Scenes of ``solid.py`` as shapes and meshes by netgen, for both peers: the half y > 0 of all bodies, sized by hand.

Lengths are in mm, the probe's axis is x = y = 0, the tissue lies below z = 0. A single tumour in round tissue under a
probe without a groove is turned about the axis into the plane y = 0; other scenes must be their own mirror images there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from netgen import occ
from netgen.meshing import MeshingParameters

from geometry import Material, Scene

MM = 1e3
FLAT_TOLERANCE = 1e-4  # more than the margins of the shapes' bounding boxes, less than their sizes
ENDS = ("end_inner", "end_outer")


@dataclass(frozen=True)
class SolidSetting:
    """One discretisation; lengths in mm.

    Attributes
    ----------
    order
        Of the polynomials.
    rim
        Size of elements at the rims of the contact, three circles.
    block
        In the blocks.
    tumour
        At the tumours' surfaces.
    end
        At the rims of the blocks' ends and of the groove.
    far
        In the tissue.
    grading
        Netgen's, how fast elements may grow.
    smoothing
        Netgen's rounds of mesh optimisation.
    fill
        Whether netgen fills the interior with points of its own before it advances the front.
    layers
        Geometric layers of elements at the rims of the contact; none for tetrahedra only.
    factor
        By which one layer is thinner than the next.
    solver
        The peer's.
    """

    order: int
    rim: float
    block: float
    tumour: float
    end: float
    far: float = 25.0
    grading: float = 0.5
    smoothing: int = 1
    fill: bool = True
    layers: int = 0
    factor: float = 0.125
    solver: str = ""


def spheres(scene: Scene) -> list[tuple[float, float, float]]:
    """Return for each tumour its place along x, its depth and its radius, mm.

    Raises
    ------
    ValueError
        The scene is not its own mirror image.
    """
    solids = []
    for body in scene.inclusion:
        x, y = body.x - scene.placement.x, body.y - scene.placement.y
        if len(scene.inclusion) == 1 and scene.probe.groove is None and scene.tissue.shape == "cylinder":
            x, y = math.hypot(x, y), 0.0
        if abs(y) > 1e-9 or body.diameter is None:
            raise ValueError("the peers take spheres in the plane of symmetry y = 0")
        solids.append((MM * x, MM * body.depth, MM * body.diameter / 2))
    return solids


def materials(scene: Scene) -> dict[str, Material]:
    """Return the materials by the bodies' names."""
    tumours = {f"tumour{k}": body for k, body in enumerate(scene.inclusion)}
    return {"tissue": scene.tissue, "inner": scene.probe.inner, "outer": scene.probe.outer, **tumours}


def bodies(scene: Scene) -> dict[str, Any]:
    """Return the whole bodies by name."""
    probe, tissue = scene.probe, scene.tissue
    inner, hole, tube = (MM * length for length in (probe.inner_radius, probe.hole_radius, probe.tube_radius))
    heights, origin = (MM * probe.core_height, MM * probe.tube_height), occ.Pnt(0, 0, 0)
    outer = occ.Cylinder(origin, occ.Z, tube, heights[1]) - occ.Cylinder(origin, occ.Z, hole, heights[1])
    if probe.groove is not None:
        side, top = MM * probe.groove.width / 2, heights[1]
        outer = outer - occ.Box(occ.Pnt(0, -side, top - MM * probe.groove.depth), occ.Pnt(2 * tube, side, 2 * top))
    tumours = [occ.Sphere(occ.Pnt(x, 0, -depth), radius) for x, depth, radius in spheres(scene)]
    if tissue.shape == "cylinder":
        whole = occ.Cylinder(occ.Pnt(0, 0, -MM * tissue.depth), occ.Z, MM * tissue.radius, MM * tissue.depth)
    else:
        assert tissue.shape == "block"  # no scene here is a half-space
        half = (MM * tissue.length / 2, MM * tissue.breadth / 2)
        x, y = MM * scene.placement.x, MM * scene.placement.y
        whole = occ.Box(occ.Pnt(-half[0] - x, -half[1] - y, -MM * tissue.depth), occ.Pnt(half[0] - x, half[1] - y, 0))
    for each in tumours:
        whole = whole - each
    named = {f"tumour{k}": tumour for k, tumour in enumerate(tumours)}
    return {"tissue": whole, "inner": occ.Cylinder(origin, occ.Z, inner, heights[0]), "outer": outer, **named}


def shape(scene: Scene, setting: SolidSetting) -> Any:
    """Return the half y > 0 of all bodies, with names and sizes."""
    half = occ.Box(occ.Pnt(-1e3, 0, -1e3), occ.Pnt(1e3, 1e3, 1e3))
    sizes = {"inner": setting.block, "outer": setting.block, "groove": setting.block}
    parts = []
    for name, whole in bodies(scene).items():
        for solid in (whole * half).solids:
            solid.mat(name)
            solid.maxh = setting.tumour if name.startswith("tumour") else sizes.get(name, setting.far)
            parts.append(solid)
    glued = occ.Glue(parts)
    tube, top = MM * scene.probe.tube_radius, MM * scene.probe.tube_height
    hole = MM * (scene.probe.inner_radius + scene.probe.hole_radius) / 2
    for face in glued.faces:
        low, high = face.bounding_box
        face.name = _name(low, high, hole, top, MM * scene.probe.core_height)
    for edge in glued.edges:
        low, high = edge.bounding_box
        if high[1] > FLAT_TOLERANCE and high[0] < 1.001 * tube and low[2] > -FLAT_TOLERANCE:
            edge.maxh = min(edge.maxh, setting.rim if high[2] < FLAT_TOLERANCE else setting.end)
            edge.hpref = float(high[2] < FLAT_TOLERANCE)
    return glued


def _name(low: Any, high: Any, hole: float, tube_top: float, core_top: float) -> str:
    if high[1] < FLAT_TOLERANCE:
        return "mirror"
    if high[2] - low[2] > FLAT_TOLERANCE:
        return "free"
    if high[0] < hole and abs(low[2] - core_top) < FLAT_TOLERANCE:
        return ENDS[0]
    if high[0] > hole and abs(low[2] - tube_top) < FLAT_TOLERANCE:
        return ENDS[1]
    return "bottom" if high[2] < -FLAT_TOLERANCE else "free"


def tetrahedra(scene: Scene, setting: SolidSetting) -> Any:
    """Return netgen's mesh of straight tetrahedra."""
    parameters = MeshingParameters(
        maxh=setting.far,
        grading=setting.grading,
        optsteps3d=setting.smoothing,
        blockfill=setting.fill,
        curvaturesafety=0.5,
        segmentsperedge=0.5,
        parallel_meshing=False,
    )
    return occ.OCCGeometry(shape(scene, setting)).GenerateMesh(mp=parameters)
