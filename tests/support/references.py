"""Scenes with converged results of independent codes; origins in tests/reference/README.md."""

from __future__ import annotations

import json
from dataclasses import dataclass

from geometry import Scene, read_scene
from tests.support.paths import REFERENCE


@dataclass(frozen=True)
class Expected:
    """What an independent code found for a scene."""

    name: str
    scene: Scene
    stress_inner: float
    stress_outer: float
    ratio: float
    stiffness: float
    log_sensitivity: float | None
    uncertainty: float


def expected(folder: str) -> list[Expected]:
    """Read all scenes of a folder with their results."""
    values_by_name = json.loads((REFERENCE / folder / "expected.json").read_text())
    return [_make_expected(folder, name, values) for name, values in values_by_name.items()]


def named(folder: str, name: str) -> Expected:
    """Read one scene with its results."""
    return next(reference for reference in expected(folder) if reference.name == name)


def _make_expected(folder: str, name: str, values: dict[str, float]) -> Expected:
    return Expected(
        name,
        read_scene(REFERENCE / folder / f"{name}.toml"),
        values["stress_inner_pa"],
        values["stress_outer_pa"],
        values["ratio"],
        values["stiffness_n_per_m"],
        values.get("log_sensitivity"),
        values["relative_uncertainty"],
    )
