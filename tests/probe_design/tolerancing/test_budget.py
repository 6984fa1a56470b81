"""The uncertainty budget: its derivatives against differences of results, its samples against theory and finite elements."""

from __future__ import annotations

import json
import math
import tomllib
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from geometry.common.errors import InputError, Refusal
from geometry.scenes.scene import Scene
from geometry.scenes.scene_file import read_scene
from geometry.scenes.variables import list_values
from probe_design.built_probe.bench import Workshop, read_builtin_bench
from probe_design.built_probe.block_predictions import express_by_outer_radius, predict_blocks
from probe_design.tolerancing.budget import ToleranceBudget, allocate_tolerances, compute_budget, split_heights
from probe_design.tolerancing.derivatives import compute_derivatives
from probe_design.tolerancing.loaded_check import compute_built_outputs
from probe_design.tolerancing.sample_statistics import OUTPUT_NAMES, keep_gap_open, sample_probes
from probe_design.tolerancing.uncertain_numbers import GAIN_NAMES, list_uncertain_numbers
from solver import evaluate
from tests.support.paths import EXAMPLES
from tests.support.program import refused, run

SCENE = read_scene(EXAMPLES / "scene.toml")
NONE = dict.fromkeys(GAIN_NAMES, 0.0)


@cache
def budget() -> ToleranceBudget:
    return compute_budget(SCENE, samples=256)


def outputs(scene: Scene, drawn: Scene, evaluator: str = "axisymmetric", accuracy: float = 1e-4) -> np.ndarray:
    result = evaluate(scene, evaluator, accuracy, linear=True)
    assert result.ratio is not None
    assert result.stiffness is not None
    built, drawn_probe = scene.probe, drawn.probe
    areas = math.log(built.inner_area / built.outer_area * drawn_probe.outer_area / drawn_probe.inner_area)
    return np.array([math.log(result.ratio), math.log(result.ratio) + areas, math.log(result.stiffness), result.log_sensitivity])


def built_off(scene: Scene, name: str, step: float) -> dict[str, float]:
    """What a workshop that is off by a step makes of one number: the hole stays where the inner block's radius is off."""
    new = {name: list_values(scene)[name] + step}
    return new | ({"probe.gap": scene.probe.gap - step} if name == "probe.inner_radius" else {})


@pytest.mark.slow
@pytest.mark.parametrize("x", [0.0, 4e-3])  # by axisymmetric, and by equivalent-inclusion
def test_slopes_are_those_of_answers(x: float) -> None:
    """Central differences of ``evaluate`` at 1 % of each number."""
    off_axis = SCENE.inclusion[0].model_copy(update={"x": x})
    scene = express_by_outer_radius(SCENE.model_copy(update={"inclusion": (off_axis,)}))
    evaluator = "equivalent-inclusion" if x else "axisymmetric"
    chosen = ("probe.inner_radius", "probe.gap", "probe.outer_radius", "probe.outer.youngs_modulus")
    variables = [
        variable for variable in list_uncertain_numbers(scene) if (variable.name in chosen if x else variable.kind != "gain")
    ]
    computed = compute_derivatives(scene, variables, 1e-3)
    for variable, derivative in zip(variables, computed.T, strict=True):
        step = (0.002 if variable.name == "probe.inner_radius" else 0.01) * variable.value  # of which a gap of 0.1 mm takes 8 um
        upper, lower = (outputs(scene.replace(built_off(scene, variable.name, s)), scene, evaluator, 1e-3) for s in (step, -step))
        wanted = (upper - lower) / (2 * step)
        assert derivative[:3] == pytest.approx(wanted[:3], rel=0.03, abs=3e-3 / variable.value), variable.name
        share = 0.1 if x else 0.03  # off the axis the log-sensitivity's slope leaves reflections out
        assert derivative[3] == pytest.approx(wanted[3], rel=share, abs=3e-3 / variable.value), variable.name


