"""Choose what of a scene is meshed in three dimensions, and the symmetric reference whose exact solution is known.

Meshes are made about the probe's axis. Where tissue is round about it, or its edges are far, any plane through the axis may be
that of a mirror-symmetric scene's half: tumours are turned into it.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from dataclasses import dataclass

from geometry.scenes.probe import Base
from geometry.scenes.scene import CylinderTissue, Inclusion, Load, Placement, Scene
from geometry.tetra.layout import mirror_symmetric

SPAN = 8.0  # outer radii: minimum radius and depth of the modelled tissue
AROUND = 5.0  # outer radii: with this much tissue about the axis, a coaxial cylinder replaces other shapes
REACH = 1.7  # times the distance of the farthest point of an inclusion
SLICE = 0.9  # of the depth at which tissue is cut off: layers that begin deeper are left out
EVEN = 1e-9


@dataclass(frozen=True)
class Domain:
    """A scene as it is meshed.

    Attributes:
        scene: the scene; its tissue may be a smaller cylinder about the probe's axis.
        reference: the probe alone, without groove, films and elastic base, on a cylinder of tissue about its axis.
        radius: radius of that cylinder, m, if it differs from the meshed tissue's side; or None.
        half: whether the half y >= 0 is meshed.
        shortened: whether tissue was left out.
    """

    scene: Scene
    reference: Scene
    radius: float | None
    half: bool
    shortened: bool


def plain(scene: Scene) -> Scene:
    """Return the scene without what is not rotationally symmetric: inclusions, groove and tilt."""
    probe = scene.probe.model_copy(update={"groove": None})
    at = scene.placement.model_copy(update={"tilt": 0.0})
    return scene.model_copy(update={"probe": probe, "inclusion": (), "placement": at, "load": Load(indentation=0.0)})


def room(scene: Scene) -> float:
    """Return the radius of the largest cylinder about the probe's axis inside the tissue, m."""
    tissue, at = scene.tissue, scene.placement
    if tissue.shape == "half-space":
        return math.inf
    if tissue.shape == "cylinder":
        return tissue.radius - math.hypot(at.x, at.y)
    return min(tissue.length / 2 - abs(at.x), tissue.breadth / 2 - abs(at.y))


def reach(scene: Scene, span: float = SPAN) -> float:
    """Return the distance from the probe, m, that the model must include: ``span`` probe radii, and all inclusions."""
    at, probe = scene.placement, scene.probe
    sizes = [max(probe.tube_radius, probe.core_height, probe.tube_height) * span]
    for body in scene.inclusion:
        size = body.diameter or max(body.diameters or (0.0,))
        sizes.append(REACH * (math.hypot(body.x - at.x, body.y - at.y, body.depth) + size / 2))
    return max(sizes)


def domain(scene: Scene, span: float, wall: float | None) -> Domain:
    """Choose the domain to mesh and its reference.

    Args:
        scene: the scene.
        span: radius and depth to which larger tissue may be cut, m; inf for no cut.
        wall: radius of the reference cylinder if tissue is not coaxial with the probe and cannot be cut, or None.
    """
    whole = math.inf if scene.tissue.shape == "half-space" else scene.tissue.depth
    if coaxial(scene) or (math.isfinite(span) and room(scene) >= min(span, reach(scene, AROUND))):
        radius, depth = min(span, room(scene)), min(whole, span)
        tissue = _cylinder(scene, radius, depth)
        own = _about_the_axis(scene, tissue)
        cut = not coaxial(scene) or radius < room(scene) or depth < whole
        return Domain(own, _reference(own, tissue), None, mirror_symmetric(own), cut)
    assert wall is not None
    assert scene.tissue.shape != "half-space"
    tissue = _cylinder(scene, wall, scene.tissue.depth)
    own = _mirrored(scene)
    return Domain(own, _reference(own, tissue), wall, mirror_symmetric(own), False)


def _cylinder(scene: Scene, radius: float, depth: float) -> CylinderTissue:
    """Return a cylinder of the scene's tissue; a cut above or just below an interface omits the layers beneath."""
    tissue = scene.tissue
    cut = tissue.shape == "half-space" or depth < tissue.depth
    kept = bisect_left(tissue.interfaces, SLICE * depth if cut else depth)
    own = (*tissue.layer, tissue)[kept]
    return CylinderTissue(
        shape="cylinder",
        radius=radius,
        depth=depth,
        youngs_modulus=own.youngs_modulus,
        poisson_ratio=own.poisson_ratio,
        layer=tissue.layer[:kept],
    )


def coaxial(scene: Scene) -> bool:
    """Return whether the tissue is rotationally symmetric about the probe's axis."""
    at = scene.placement
    off = math.hypot(at.x, at.y) > EVEN * scene.probe.tube_radius
    return scene.tissue.shape == "half-space" or (scene.tissue.shape == "cylinder" and not off)


def _reference(scene: Scene, tissue: CylinderTissue) -> Scene:
    """Return the reference: the probe alone, on a rigid base and without films, on a coaxial cylinder of tissue."""
    alone = plain(scene)
    probe = alone.probe.model_copy(update={"film": None, "base": Base(rigid=True)})
    return alone.model_copy(update={"probe": probe, "tissue": tissue, "placement": Placement()})


def _about_the_axis(scene: Scene, tissue: CylinderTissue) -> Scene:
    """Return the scene in the probe's axes; without groove and tilt, rotated so that the farthest inclusion lies in y = 0."""
    at = scene.placement
    bodies = [body.model_copy(update={"x": body.x - at.x, "y": body.y - at.y}) for body in scene.inclusion]
    turned = bodies
    if scene.probe.groove is None and at.tilt == 0 and bodies and all(body.surface is None for body in bodies):
        far = max(bodies, key=lambda body: math.hypot(body.x, body.y))
        turned = [_turned(body, -math.atan2(far.y, far.x)) for body in bodies]
    placed = Placement(tilt=at.tilt)
    return scene.model_copy(update={"tissue": tissue, "inclusion": tuple(turned), "placement": placed})


def _mirrored(scene: Scene) -> Scene:
    """Mirror a scene of spheres so that the probe stands at x, y >= 0 of its tissue: mirror images share a mesh."""
    at = scene.placement
    if scene.probe.groove is not None or at.tilt != 0 or any(body.diameter is None for body in scene.inclusion):
        return scene
    x, y = (-1.0 if side < 0 else 1.0 for side in (at.x, at.y))
    bodies = tuple(body.model_copy(update={"x": x * body.x, "y": y * body.y}) for body in scene.inclusion)
    return scene.model_copy(update={"inclusion": bodies, "placement": Placement(x=x * at.x, y=y * at.y)})


def _turned(body: Inclusion, angle: float) -> Inclusion:
    """Return an inclusion rotated about the z axis by an angle, rad."""
    x, y = (
        math.cos(angle) * body.x - math.sin(angle) * body.y,
        math.sin(angle) * body.x + math.cos(angle) * body.y,
    )
    y = 0.0 if abs(y) < EVEN * max(abs(x), body.depth) else y
    if body.diameter is not None:
        return body.model_copy(update={"x": x, "y": y})
    rz, ry, rx = body.orientation
    return body.model_copy(update={"x": x, "y": y, "orientation": (math.remainder(rz + math.degrees(angle), 360.0), ry, rx)})
