"""Reasons why most evaluators refuse certain kinds of scenes; each text names the evaluator that takes them."""

from __future__ import annotations

import math

from geometry.scenes.fit import semi_axes
from geometry.scenes.scene import Inclusion, Scene

TOUCHING = 1e-6  # of a body's half height: at this distance from an interface of layers it counts as crossed


def unsupported(scene: Scene) -> str | None:
    """Return why no linear evaluator takes the scene: a unilateral interface or round edges; None otherwise."""
    if scene.contact.interface == "unilateral":
        return "contact for contact.interface = 'unilateral'"
    if scene.contact.edge_radius > 0:
        return "contact for contact.edge_radius above 0: round edges close bit by bit"
    return None


def layered(scene: Scene) -> str | None:
    """Return which evaluator takes the scene's layers of tissue, for one that does not; None without layers."""
    if not scene.tissue.layer:
        return None
    return (
        needs_solid(scene)
        or crossed(scene)
        or f"{'axisymmetric' if is_round(scene) else 'equivalent-inclusion'} for layers of tissue"
    )


def crossed(scene: Scene) -> str | None:
    """Return which evaluator takes inclusions crossed by an interface of layers, for one that does not; None without any."""
    if not any(_crosses(scene, body) for body in scene.inclusion if body.surface is None):
        return None
    return f"{'axisymmetric' if is_round(scene) else 'solid'} for an inclusion that an interface of the tissue's layers crosses"


def _crosses(scene: Scene, body: Inclusion) -> bool:
    half = math.hypot(*semi_axes(body)[2])
    return any(abs(interface - body.depth) < half * (1 + TOUCHING) for interface in scene.tissue.interfaces)


def is_round(scene: Scene) -> bool:
    """Return whether the probe is upright with at most one inclusion, a sphere on its axis."""
    at = scene.placement
    centred = all(math.hypot(body.x - at.x, body.y - at.y) <= 1e-9 * (body.diameter or 0.0) for body in scene.inclusion)
    return at.tilt == 0 and len(scene.inclusion) <= 1 and centred and all(body.diameter is not None for body in scene.inclusion)


def needs_solid(scene: Scene) -> str | None:
    """Return why only ``solid``, or no linear evaluator, takes the scene: contact, tilt, shape or crossed layers; else None."""
    if unsupported(scene) is not None:
        return unsupported(scene)
    if scene.placement.tilt != 0:
        return "solid for placement.tilt other than 0"
    if any(body.surface is not None for body in scene.inclusion):
        return "solid for an inclusion that is neither sphere nor ellipsoid"
    return None if is_round(scene) else crossed(scene)
