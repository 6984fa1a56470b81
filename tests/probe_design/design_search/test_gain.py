"""What counts as a gain: beyond the errors of both designs, between designs that differ, and described in words."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from geometry import Load, Refusal, Scene, read_scene
from geometry.scenes.probe import Probe
from probe_design.design_report.tumour_report import build_comparison_table, build_tumour_report
from probe_design.design_search.choices import ChoiceSearch
from probe_design.design_search.optimum import TumourOptimum
from probe_design.design_search.tumour_objective import Noise
from probe_design.design_search.tumour_study import TumourStudy
from probe_design.design_search.variables import read_vector
from probe_design.design_search.verification import (
    FINER_ACCURACY,
    TumourVerification,
    merge_designs,
    verify_tumour_design,
)
from probe_design.populations.objective import Kind, Objective
from tests.support.paths import EXAMPLES, SCENE
from tests.support.scenes import nodule
from tests.support.searches import build_space

NOISE = Noise()


def build_verification(objective: float, error: float, scene: Scene | None = None) -> TumourVerification:
    """Return a candidate verified to ``error`` of its log-sensitivity."""
    verified_design = verify_tumour_design(scene or read_scene(SCENE), NOISE, "axisymmetric")
    return replace(verified_design, value=objective, lower=objective / (1 + error), upper=objective / (1 - error))


def build_optimum(scene: Scene, start: TumourVerification, *finalists: TumourVerification) -> TumourOptimum:
    """Return what a search of a scene would that has found these."""
    study = TumourStudy.from_scene(scene)
    search = ChoiceSearch((), "", True, {})
    return TumourOptimum(study.design, study.search_space, start, finalists, search, NOISE, "axisymmetric")


def test_a_gain_counts_beyond_the_errors_of_both() -> None:
    start = build_verification(1.0, 0.04)

    def make_optimum(best: TumourVerification) -> TumourOptimum:
        return build_optimum(start.scene, start, best)

    assert make_optimum(build_verification(0.90, 0.04)).status == "improved"
    hidden = make_optimum(build_verification(0.98, 0.04))
    assert hidden.status == "no-gain"
    assert hidden.best is start
    for words in (
        "no design better than the start was verified: the start is exported",
        "0.98",
        "2 % less",
        "0.942 to 1.02",
        "is within its errors",
    ):
        assert words in hidden.verdict
    worse = make_optimum(build_verification(1.02, 0.04))
    assert "none of 1 designs" in worse.verdict
    assert "1.02" in worse.verdict


@pytest.mark.slow
def test_a_gain_within_the_errors_of_the_verification_is_none() -> None:
    """15 mm off the axis the log-sensitivity's error is 7 times itself for the start: the gain counts at a finer accuracy."""
    start = read_scene(EXAMPLES / "two-tumours.toml")
    second_scene = build_space(start).build_scene(np.array([3.1e-3, 0.2088, 0.5e-3, 1.54e-3, 1e6, 1e6]))
    assert second_scene is not None
    for accuracy, counts in ((0.01, False), (FINER_ACCURACY, True)):
        first, second = (
            verify_tumour_design(design, NOISE, "equivalent-inclusion", accuracy) for design in (start, second_scene)
        )
        assert second.value < 0.9 * first.value
        assert second.is_better_than(first) == counts


@pytest.mark.slow
@pytest.mark.parametrize("verifier", ["axisymmetric", "equivalent-inclusion"])
@pytest.mark.parametrize("scene", [read_scene(SCENE), nodule()])
def test_errors_of_the_verification_contain_the_objective(scene: Scene, verifier: str) -> None:
    """The range of a coarse evaluation contains the value of a fine one."""
    coarse, fine = verify_tumour_design(scene, NOISE, verifier, 0.05), verify_tumour_design(scene, NOISE, "axisymmetric", 1e-4)
    assert coarse.lower < fine.value < coarse.upper


def test_designs_alike_are_merged() -> None:
    scene = read_scene(SCENE)

    def moved(factor: float) -> Scene:
        probe = scene.probe.model_copy(update={"height": scene.probe.core_height * factor})
        return scene.model_copy(update={"probe": probe})

    kept = merge_designs(
        [build_verification(1.0, 0.0), build_verification(0.9, 0.0, moved(1.004)), build_verification(0.8, 0.0, moved(1.02))]
    )
    assert [design.value for design in kept] == [0.8, 0.9]


