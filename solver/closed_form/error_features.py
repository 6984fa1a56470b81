"""What the closed form's errors are told from: numbers that are large where it leaves out much, for each quantity it returns.

A quantity is ln(ratio), the logarithm of either total or the log-sensitivity. Its features are

- one;
- its derivatives by the logarithms of both blocks' moduli, as the blocks' ends are coarse, as they are and times how far the
  outer block is a tall shell, a soft one, soft and tall, or wide and thick beside a small inner, or the inner small or flat;
- what the spheres change of it, as it is and times how near they are to surface, floor and sides, how far they fill the tissue,
  whether they lie beside the axis, under the probe's rim, or are several;
- powers of the probe's radius over the way to the tissue's sides and how tall a column the tissue is, once where the sides are
  modelled ("cut") and once where not ("side"), and over the tissue's depth; how narrow the gap is; how far forces cancel; how
  soft the outer block is, and wide beside the inner.

The last group's, for the log-sensitivity, are times what the target changes of both totals; it has some of its own. From these
``benchmarks/closed_form/error.py`` chooses: one without a weight in ``error_weights.json`` is one that no scene asked for.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from geometry.common.arrays import Floats
from geometry.scenes.probe import Material
from geometry.scenes.scene import Inclusion, Scene
from solver.closed_form.lateral_boundary import side_radius

EFFECTS = ("scene", "inner_modulus", "outer_modulus", "no inclusions")  # the variants whose forces are asked for
STEP = 1.05  # by which the variants' moduli are larger


def features(scene: Scene, forces: Floats, slopes: Floats, sided: bool) -> tuple[dict[str, float], ...]:
    """Return the features of ln(ratio), of the logarithms of inner and outer total, and of the log-sensitivity.

    Args:
        scene: what is pressed on what.
        forces: of the variants ``EFFECTS`` of the scene, positive totals, shape (4, 2, 2).
        slopes: their derivatives by the logarithm of the target's modulus, shape (4, 2, 2).
        sided: whether the tissue's sides are modelled.
    """
    totals = forces.sum(axis=2)
    logs, shares = np.log(totals), slopes.sum(axis=2) / totals
    cancelled = np.abs(forces[0]).sum(axis=1) / totals[0] - 1
    spheres = np.abs(logs[0] - logs[3])
    size = float(np.abs(shares[0]).sum() + np.abs(shares[3]).sum() * _saturated(scene))
    every = {"always": 1.0, **_of_sides(scene, sided), **_of_softness(scene), **_of_gap(scene)}
    factors = _of_moduli(scene), _of_places(scene)
    return (
        _features(logs @ [1, -1], float(spheres.sum()), *factors) | every | {"cancelled": float(cancelled.max())},
        *(_features(logs[:, i], float(spheres[i]), *factors) | every | {"cancelled": float(cancelled[i])} for i in (0, 1)),
        _features(shares @ [1, -1], size, *factors)
        | {name: size * value for name, value in (every | {"cancelled": float(cancelled.max())} | _of_target(scene)).items()},
    )


def _features(
    values: Floats, spheres: float, moduli: tuple[dict[str, float], dict[str, float]], places: dict[str, float]
) -> dict[str, float]:
    """Features of one quantity, from what it is for the variants and what the spheres change of it."""
    terms: dict[str, float] = {}
    for name, value, times in zip(("inner", "outer"), np.abs(values[1:3] - values[0]) / math.log(STEP), moduli, strict=True):
        terms |= {name: float(value), **{f"{name} {kind}": float(value) * factor for kind, factor in times.items()}}
    return terms | {"spheres": spheres, **{f"spheres {place}": spheres * factor for place, factor in places.items()}}


def _of_moduli(scene: Scene) -> tuple[dict[str, float], dict[str, float]]:
    """How badly the functions suit the inner and the outer block."""
    probe = scene.probe
    wall = probe.tube_radius - probe.hole_radius
    shell, slender, soft = (1 - wall / probe.tube_radius) ** 4, probe.tube_height / wall, _soft(scene, probe.outer)
    inner = {
        "small": _small(scene) ** 4, "flat": math.log1p(probe.inner_radius / probe.core_height),
        "soft": _soft(scene, probe.inner), "in shell": shell * _soft(scene, probe.inner),
    }  # fmt: skip
    outer = {
        "tall shell": shell * min(1.0, slender / 20), "soft shell": shell * soft, "soft tall": soft * math.log1p(slender),
        "wide": _small(scene) ** 2 * wall / probe.tube_radius,
    }  # fmt: skip
    return inner, outer


def _of_softness(scene: Scene) -> dict[str, float]:
    """How far the outer block is soft beside the tissue and wide beside the inner."""
    probe, soft = scene.probe, _soft(scene, scene.probe.outer)
    wide = soft * math.log1p((probe.tube_radius - probe.hole_radius) / probe.inner_radius)
    return {"soft": wide, "soft squared": wide**2, "soft wide": soft * _small(scene) ** 4}


def _of_gap(scene: Scene) -> dict[str, float]:
    """How much narrower the gap is than the rings at its edges, 0 to 1."""
    probe = scene.probe
    narrowest = 0.01 * min(probe.inner_radius, probe.tube_radius - probe.hole_radius)
    hairline = 1 / (1 + (probe.gap / narrowest) ** 2)
    return {"hairline": hairline, "hairline small": hairline * _small(scene) ** 2}


def _soft(scene: Scene, block: Material) -> float:
    """How soft a block is beside the tissue, 0 to 1."""
    return scene.tissue.youngs_modulus / (scene.tissue.youngs_modulus + block.youngs_modulus)


def _small(scene: Scene) -> float:
    """How small the inner block is beside the outer, 0 to 1."""
    return 1 - scene.probe.inner_radius / scene.probe.tube_radius


def _of_places(scene: Scene) -> dict[str, float]:
    """How near spheres are to surface, floor and sides, how far they fill the tissue, and how they lie; the largest of all."""
    depth = math.inf if scene.tissue.shape == "half-space" else scene.tissue.depth
    reach = scene.probe.tube_radius

    def offset(body: Inclusion) -> float:
        return math.hypot(body.x - scene.placement.x, body.y - scene.placement.y)

    def largest(value: Callable[[Inclusion, float], float]) -> float:
        return max((value(body, (body.diameter or 0.0) / 2) for body in scene.inclusion), default=0.0)

    return {
        "near surface": largest(lambda body, R: (R / body.depth) ** 3),
        "near floor": largest(lambda body, R: (R / (depth - body.depth)) ** 3),
        "at the floor": largest(lambda body, R: (R / (depth - body.depth)) ** 6),
        "near sides": largest(lambda body, R: min(1.0, R / _room(scene, body.x, body.y)) ** 4),
        "beside": largest(lambda body, R: float(offset(body) > 0)),
        "under rim": largest(lambda body, R: math.exp(-4 * (offset(body) / reach - 1) ** 2) * float(offset(body) > 0)),
        "several": float(len(scene.inclusion) > 1),
    }


def _of_target(scene: Scene) -> dict[str, float]:
    """How near a target of another modulus is."""
    strong = (math.log(_saturated(scene) or 1.0) / math.log(1e4)) ** 2
    places = _of_places(scene)
    return {"strong": strong, **{f"strong {place}": strong * places[place] for place in ("near surface", "near floor")}}


def _saturated(scene: Scene) -> float:
    """About what share of its slope in tissue as stiff as itself a target has left."""
    if scene.target is None:
        return 0.0
    times = scene.inclusion[scene.target].youngs_modulus / scene.tissue.youngs_modulus
    return min(times, 1 / times)


def _of_sides(scene: Scene, sided: bool) -> dict[str, float]:
    """Powers of the outer radius over the way to the nearest side and over the depth, and how tall a column the tissue is."""
    tissue, outer = scene.tissue, scene.probe.tube_radius
    edge, slender, left, thin = 0.0, 0.0, 1.0, 0.0
    if tissue.shape != "half-space":
        radius = side_radius(tissue)
        room = max(_room(scene, scene.placement.x, scene.placement.y), 1e-9 * outer)
        edge, slender, thin = outer / room, tissue.depth * outer / radius**2, outer / tissue.depth
        left = max(0.0, 1 - room / radius) if sided else 1.0
    terms = {"thin": thin**2, "very thin": thin**4}
    for name, power in {**{f"{n}": edge**n for n in (2, 4, 8)}, "slender": slender}.items():
        terms |= {f"side {name}": left * power, f"cut {name}": (1 - left) * power}
    return terms


def _room(scene: Scene, x: float, y: float) -> float:
    """Distance of a place to the tissue's nearest side."""
    tissue = scene.tissue
    if tissue.shape == "half-space":
        return math.inf
    if tissue.shape == "cylinder":
        return tissue.radius - math.hypot(x, y)
    return min(tissue.length / 2 - abs(x), tissue.breadth / 2 - abs(y))
