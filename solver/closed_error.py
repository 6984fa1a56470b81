"""How far the closed form may be off: what it leaves out, each by how much it matters in this scene.

    error <= sum of weight x feature,                                                             (C2)

of ln(ratio), of the logarithms of both totals and, absolute, of the log-sensitivity. The features of a quantity: one; its
derivatives by the logarithms of both blocks' moduli, as the blocks' ends are coarse, and the outer's once more where it is a
tall shell, or a soft one; what the spheres change of it, as it is and times the cube of a sphere's radius over its centre's
distance from surface, floor and sides, and once more beside the axis; powers of the probe's radius over the distance of the
tissue's sides and how tall a column it is, by one weight where they are modelled ("cut") and by another where not ("side"); how
far forces cancel; how wide and soft the outer block is beside the inner. Those of the log-sensitivity are times what the target
changes of both totals. The weights are an envelope of 1270 random scenes and the references, times 1.75;
``benchmarks/closed_form.py`` audits them on others.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from geometry.grading import Floats
from geometry.scene import Scene
from solver.closed_sides import side_radius
from solver.details import details
from solver.film_forces import Bound

EFFECTS = ("scene", "inner_modulus", "outer_modulus", "no inclusions")  # the variants whose forces are asked for
STEP = 1.05  # by which the variants' moduli are larger
WEIGHTS: dict[str, dict[str, float]] = {
    "ratio": {
        "always": 0.03, "inner": 0.25, "shell": 0.25, "soft shell": 1.75, "near surface": 1.25, "near sides": 0.375,
        "side 2": 0.175, "side 4": 0.475, "side 8": 2.5, "cut 8": 1.25, "side slender": 0.00875, "cancelled": 0.015,
        "soft": 0.45,
    },
    "film": {
        "inner": 0.25, "shell": 0.25, "soft shell": 1.5, "near surface": 1.25, "near sides": 4.25, "beside": 1.5,
        "side 8": 2.75, "cut 2": 0.0525, "cut 8": 1.75, "side slender": 1.25, "cut slender": 0.0125, "cancelled": 0.015,
        "soft": 0.35, "always": 0.03,
    },
    "sensitivity": {
        "inner": 3, "outer": 3.25, "soft shell": 5.25, "near surface": 2.5, "beside": 4.5, "side 4": 4.75, "side 8": 20,
        "cut 8": 3.25, "cancelled": 0.009, "strong near surface": 0.95, "strong near floor": 5.75, "thin": 0.25,
    },
}  # fmt: skip


@dataclass(frozen=True)
class Errors:
    """Bounds on the errors of ln(ratio), of the logarithms of both totals, shape (2,), and of the log-sensitivity."""

    log_ratio: float
    log_totals: Floats
    sensitivity: float

    def bound(self, totals: Floats) -> Bound:
        """What totals may be too large by: as their logarithms are bounded, true ones are not zero."""
        return Bound(-np.expm1(-self.log_totals) * totals, self.log_ratio)

    @property
    def largest(self) -> float:
        """Relative error bound of ratio, stresses and stiffness."""
        return float(np.expm1(min(max(self.log_ratio, *self.log_totals), 700.0)))


def errors(scene: Scene, forces: Floats, slopes: Floats, sided: bool) -> Errors:
    """Return eq. (C2) for a scene, with all of groove, film and base.

    Args:
        scene: what is pressed on what.
        forces: of the variants ``EFFECTS`` of the scene, positive totals, shape (4, 2, 2).
        slopes: their derivatives by the logarithm of the target's modulus, shape (4, 2, 2).
        sided: whether the tissue's sides are modelled.
    """
    found = features(scene, forces, slopes, sided)
    ratio, inner, outer, sensitivity = (
        sum(weight * part[name] for name, weight in WEIGHTS[kind].items())
        for kind, part in zip(("ratio", "film", "film", "sensitivity"), found, strict=True)
    )
    told = [detail.bound(forces[0]) for detail in details(scene.probe)]
    totals = forces[0].sum(axis=1)
    films = np.array([inner, outer]) + sum(bound.totals for bound in told) / totals
    return Errors(ratio + sum(bound.log_ratio for bound in told), films, sensitivity)


def features(scene: Scene, forces: Floats, slopes: Floats, sided: bool) -> tuple[dict[str, float], ...]:
    """What the bounds on the logarithms of the ratio and of both totals and on the log-sensitivity are made of."""
    totals = forces.sum(axis=2)
    logs, shares = np.log(totals), slopes.sum(axis=2) / totals
    cancelled = np.abs(forces[0]).sum(axis=1) / totals[0] - 1
    spheres = np.abs(logs[0] - logs[3])
    around = _around(scene, sided)
    size = float(np.abs(shares[0]).sum() + np.abs(shares[3]).sum() * _saturated(scene))
    sensitivity = _features(around, shares @ [1, -1], size, float(cancelled.max()))
    alone = {**around, "always": 1.0, "cancelled": float(cancelled.max()), **_saturated_near(scene, around)}
    return (
        _features(around, logs @ [1, -1], float(spheres.sum()), float(cancelled.max())),
        *(_features(around, logs[:, i], float(spheres[i]), float(cancelled[i])) for i in (0, 1)),
        {**sensitivity, **{name: size * value for name, value in alone.items()}},
    )


def _features(around: dict[str, float], values: Floats, spheres: float, cancelled: float) -> dict[str, float]:
    """Features of one quantity, from what it is for the variants, what the spheres change of it, and the scene's own."""
    inner, outer = np.abs(values[1:3] - values[0]) / math.log(STEP)
    return {
        "always": 1.0, "inner": float(inner), "outer": float(outer), "shell": float(outer) * around["shell"],
        "soft shell": float(outer) * around["soft shell"],
        "spheres": spheres, "near surface": spheres * around["near surface"], "near floor": spheres * around["near floor"],
        "near sides": spheres * around["near sides"], "beside": spheres * around["beside"],
        **{name: value for name, value in around.items() if name.startswith(("side", "cut"))},
        "cancelled": cancelled, "soft": around["soft"], "inner soft": float(inner) * around["soft"],
    }  # fmt: skip


