"""Level contact: what it answers is within its bounds, when it is asked, and what it refuses."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from typing import Literal

import numpy as np
import pytest

from geometry import Refusal, Scene, read_scene
from geometry.common.errors import SolveError
from geometry.scenes.scene_tables import Contact, HalfSpaceTissue, Load
from solver.axisymmetric.evaluator import Axisymmetric
from solver.contact import path
from solver.contact.evaluator import ContactEvaluator
from solver.contact.loaded_scene import LoadedForces, LoadedScene, press_with_enough_points, solve_neighbour
from solver.contact.model import ContactModel
from solver.contact.newton import solve
from solver.contact.states import Equilibrium, State, StoppedError
from solver.evaluation import curve, evaluate, plan
from tests.support.paths import EXAMPLES, REFERENCE
from tests.support.slow import slow_unless

FOLDER = REFERENCE / "contact"
EXPECTED = json.loads((FOLDER / "expected.json").read_text())
EXAMPLE = read_scene(FOLDER / "example.toml")
HALF_SPACE = HalfSpaceTissue(shape="half-space", youngs_modulus=6e3, poisson_ratio=0.45)


def with_load(scene: Scene, **load: float) -> Scene:
    return scene.model_copy(update={"load": Load(**load)})


def check(name: str, rows: slice) -> None:
    scene = read_scene(FOLDER / f"{name}.toml")
    for row in EXPECTED[name]["rows"][rows]:
        result = ContactEvaluator().evaluate(with_load(scene, indentation=row["indentation"]))
        assert result.ratio is not None
        assert result.stiffness is not None
        assert result.error_estimate is not None
        assert result.ratio == pytest.approx(row["ratio"], abs=result.error_estimate * row["ratio"] + row["ratio_unc"])
        assert result.ratio == pytest.approx(row["ratio"], abs=2e-3 * row["ratio"] + row["ratio_unc"])
        assert result.stiffness * row["indentation"] == pytest.approx(row["force"], abs=1e-3 * row["force"] + row["force_unc"])
        assert result.log_sensitivity == pytest.approx(
            row["log_sensitivity"], abs=0.01 * row["log_sensitivity"] + row["log_sensitivity_unc"]
        )


def test_another_code_s_answer_is_within_the_bound() -> None:
    check("example", slice(1, 2))


@pytest.mark.slow
@pytest.mark.parametrize("name", EXPECTED)
def test_others_are(name: str) -> None:
    """All loads: ``benchmarks/contact/accuracy.py``."""
    check(name, slice(3, None, 2))


@pytest.mark.parametrize("interface", slow_unless("bonded".__eq__, ["bonded", "frictionless"]))
def test_small_loads_are_answered_as_linear_elements_do(interface: Literal["bonded", "frictionless"]) -> None:
    """However small, and whether the force or the indentation is given."""
    scene = EXAMPLE.model_copy(update={"contact": Contact(interface=interface)})
    linear = Axisymmetric().evaluate(scene, 1e-3)
    assert linear.stiffness is not None
    assert linear.error_estimate is not None
    for depth in (1e-9, 3.1e-8, 1e-6):
        for load in (Load(indentation=depth), Load(force=depth * linear.stiffness)):
            result = ContactEvaluator().evaluate(scene.model_copy(update={"load": load}))
            assert result.error_estimate is not None
            assert result.error_estimate < 2e-3
            assert result.ratio == pytest.approx(linear.ratio, rel=result.error_estimate + linear.error_estimate)
            assert result.stiffness == pytest.approx(linear.stiffness, rel=1e-3)
            assert result.log_sensitivity == pytest.approx(linear.log_sensitivity, rel=5e-3)


@pytest.mark.parametrize(
    ("layers", "force"),
    [
        (({"thickness": 0.5e-3, "youngs_modulus": 4e5, "poisson_ratio": 0.45},), 1e-5),
        pytest.param((), 1e-3, marks=pytest.mark.slow),
    ],
    ids=["thin stiff skin", "no skin"],
)
def test_faces_that_slide_settle_on_a_thin_stiff_skin_and_without_one(layers: tuple[dict[str, float], ...], force: float) -> None:
    """Rounding of positions leaves more of a residual where a skin is stiff; lines that slide do not fit each other exactly."""
    tables = read_scene(EXAMPLES / "skin.toml").model_dump(exclude_unset=True)
    tables |= {"inclusion": [], "contact": {"interface": "frictionless"}, "load": {"force": force}}
    tables["tissue"] |= {"youngs_modulus": 8e3, "layer": list(layers)}
    scene = Scene.from_tables(tables)
    result, linear = ContactEvaluator().evaluate(scene), Axisymmetric().evaluate(scene, 1e-3)
    assert result.error_estimate is not None
    assert linear.error_estimate is not None
    assert result.error_estimate < 3e-3
    assert result.ratio == pytest.approx(linear.ratio, rel=result.error_estimate + linear.error_estimate)


@pytest.mark.slow
def test_sharp_edges_on_which_faces_slide_are_within_the_stated_error() -> None:
    """Of wide-gapped blocks on a thin film, whose meshes agree within 2e-5: their edges have the same small radius."""
    tables = {
        "probe": {
            "inner_radius": 4.264e-3,
            "outer_radius": 8.201e-3,
            "gap": 1.246e-3,
            "height": 5.472e-3,
            "inner": {"material": "ecoflex-00-50"},
            "outer": {"material": "sortaclear-40"},
            "base": {"rigid": True},
            "film": {"thickness": 9e-6, "bond_to_base": {"name": "epoxy-20um"}, "bond_to_block": {"name": "rigid"}},
        },
        "tissue": {"shape": "cylinder", "radius": 38.8e-3, "depth": 50e-3, "youngs_modulus": 4116.0, "poisson_ratio": 0.3},
        "inclusion": [{"diameter": 12e-3, "depth": 8.8e-3, "youngs_modulus": 4851.0, "poisson_ratio": 0.499}],
        "contact": {"interface": "frictionless"},
        "load": {"force": 1e-5},
    }
    scene = Scene.from_tables(tables)
    linear, loaded = evaluate(scene, "axisymmetric", 1e-3), evaluate(scene, "contact")
    assert linear.error_estimate is not None
    assert loaded.error_estimate is not None
    assert loaded.ratio == pytest.approx(linear.ratio, rel=linear.error_estimate + loaded.error_estimate)
    assert loaded.error_estimate < linear.error_estimate + 5e-4  # it contains the error of the linear solution, too


@pytest.mark.slow
def test_a_finer_mesh_that_fails_leaves_what_rougher_ones_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """As on the finest mesh under a thin stiff skin, where the faces' pressures need too many rounds: it was refused."""

    def fail(_: LoadedScene) -> LoadedScene:
        raise SolveError("contact does not settle")

    monkeypatch.setattr(LoadedScene, "refine", fail)
    result = ContactEvaluator().evaluate(with_load(EXAMPLE, indentation=1e-6), 1e-4)
    assert result.error_estimate is not None
    assert 1e-4 < result.error_estimate < 1e-3
    assert any("accuracy 0.01 % requested" in note for note in result.warnings)