def test_gains_move_ratio_and_stiffness_as_each_film_s_share() -> None:
    """Independent of the probe: ln(g_1 F_1 / (g_2 F_2)); ln(g_1 F_1 + g_2 F_2)."""
    result = evaluate(SCENE, "axisymmetric", 1e-3)
    assert result.stress_inner is not None
    assert result.stress_outer is not None
    inner, outer = result.stress_inner * SCENE.probe.inner_area, result.stress_outer * SCENE.probe.outer_area
    lines = {line.name: line for line in budget().lines}
    for name, sign, share in ((GAIN_NAMES[0], 1.0, inner / (inner + outer)), (GAIN_NAMES[1], -1.0, outer / (inner + outer))):
        parts = lines[name].outputs
        assert parts["ln_ratio"].derivative == pytest.approx(sign)
        assert parts["ln_stiffness"].derivative == pytest.approx(share, rel=1e-3)
        assert parts["log_sensitivity"].contribution == 0.0


def test_small_tolerances_make_samples_linear() -> None:
    """As all tolerances go to 0 the samples' scatter is that of first order, and Sobol indices are the shares of variance."""
    scene = express_by_outer_radius(SCENE)
    small = {"length": 1e-3, "modulus": 1e-3, "poisson_ratio": 1e-4, "gain": 1e-3}
    plain = list_uncertain_numbers(scene)
    given = {variable.name: 1e-7 if variable.kind == "length" else small[variable.kind] for variable in plain}
    drawn = sample_probes(scene, list_uncertain_numbers(scene, given=given), 512, 1)
    assert drawn is not None
    assert drawn.curvature_factor == pytest.approx(np.ones(len(OUTPUT_NAMES)), abs=0.02)
    shares = drawn.derivatives**2 / (drawn.derivatives**2).sum(axis=1, keepdims=True)
    assert drawn.indices["total"] == pytest.approx(shares, abs=0.06)
    inside = (drawn.indices["total_interval"][..., 0] - 0.02 <= shares) & (
        shares <= drawn.indices["total_interval"][..., 1] + 0.02
    )
    assert inside.mean() > 0.9


@pytest.mark.slow
def test_a_lognormal_modulus_of_which_the_ratio_is_a_power_scatters_as_its_logarithm() -> None:
    """With gains alone ln ratio is linear in the normal variables: sd^2 = s_1^2 + s_2^2, shares by their squares."""
    given: dict[str, object] = {
        variable.name: 0.0 for variable in list_uncertain_numbers(split_heights(express_by_outer_radius(SCENE)))
    }
    budget = compute_budget(SCENE, samples=1024, given=given | {GAIN_NAMES[0]: "40 %", GAIN_NAMES[1]: 0.3})
    ratio = budget.outputs["ln_ratio"]
    assert ratio.sd == pytest.approx(0.5)
    assert ratio.sampled == pytest.approx(0.5, abs=0.02)
    lines = {line.name: line.outputs["ln_ratio"] for line in budget.lines}
    assert [lines[name].share for name in GAIN_NAMES] == pytest.approx([0.64, 0.36])
    assert [lines[name].total for name in GAIN_NAMES] == pytest.approx([0.64, 0.36], abs=0.06)


def test_few_samples_scatter_no_more_than_stated() -> None:
    """With the built-in bench's tolerances ln ratio is all but linear in normal numbers, so that first order is its scatter."""
    scatter = compute_budget(SCENE, samples=64, bench=read_builtin_bench()).outputs["ln_ratio"]
    assert scatter.sampled is not None
    assert scatter.sampled_error is not None
    assert abs(scatter.sampled - scatter.sd) < 2 * scatter.sampled_error
    assert scatter.sampled_error < 0.05 * scatter.sd


def test_a_budget_is_the_same_again() -> None:
    """Samples and resamples are seeded, so that `rerun` compares like with like."""
    first, second = (compute_budget(SCENE, samples=64, seed=3) for _ in range(2))
    assert first.lines == second.lines
    assert first.lines != compute_budget(SCENE, samples=64, seed=4).lines


