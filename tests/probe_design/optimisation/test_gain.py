"""What counts as a gain: beyond the errors of both designs, between designs that differ, and said in words."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from geometry import Load, Refusal, Scene, read_scene
from geometry.scenes.probe import Probe
from probe_design.optimisation.candidate import FINER, Candidate, candidate, merged
from probe_design.optimisation.comparison import headings, level_rows
from probe_design.optimisation.design_space import space, variables
from probe_design.optimisation.global_search import search
from probe_design.optimisation.objective import Noise
from probe_design.optimisation.optimum import Optimum
from probe_design.optimisation.report import page, summary
from tests.support.paths import EXAMPLES, SCENE
from tests.support.scenes import nodule

NOISE = Noise()


def judged(objective: float, error: float, scene: Scene | None = None) -> Candidate:
    """A candidate whose judge is good to ``error`` of its log-sensitivity."""
    one = candidate(scene or read_scene(SCENE), NOISE, "axisymmetric")
    return replace(one, judged_objective=objective, least=objective / (1 + error), most=objective / (1 - error))


def test_a_gain_counts_beyond_the_errors_of_both() -> None:
    room = space(read_scene(SCENE))
    start = judged(1.0, 0.04)

    def found(best: Candidate) -> Optimum:
        return Optimum("axisymmetric", room, NOISE, start, (best,))

    assert found(judged(0.90, 0.04)).status == "improved"
    hidden = found(judged(0.98, 0.04))
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
    worse = found(judged(1.02, 0.04))
    assert "none of 1 designs" in worse.verdict
    assert "1.02" in worse.verdict


@pytest.mark.slow
def test_a_gain_that_the_judge_cannot_tell_is_none() -> None:
    """15 mm beside the tumour the judge's log-sensitivity is off by 7 times itself for the start: judged finely it tells."""
    start = read_scene(EXAMPLES / "two-tumours.toml")
    other = space(start).scene_of(np.array([3.1e-3, 0.2088, 0.5e-3, 1.54e-3, 1e6, 1e6]))
    assert other is not None
    for accuracy, counts in ((0.01, False), (FINER, True)):
        first, second = (candidate(one, NOISE, "equivalent-inclusion", accuracy) for one in (start, other))
        assert second.judged_objective < 0.9 * first.judged_objective
        assert second.beats(first) == counts


@pytest.mark.slow
@pytest.mark.parametrize("judge", ["axisymmetric", "equivalent-inclusion"])
@pytest.mark.parametrize("scene", [read_scene(SCENE), nodule()])
def test_judge_s_errors_hold_the_objective(scene: Scene, judge: str) -> None:
    """A coarse judge's range holds what a fine one says."""
    coarse, fine = candidate(scene, NOISE, judge, 0.05), candidate(scene, NOISE, "axisymmetric", 1e-4)
    assert coarse.least < fine.judged_objective < coarse.most


def test_designs_alike_are_merged() -> None:
    scene = read_scene(SCENE)

    def moved(factor: float) -> Scene:
        probe = scene.probe.model_copy(update={"height": scene.probe.core_height * factor})
        return scene.model_copy(update={"probe": probe})

    kept = merged([judged(1.0, 0.0), judged(0.9, 0.0, moved(1.004)), judged(0.8, 0.0, moved(1.02))])
    assert [one.judged_objective for one in kept] == [0.8, 0.9]


def test_a_search_steered_by_formulas_that_refuse_the_scene_says_so() -> None:
    shallow = nodule().inclusion[0].model_copy(update={"depth": 2.7e-3})  # covered by 0.04 of its diameter
    scene = nodule().model_copy(update={"inclusion": (shallow,)})
    start = candidate(scene, NOISE, "axisymmetric")
    assert start.searched is None
    told = list(Optimum("axisymmetric", space(scene), NOISE, start, ()).remarks)
    assert len(told) == 1
    assert "closed-form refuses this scene" in told[0]
    assert "the search used its formulas" in told[0]
    assert not list(Optimum("axisymmetric", space(nodule()), NOISE, candidate(nodule(), NOISE, "axisymmetric"), ()).remarks)


def test_a_search_that_can_tell_nothing_is_refused() -> None:
    data = read_scene(SCENE).model_dump(exclude_unset=True)
    body = {key: value for key, value in data["inclusion"][0].items() if key != "diameter"} | {"diameters": (8e-3, 8e-3, 5e-3)}
    flat = Scene.model_validate(data | {"inclusion": (body,)})
    with pytest.raises(Refusal, match="a sphere as the target"):
        search(space(flat), NOISE, 1, lambda done, total: None)


def test_a_design_is_written_with_the_load_that_it_bears() -> None:
    scene = read_scene(SCENE).model_copy(update={"load": Load(force=1.0)})
    one = candidate(scene, NOISE, "axisymmetric")
    assert one.pressed.load.force == one.pressing.force < 1.0
    areas = (scene.probe.inner_area, scene.probe.outer_area)
    force = areas[0] * one.judged.stress_inner + areas[1] * one.judged.stress_outer
    assert force == pytest.approx(one.pressing.force)
    assert one.scene.load.force == 1.0
    assert np.all(variables(one.pressed) == variables(scene))


def test_where_nothing_is_verified_the_recommended_design_is_the_start_everywhere() -> None:
    """Table, limits, remarks and page once spoke of the best tried, while the start was what was written."""
    room, start = space(read_scene(SCENE)), judged(1.0, 0.04)
    tried = replace(judged(0.98, 0.04), scene=start.scene.model_copy(update={"probe": _widest(start.scene, room.outer_radius)}))
    found = Optimum("axisymmetric", room, NOISE, start, (tried,))
    assert headings(found)[1:3] == ("best tried, no gain", "start, recommended")
    radii = next(row for row in level_rows(found) if row[0] == "outer radius, mm")
    assert radii[1:3] == (f"{1e3 * room.outer_radius:.4g}", f"{1e3 * start.scene.probe.tube_radius:.4g}")
    assert not next(one.active for one in found.limits if one.name == "largest outer_radius")
    answer = summary(found, ())
    assert answer["recommended"] == "start"
    assert answer["design"]["probe"]["inner_radius"] == f"{1e3 * start.scene.probe.inner_radius:.12g} mm"
    assert 'class="headline none"' in page(found, (), answer)


def _widest(scene: Scene, radius: float) -> Probe:
    return scene.probe.model_copy(update={"outer_radius": radius, "area_ratio": None})
