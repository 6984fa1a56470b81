"""Choose the part of a scene that is meshed in three dimensions, and the symmetric reference whose exact solution is known.

Meshes are made about the probe's axis. Where tissue is round about it, or its edges are far, any plane through the axis may be
that of a mirror-symmetric scene's half: tumours are turned into it.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from dataclasses import dataclass

from geometry.scenes.probe import Base
from geometry.scenes.scene import Scene
from geometry.scenes.scene_tables import CylinderTissue, Inclusion, Load, Placement
from geometry.scenes.tissue_sides import compute_side_distance
from geometry.tetra.layout import is_mirror_symmetric

MIN_SPAN_RADII = 8.0  # outer radii: minimum radius and depth of the modelled tissue
ROUND_SPAN_RADII = 5.0  # outer radii: with this much tissue about the axis, a coaxial cylinder replaces other shapes
INCLUSION_REACH_FACTOR = 1.7  # times the distance of the farthest point of an inclusion
MIN_LAYER_DEPTH_SHARE = 0.9  # of the depth at which tissue is cut off: layers that begin deeper are left out
COORDINATE_TOLERANCE_RELATIVE = 1e-9


@dataclass(frozen=True)
class Domain:
    """A scene as it is meshed.

    Attributes
    ----------
    scene
        The scene; its tissue may be a smaller cylinder about the probe's axis.
    reference
        The probe alone, without groove, films and elastic base, on a cylinder of tissue about its axis.
    radius
        Radius of that cylinder, m, if it differs from the meshed tissue's side; or None.
    half
        Whether the half y >= 0 is meshed.
    shortened
        Whether tissue was left out.
    turn
        Angle by which the x axis of ``scene`` leads the probe's, rad.
    """

    scene: Scene
    reference: Scene
    radius: float | None
    half: bool
    shortened: bool
    turn: float = 0.0


def remove_asymmetry(scene: Scene) -> Scene:
    """Return the scene without what is not rotationally symmetric: inclusions, groove and tilt."""
    probe = scene.probe.model_copy(update={"groove": None})
    placement = scene.placement.model_copy(update={"tilt": 0.0})
    return scene.model_copy(update={"probe": probe, "inclusion": (), "placement": placement, "load": Load(indentation=0.0)})


def compute_free_radius(scene: Scene) -> float:
    """Return the radius of the largest cylinder about the probe's axis inside the tissue, m; infinite for a half-space."""
    return float(compute_side_distance(scene.tissue, scene.placement.x, scene.placement.y))


def compute_reach(scene: Scene, span: float = MIN_SPAN_RADII) -> float:
    """Return the distance from the probe, m, that the model must include: ``span`` times its size, and all inclusions.

    The probe's size is the maximum of its radius and its blocks' heights.
    """
    placement, probe = scene.placement, scene.probe
    sizes = [max(probe.tube_radius, probe.core_height, probe.tube_height) * span]
    for body in scene.inclusion:
        size = body.diameter or max(body.diameters or (0.0,))
        sizes.append(INCLUSION_REACH_FACTOR * (math.hypot(body.x - placement.x, body.y - placement.y, body.depth) + size / 2))
    return max(sizes)


def choose_domain(scene: Scene, span: float, wall: float | None) -> Domain:
    """Choose the domain to mesh and its reference.

    Parameters
    ----------
    scene
        The scene.
    span
        Radius and depth to which larger tissue may be cut, m; inf for no cut.
    wall
        Radius of the reference cylinder if tissue is not coaxial with the probe and cannot be cut, or None.
    """
    full_depth = scene.tissue.bottom
    if is_coaxial(scene) or (
        math.isfinite(span) and compute_free_radius(scene) >= min(span, compute_reach(scene, ROUND_SPAN_RADII))
    ):
        radius, depth = min(span, compute_free_radius(scene)), min(full_depth, span)
        tissue = _build_cylinder(scene, radius, depth)
        meshed_scene, turn = _move_to_axis(scene, tissue)
        cut = not is_coaxial(scene) or radius < compute_free_radius(scene) or depth < full_depth
        half = is_mirror_symmetric(meshed_scene)
        return Domain(meshed_scene, _build_reference(meshed_scene, tissue), None, half, cut, turn)
    assert wall is not None
    tissue = _build_cylinder(scene, wall, full_depth)
    meshed_scene = _mirror_scene(scene)
    return Domain(meshed_scene, _build_reference(meshed_scene, tissue), wall, is_mirror_symmetric(meshed_scene), False)