@pytest.mark.slow
def test_a_path_goes_on_from_points_that_lie_close_together() -> None:
    alone, continued = (ContactEvaluator().prepare_scene(EXAMPLE) for _ in range(2))
    for depth in (1e-7, 1.1e-7, 1.2e-7):
        continued.press_to_indentation(depth)
    expected, result = (path.press_to_indentation(8e-4).films for path in (alone, continued))
    np.testing.assert_allclose(result.totals, expected.totals, rtol=1e-5)


@pytest.mark.slow
def test_open_faces_are_pressed_to_the_force_that_is_asked_for_however_small() -> None:
    """Friction makes them stiffer than frictionless ones, whose linear answer gives the scale."""
    rubbing = EXAMPLE.model_copy(update={"contact": Contact(interface="unilateral", friction=0.3)})
    assert ContactEvaluator().prepare_scene(rubbing).press_to_force(1e-4).point.force == pytest.approx(1e-4, rel=1e-3)


def test_auto_asks_it_beyond_linear_elasticity_and_not_before() -> None:
    light, heavy = with_load(EXAMPLE, force=0.02), with_load(EXAMPLE, force=0.08)
    assert (plan(light).evaluator, plan(heavy).evaluator) == ("axisymmetric", "contact")
    result, linear = evaluate(heavy), evaluate(heavy, linear=True)
    assert (result.evaluator, linear.evaluator) == ("contact", "axisymmetric")
    assert result.log_sensitivity > 1.08 * linear.log_sensitivity
    assert result.error_estimate <= 0.01
    assert not any("linear" in note for note in result.warnings)
    modelled = {decision.feature: decision.modelled for decision in result.plan}
    assert modelled["finite strain"]
    assert modelled["gap contact"]


