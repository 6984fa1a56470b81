"""Kinds of scenes that most levels cannot take."""

from __future__ import annotations

from geometry.scenes.scene import Scene


def unsupported(scene: Scene) -> str | None:
    """Say which kind of thing in the scene no level knows yet, or None."""
    if scene.contact.interface == "unilateral":
        return "none built yet for contact.interface = 'unilateral' (planned: contact)"
    return None


def needs_solid(scene: Scene) -> str | None:
    """Say which kind of thing in the scene no level, or only ``solid``, knows; or None."""
    if unsupported(scene) is not None:
        return unsupported(scene)
    if scene.placement.tilt != 0:
        return "solid for placement.tilt other than 0"
    if any(body.surface is not None for body in scene.inclusion):
        return "solid for an inclusion that is neither sphere nor ellipsoid"
    return None
