"""Describe a scene's bodies by numbers in the probe's axes, for the surfaces, labels and checks of a volume mesh."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from geometry.common.errors import Refusal
from geometry.scenes.fit_check import compute_offset, compute_semi_axes
from geometry.scenes.probe import format_mm
from geometry.scenes.scene import Scene
from geometry.tetra.body_layout import BodyLayout, Ellipsoid, check_extent, check_fit
from geometry.tetra.surface_files import Sheet, read_surface

_SYMMETRY_TOLERANCE = 1e-9  # by how much of its size a scene may be off its mirror image


def find_extent(scene: Scene, tissue_extent: float | None) -> float:
    """Return radius and depth in m of the meshed tissue: ``tissue_extent``, infinity, or the extent that replaces a half-space.

    A half-space reaches to 25 outer radii and beyond all inclusions, five times as far from the probe as they are.
    """
    if tissue_extent is not None:
        return tissue_extent
    if scene.tissue.shape != "half-space":
        return math.inf
    reach = [
        compute_offset(scene, body) + body.depth + max(body.diameters or (body.diameter or 0.0,)) for body in scene.inclusion
    ]
    return max(25 * scene.probe.tube_radius, *(5 * size for size in reach), 0.0)


def build_layout(scene: Scene, half: bool, tissue_extent: float, reference_radius: float | None) -> BodyLayout:
    """Read a scene into its bodies in the probe's axes.

    Parameters
    ----------
    scene
        The scene.
    half
        Whether only y >= 0 is meshed.
    tissue_extent
        Radius and depth in m that stand for a half-space's; other tissue that reaches further to its sides becomes a cylinder of
        that radius about the probe's axis, and deeper tissue becomes as deep. See ``find_extent``.
    reference_radius
        Of the reference cylinder in m; None for the tissue's own side where that is coaxial, else a large one.

    Raises
    ------
    InputError
        A surface file that cannot be read.
    Refusal
        Half of a scene that is not its own mirror image, a reference cylinder or an extent out of range, or bodies that leave the
        tissue or overlap.
    """
    probe, placement = scene.probe, scene.placement
    if half and not is_mirror_symmetric(scene):
        raise Refusal("half", True, "a scene that is its own mirror image in the plane y = placement.y")
    groove = None if probe.groove is None else (probe.groove.width / 2, probe.groove.depth)
    bodies = tuple(_read_inclusion(scene, index) for index in range(len(scene.inclusion)))
    centre, radius, sides, depth = _read_tissue(scene)
    whole = BodyLayout(
        inner=probe.inner_radius,
        hole=probe.hole_radius,
        tube=probe.tube_radius,
        inner_height=probe.core_height,
        outer_height=probe.tube_height,
        groove=groove,
        centre=(centre[0] - placement.x, centre[1] - placement.y),
        tissue_radius=radius,
        sides=sides,
        depth=depth,
        interfaces=scene.tissue.interfaces,
        wall=None,
        inclusions=bodies,
        half=half,
    )
    shortened = _shorten(whole, tissue_extent)
    check_fit(shortened, tuple(body.surface or "" for body in scene.inclusion), tissue_extent)
    return _add_wall(shortened, reference_radius)


def _read_tissue(scene: Scene) -> tuple[tuple[float, float], float | None, tuple[float, float], float]:
    """Return the tissue's axis in the scene, its radius or None, half its sides, and its depth; infinite for a half-space."""
    tissue = scene.tissue
    if tissue.shape == "half-space":
        return (scene.placement.x, scene.placement.y), math.inf, (0.0, 0.0), math.inf
    if tissue.shape == "cylinder":
        return (0.0, 0.0), tissue.radius, (0.0, 0.0), tissue.depth
    return (0.0, 0.0), None, (tissue.length / 2, tissue.breadth / 2), tissue.depth