def _build_cylinder(scene: Scene, radius: float, depth: float) -> CylinderTissue:
    """Return a cylinder of the scene's tissue, of a radius and a depth, m.

    Layers below the depth are left out. Where tissue is cut off, so is a layer that begins just above the cut
    (``MIN_LAYER_DEPTH_SHARE``).
    """
    tissue = scene.tissue
    cut = depth < tissue.bottom
    layer_count = bisect_left(tissue.interfaces, MIN_LAYER_DEPTH_SHARE * depth if cut else depth)
    material = (*tissue.layer, tissue)[layer_count]  # below the layers that are left
    return CylinderTissue(
        shape="cylinder",
        radius=radius,
        depth=depth,
        youngs_modulus=material.youngs_modulus,
        poisson_ratio=material.poisson_ratio,
        layer=tissue.layer[:layer_count],
    )


def is_coaxial(scene: Scene) -> bool:
    """Return whether the tissue is rotationally symmetric about the probe's axis."""
    placement = scene.placement
    is_off_axis = math.hypot(placement.x, placement.y) > COORDINATE_TOLERANCE_RELATIVE * scene.probe.tube_radius
    return scene.tissue.shape == "half-space" or (scene.tissue.shape == "cylinder" and not is_off_axis)


def _build_reference(scene: Scene, tissue: CylinderTissue) -> Scene:
    """Return the rotationally symmetric reference scene, whose exact solution is known.

    The probe has a rigid base, no films, groove or tilt; the tissue is a coaxial cylinder without inclusions.
    """
    symmetric_scene = remove_asymmetry(scene)
    probe = symmetric_scene.probe.model_copy(update={"film": None, "base": Base(rigid=True)})
    return symmetric_scene.model_copy(update={"probe": probe, "tissue": tissue, "placement": Placement()})


def _move_to_axis(scene: Scene, tissue: CylinderTissue) -> tuple[Scene, float]:
    """Return the scene on ``tissue`` in the probe's axes, and ``Domain.turn``.

    Without groove, tilt and surface files it is also rotated so that the inclusion farthest from the axis lies in y = 0.
    """
    placement = scene.placement
    bodies = [body.model_copy(update={"x": body.x - placement.x, "y": body.y - placement.y}) for body in scene.inclusion]
    turned, turn = bodies, 0.0
    if scene.probe.groove is None and placement.tilt == 0 and bodies and all(body.surface is None for body in bodies):
        far = max(bodies, key=lambda body: math.hypot(body.x, body.y))
        turn = math.atan2(far.y, far.x)
        turned = [_turn_inclusion(body, -turn) for body in bodies]
    placed = Placement(tilt=placement.tilt)
    return scene.model_copy(update={"tissue": tissue, "inclusion": tuple(turned), "placement": placed}), turn


def _mirror_scene(scene: Scene) -> Scene:
    """Mirror a scene of spheres so that the probe stands at x, y >= 0 of its tissue: mirror images share a mesh."""
    placement = scene.placement
    if scene.probe.groove is not None or placement.tilt != 0 or any(body.diameter is None for body in scene.inclusion):
        return scene
    x, y = (-1.0 if side < 0 else 1.0 for side in (placement.x, placement.y))
    bodies = tuple(body.model_copy(update={"x": x * body.x, "y": y * body.y}) for body in scene.inclusion)
    return scene.model_copy(update={"inclusion": bodies, "placement": Placement(x=x * placement.x, y=y * placement.y)})


def _turn_inclusion(body: Inclusion, angle: float) -> Inclusion:
    """Return an inclusion rotated about the z axis by an angle, rad."""
    x, y = (
        math.cos(angle) * body.x - math.sin(angle) * body.y,
        math.sin(angle) * body.x + math.cos(angle) * body.y,
    )
    # rounding must not leave the inclusion just off the plane of symmetry
    y = 0.0 if abs(y) < COORDINATE_TOLERANCE_RELATIVE * max(abs(x), body.depth) else y
    if body.diameter is not None:
        return body.model_copy(update={"x": x, "y": y})
    rz, ry, rx = body.orientation
    return body.model_copy(update={"x": x, "y": y, "orientation": (math.remainder(rz + math.degrees(angle), 360.0), ry, rx)})
