"""Many scenes at once: each result is that of the scene alone within both stated errors, in order, refusals among them."""

from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from geometry import InputError, Scene, read_scene
from geometry.common.errors import Refusal
from geometry.common.resources import LimitReached, Limits
from geometry.provenance.block import record_command
from geometry.scenes.scene_tables import Load
from solver import Result, evaluate, evaluate_many
from solver.linalg.cholesky import Factor, Pattern, factorise
from tests.support.paths import SCENE

ACCURACY = 0.01
OURS = read_scene(SCENE)
MODULI = [float(modulus) for modulus in np.geomspace(600.0, 6e6, 8)]


def with_modulus(modulus: float, scene: Scene = OURS, **changes: Any) -> Scene:
    body = scene.inclusion[0].model_copy(update={"youngs_modulus": modulus, **changes})
    return scene.model_copy(update={"inclusion": (body,)})


def with_gap(gap: float, scene: Scene = OURS) -> Scene:
    return scene.model_copy(update={"probe": scene.probe.model_copy(update={"gap": gap})})


def with_load(scene: Scene = OURS, **load: float) -> Scene:
    return scene.model_copy(update={"load": Load(**load)})


def mixture() -> list[Scene | Path | str]:
    """Curves of two designs among each other, loads, one of a kind, a block, refused ones, and what is no scene."""
    block = OURS.tissue.model_copy(update={"poisson_ratio": 0.45})
    ours: list[Scene | Path | str] = [with_modulus(modulus) for modulus in MODULI]
    thicker = [with_modulus(modulus, with_gap(2e-4)) for modulus in reversed(MODULI)]
    mixed: list[Scene | Path | str] = [scene for pair in zip(ours, thicker, strict=True) for scene in pair]
    mixed[3:3] = [with_load(force=1e-3), with_load(force=0.0), with_load(indentation=1e-6), with_load(force=1e9)]
    mixed[6:6] = [with_modulus(6e4, x=0.003), OURS.model_copy(update={"tissue": block}), str(SCENE), "no such file.toml"]
    return [*mixed, OURS.model_copy(update={"inclusion": ()}), with_modulus(1e3, depth=0.0041), mixed[0]]


def alone(scene: Scene | Path | str, evaluator: str, linear: bool) -> Result | str:
    try:
        return evaluate(scene, evaluator, ACCURACY, linear=linear)
    except InputError as fault:
        return str(fault)


def assert_same(first: Result, second: Result) -> None:
    """Both within their errors; what does not depend on meshes is the same."""
    assert (first.evaluator, first.provenance) == (second.evaluator, second.provenance)
    assert [note.kind for note in first.warnings] == [note.kind for note in second.warnings]
    assert [(line.feature, line.modelled) for line in first.plan] == [(line.feature, line.modelled) for line in second.plan]
    for name in ("ratio", "stress_inner", "stress_outer", "stiffness", "log_sensitivity", "error_estimate", "linear_limit_load"):
        mine, theirs = getattr(first, name), getattr(second, name)
        assert (mine is None) == (theirs is None), name
    if first.error_estimate is not None and second.error_estimate is not None and first.ratio is not None:
        error = first.error_estimate + second.error_estimate
        assert first.ratio == pytest.approx(second.ratio, rel=error)
        assert first.stress_inner == pytest.approx(second.stress_inner, rel=error)
        assert first.stiffness == pytest.approx(second.stiffness, rel=error)
        sensitivities = [result.log_sensitivity for result in (first, second) if result.log_sensitivity is not None]
        assert sensitivities == pytest.approx(sensitivities[::-1], rel=10 * ACCURACY, abs=2e-5)
        assert first.error_estimate <= max(ACCURACY, second.error_estimate)


@pytest.mark.slow
@pytest.mark.parametrize(("evaluator", "linear"), [("axisymmetric", False), ("auto", False), ("auto", True)])
def test_a_mixture_is_answered_as_one_by_one(evaluator: str, linear: bool) -> None:
    scenes = mixture()
    together = evaluate_many(scenes, evaluator, ACCURACY, linear=linear)
    assert len(together) == len(scenes)
    refused = 0
    for result, scene in zip(together, scenes, strict=True):
        single = alone(scene, evaluator, linear)
        if isinstance(single, str):
            assert str(result) == single
            refused += 1
        else:
            assert isinstance(result, Result), result
            assert_same(result, single)
    assert 2 <= refused < len(scenes) / 2


def test_each_scene_has_its_own_accuracy() -> None:
    """An accuracy that is left out is the scene's, as of ``evaluate``, also where scenes share their work."""
    scenes = [OURS, OURS.replace({"reading.accuracy": 0.2}), with_load(force=1e-3).replace({"reading.accuracy": 0.2})]
    for result, scene in zip(evaluate_many(scenes), scenes, strict=True):
        single = evaluate(scene)
        assert isinstance(result, Result)
        assert result.provenance is not None
        assert single.provenance is not None
        assert result.provenance["accuracy"] == single.provenance["accuracy"] == (scene.reading.accuracy or ACCURACY)
        assert [note.kind for note in result.warnings] == [note.kind for note in single.warnings]