def test_a_load_is_a_force_or_the_indentation_that_it_takes() -> None:
    by_force = evaluate(with_load(EXAMPLE, force=0.05), "contact")
    by_depth = evaluate(with_load(EXAMPLE, indentation=0.05 / by_force.stiffness), "contact")
    for key in ("ratio", "log_sensitivity", "stiffness", "stress_inner", "stress_outer"):
        assert getattr(by_depth, key) == pytest.approx(getattr(by_force, key), rel=1e-5)
    areas = EXAMPLE.probe.inner_area, EXAMPLE.probe.outer_area
    assert by_force.stress_inner * areas[0] + by_force.stress_outer * areas[1] == pytest.approx(0.05, rel=1e-9)


def test_no_load_is_the_linear_answer() -> None:
    for load in (0.0, 1e-7):
        still, linear = (evaluate(with_load(EXAMPLE, force=load), name) for name in ("contact", "axisymmetric"))
        assert still.ratio == pytest.approx(linear.ratio, rel=linear.error_estimate + still.error_estimate)
        assert still.log_sensitivity == pytest.approx(linear.log_sensitivity, rel=0.01)


def test_layers_and_no_tumour() -> None:
    """At next to no load NGSolve's ratio on a skin; beyond it a bound that the change by the load does not reach."""
    scene = read_scene(REFERENCE / "tissue-layers" / "without-a-tumour.toml")
    expected = json.loads((REFERENCE / "tissue-layers" / "expected.json").read_text())["without-a-tumour"]
    light, heavy = (evaluate(with_load(scene, force=force), "contact", 0.005) for force in (1e-4, 0.02))
    assert heavy.log_sensitivity is None
    assert light.ratio == pytest.approx(expected["ratio"], rel=light.error_estimate)
    assert abs(heavy.ratio / light.ratio - 1) > heavy.error_estimate + light.error_estimate


@pytest.mark.slow
def test_a_curve_under_load_goes_through_the_answers() -> None:
    moduli = np.geomspace(1e3, 1e6, 6)
    scene = with_load(EXAMPLE, force=0.15)
    answered = curve(scene, moduli)
    assert answered.evaluator == "contact"
    for k in (0, 3, 5):
        body = scene.inclusion[0].model_copy(update={"youngs_modulus": float(moduli[k])})
        alone = evaluate(scene.model_copy(update={"inclusion": (body,)}))
        assert answered.ratio[k] == pytest.approx(alone.ratio, rel=alone.error_estimate)
        assert answered.log_sensitivity[k] == pytest.approx(alone.log_sensitivity, rel=0.05)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"contact": Contact(interface="unilateral"), "tissue": HALF_SPACE}, "finite size"),
        ({"placement": EXAMPLE.placement.model_copy(update={"tilt": 0.1})}, "tilt"),
    ],
)
def test_other_kinds_are_refused(changes: dict[str, object], words: str) -> None:
    with pytest.raises(Refusal, match=words):
        evaluate(EXAMPLE.model_copy(update=changes), "contact")


