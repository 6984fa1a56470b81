"""Reasons why most evaluators refuse certain kinds of scenes; each text names the evaluator that takes them."""

from __future__ import annotations

import math

from geometry.scenes.fit_check import compute_semi_axes
from geometry.scenes.scene import Inclusion, Scene

TOUCHING_RELATIVE = 1e-6  # of a body's half height: at this distance from an interface of layers it counts as crossed


def find_linear_refusal(scene: Scene) -> str | None:
    """Return why no linear evaluator takes the scene: a unilateral interface or round edges; None otherwise."""
    if scene.contact.interface == "unilateral":
        return "contact for contact.interface = 'unilateral'"
    if scene.contact.edge_radius > 0:
        return "contact for contact.edge_radius above 0: round edges close bit by bit"
    return None


def find_layer_refusal(scene: Scene) -> str | None:
    """Return which evaluator takes the scene's layers of tissue, for one that does not; None without layers."""
    if not scene.tissue.layer:
        return None
    return (
        find_geometry_refusal(scene)
        or find_crossing_refusal(scene)
        or f"{'axisymmetric' if is_round(scene) else 'equivalent-inclusion'} for layers of tissue"
    )


def find_crossing_refusal(scene: Scene) -> str | None:
    """Return which evaluator takes inclusions crossed by an interface of layers, for one that does not; None without any."""
    if not any(_is_crossed(scene, body) for body in scene.inclusion if body.surface is None):
        return None
    return f"{'axisymmetric' if is_round(scene) else 'solid'} for an inclusion that an interface of the tissue's layers crosses"


def _is_crossed(scene: Scene, body: Inclusion) -> bool:
    half = math.hypot(*compute_semi_axes(body)[2])
    return any(abs(interface - body.depth) < half * (1 + TOUCHING_RELATIVE) for interface in scene.tissue.interfaces)


def is_round(scene: Scene) -> bool:
    """Return whether the probe is upright with at most one inclusion, a sphere on its axis."""
    placement = scene.placement
    centred = all(
        math.hypot(body.x - placement.x, body.y - placement.y) <= 1e-9 * (body.diameter or 0.0) for body in scene.inclusion
    )
    return (
        placement.tilt == 0
        and len(scene.inclusion) <= 1
        and centred
        and all(body.diameter is not None for body in scene.inclusion)
    )


def find_geometry_refusal(scene: Scene) -> str | None:
    """Return why only ``solid``, or no linear evaluator, takes the scene: contact, tilt, shape or crossed layers; else None."""
    if find_linear_refusal(scene) is not None:
        return find_linear_refusal(scene)
    if scene.placement.tilt != 0:
        return "solid for placement.tilt other than 0"
    if any(body.surface is not None for body in scene.inclusion):
        return "solid for an inclusion that is neither sphere nor ellipsoid"
    return None if is_round(scene) else find_crossing_refusal(scene)