def test_held_tolerances_add_up_to_what_is_allowed_and_cost_least() -> None:
    """Against scipy's minimiser of the cost sum t_j / tau_j under sum (a_j tau_j / t_j)^2 = x^2."""
    from scipy.optimize import minimize

    contributions, allowed = np.array([0.05, 0.02, 0.004, 1e-3]), 0.01
    allowed_shares = allocate_tolerances(np.ones(4), contributions, allowed)
    assert np.sqrt(((contributions * allowed_shares) ** 2).sum()) == pytest.approx(allowed)
    rule = {"type": "eq", "fun": lambda u: (contributions**2 * np.exp(2 * u)).sum() / allowed**2 - 1}
    best = minimize(lambda u: np.exp(-u).sum(), np.zeros(4), constraints=[rule], method="SLSQP", options={"ftol": 1e-12})
    assert allowed_shares == pytest.approx(np.exp(best.x), rel=1e-3)


def test_a_budget_with_the_held_tolerances_is_what_was_asked() -> None:
    given = {line.name: line.held if line.kind == "length" else line.held / line.value for line in budget().lines if line.held}
    given |= {line.name: line.held for line in budget().lines if line.kind == "poisson_ratio" and line.held}
    assert compute_budget(SCENE, samples=64, given=given).outputs["ln_ratio"].sd == pytest.approx(0.01, rel=1e-3)


@pytest.mark.slow
def test_samples_of_the_closed_form_tell_how_far_finite_elements_bend() -> None:
    """The same 24 built probes by ``axisymmetric`` and by its derivatives: their scatters differ by what is stated."""
    scene = express_by_outer_radius(SCENE)
    given = NONE | {"probe.gap": 4e-5, "probe.outer.youngs_modulus": 0.4, "probe.inner_radius": 3e-5}
    budget = compute_budget(SCENE, samples=1024, given=given)
    variables = [
        variable for variable in list_uncertain_numbers(scene, given=given) if variable.name in given and variable.kind != "gain"
    ]
    eta = np.random.default_rng(3).normal(size=(24, len(variables)))
    built = [{variable.name: float(variable.draw(e)) for variable, e in zip(variables, row, strict=True)} for row in eta]
    for new in built:  # the hole stays, and no gap closes
        deviation = new["probe.inner_radius"] - scene.probe.inner_radius
        new["probe.gap"] = float(keep_gap_open((new["probe.gap"] - deviation) / scene.probe.gap)) * scene.probe.gap
    values = np.array([outputs(scene.replace(new), scene, accuracy=1e-3) for new in built])
    line = (eta * [variable.sd for variable in variables]) @ compute_derivatives(scene, variables, 1e-3).T
    for k, name in enumerate(OUTPUT_NAMES):
        variable = budget.outputs[name]
        assert variable.error_estimate is not None
        assert abs(values[:, k].std() / line[:, k].std() - 1) < variable.error_estimate + 0.05  # 24 draws bend by chance


@pytest.mark.slow
def test_a_log_sensitivity_that_the_level_cannot_tell_has_no_error() -> None:
    """`evaluate` warns of the two tumours, one far off the axis, that the error is about twice the value."""
    scatter = compute_budget(read_scene(EXAMPLES / "two-tumours.toml"), samples=64).outputs
    assert scatter["log_sensitivity"].error_estimate is None
    assert scatter["ln_ratio"].error_estimate is not None


def test_a_material_s_width_is_carried() -> None:
    budget = compute_budget(SCENE, samples=64, materials={"outer": "ecoflex-00-50"})
    line = next(budget_line for budget_line in budget.lines if budget_line.name == "probe.outer.youngs_modulus")
    assert line.sd / line.value == pytest.approx(math.log(152.7 / 67) / 2, rel=1e-3)
    assert "ecoflex-00-50" in line.source


def test_tolerances_are_the_bench_s() -> None:
    """One place for defaults: the built-in bench file says what ``Workshop`` and ``Channels`` have."""
    assert read_builtin_bench().workshop == Workshop()
    bench = read_builtin_bench().model_copy(update={"workshop": Workshop(length=5e-6)})
    lines = {variable.name: variable.sd for variable in list_uncertain_numbers(express_by_outer_radius(SCENE), bench)}
    assert lines["probe.gap"] == 5e-6
    assert lines[GAIN_NAMES[0]] == read_builtin_bench().channels.gain


