"""A limit is marked on a slider at the value with which the design just keeps to it."""

from __future__ import annotations

import pytest

from geometry.scenes.scene import Scene
from geometry.scenes.scene_file import read_scene
from probe_design import evaluate
from probe_design.explorer.limits import list_limits
from probe_design.explorer.variables import list_variables
from tests.support.paths import ROOT

EXAMPLE = read_scene(ROOT / "examples" / "scene.toml")
PROBE = EXAMPLE.probe
WALL = 0.8e-3  # m
BY_RADIUS = EXAMPLE.model_copy(
    update={"probe": PROBE.model_copy(update={"area_ratio": None, "outer_radius": PROBE.hole_radius + WALL})}
)


@pytest.mark.parametrize("scene", [EXAMPLE, BY_RADIUS])
def test_limits_bind_where_they_are_marked(scene: Scene) -> None:
    result = evaluate(scene, evaluator="closed-form")
    limits = {limit.sign: limit for limit in list_limits(scene, result, WALL, list_variables(scene))}
    assert limits["W"].is_kept
    size = "probe.outer_radius" if scene.probe.area_ratio is None else "probe.area_ratio"
    assert {"probe.inner_radius", size} <= limits["W"].marks.keys() <= {"probe.inner_radius", "probe.gap", size}
    for key, value in limits["W"].marks.items():
        probe = scene.replace({key: value}).probe
        assert probe.tube_radius - probe.hole_radius == pytest.approx(WALL, rel=1e-6)
    for sign, load in (("L", result.linear_limit_load), ("G", result.gap_closure_load)):
        assert load is not None
        assert limits[sign].marks == {"load.force": load.force}
        assert limits[sign].is_kept == (scene.load.force <= load.force)
    assert not {limit.sign: limit for limit in list_limits(scene, result, 10.0, list_variables(scene))}["W"].is_kept
