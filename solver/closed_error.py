"""How far the closed form may be off in ln(ratio): what it leaves out, each by how much it matters in this scene.

    error <= sum of weight x feature,                                                             (C2)

with these features: one; the derivatives of ln(ratio) by both blocks' moduli, as the blocks' ends are coarse, and the outer's
once more where it is a tall shell; what the spheres change of both forces, as it is and times the cube of a sphere's radius over
its centre's distance from surface, floor and sides, and once more beside the axis; powers of the probe's radius over the
distance of the tissue's sides, which are left out; how far forces cancel; how wide and soft the outer block is beside the
inner. The weights are an envelope of 260 random scenes, with a margin; ``benchmarks/closed_form.py`` audits them on others.
"""

from __future__ import annotations

import math

import numpy as np

from geometry.grading import Floats
from geometry.scene import Scene
from solver.details import details

EFFECTS = ("scene", "inner_modulus", "outer_modulus", "no inclusions")  # the variants whose forces are asked for
STEP = 1.05  # by which the variants' moduli are larger
WEIGHTS = {
    "always": 0.025, "inner": 0.125, "outer": 0.05, "shell": 0.75,
    "spheres": 0.1, "near surface": 2.0, "near floor": 3.75, "near sides": 0.25, "beside": 0.125,
    "side 2": 0.125, "side 4": 0.375, "side 8": 3.75, "cancelled": 0.005, "soft": 0.5, "inner soft": 0.125,
}  # fmt: skip


def log_error(scene: Scene, forces: Floats) -> float:
    """Bound on the error of ln(ratio): the sum of eq. (C2) and all of groove, film and base.

    Args:
        scene: what is pressed on what.
        forces: of the variants ``EFFECTS`` of the scene, shape (4, 2, 2).

    Returns:
        inf where a film is pulled.
    """
    if not np.all(forces.sum(axis=2) > 0):
        return math.inf
    extra = sum(detail.bound(forces[0]).log_ratio for detail in details(scene.probe))
    found = features(scene, forces)
    return sum(weight * found[name] for name, weight in WEIGHTS.items()) + extra


def features(scene: Scene, forces: Floats) -> dict[str, float]:
    """What the bound is made of, each one dimensionless; for positive forces."""
    totals = forces.sum(axis=2)
    logs = np.log(totals)
    ratios = logs[:, 0] - logs[:, 1]
    inner, outer = (float(abs(ratio - ratios[0])) / math.log(STEP) for ratio in ratios[1:3])
    spheres = float(np.abs(logs[0] - logs[3]).sum())
    soft, edge = _soft(scene), _edge(scene)
    near, floor, side = _closeness(scene)
    beside = any(math.hypot(body.x - scene.placement.x, body.y - scene.placement.y) > 0 for body in scene.inclusion)
    return {
        "always": 1.0, "inner": inner, "outer": outer, "shell": outer * _shell(scene),
        "spheres": spheres, "near surface": spheres * near, "near floor": spheres * floor, "near sides": spheres * side,
        "beside": spheres * beside, "side 2": edge**2, "side 4": edge**4, "side 8": edge**8,
        "cancelled": float((np.abs(forces[0]).sum(axis=1) / totals[0]).max() - 1), "soft": soft, "inner soft": inner * soft,
    }  # fmt: skip


def _shell(scene: Scene) -> float:
    """How far the outer block is a thin and tall shell, 0 to 1."""
    probe = scene.probe
    wall = probe.tube_radius - probe.hole_radius
    return math.sqrt(1 - wall / probe.tube_radius) * min(1.0, probe.tube_height / (5 * math.sqrt(wall * probe.tube_radius)))


def _soft(scene: Scene) -> float:
    """How far the outer block is wide beside the inner and soft beside the tissue."""
    probe, tissue = scene.probe, scene.tissue.youngs_modulus
    wall = probe.tube_radius - probe.hole_radius
    return math.log1p(wall / probe.inner_radius) * tissue / (tissue + probe.outer.youngs_modulus)


def _edge(scene: Scene) -> float:
    """Outer radius over the distance from the probe's axis to the tissue's nearest side."""
    room = _room(scene, scene.placement.x, scene.placement.y)
    return scene.probe.tube_radius / max(room, 1e-9 * scene.probe.tube_radius)


def _room(scene: Scene, x: float, y: float) -> float:
    """Distance of a place to the tissue's nearest side."""
    tissue = scene.tissue
    if tissue.shape == "half-space":
        return math.inf
    if tissue.shape == "cylinder":
        return tissue.radius - math.hypot(x, y)
    return min(tissue.length / 2 - abs(x), tissue.breadth / 2 - abs(y))


def _closeness(scene: Scene) -> tuple[float, float, float]:
    """Largest cube of a sphere's radius over the distance of its centre to surface, floor and sides."""
    found = np.zeros(3)
    for body in scene.inclusion:
        floor = math.inf if scene.tissue.shape == "half-space" else scene.tissue.depth - body.depth
        distances = np.array([body.depth, floor, _room(scene, body.x, body.y)])
        found = np.maximum(found, ((body.diameter or 0.0) / 2 / distances) ** 3)
    return float(found[0]), float(found[1]), float(found[2])