def test_without_a_bench_tolerances_are_the_process_s_and_the_catalogue_s() -> None:
    """ISO 3302-1 M2 of cast blocks: 0.2 mm of 8 and 8.2 mm, 0.15 mm of 3 mm across the parting plane; ISO 2768-m of hard ones."""
    tables = SCENE.model_dump(exclude_unset=True)
    tables["probe"]["outer"] = {"material": "dragon-skin-30"}
    named = split_heights(express_by_outer_radius(Scene.model_validate(tables)))
    sds = {variable.name: variable.sd for variable in list_uncertain_numbers(named)}
    root = math.sqrt(3)
    lengths = ("probe.inner_radius", "probe.gap", "probe.outer_height")
    assert [sds[name] for name in lengths] == pytest.approx([0.1e-3 / root, 0.1e-3 / root, 0.15e-3 / root])
    assert sds["probe.outer.youngs_modulus"] == pytest.approx(0.554 * 668e3, rel=2e-3)  # eq. SC.3
    assert sds["probe.inner.youngs_modulus"] == pytest.approx(0.02 * 1e6)  # no name: taken as measured
    tables["probe"]["outer"]["youngs_modulus"], tables["probe"]["inner"]["youngs_modulus"] = 610e3, 3e9
    measured = {
        variable.name: variable.sd
        for variable in list_uncertain_numbers(split_heights(express_by_outer_radius(Scene.model_validate(tables))))
    }
    assert measured["probe.outer.youngs_modulus"] == pytest.approx(0.02 * 610e3)
    assert measured["probe.inner_radius"] == pytest.approx(0.2e-3 / 2 / root)
    assert measured["probe.inner_height"] == pytest.approx(0.1e-3 / root)


@pytest.mark.parametrize(
    "wrong",
    [
        {"ratio": 0.0}, {"ratio": math.nan}, {"samples": 100}, {"samples": 0}, {"given": {"probe.knob": 1e-5}},
        {"given": {"probe.gap": "1 kPa"}}, {"given": {"probe.gap": "-1 um"}}, {"given": {"probe.gap": 1.0}},
        {"given": {"probe.inner.youngs_modulus": "-3 %"}}, {"given": {"film.inner.gain": math.inf}},
        {"materials": {"middle": "pmma"}}, {"materials": {"inner": "ecoflex-00-10"}}, {"materials": {"inner": "oak"}},
    ],
)  # fmt: skip
def test_what_is_no_tolerance_is_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(InputError):
        compute_budget(SCENE, **wrong)  # type: ignore[arg-type]


def test_other_kinds_are_refused() -> None:
    contact = SCENE.contact.model_copy(update={"interface": "unilateral", "friction": 0.3})
    with pytest.raises(Refusal):
        compute_budget(SCENE.model_copy(update={"contact": contact}))


def test_a_scene_without_tumour_has_no_log_sensitivity() -> None:
    assert "log_sensitivity" not in compute_budget(SCENE.model_copy(update={"inclusion": ()}), samples=64).outputs


def test_the_command_tells_what_python_does(tmp_path: Path) -> None:
    bench = tmp_path / "bench.toml"
    bench.write_text('[workshop]\nlength = "5 um"\n[[reference]]\nyoungs_modulus = "6 kPa"\n', encoding="utf-8")
    words = ("--bench", bench, "--samples", "64", "--tolerance", "probe.gap = 10 um", "--material", "inner=rtv615")
    picture = tmp_path / "budget.png"
    output = json.loads(run("tolerances", EXAMPLES / "scene.toml", *words, "--plot", picture, "--json").stdout)
    lines = {entry["name"]: entry for entry in output["lines"]}
    assert lines["probe.gap"]["sd"] == pytest.approx(1e-5)
    assert lines["probe.inner_radius"]["sd"] == pytest.approx(5e-6)
    assert lines["probe.inner.youngs_modulus"]["source"].startswith("rtv615")
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert tomllib.loads(bench.read_text(encoding="utf-8"))
    assert "standard deviation" in run("tolerances", EXAMPLES / "scene.toml", "--samples", "64").stdout


