"""The rule for loads as evaluators and `auto` apply it to scenes under a load."""

from __future__ import annotations

import math

import numpy as np
import pytest

from geometry import read_scene
from geometry.common.errors import InputError, Refusal
from geometry.scenes.scene_file import scene_from_dict, scene_to_dict
from solver import evaluate, plan
from solver.contact.evaluator import ContactEvaluator
from solver.linalg.workspace import Workspace, use_workspace
from solver.planning.coarse_model import CoarseModel
from solver.planning.loads import (
    bound_closure_force,
    bound_ratio_change,
)
from solver.planning.strains import compute_cover_factor
from tests.solver.planning.test_loads import COVERED, EVERY, ContactReference, with_load
from tests.support.load_paths import added_by_blocks
from tests.support.paths import EXAMPLES, REFERENCE
from tests.support.slow import slow_unless


@EVERY
def test_what_auto_answers_is_within_its_error_of_what_is_true(reference: ContactReference) -> None:
    """Linear results at the loads of the references, the rule's effect counted, whatever it makes of them."""
    known = 0
    for row in reference.rows:
        result = evaluate(with_load(reference.scene, indentation=row["indentation"]), accuracy=0.05, linear=True)
        if result.error_estimate is None:
            continue
        known += 1
        assert result.ratio == pytest.approx(row["ratio"], rel=result.error_estimate, abs=row["ratio_unc"])
        assert result.stiffness == pytest.approx(row["force"] / row["indentation"], rel=result.error_estimate)
    assert known >= (reference.name == "example")


SCENE = read_scene(REFERENCE / "contact" / "example.toml")


BESIDE = SCENE.model_copy(update={"inclusion": (SCENE.inclusion[0].model_copy(update={"x": 2e-3}),)})


class TestAuto:
    @pytest.mark.slow
    def test_refuses_with_a_load_that_it_then_answers(self) -> None:
        """With the tumour off the probe's axis, where ``contact`` presses less deep."""
        with pytest.raises(Refusal, match=r"load.force = 0.4 N: allowed: up to 0.3\d+ N .*--linear") as refused:
            evaluate(with_load(BESIDE, force=0.4), accuracy=0.05)
        limit = float(str(refused.value).split("up to ")[1].split(" N")[0])
        result = evaluate(with_load(BESIDE, force=limit), accuracy=0.05)
        assert result.error_estimate is not None
        assert result.error_estimate <= 0.05

    def test_refuses_an_indentation_in_millimetres(self) -> None:
        with pytest.raises(Refusal, match=r"load.indentation = 4 mm: allowed: up to 3\.\d+ mm"):
            evaluate(with_load(BESIDE, indentation=4e-3), accuracy=0.05)

    def test_counts_the_effect_at_loads_that_are_allowed(self) -> None:
        scene = with_load(SCENE, indentation=2e-4)
        alone, loaded = evaluate(scene, "axisymmetric", plan(scene).accuracy), evaluate(scene)
        assert alone.error_estimate is not None
        assert loaded.error_estimate is not None
        radius = SCENE.probe.tube_radius
        strain = math.hypot(1 / radius, 25 * radius / 0.05**2) + added_by_blocks(SCENE.probe, loaded, 2e-4)
        rule = 0.1 * COVERED * 2e-4 * strain
        assert (1 + loaded.error_estimate) / (1 + alone.error_estimate) - 1 == pytest.approx(rule, rel=0.01)
        assert loaded.ratio == alone.ratio

    def test_a_load_of_zero_has_a_ratio(self) -> None:
        result = evaluate(with_load(SCENE, force=0.0))
        assert result.stress_inner == 0
        assert result.ratio == pytest.approx(0.56295, rel=0.01)

    @pytest.mark.slow
    def test_the_promise_on_log_sensitivity_counts(self) -> None:
        bare = SCENE.model_copy(update={"inclusion": ()})
        limits = [plan(scene).linear_limit_load for scene in (SCENE, bare)]
        assert [limit.by for limit in limits] == ["log_sensitivity", "ratio"]
        assert limits[0].indentation < 0.7 * limits[1].indentation

    def test_linear_answers_where_something_is_known_with_the_effect_and_beyond_without_a_bound(self) -> None:
        known, unknown = (evaluate(with_load(SCENE, force=force), linear=True) for force in (0.05, 2000.0 * 1e-3))
        assert known.error_estimate is not None
        assert 0.01 < known.error_estimate < 0.03
        assert unknown.error_estimate is None
        assert unknown.ratio == pytest.approx(known.ratio, rel=1e-9)
        for result in (known, unknown):
            assert [note.kind for note in result.warnings] == ["linear"]

    def test_a_tilt_counts_as_indentation(self) -> None:
        tilted = SCENE.model_copy(update={"placement": SCENE.placement.model_copy(update={"tilt": 0.2})})
        with pytest.raises(Refusal, match=r"placement.tilt = 11.5 deg"):
            evaluate(with_load(tilted, force=0.01))


