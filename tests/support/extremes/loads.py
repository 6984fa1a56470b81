"""Rows of the matrix under loads, from none to where nothing is known: pressed by NGSolve with finite strain and contact."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator

from geometry import Load, Scene
from tests.support.extremes.rows import Row, Truth
from tests.support.load_paths import FOLDER, scene_of

NONE = (0.0, 1e-9)  # N: the limit of small loads
BEYOND = (10.0, 1e6)  # times the largest load that is known: an answer there would be wrong
ORIGIN = "NGSolve, finite strain and contact"


def loaded() -> Iterator[Row]:
    """Yield the references' probes under each load that another code has pressed them to, and some that none has."""
    better = json.loads((FOLDER / "ngsolve.json").read_text(encoding="utf-8"))
    for name, known in (json.loads((FOLDER / "expected.json").read_text(encoding="utf-8")) | better).items():
        scene = scene_of(name)
        for force in NONE:
            yield _row(name, scene, force, _small(known["small_load"]), f"{ORIGIN}, at small loads")
        for row in known["rows"]:
            yield _row(name, scene, row["force"], _pressed(scene, row), ORIGIN)
        last = known["rows"][-1]["force"]
        for times in BEYOND:
            yield _row(name, scene, times * last, Truth(math.nan), "nobody knows: a refusal is right")


def _row(name: str, scene: Scene, force: float, truth: Truth, origin: str) -> Row:
    return Row("loads", f"{name}, {force:.4g} N", scene.model_copy(update={"load": Load(force=force)}), truth, origin)


def _small(values: dict[str, float]) -> Truth:
    return Truth(values["ratio"], None, None, values["stiffness"], values["log_sensitivity"], 2e-4, 1e-4)


def _pressed(scene: Scene, row: dict[str, float]) -> Truth:
    """Stresses follow from ratio and force, the secant stiffness from force and indentation."""
    areas = scene.probe.inner_area, scene.probe.outer_area
    outer = row["force"] / (row["ratio"] * areas[0] + areas[1])
    doubt = row["ratio_unc"] / row["ratio"] + row["force_unc"] / row["force"]
    stiffness, derivative = row["force"] / row["indentation"], row["log_sensitivity"]
    return Truth(row["ratio"], row["ratio"] * outer, outer, stiffness, derivative, doubt, row["log_sensitivity_unc"])
