"""Draw random scenes within the closed form's range: half of them ordinary probes on ordinary tissue, a third with layers."""

from __future__ import annotations

from typing import Any

import numpy as np

from geometry import Scene

MIN_WAY_DIAMETERS = 0.1  # from a sphere to an interface, in its diameters


def draw(rng: np.random.Generator) -> Scene:
    """Draw a scene; raises ``ValueError`` where its parts do not fit."""
    layered = rng.random() < 1 / 3
    return (_ordinary if rng.random() < 1 / 2 else _extreme)(rng, layered)


def _draw_log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _material(rng: np.random.Generator, modulus: float, min_poisson: float = 0.0) -> dict[str, Any]:
    poisson = float(rng.choice([rng.uniform(min_poisson, 0.49), 0.45, 0.48, 0.499, 0.4999]))
    return {"youngs_modulus": modulus, "poisson_ratio": poisson}


def _ordinary(rng: np.random.Generator, layered: bool) -> Scene:
    """Blocks of 1 to 6 mm, 5 to 300 times as stiff as the tissue, and a tumour covered by a quarter of its diameter or more."""
    radius, tissue = _draw_log_uniform(rng, 1e-3, 6e-3), _draw_log_uniform(rng, 1e3, 2e4)
    probe = {
        "inner_radius": radius, "area_ratio": _draw_log_uniform(rng, 0.1, 3), "gap": _draw_log_uniform(rng, 0.02, 0.1) * radius,
        "inner_height": _draw_log_uniform(rng, 0.5, 4) * radius,
        "inner": _material(rng, tissue * _draw_log_uniform(rng, 5, 300), 0.3),
        "outer": _material(rng, tissue * _draw_log_uniform(rng, 5, 300), 0.3),
    }  # fmt: skip
    probe["outer_height"] = probe["inner_height"]
    size = radius * _draw_log_uniform(rng, 0.5, 4)
    material = _material(rng, tissue * _draw_log_uniform(rng, 0.02, 100), 0.3)
    sphere = {"diameter": size, "depth": size * (0.5 + _draw_log_uniform(rng, 0.25, 2)), **material}
    return _scene(rng, probe, [sphere], tissue, (2.5, 12), (1, 6), layered)


def _extreme(rng: np.random.Generator, layered: bool) -> Scene:
    radius, tissue = _draw_log_uniform(rng, 0.1e-3, 20e-3), _draw_log_uniform(rng, 5e2, 2e4)
    probe = {
        "inner_radius": radius, "area_ratio": _draw_log_uniform(rng, 0.02, 50),
        "gap": min(max(_draw_log_uniform(rng, 0.001, 0.5) * radius, 1e-6), 5e-3),
        "inner_height": radius * _draw_log_uniform(rng, 0.05, 20), "outer_height": radius * _draw_log_uniform(rng, 0.05, 20),
        "inner": _material(rng, tissue * _draw_log_uniform(rng, 0.1, 1e4)),
        "outer": _material(rng, tissue * _draw_log_uniform(rng, 0.1, 1e4)),
    }  # fmt: skip
    spheres = []
    for _ in range(int(rng.choice([0, 1, 2], p=[0.05, 0.85, 0.1]))):
        size = radius * _draw_log_uniform(rng, 0.3, 10)
        material = _material(rng, tissue * _draw_log_uniform(rng, 1e-4, 1e4))
        spheres.append({"diameter": size, "depth": size * (0.5 + _draw_log_uniform(rng, 0.1, 3)), **material})
    return _scene(rng, probe, spheres, tissue, (1.05, 20), (0.3, 15), layered)


def _scene(
    rng: np.random.Generator,
    probe: dict[str, Any],
    spheres: list[dict[str, Any]],
    modulus: float,
    sides: tuple[float, float],
    depths: tuple[float, float],
    layered: bool,
) -> Scene:
    """Put the spheres under the probe, a third of them beside its axis, into tissue of sides and depth in outer radii.

    On layers there is one sphere at most, on the axis, as ``axisymmetric`` takes it.
    """
    spheres = spheres[:1] if layered else spheres
    inner = np.pi * probe["inner_radius"] ** 2
    outer = float(np.sqrt((probe["inner_radius"] + probe["gap"]) ** 2 + inner / probe["area_ratio"] / np.pi))
    for sphere in spheres:
        sphere["x"] = outer * _draw_log_uniform(rng, 0.1, 3) if rng.random() < 0.35 and not layered else 0.0
    reach = max((sphere["x"] + 0.55 * sphere["diameter"] for sphere in spheres), default=0.0)
    deepest = max((sphere["depth"] + sphere["diameter"] / 2 for sphere in spheres), default=0.0)
    depth = max(_draw_log_uniform(rng, *depths) * outer, deepest * _draw_log_uniform(rng, 1.02, 3))
    side = max(outer * _draw_log_uniform(rng, *sides), reach)
    tissue: dict[str, Any] = {"shape": "cylinder", "radius": side, "depth": depth}
    kind = rng.random()
    if kind < 0.1:
        tissue = {"shape": "half-space"}
    elif kind < 0.2 and not layered:
        tissue = {"shape": "block", "length": 2 * side * _draw_log_uniform(rng, 1, 2), "breadth": 2 * side, "depth": depth}
    material = _layers(rng, spheres, modulus, outer, depth) if layered else _material(rng, modulus)
    return Scene.model_validate(
        {
            "probe": probe,
            "tissue": tissue | material,
            "inclusion": [sphere | {"target": i == 0} for i, sphere in enumerate(spheres)],
            "contact": {"interface": "bonded" if rng.random() < 0.6 else "frictionless"},
            "load": {"indentation": 1e-7},
        }
    )


def _layers(
    rng: np.random.Generator, spheres: list[dict[str, Any]], modulus: float, outer: float, depth: float
) -> dict[str, Any]:
    """Put up to two layers over what holds the sphere and what is of ``modulus``, and a stiffer or softer one below or bone.

    The first two are a stiff skin or a soft film, from a thousandth of what is over the sphere.
    """
    above, below = outer * _draw_log_uniform(rng, 0.1, 3), 0.1 * outer
    for sphere in spheres:
        above = sphere["depth"] - (0.5 + MIN_WAY_DIAMETERS) * sphere["diameter"]
        below = sphere["depth"] + (0.5 + MIN_WAY_DIAMETERS) * sphere["diameter"]
    layers = []
    for _ in range(int(rng.choice([0, 1, 2], p=[0.2, 0.6, 0.2]))):
        thickness = above * (float(rng.uniform(0.05, 0.95)) if rng.random() < 0.7 else _draw_log_uniform(rng, 1e-3, 0.1))
        above -= thickness
        stiff = _draw_log_uniform(rng, 1.5, 100) if rng.random() < 0.7 else _draw_log_uniform(rng, 0.01, 0.7)
        layers.append({"thickness": thickness, **_material(rng, modulus * stiff, 0.3)})
    base = _material(rng, modulus)
    if layers and rng.random() < 0.6:
        return {"layer": layers, **base}
    floor = below + (depth - below) * float(rng.uniform(0.02, 0.9))
    stiff = _draw_log_uniform(rng, 0.1, 10) if rng.random() < 0.5 else _draw_log_uniform(rng, 1e2, 1e6)
    layers.append({"thickness": floor - sum(layer["thickness"] for layer in layers), **base})
    return {"layer": layers, **_material(rng, modulus * stiff)}
