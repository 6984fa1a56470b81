"""Random scenes from the range of the closed form, by class: half ordinary probes on ordinary tissue, half from broad ranges."""

from __future__ import annotations

from typing import Any

import numpy as np

from geometry import Scene
from solver.closed_form.error_quantile import SCENE_CLASSES

MIN_WAY_DIAMETERS = 0.1  # from a sphere to an interface, in its diameters
NEARLY_INCOMPRESSIBLE = (0.45, 0.48, 0.49, 0.499, 0.4999)  # Poisson's ratios of rubber and tissue
MODULI_PA = (1e3, 1e7)
SOFT_SKIN = "soft skin"  # layered, of ordinary probes on a layer that is softer than the tissue below
DRAWN_KINDS = (*SCENE_CLASSES, SOFT_SKIN)


def draw(rng: np.random.Generator, kind: str) -> Scene:
    """Draw a scene meant for a class of ``solver.closed_form.error_quantile``; its parts may make it one of another class.

    Raises
    ------
    ValueError
        Its parts do not fit.
    """
    ordinary = rng.random() < 1 / 2 or kind == SOFT_SKIN
    probe, spheres, modulus = (_draw_ordinary if ordinary else _draw_broad)(rng, several=kind == "off axis")
    if kind == SOFT_SKIN:
        probe["area_ratio"] = _draw_log_uniform(rng, 0.3, 4)
    inner = np.pi * probe["inner_radius"] ** 2
    outer = float(np.sqrt((probe["inner_radius"] + probe["gap"]) ** 2 + inner / probe["area_ratio"] / np.pi))
    for sphere in spheres:
        sphere["x"] = outer * _draw_log_uniform(rng, 0.1, 3) if kind == "off axis" else 0.0
    tissue = _draw_tissue(rng, kind, spheres, outer, ordinary)
    depth = tissue.get("depth", 6 * outer)
    material = _draw_layers(rng, spheres, modulus, outer, depth) if kind == "layered" else _draw_material(rng, modulus)
    if kind == SOFT_SKIN:
        material |= {"layer": [_draw_soft_skin(rng, modulus)]}
    return Scene.model_validate(
        {
            "probe": probe,
            "tissue": tissue | material,
            "inclusion": [sphere | {"target": i == 0} for i, sphere in enumerate(spheres)],
            "contact": {"interface": "bonded" if rng.random() < 0.6 else "frictionless"},
            "load": {"indentation": 1e-7},
        }
    )


def _draw_log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _draw_material(rng: np.random.Generator, modulus: float, min_poisson: float = 0.2) -> dict[str, Any]:
    poisson = float(rng.choice([rng.uniform(min_poisson, 0.49), *NEARLY_INCOMPRESSIBLE]))
    return {"youngs_modulus": float(np.clip(modulus, *MODULI_PA)), "poisson_ratio": poisson}


def _draw_ordinary(rng: np.random.Generator, several: bool) -> tuple[dict[str, Any], list[dict[str, Any]], float]:
    """Blocks of 1 to 6 mm, 5 to 300 times as stiff as the tissue, and a tumour covered by a quarter of its diameter or more."""
    radius, modulus = _draw_log_uniform(rng, 1e-3, 6e-3), _draw_log_uniform(rng, 1e3, 3e4)
    height = _draw_log_uniform(rng, 0.5, 4) * radius
    probe = {
        "inner_radius": radius, "area_ratio": _draw_log_uniform(rng, 0.1, 3), "gap": _draw_log_uniform(rng, 0.02, 0.1) * radius,
        "inner_height": height, "outer_height": height,
        "inner": _draw_material(rng, modulus * _draw_log_uniform(rng, 5, 300), 0.3),
        "outer": _draw_material(rng, modulus * _draw_log_uniform(rng, 5, 300), 0.3),
    }  # fmt: skip
    spheres = []
    for _ in range(1 + int(several and rng.random() < 0.2)):
        size = radius * _draw_log_uniform(rng, 0.5, 4)
        material = _draw_material(rng, modulus * _draw_log_uniform(rng, 0.05, 100), 0.3)
        spheres.append({"diameter": size, "depth": size * (0.5 + _draw_log_uniform(rng, 0.25, 2)), **material})
    return probe, spheres, modulus