def test_a_load_far_beyond_all_is_refused_at_once() -> None:
    soft = read_scene(FOLDER / "paper.toml")
    refused = (
        r"load.force = 10 N: allowed: up to about 0.07\d N for contact, which indents the tissue by the probe's outer radius"
    )
    for name, remedy in (("contact", "$"), ("auto", r", or --linear \(linear=True\)$")):
        with pytest.raises(Refusal, match=refused + remedy):
            evaluate(with_load(soft, force=10.0), name)


def test_a_load_that_no_step_reaches_is_refused_with_the_one_reached(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where Newton's method fails depends on rounding deep down, so here it fails at a depth of our choice."""
    max_indentation = 0.3e-3

    def stops(model: ContactModel, guess: State) -> Equilibrium:
        if guess.indentation > max_indentation:
            raise SolveError("the elements fold")
        return solve(model, guess)

    monkeypatch.setattr(path, "solve", stops)
    reached = ContactEvaluator().prepare_scene(EXAMPLE).press_to_indentation(max_indentation).point.force
    with pytest.raises(
        Refusal, match=r"load.force = 0.1 N: .* for contact: no further step converges: the elements fold"
    ) as refusal:
        evaluate(with_load(EXAMPLE, force=0.1), "contact")
    said = re.search(r"up to ([\d.]+) N", str(refusal.value))
    assert said is not None
    assert 0.9 * reached < float(said[1]) <= reached * 1.001


@pytest.mark.slow
def test_a_refused_load_names_what_both_meshes_reach(monkeypatch: pytest.MonkeyPatch) -> None:
    """Under faces that slide the coarse mesh ends at 0.3 mm, the fine one at 0.2 mm."""
    scene = with_load(EXAMPLE.model_copy(update={"contact": Contact(interface="frictionless")}), force=0.1)
    coarse, fine = (len(path.model.mesh.body) for path in ContactEvaluator().prepare_scene(scene).paths)

    def stops(model: ContactModel, guess: State) -> Equilibrium:
        if guess.indentation > {coarse: 0.3e-3, fine: 0.2e-3}[len(model.mesh.body)]:
            raise SolveError("the elements fold")
        return solve(model, guess)

    monkeypatch.setattr(path, "solve", stops)
    reached = ContactEvaluator().prepare_scene(scene).press_to_indentation(0.2e-3).point.force
    with pytest.raises(Refusal, match=r"contact\.interface = 'bonded'") as refusal:
        ContactEvaluator().evaluate(scene)
    said = re.search(r"up to ([\d.]+) N", str(refusal.value))
    assert said is not None
    assert 0.9 * reached < float(said[1]) <= reached * 1.001


@pytest.mark.slow
def test_a_load_beyond_all_that_is_reached_is_refused_with_the_one_reached() -> None:
    """What stands in the way, Newton's method or the depth that has been compared, hangs on rounding."""
    ends = "(no further step converges|the indentation is the probe's outer radius)"
    with pytest.raises(Refusal, match=rf"load.force = 0.9 N: allowed: up to 0.[2-6]\d* N for contact: {ends}"):
        evaluate(with_load(EXAMPLE, force=0.9), "contact")


@pytest.mark.slow
def test_faces_that_open_are_as_a_trial_found_them() -> None:
    """Frictionless, opening at sharp edges, by one other code: ratio 0.566 at 0.037 N (CONTACT.md)."""
    open_ = with_load(EXAMPLE.model_copy(update={"contact": Contact(interface="unilateral")}), force=0.037)
    result = ContactEvaluator().evaluate(open_, accuracy=0.1)
    assert result.error_estimate is not None
    assert result.ratio == pytest.approx(0.566, rel=result.error_estimate)
    assert result.error_estimate < 0.05


@pytest.mark.slow
def test_friction_brings_faces_nearer_to_the_bond() -> None:
    """Ratios at one small load: free, held by friction, bonded."""
    kinds = (Contact(interface="unilateral"), Contact(interface="unilateral", friction=10.0), Contact())
    free, held, bonded = (
        ContactEvaluator().evaluate(with_load(EXAMPLE.model_copy(update={"contact": kind}), force=0.01), accuracy=0.1)
        for kind in kinds
    )
    ratios = np.array([free.ratio, held.ratio, bonded.ratio], dtype=float)
    assert abs(ratios[1] - ratios[2]) < 0.5 * abs(ratios[0] - ratios[2])
    assert held.error_estimate is not None
    assert ratios[1] == pytest.approx(ratios[2], rel=held.error_estimate)


@pytest.mark.slow
def test_a_curve_keeps_what_meshes_differ_by_on_the_way() -> None:
    """Other moduli begin at the loaded state: their bounds are no smaller than those of a way of their own, by much."""
    scene, moduli = with_load(EXAMPLE, force=0.15), np.array([3e4, 6e4])
    answered = ContactEvaluator().curve(scene, moduli)
    for k, modulus in enumerate(moduli):
        body = scene.inclusion[0].model_copy(update={"youngs_modulus": float(modulus)})
        alone = ContactEvaluator().evaluate(scene.model_copy(update={"inclusion": (body,)}))
        assert answered.error_estimate[k] > 0.7 * alone.error_estimate


@pytest.mark.slow
def test_tissue_that_folds_onto_a_corner_is_pressed_with_few_contact_points_or_twice_as_many() -> None:
    """Either answer is within the other's bound."""
    few = ContactEvaluator().prepare_scene(with_load(EXAMPLE, force=0.3))
    many = few.add_contact_points()
    assert many is not None
    bounds = [loaded.press_to_scene_load().films for loaded in (few, many)]
    errors = [films.ratio_error for films in bounds]
    assert max(errors) < 0.012  # 0.0102 and 0.0110, of which fine corners add most
    ratios = [films.totals[0] / films.totals[1] for films in bounds]
    assert ratios[0] == pytest.approx(ratios[1], rel=min(errors))


def test_another_modulus_is_pressed_with_more_contact_points_too(monkeypatch: pytest.MonkeyPatch) -> None:
    loaded, press = ContactEvaluator().load_scene(with_load(EXAMPLE, force=0.01), 0.1), LoadedScene.press_to_scene_load

    def stop_with_few_points(scene: LoadedScene) -> LoadedForces:
        if not scene.dense:
            raise StoppedError(scene.paths[1].last, "a wall kinks")
        return press(scene)

    monkeypatch.setattr(LoadedScene, "press_to_scene_load", stop_with_few_points)
    forces, neighbour = solve_neighbour(loaded, 3e4)
    assert neighbour.dense
    assert neighbour.scene.inclusion[0].youngs_modulus == 3e4
    assert forces.films.ratio_error < 0.1


def test_the_refusal_names_the_path_that_got_further(monkeypatch: pytest.MonkeyPatch) -> None:
    """More contact points stop earlier on some scenes; what fewer reached is the limit then."""
    loaded = ContactEvaluator().prepare_scene(EXAMPLE)
    far, near = loaded.press_to_indentation(2e-4).point, loaded.press_to_indentation(1e-4).point
    monkeypatch.setattr(LoadedScene, "add_contact_points", lambda scene: scene)
    for first, second in ((far, near), (near, far)):
        stops = iter((StoppedError(first, "first"), StoppedError(second, "second")))

        def press(_: LoadedScene, stops: Iterator[StoppedError] = stops) -> LoadedForces:
            raise next(stops)

        with pytest.raises(StoppedError) as stop:
            press_with_enough_points(loaded, press)
        assert stop.value.last is far