def _around(scene: Scene, sided: bool) -> dict[str, float]:
    """Features of the scene's shape alone."""
    edge, slender, left = _edges(scene, sided)
    near, floor, side = _closeness(scene)
    beside = any(math.hypot(body.x - scene.placement.x, body.y - scene.placement.y) > 0 for body in scene.inclusion)
    return {
        "near surface": near, "near floor": floor, "near sides": side, "beside": float(beside), "soft": _soft(scene),
        "shell": _shell(scene), "soft shell": _shell(scene) * _yielding(scene),
        **{f"side {n}": left * edge**n for n in (2, 4, 8)}, **{f"cut {n}": (1 - left) * edge**n for n in (2, 4, 8)},
        "side slender": left * slender, "cut slender": (1 - left) * slender,
    }  # fmt: skip


def _saturated(scene: Scene) -> float:
    """About what share of its slope in tissue as stiff as itself a target has left."""
    if scene.target is None:
        return 0.0
    times = scene.inclusion[scene.target].youngs_modulus / scene.tissue.youngs_modulus
    return min(times, 1 / times)


def _saturated_near(scene: Scene, around: dict[str, float]) -> dict[str, float]:
    """How near a target of another modulus is, and how thin the tissue."""
    contrast = abs(math.log(_saturated(scene) or 1.0)) / math.log(1e4)
    near = {f"strong {name}": contrast**2 * around[name] for name in ("near surface", "near floor", "near sides")}
    thin = 0.0 if scene.tissue.shape == "half-space" else (scene.probe.tube_radius / scene.tissue.depth) ** 2
    return {**near, "thin": thin, "strong": contrast**2}


def _shell(scene: Scene) -> float:
    """How far the outer block is a thin and tall shell, 0 to 1."""
    probe = scene.probe
    wall = probe.tube_radius - probe.hole_radius
    return math.sqrt(1 - wall / probe.tube_radius) * min(1.0, probe.tube_height / (5 * math.sqrt(wall * probe.tube_radius)))


def _soft(scene: Scene) -> float:
    """How far the outer block is wide beside the inner and soft beside the tissue."""
    wall = scene.probe.tube_radius - scene.probe.hole_radius
    return math.log1p(wall / scene.probe.inner_radius) * _yielding(scene)


def _yielding(scene: Scene) -> float:
    """How soft the outer block is beside the tissue, 0 to 1."""
    return scene.tissue.youngs_modulus / (scene.tissue.youngs_modulus + scene.probe.outer.youngs_modulus)


def _edges(scene: Scene, sided: bool) -> tuple[float, float, float]:
    """Outer radius over the way to the nearest side, how tall a column the tissue is, and the share of both not modelled."""
    tissue, outer = scene.tissue, scene.probe.tube_radius
    if tissue.shape == "half-space":
        return 0.0, 0.0, 1.0
    radius = side_radius(tissue)
    room = max(_room(scene, scene.placement.x, scene.placement.y), 1e-9 * outer)
    left = max(0.0, 1 - room / radius) if sided else 1.0
    return outer / room, tissue.depth * outer / radius**2, left


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
