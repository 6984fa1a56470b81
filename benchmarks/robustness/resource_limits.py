"""Scenes that take much memory or time, under limits that the system or the user sets."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import tomli_w

from benchmarks.robustness.attempt import Attempt
from benchmarks.robustness.damage import Random
from benchmarks.robustness.files import SCENE

ANSWER_SECONDS = 120.0  # s that an answer may take unless --time says otherwise
GIGABYTES = (0.15, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0)  # the first is too little to load libraries with


def little_memory(draw: Random, folder: Path) -> Attempt:
    """Many spheres, or a few ellipsoids, within the address space or the data that the system allows."""
    kind = draw.choice(["lattice", "ellipsoids"])
    bodies = _lattice(draw.randint(2, 10)) if kind == "lattice" else [_ellipsoid(draw) for _ in range(2)]
    (folder / "scene.toml").write_text(tomli_w.dumps(SCENE | {"inclusion": bodies}), encoding="utf-8")
    level = draw.choice(["auto", "closed-form", "equivalent-inclusion", "axisymmetric", "solid"])
    size = draw.choice(GIGABYTES)
    allowed = draw.choice([(), ("--memory", "1 TB"), ("--memory", f"{size:g} GB")])
    held = draw.choice(["RLIMIT_AS", "RLIMIT_DATA"])
    words = ("evaluate", "scene.toml", "--evaluator", level, "--json", *allowed)
    return Attempt(words, f"{len(bodies)} bodies, {held} {size:g} GB", ANSWER_SECONDS + 60.0, {held: int(size * 2**30)})


def _lattice(side: int) -> list[dict[str, Any]]:
    places = [(i, j, k) for i in range(side) for j in range(side) for k in range(side)]
    positions = [4.0 * (i - (side - 1) / 2) for i in range(side)]
    return [_body(positions[i], positions[j], 3.0 + 4.0 * k) | {"diameter": "1.5 mm"} for i, j, k in places]


def _ellipsoid(draw: Random) -> dict[str, Any]:
    axes = [f"{10 ** draw.uniform(-0.5, 1.1):.3g} mm" for _ in range(3)]
    return _body(draw.uniform(-15, 15), draw.uniform(-15, 15), draw.uniform(4, 15)) | {"diameters": axes}


def _body(x: float, y: float, depth: float) -> dict[str, Any]:
    place = {"x": f"{x:.4g} mm", "y": f"{y:.4g} mm", "depth": f"{depth:.4g} mm"}
    return place | {"youngs_modulus": "30 kPa", "poisson_ratio": 0.45}