class TestNamedEvaluators:
    @pytest.mark.parametrize("name", ["closed-form", "axisymmetric", "equivalent-inclusion"])
    def test_answer_linearly_and_warn(self, name: str) -> None:
        light, heavy = (evaluate(with_load(SCENE, force=force), name, 0.05) for force in (1e-3, 0.1))
        assert not any(note.kind == "linear" for note in light.warnings)
        assert any("beyond linear_limit_load" in note for note in heavy.warnings if note.kind == "linear")
        assert heavy.error_estimate == light.error_estimate
        assert heavy.ratio == light.ratio
        assert heavy.linear_limit_load is not None
        assert heavy.linear_limit_load.force < 0.1

    def test_the_paper_gives_no_stress_and_so_no_limit(self) -> None:
        assert evaluate(SCENE, "published").linear_limit_load is None

    @pytest.mark.parametrize("name", ["auto", "closed-form", "axisymmetric"])
    def test_nobody_drives_a_probe_through_the_tissue(self, name: str) -> None:
        with pytest.raises(Refusal, match=r"load.force = 2000 N: allowed: "):
            evaluate(with_load(SCENE, force=2000.0), name, 0.05)

    def test_nor_linearly(self) -> None:
        with pytest.raises(Refusal, match=r"mm into tissue 50 mm deep"):
            evaluate(with_load(SCENE, force=2000.0), linear=True)


@pytest.mark.parametrize("indentation", [0.05, 0.07])
def test_an_indentation_deeper_than_the_tissue_is_no_scene(indentation: float) -> None:
    tables = scene_to_dict(SCENE) | {"load": {"indentation": f"{1e3 * indentation} mm"}}
    with pytest.raises(InputError, match=r"load.indentation = .* mm: allowed: less than the tissue's depth of 50 mm"):
        scene_from_dict(tables)


@pytest.mark.parametrize(
    "folder", slow_unless(("axisymmetric", "contact").__contains__, ["axisymmetric", "contact", "extra", "extremes"])
)
def test_the_gap_closes_no_earlier_than_the_formulas_say(folder: str) -> None:
    paths = sorted((REFERENCE / folder).glob("*.toml"))
    for scene in map(read_scene, paths):
        rough = CoarseModel.from_scene(scene, details=False)
        assert bound_closure_force(scene, rough.forces.sum(axis=1)) <= rough.closure_force


@pytest.mark.slow
@pytest.mark.parametrize(("diameter", "depth", "contrast"), [(14e-3, 8.7e-3, 0.16), (14e-3, 9e-3, 24.0)])
def test_the_rule_holds_over_large_inclusions_near_the_surface(diameter: float, depth: float, contrast: float) -> None:
    """``contact`` changes the ratio, or a stress, by more than eq. PL.2 alone allows; eq. PL.7 covers that."""
    scene = read_scene(EXAMPLES / "scene.toml")
    body = scene.inclusion[0].model_copy(update={"diameter": diameter, "depth": depth, "youngs_modulus": contrast * 6e3})
    scene = scene.model_copy(update={"inclusion": (body,)})
    rule = CoarseModel.from_scene(scene).build_rule(scene)
    loaded = ContactEvaluator().prepare_scene(scene)
    point = loaded.press_to_force(0.3 * rule.largest_known_force).point
    small_tangent = loaded.paths[1].points[0].tangent
    changes = (
        np.append(
            point.films / point.indentation / small_tangent,
            (point.films[0] / point.films[1]) / (small_tangent[0] / small_tangent[1]),
        )
        - 1
    )
    x = rule.compute_x(point.force)
    assert bound_ratio_change(x) < np.abs(changes).max() < bound_ratio_change(x, rule.covered)


def test_deep_or_small_inclusions_change_nothing_of_the_rule() -> None:
    body = read_scene(EXAMPLES / "scene.toml").inclusion[0]
    assert compute_cover_factor(()) == compute_cover_factor((body.model_copy(update={"depth": 32e-3}),)) == 1.0
    close, nearer = (compute_cover_factor((body.model_copy(update={"depth": 4e-3 + cover}),)) for cover in (2e-3, 1e-3))
    assert 1.0 < close < nearer < compute_cover_factor((body, body.model_copy(update={"depth": 4.1e-3})))


def test_a_series_without_meshes_stays_within_the_workspace() -> None:
    """The load's check keeps a mesh of each probe, also beside an evaluator that has none: earlier ones go at the limit."""
    limit = 20e6
    with use_workspace(Workspace(limit)) as workspace:
        for k in range(20):
            evaluate(SCENE.replace({"probe.inner_radius": SCENE.probe.inner_radius * (1 + 1e-3 * k)}), evaluator="closed-form")
        assert 0.25 * limit < workspace.bytes_held < 1.5 * limit
