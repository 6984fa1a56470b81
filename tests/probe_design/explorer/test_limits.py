"""A limit is marked on a slider at the value with which the design just keeps to it."""

from __future__ import annotations

from typing import cast

import pytest

from geometry.scenes.scene import Scene
from geometry.scenes.scene_file import read_scene
from probe_design import evaluate
from probe_design.explorer.limits import GAP_KEY, list_limits, search_gap
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


@pytest.mark.parametrize(
    ("gap", "force", "is_marked"),
    [("0.1 mm", "40 mN", True), ("0.2 mm", "60 mN", True), ("0.1 mm", "0.4 N", False)],  # the last strains too much for any gap
)
def test_the_marked_gap_is_the_one_that_the_load_closes(gap: str, force: str, is_marked: bool) -> None:
    scene = EXAMPLE.replace({"probe.gap": gap, "load.force": force})
    variable = next(item for item in list_variables(scene) if item.key == GAP_KEY)

    def compute_closure(design: Scene) -> float | None:
        load = evaluate(design, evaluator="closed-form").gap_closure_load
        return None if load is None else load.force

    def run_search() -> float | None:
        closure = compute_closure(scene)
        search, closures = search_gap(scene, closure or 0.0, variable), list[float | None]()
        while True:
            try:
                design = search.send(closures[-1]) if closures else next(search)
            except StopIteration as ended:
                return cast(float | None, ended.value)
            closures.append(compute_closure(design))

    marked_gap = run_search()
    assert (marked_gap is not None) == is_marked
    if marked_gap is not None:
        assert compute_closure(scene.replace({GAP_KEY: marked_gap})) == pytest.approx(scene.load.force, rel=0.02)