def test_formulas_answer_a_mixture_to_the_last_bit() -> None:
    """Also films, and what is probably a mistake."""
    doubtful = with_gap(1.01 * OURS.probe.inner_radius)
    scenes = [*mixture(), doubtful, SCENE.with_name("films.toml")]
    assert any(note.kind == "doubt" for note in evaluate(doubtful, "closed-form", ACCURACY).warnings)
    for result, scene in zip(evaluate_many(scenes, "closed-form", ACCURACY), scenes, strict=True):
        single = alone(scene, "closed-form", False)
        if isinstance(single, str):
            assert str(result) == single
        else:
            assert isinstance(result, Result)
            assert without_limits(result) == without_limits(single)
            if result.load_limits is not None and single.load_limits is not None:  # of thousands no mesh is made for each
                assert {limit["known"] for limit in (result.as_dict()["load_limits"] or {}).values() if limit} == {"formulas"}
                assert result.linear_limit_load.force <= 1.02 * single.linear_limit_load.force  # type: ignore[union-attr]


def test_formulas_build_a_result_when_it_is_read_as_it_would_have_been_at_once() -> None:
    """With the command line of the call in its provenance, once; pickled with its refusals, and as a frame."""
    with record_command(["evaluate", "many"]):
        results = evaluate_many([*mixture()[:3], with_load(force=1e9)], "closed-form")
    first = results[0]
    assert isinstance(first, Result)
    assert first.provenance is not None
    assert first.provenance["command"] == ["evaluate", "many"]
    assert results[-4] is first
    assert [type(item) for item in results[1:]] == [Result, Result, Refusal]
    copied = pickle.loads(pickle.dumps(results))
    assert [str(item) for item in copied] == [str(item) for item in results]
    assert (copied[-1].key, copied[-1].value, copied[-1].exit_code) == (results[-1].key, results[-1].value, 2)
    frame = copied.to_frame()
    assert frame["ratio"][0] == first.ratio
    assert frame["error"][3] == str(results[3])
    with pytest.raises(IndexError):
        results[4]


def without_limits(result: Result) -> Result:
    """What both results have in common but for loads, and for the time that it took."""
    notes = tuple(note for note in result.warnings if note.kind != "linear")
    return replace(result, seconds=0.0, load_limits=None, warnings=notes)


def test_a_design_s_moduli_and_loads_take_the_factorisations_of_one_curve(monkeypatch: pytest.MonkeyPatch) -> None:
    counted: list[int] = []

    def counting(matrix: Any, pattern: Pattern | None) -> Factor:
        counted.append(matrix.shape[0])
        return factorise(matrix, pattern)

    monkeypatch.setattr("solver.axisymmetric.condensed_system.factorise", counting)
    scenes = [with_load(with_modulus(modulus), force=force) for modulus in MODULI for force in (1e-4, 1e-3, 2e-3)]
    results = evaluate_many(scenes, "axisymmetric", 0.05)
    assert all(isinstance(result, Result) for result in results)
    assert 0 < len(counted) <= 8  # a light mesh, its lower orders at one and at the stiffest modulus, the coarse one for loads
    stresses = np.array([result.stress_inner for result in results[:3] if isinstance(result, Result)])
    np.testing.assert_allclose(stresses / stresses[0], [1, 10, 20], rtol=1e-12)


def test_moduli_that_no_curve_takes_are_answered_alone() -> None:
    """A range so wide that no curve spans it leaves the moduli that can be computed alone."""
    extreme = [*MODULI, 1e-9, 1e25]
    results = evaluate_many([with_modulus(modulus) for modulus in extreme], "axisymmetric", 0.05)
    for result, modulus in zip(results, extreme, strict=True):
        single = alone(with_modulus(modulus), "axisymmetric", False)
        assert isinstance(result, Result) == isinstance(single, Result)
    assert all(isinstance(result, Result) for result in results[: len(MODULI)])


@pytest.mark.parametrize("evaluator", ["axisymmetric", "closed-form", "auto"])
def test_limits_are_for_each_answer(evaluator: str) -> None:
    results = evaluate_many([with_modulus(modulus) for modulus in MODULI], evaluator, limits=Limits(seconds=1e-9))
    assert all(isinstance(result, LimitReached) for result in results)


def test_what_is_wrong_for_all_is_said_at_once() -> None:
    with pytest.raises(InputError, match="accuracy"):
        evaluate_many([OURS], accuracy=2.0)
    with pytest.raises(InputError, match="evaluator"):
        evaluate_many([OURS], "closed")
    assert list(evaluate_many([])) == []