def _draw_broad(rng: np.random.Generator, several: bool) -> tuple[dict[str, Any], list[dict[str, Any]], float]:
    radius, modulus = _draw_log_uniform(rng, 0.3e-3, 20e-3), _draw_log_uniform(rng, 1e3, 1e5)
    probe = {
        "inner_radius": radius, "area_ratio": _draw_log_uniform(rng, 0.03, 30),
        "gap": min(max(_draw_log_uniform(rng, 0.003, 0.5) * radius, 1e-6), 5e-3),
        "inner_height": radius * _draw_log_uniform(rng, 0.1, 10), "outer_height": radius * _draw_log_uniform(rng, 0.1, 10),
        "inner": _draw_material(rng, _draw_log_uniform(rng, *MODULI_PA)),
        "outer": _draw_material(rng, _draw_log_uniform(rng, *MODULI_PA)),
    }  # fmt: skip
    spheres = []
    for _ in range(1 + int(several and rng.random() < 0.3)):
        size = radius * _draw_log_uniform(rng, 0.3, 8)
        material = _draw_material(rng, _draw_log_uniform(rng, *MODULI_PA))
        spheres.append({"diameter": size, "depth": size * (0.5 + _draw_log_uniform(rng, 0.1, 3)), **material})
    return probe, spheres, modulus


def _draw_soft_skin(rng: np.random.Generator, modulus: float) -> dict[str, Any]:
    """Draw a layer of 20 um to 1 mm for tissue of ``modulus`` below it, as 1 to 10 kPa on 5 to 60 kPa."""
    material = _draw_material(rng, modulus, 0.3) | {"youngs_modulus": modulus * _draw_log_uniform(rng, 1 / 60, 0.8)}
    return {"thickness": _draw_log_uniform(rng, 20e-6, 1e-3), **material}


def _draw_tissue(
    rng: np.random.Generator, kind: str, spheres: list[dict[str, Any]], outer: float, ordinary: bool
) -> dict[str, Any]:
    """Draw the tissue's shape: sides and depth that hold the spheres, in outer radii near, far or thin as the class asks."""
    if rng.random() < 0.1 and kind != "near sides":
        return {"shape": "half-space"}
    reach = max(sphere["x"] + 0.55 * sphere["diameter"] for sphere in spheres)
    deepest = max(sphere["depth"] + sphere["diameter"] / 2 for sphere in spheres)
    depth = max(_draw_log_uniform(rng, *((1, 8) if ordinary else (0.3, 15))) * outer, deepest * _draw_log_uniform(rng, 1.02, 3))
    sides = (1.05, 6) if kind == "near sides" else (3, 20) if kind == "bare" else (2, 15)
    return {"shape": "cylinder", "radius": max(outer * _draw_log_uniform(rng, *sides), reach), "depth": depth}


def _draw_layers(
    rng: np.random.Generator, spheres: list[dict[str, Any]], modulus: float, outer: float, depth: float
) -> dict[str, Any]:
    """Put up to two layers over what holds the sphere and what is of ``modulus``, and a stiffer or softer one below or bone.

    The first two are a stiff skin or a soft film, from a thousandth of what is over the sphere.
    """
    sphere = spheres[0]
    above = sphere["depth"] - (0.5 + MIN_WAY_DIAMETERS) * sphere["diameter"]
    below = sphere["depth"] + (0.5 + MIN_WAY_DIAMETERS) * sphere["diameter"]
    layers = []
    for _ in range(int(rng.choice([0, 1, 2], p=[0.2, 0.6, 0.2]))):
        thickness = above * (float(rng.uniform(0.05, 0.95)) if rng.random() < 0.7 else _draw_log_uniform(rng, 1e-3, 0.1))
        above -= thickness
        stiff = _draw_log_uniform(rng, 1.5, 100) if rng.random() < 0.7 else _draw_log_uniform(rng, 0.01, 0.7)
        layers.append({"thickness": thickness, **_draw_material(rng, modulus * stiff, 0.3)})
    base = _draw_material(rng, modulus)
    if layers and rng.random() < 0.6:
        return {"layer": layers, **base}
    floor = below + max(depth - below, 0.1 * outer) * float(rng.uniform(0.02, 0.9))
    stiff = _draw_log_uniform(rng, 0.1, 10) if rng.random() < 0.5 else _draw_log_uniform(rng, 1e2, 1e4)
    layers.append({"thickness": floor - sum(layer["thickness"] for layer in layers), **base})
    return {"layer": layers, **_draw_material(rng, modulus * stiff)}