@pytest.mark.parametrize(
    ("words", "allowed"),
    [
        (("--tolerance", "probe.gap"), ": allowed: "),
        (("--material", "oak"), ": allowed: "),
        (("--samples", "7"), "not in the range 64<=x<=65536"),
        (("--ratio", "2"), ": allowed: "),
    ],
)
def test_the_command_refuses_in_one_line(words: tuple[str, str], allowed: str) -> None:
    assert allowed in refused("tolerances", EXAMPLES / "scene.toml", *words)


@pytest.mark.slow
def test_a_check_takes_an_unmeasured_modulus_as_uncertain_as_the_budget_does() -> None:
    """One source: the catalogue's 0.35 of ln E (97.3 and 48 kPa), until a measured modulus stands beside the name."""
    tables = SCENE.model_dump(exclude_unset=True)
    tables["probe"]["outer"] = {"material": "ecoflex-00-30"}
    name, sds = "probe.outer.youngs_modulus", []
    for given in ({}, {"youngs_modulus": 72e3}):
        tables["probe"]["outer"] |= given
        scene = Scene.model_validate(tables)
        shares = predict_blocks(scene, read_builtin_bench().blocks[:1])
        sds.append(dict(zip(shares.variables, shares.compute_tolerances(Workshop()).tolist(), strict=True))[name])
        budgeted = {variable.name: variable.sd for variable in list_uncertain_numbers(express_by_outer_radius(scene))}
        assert sds[-1] == pytest.approx(budgeted[name])
    assert sds == pytest.approx([math.log(97.3 / 48) / 2 * 68.34e3, 0.02 * 72e3], rel=2e-3)


def press(x: float = 0.0) -> Scene:
    """The examples' scene under the load of a hand, the tumour at an offset."""
    body = SCENE.inclusion[0].model_copy(update={"x": x})
    return split_heights(express_by_outer_radius(SCENE.model_copy(update={"inclusion": (body,)}))).replace({"load.force": 0.05})


@pytest.mark.slow
@pytest.mark.parametrize("x", [0.0, 4e-3])
def test_derivatives_under_load_are_those_of_contact(x: float) -> None:
    """Central differences of ``evaluate``, of built probes; a light load's differ by up to a fifth of S."""
    scene = press(x)
    names = ("probe.inner_radius", "probe.outer_radius", "probe.outer.youngs_modulus", "film.inner.gain")
    variables = [item for item in list_uncertain_numbers(scene) if item.name in names]
    result = evaluate(scene, "contact", 0.01)
    computed = compute_derivatives(scene, variables, 1e-3, result) * [item.sd for item in variables]
    light = compute_derivatives(scene, variables, 1e-3) * [item.sd for item in variables]
    for k, variable in enumerate(variables):  # steps of one sd: contact's points touch one after the other
        step = 0.5 * np.eye(len(variables))[k]
        wanted = np.subtract(*(compute_built_outputs(scene, variables, side * step, 0.01) for side in (1.0, -1.0)))
        assert computed[:3, k] == pytest.approx(wanted[:3], rel=0.06, abs=1e-3), variable.name
        assert computed[3, k] == pytest.approx(wanted[3], rel=0.15 if x else 0.1, abs=5e-5), variable.name
    assert np.abs(computed - light).max() > 5e-4


@pytest.mark.slow
def test_a_budget_under_load_is_by_contact_and_counts_what_the_closed_form_leaves_out() -> None:
    """Gains alone: ln ratio is linear in their logarithms under any load, so that eq. TO.8 adds nothing."""
    scene = press()
    given: dict[str, object] = {variable.name: 0.0 for variable in list_uncertain_numbers(scene)}
    budget = compute_budget(scene, samples=64, given=given | {GAIN_NAMES[0]: "40 %", GAIN_NAMES[1]: 0.3})
    assert budget.evaluator == "contact"
    assert not any("linear" in text for text in budget.warnings)
    ratio = budget.outputs["ln_ratio"]
    assert ratio.sd == pytest.approx(0.5)
    assert ratio.error_estimate is not None
    assert ratio.error_estimate < 0.15