def test_a_search_steered_by_formulas_that_refuse_the_scene_says_so() -> None:
    shallow = nodule().inclusion[0].model_copy(update={"depth": 2.7e-3})  # covered by 0.04 of its diameter
    scene = nodule().model_copy(update={"inclusion": (shallow,)})
    start = verify_tumour_design(scene, NOISE, "axisymmetric")
    assert start.formula_result is None
    warnings = build_optimum(scene, start).warnings
    assert len(warnings) == 1
    assert "closed-form refuses this scene" in warnings[0]
    assert "the search used its formulas" in warnings[0]
    assert not build_optimum(nodule(), verify_tumour_design(nodule(), NOISE, "axisymmetric")).warnings


def test_a_search_that_can_tell_nothing_is_refused() -> None:
    data = read_scene(SCENE).model_dump(exclude_unset=True)
    body = {key: value for key, value in data["inclusion"][0].items() if key != "diameter"} | {"diameters": (8e-3, 8e-3, 5e-3)}
    flat = Scene.model_validate(data | {"inclusion": (body,)})
    with pytest.raises(Refusal, match="a sphere as the target"):
        TumourStudy.from_scene(flat)


def test_a_design_is_written_with_the_load_that_it_bears() -> None:
    scene = read_scene(SCENE).model_copy(update={"load": Load(force=1.0)})
    start = verify_tumour_design(scene, NOISE, "axisymmetric")
    assert start.loaded_scene.load.force == start.pressing.force < 1.0
    areas = (scene.probe.inner_area, scene.probe.outer_area)
    force = areas[0] * start.result.stress_inner + areas[1] * start.result.stress_outer
    assert force == pytest.approx(start.pressing.force)
    assert start.scene.load.force == 1.0
    assert np.all(read_vector(start.loaded_scene) == read_vector(scene))


@pytest.mark.slow
def test_where_nothing_is_verified_the_recommended_design_is_the_start_everywhere() -> None:
    """Table, limits, warnings and page once spoke of the best tried, while the start was what was written."""
    space, start = build_space(read_scene(SCENE)), build_verification(1.0, 0.04)
    tried = replace(
        build_verification(0.98, 0.04), scene=start.scene.model_copy(update={"probe": _widest(start.scene, space.outer_radius)})
    )
    optimum = build_optimum(start.scene, start, tried)
    table = build_comparison_table(optimum)
    assert table.headings[1:3] == ("best tried, no gain", "start, recommended")
    radii = next(row for row in table.rows if row[0] == "outer radius, mm")
    assert radii[1:3] == (f"{1e3 * space.outer_radius:.4g}", f"{1e3 * start.scene.probe.tube_radius:.4g}")
    assert not next(limit.active for limit in optimum.limits if limit.name == "outer_radius")
    report = build_tumour_report(optimum)
    answer = report.build_summary(())
    assert answer["recommended"] == "start"
    assert answer["design"]["probe"]["inner_radius"] == f"{1e3 * start.scene.probe.inner_radius:.12g} mm"
    assert 'class="headline none"' in report.build_page((), answer, Path())


def _widest(scene: Scene, radius: float) -> Probe:
    return scene.probe.model_copy(update={"outer_radius": radius, "area_ratio": None})


@pytest.mark.parametrize(
    ("kind", "value", "error", "text"),
    [
        ("detection", 0.95, 0.076, "95.0 ± 7.6 %"),
        ("resolved", 0.0, 0.024, "0.0 ± 2.4 %"),
        ("information", 3.84, 0.97, "3.840 ± 0.97 nats"),
        ("place_error", 7.63e-4, 4e-4, "0.763 ± 0.4 mm"),
    ],
)
def test_objectives_are_written_in_units_of_people(kind: Kind, value: float, error: float, text: str) -> None:
    aim = Objective(maximise=kind)
    assert aim.format_value(value, error) == text
    assert aim.label.endswith(f", {text.split()[-1]}")