def _shorten(whole: BodyLayout, extent: float) -> BodyLayout:
    """Return a layout whose tissue reaches no farther than ``extent`` in m, to its sides and in depth.

    Tissue that reaches farther to its sides becomes a cylinder of that radius about the probe's axis.

    Raises
    ------
    Refusal
        The extent is too small for the probe, or infinite.
    """
    endless = math.inf in (whole.tissue_radius, whole.depth)
    room = math.inf if endless else float(whole.compute_side_distance(np.linspace(0, 2 * math.pi, 721)).max())
    if not endless and room <= extent and whole.depth <= extent:
        return whole
    check_extent(whole.tube, extent)
    depth = min(whole.depth, extent)
    shorter = replace(
        whole, depth=depth, interfaces=tuple(depth_of_layer for depth_of_layer in whole.interfaces if depth_of_layer < depth)
    )
    return replace(shorter, centre=(0.0, 0.0), tissue_radius=extent, sides=(0.0, 0.0)) if room > extent else shorter


def _add_wall(layout: BodyLayout, radius: float | None) -> BodyLayout:
    """Return a layout with a reference cylinder of a radius in m, see ``build_layout``; it needs none where tissue is coaxial.

    Raises
    ------
    Refusal
        The cylinder does not lie between the probe and the tissue's side.
    """
    room = float(layout.compute_side_distance(np.linspace(0, 2 * math.pi, 721)).min())
    coaxial = layout.tissue_radius is not None and math.hypot(*layout.centre) <= _SYMMETRY_TOLERANCE * layout.tissue_radius
    if coaxial and (radius is None or radius >= room * (1 - _SYMMETRY_TOLERANCE)):
        return layout
    wall = choose_wall(layout, room) if radius is None else radius
    if not layout.tube * 1.05 < wall < room * 0.999:
        allowed = (
            f"from {format_mm(layout.tube * 1.05)} to {format_mm(room * 0.999)}: a cylinder round the probe's "
            "axis inside the tissue"
        )
        raise Refusal("reference_radius", format_mm(wall), allowed)
    return replace(layout, wall=wall)


def choose_wall(layout: BodyLayout, room: float) -> float:
    """Return the largest radius of a reference cylinder, m, that meets no inclusion and leaves a margin to the tissue's side.

    ``room`` is the smallest distance from the probe's axis to that side. Radii are tried from just beyond the tube to 0.8
    ``room``, or where there is little room to the middle between both.
    """
    free = [(layout.tube * 1.05, (layout.tube + room) / 2 if room < 1.2 * layout.tube else 0.8 * room)]
    for body in layout.inclusions:  # ``free`` are intervals of radii; each inclusion takes one out, with a margin
        centre, reach = math.hypot(*body.centre[:2]), math.hypot(*body.reach[:2])
        spare = max(0.25 * reach, 0.12 * centre)
        low, high = centre - reach - spare, centre + reach + spare
        free = [part for a, b in free for part in ((a, min(b, low)), (max(a, high), b)) if part[1] > part[0]]
    good = [b for a, b in free if b > 1.3 * layout.tube] or [b for a, b in free] or [(layout.tube + room) / 2]
    return max(good)


def is_mirror_symmetric(scene: Scene) -> bool:
    """Return whether a scene is its own mirror image in the plane y = placement.y; a surface from a file never counts as such."""
    size, placement = scene.probe.tube_radius, scene.placement
    if scene.tissue.shape != "half-space" and abs(placement.y) > _SYMMETRY_TOLERANCE * size:
        return False
    for body in scene.inclusion:
        if body.surface is not None or abs(body.y - placement.y) > _SYMMETRY_TOLERANCE * size:
            return False
        axes = np.array(compute_semi_axes(body))
        form = axes @ axes.T  # xy and yz entries vanish exactly if the ellipsoid is symmetric about y = 0
        if max(abs(form[0, 1]), abs(form[1, 2])) > _SYMMETRY_TOLERANCE * form.trace():
            return False
    return True


def _read_inclusion(scene: Scene, index: int) -> Ellipsoid | Sheet:
    """Return an inclusion of a scene, by its index, as a body in the probe's axes; raises ``InputError`` as ``read_surface``."""
    body, placement = scene.inclusion[index], scene.placement
    centre = np.array([body.x - placement.x, body.y - placement.y, -body.depth])
    if body.surface is None:
        return Ellipsoid(centre, np.array(compute_semi_axes(body)))
    return read_surface(body.surface, f"inclusion[{index}].surface", centre)
