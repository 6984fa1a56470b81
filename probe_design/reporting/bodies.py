"""Build triangle meshes of probe and tumours for the rotating view of a report, from the meridian profile; no CAD is needed.

Lengths are in mm. The z axis points out of the tissue; the probe stands where the scene places it. The quarter x > 0, y < 0 of
the probe is left out to show its inside; the groove is cut from the film end of the outer block.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from geometry.common.arrays import Floats, Ints
from geometry.scenes.base_sizes import find_base_faces, find_base_sizes, find_film_levels
from geometry.scenes.fit_check import compute_semi_axes
from geometry.scenes.probe import Probe
from geometry.scenes.scene import Scene
from geometry.scenes.units import MM_PER_M

BODY_COLOURS = {
    "inner": (0.86, 0.47, 0.20), "outer": (0.25, 0.51, 0.71), "film": (0.93, 0.78, 0.22), "base": (0.62, 0.64, 0.67),
    "tumour": (0.64, 0.23, 0.18),
}  # fmt: skip
MAX_ANGLE_STEP_RAD = math.pi / 36  # 5 degrees about the axis
END_ANGLE_RAD = 1.5 * math.pi  # of rings, which leave out a quarter of the turn
Mesh = tuple[Floats, Ints]


def build_bodies(scene: Scene) -> tuple[dict[str, object], ...]:
    """Build the bodies of a ``page.TurningView`` in mm: the parts of the probe where the scene places it, and the inclusions.

    Inclusions with a surface file are left out.
    """
    placement, rotation = scene.placement, _build_rotation(scene.placement.tilt)
    shift = np.array([placement.x, placement.y, 0.0])
    meshes = [(name, mesh[0] @ rotation.T + shift, mesh[1]) for name, mesh in iterate_probe_meshes(scene.probe)]
    for body in scene.inclusion:
        if body.surface is None:
            places, triangles = build_sphere()
            centre = np.array([body.x, body.y, -body.depth])
            meshes.append(("tumour", places @ np.array(compute_semi_axes(body)).T + centre, triangles))
    return tuple(
        {"colour": BODY_COLOURS[name], "vertices": np.round(MM_PER_M * places, 4).tolist(), "triangles": triangles.tolist()}
        for name, places, triangles in meshes
    )


def iterate_probe_meshes(probe: Probe) -> Iterator[tuple[str, Mesh]]:
    """Yield name and mesh (m) of each part of a probe whose blocks stand on z = 0, with a quarter left out."""
    core, tube, groove = probe.core_height, probe.tube_height, probe.groove
    base_inner, base_outer = find_base_faces(probe)
    inner_film, outer_film = ((core, core), (tube, tube)) if probe.film is None else find_film_levels(probe)
    r, hole, outer_radius, top = probe.inner_radius, probe.hole_radius, probe.tube_radius, max(base_inner, base_outer)
    groove_angle = 0.0 if groove is None else math.asin(min(groove.width / 2 / hole, 1.0))
    depth = 0.0 if groove is None else groove.depth
    sizes = find_base_sizes(probe)
    flange = top + sizes.step_height
    # radii and heights of each ring, and the angle at which it begins: rings at the groove's depth begin at its side
    for name, inner, outer, low, high, begin in (
        ("inner", 0.0, r, 0.0, core, 0.0),
        ("outer", hole, outer_radius, 0.0, tube - depth, 0.0),
        ("outer", hole, outer_radius, tube - depth, tube, groove_angle),
        ("film", 0.0, r, *inner_film, 0.0),
        ("film", hole, outer_radius, *outer_film, groove_angle),
        ("base", 0.0, r, base_inner, top, 0.0),  # reaches down to the lower of two blocks
        ("base", hole, outer_radius, base_outer, top, 0.0),
        ("base", 0.0, outer_radius, top, flange, 0.0),
        ("base", 0.0, sizes.flange_radius, flange, flange + sizes.thickness, 0.0),
    ):
        if high > low:
            yield name, build_ring(inner, outer, low, high, begin=begin)


def build_ring(inner: float, outer: float, low: float, high: float, *, begin: float = 0.0) -> Mesh:
    """Build the closed surface of a ring sector: a rectangle of the meridian plane rotated between two angles.

    Parameters
    ----------
    inner
        Inner radius, m; 0 for a full disc.
    outer
        Outer radius, m.
    low
        Lower z, m.
    high
        Upper z, m.
    begin
        First angle, rad, from x towards y; the last is ``END_ANGLE_RAD``, which leaves out a quarter of the turn.

    Returns
    -------
    Mesh
        Vertices (n, 3) and triangles (m, 3), whose normals point outwards.
    """
    angles = np.linspace(begin, END_ANGLE_RAD, math.ceil((END_ANGLE_RAD - begin) / MAX_ANGLE_STEP_RAD) + 1)
    profile = np.array([(inner, low), (outer, low), (outer, high), (inner, high)])
    directions = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    places = np.concatenate(
        [profile[None, :, :1] * directions[:, None], np.broadcast_to(profile[:, 1:], (len(angles), 4, 1))], axis=2
    )
    # four vertices at each angle: a and b at one angle, d and c beside them at the next
    first = 4 * np.arange(len(angles) - 1)[:, None]
    k, following = np.arange(4), (np.arange(4) + 1) % 4
    a, b, c, d = first + k, first + following, first + 4 + following, first + 4 + k
    sides = np.concatenate([np.stack([a, d, b], axis=-1).reshape(-1, 3), np.stack([b, d, c], axis=-1).reshape(-1, 3)])
    last = 4 * (len(angles) - 1)
    ends = np.array([[0, 1, 2], [0, 2, 3], [last, last + 2, last + 1], [last, last + 3, last + 2]])
    return places.reshape(-1, 3), np.concatenate([sides, ends])


def build_sphere() -> Mesh:
    """Build a sphere of radius 1 about the origin, with vertices on a grid of polar angle and azimuth."""
    count = round(math.pi / MAX_ANGLE_STEP_RAD / 2)
    polar, azimuth = np.meshgrid(np.linspace(0, math.pi, count + 1), np.linspace(0, 2 * math.pi, 2 * count + 1), indexing="ij")
    places = np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], axis=-1).reshape(-1, 3)
    width = 2 * count + 1
    a = (np.arange(count)[:, None] * width + np.arange(2 * count)).ravel()
    b, c, d = a + width, a + width + 1, a + 1
    return places, np.concatenate([np.stack([a, b, c], axis=-1), np.stack([a, c, d], axis=-1)])


def _build_rotation(tilt: float) -> Floats:
    """Return the rotation about the y axis; a positive tilt lowers the +x side."""
    c, s = math.cos(tilt), math.sin(tilt)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
