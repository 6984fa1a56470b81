"""Draw random scenes of the kinds between which ``auto`` has to decide, each determined by a kind, a seed and a number."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from geometry import InputError, Scene

MM = 1e-3
TISSUE = {"youngs_modulus": 6e3, "poisson_ratio": 0.45}
Draw = Callable[[np.random.Generator], dict[str, Any]]


def scenes(kind: str, seed: int) -> Iterator[Scene]:
    """Yield scenes of a kind of ``KINDS`` without an end; what does not fit together is drawn again."""
    rng = np.random.default_rng([seed, list(KINDS).index(kind)])
    while True:
        try:
            scene = Scene.model_validate(
                {"probe": _probe(rng), "contact": {"interface": str(rng.choice(["bonded", "frictionless"]))}, **KINDS[kind](rng)}
            )
        except (InputError, ValueError):
            continue
        yield scene


def _draw_log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _probe(rng: np.random.Generator) -> dict[str, Any]:
    height = rng.uniform(2, 6) * MM
    return {
        "inner_radius": rng.uniform(2, 5) * MM,
        "area_ratio": _draw_log_uniform(rng, 0.5, 3),
        "gap": rng.uniform(0.1, 0.6) * MM,
        "height": height,
        "inner": {"youngs_modulus": _draw_log_uniform(rng, 1e5, 1e6), "poisson_ratio": 0.47},
        "outer": {"youngs_modulus": _draw_log_uniform(rng, 5e4, 5e5), "poisson_ratio": 0.45},
        "base": {"rigid": True},
    }


def _round(rng: np.random.Generator, layers: int = 0) -> dict[str, Any]:
    skins = [
        {"thickness": rng.uniform(0.5, 2) * MM, "youngs_modulus": 6e3 * _draw_log_uniform(rng, 0.5, 8), "poisson_ratio": 0.45}
        for _ in range(layers)
    ]
    sizes = {"radius": rng.uniform(30, 50) * MM, "depth": rng.uniform(30, 50) * MM}
    return {"shape": "cylinder", **sizes, **TISSUE, "layer": tuple(skins)}


def _sphere(rng: np.random.Generator, wide: float, **given: Any) -> dict[str, Any]:
    diameter = rng.uniform(2, 9) * MM
    x, y = rng.uniform(-wide, wide, 2) * MM
    cover = {"diameter": diameter, "depth": diameter / 2 + rng.uniform(1, 10) * MM, "x": float(x), "y": float(y)}
    return cover | {"youngs_modulus": 6e3 * _draw_log_uniform(rng, 0.3, 30), "poisson_ratio": 0.45} | given


def _deep(rng: np.random.Generator) -> dict[str, float]:
    return {"indentation": _draw_log_uniform(rng, 1e-6, 1e-4)}


def _several_in_layers(rng: np.random.Generator) -> dict[str, Any]:
    tissue = _round(rng, int(rng.integers(1, 4)))
    bodies = [_sphere(rng, 8, target=k == 0) for k in range(int(rng.integers(2, 5)))]
    below = sum(layer["thickness"] for layer in tissue["layer"]) + 0.3 * MM
    for body in bodies:
        body["depth"] = max(body["depth"], below + body["diameter"] / 2)
    return {"tissue": tissue, "inclusion": tuple(bodies), "load": _deep(rng)}


def _ellipsoid(rng: np.random.Generator) -> dict[str, Any]:
    axes = rng.uniform(3, 12, 3) * MM
    body = {
        "diameters": tuple(axes.tolist()),
        "orientation": tuple(rng.uniform(0, 90, 3).tolist()),
        "depth": float(axes.max() / 2 + rng.uniform(1, 8) * MM),
        "x": float(rng.uniform(0, 8) * MM),
        "youngs_modulus": 6e3 * _draw_log_uniform(rng, 0.5, 20),
        "poisson_ratio": 0.45,
    }
    return {"tissue": _round(rng), "inclusion": (body,), "load": _deep(rng)}


def _hardly_any_matter(rng: np.random.Generator) -> dict[str, Any]:
    others = (
        _sphere(rng, 25, youngs_modulus=6e3 * float(rng.choice([1.0, 1.05])), diameter=2 * MM, depth=rng.uniform(10, 20) * MM)
        for _ in range(3)
    )
    target = _sphere(rng, float(rng.choice([1e-12, 5.0])), target=True)
    return {"tissue": _round(rng), "inclusion": (target, *others), "load": _deep(rng)}


def _block(rng: np.random.Generator) -> dict[str, Any]:
    length, breadth = rng.uniform(60, 120, 2) * MM
    place = {"x": rng.uniform(0, 0.5) * length / 2, "y": rng.uniform(0, 0.3) * breadth / 2}
    tissue = {"shape": "block", "length": length, "breadth": breadth, "depth": rng.uniform(30, 60) * MM, **TISSUE}
    return {"tissue": tissue, "inclusion": (_sphere(rng, 15),), "placement": place, "load": _deep(rng)}


def _across(rng: np.random.Generator) -> dict[str, Any]:
    body = _sphere(rng, 1e-12)
    tissue = _round(rng)
    cut = body["depth"] + rng.uniform(-0.8, 0.8) * body["diameter"] / 2
    tissue["layer"] = ({"thickness": cut, "youngs_modulus": 6e3 * _draw_log_uniform(rng, 0.2, 10), "poisson_ratio": 0.45},)
    return {"tissue": tissue, "inclusion": (body | {"x": 0.0, "y": 0.0},), "load": _deep(rng)}


def _draw_loaded(rng: np.random.Generator) -> dict[str, Any]:
    body = _sphere(rng, float(rng.choice([1e-12, 5.0])))
    return {"tissue": _round(rng), "inclusion": (body,), "load": {"force": _draw_log_uniform(rng, 1e-3, 0.1)}}


KINDS: dict[str, Draw] = {
    "several in layers": _several_in_layers,
    "ellipsoid": _ellipsoid,
    "hardly any matter": _hardly_any_matter,
    "block": _block,
    "across an interface": _across,
    "loaded": _draw_loaded,
}
