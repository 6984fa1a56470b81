"""Many scenes at once: each answered as alone to within both's stated errors, in order, refusals among them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from geometry import InputError, Scene, read_scene
from geometry.common.resources import LimitReached, Limits
from geometry.scenes.scene import Load
from solver import Result, evaluate, evaluate_many
from solver.linalg.cholesky import Factor, Pattern, factorise
from tests.support.paths import SCENE

ACCURACY = 0.01
OURS = read_scene(SCENE)
MODULI = [float(modulus) for modulus in np.geomspace(600.0, 6e6, 8)]


def with_modulus(modulus: float, scene: Scene = OURS, **other: Any) -> Scene:
    body = scene.inclusion[0].model_copy(update={"youngs_modulus": modulus, **other})
    return scene.model_copy(update={"inclusion": (body,)})


def with_gap(gap: float, scene: Scene = OURS) -> Scene:
    return scene.model_copy(update={"probe": scene.probe.model_copy(update={"gap": gap})})


def under(scene: Scene = OURS, **load: float) -> Scene:
    return scene.model_copy(update={"load": Load(**load)})


def mixture() -> list[Scene | Path | str]:
    """Curves of two designs among each other, loads, one of a kind, a block, refused ones, and what is no scene."""
    block = OURS.tissue.model_copy(update={"poisson_ratio": 0.45})
    ours: list[Scene | Path | str] = [with_modulus(modulus) for modulus in MODULI]
    others = [with_modulus(modulus, with_gap(2e-4)) for modulus in reversed(MODULI)]
    mixed: list[Scene | Path | str] = [one for pair in zip(ours, others, strict=True) for one in pair]
    mixed[3:3] = [under(force=1e-3), under(force=0.0), under(indentation=1e-6), under(force=1e9)]
    mixed[6:6] = [with_modulus(6e4, x=0.003), OURS.model_copy(update={"tissue": block}), str(SCENE), "no such file.toml"]
    return [*mixed, OURS.model_copy(update={"inclusion": ()}), with_modulus(1e3, depth=0.0041), mixed[0]]


def alone(scene: Scene | Path | str, evaluator: str, linear: bool) -> Result | str:
    try:
        return evaluate(scene, evaluator, ACCURACY, linear=linear)
    except InputError as fault:
        return str(fault)


def same(one: Result, other: Result) -> None:
    """Both within their errors; what does not depend on meshes is the same."""
    assert (one.evaluator, one.provenance) == (other.evaluator, other.provenance)
    assert [note.kind for note in one.warnings] == [note.kind for note in other.warnings]
    assert [(line.feature, line.modelled) for line in one.plan] == [(line.feature, line.modelled) for line in other.plan]
    for name in ("ratio", "stress_inner", "stress_outer", "stiffness", "log_sensitivity", "error_estimate", "linear_limit_load"):
        mine, theirs = getattr(one, name), getattr(other, name)
        assert (mine is None) == (theirs is None), name
    if one.error_estimate is not None and other.error_estimate is not None and one.ratio is not None:
        off = one.error_estimate + other.error_estimate
        assert one.ratio == pytest.approx(other.ratio, rel=off)
        assert one.stress_inner == pytest.approx(other.stress_inner, rel=off)
        assert one.stiffness == pytest.approx(other.stiffness, rel=off)
        sensitivities = [result.log_sensitivity for result in (one, other) if result.log_sensitivity is not None]
        assert sensitivities == pytest.approx(sensitivities[::-1], rel=10 * ACCURACY, abs=2e-5)
        assert one.error_estimate <= max(ACCURACY, other.error_estimate)


@pytest.mark.slow
@pytest.mark.parametrize(("evaluator", "linear"), [("axisymmetric", False), ("auto", False), ("auto", True)])
def test_a_mixture_is_answered_as_one_by_one(evaluator: str, linear: bool) -> None:
    scenes = mixture()
    together = evaluate_many(scenes, evaluator, ACCURACY, linear=linear)
    assert len(together) == len(scenes)
    refused = 0
    for one, scene in zip(together, scenes, strict=True):
        single = alone(scene, evaluator, linear)
        if isinstance(single, str):
            assert str(one) == single
            refused += 1
        else:
            assert isinstance(one, Result), one
            same(one, single)
    assert 2 <= refused < len(scenes) / 2


def test_formulas_answer_a_mixture_to_the_last_bit() -> None:
    scenes = mixture()
    for one, scene in zip(evaluate_many(scenes, "closed-form", ACCURACY), scenes, strict=True):
        single = alone(scene, "closed-form", False)
        if isinstance(single, str):
            assert str(one) == single
        else:
            assert isinstance(one, Result)
            assert without_limits(one) == without_limits(single)
            if one.load_limits is not None and single.load_limits is not None:  # of thousands no mesh is made for each
                assert {limit["known"] for limit in (one.as_dict()["load_limits"] or {}).values() if limit} == {"formulas"}
                assert one.linear_limit_load.force <= 1.02 * single.linear_limit_load.force  # type: ignore[union-attr]


def without_limits(result: Result) -> Result:
    """What both say but for loads, and for the time that it took."""
    notes = tuple(note for note in result.warnings if note.kind != "linear")
    return replace(result, seconds=0.0, load_limits=None, warnings=notes)


def test_a_design_s_moduli_and_loads_take_the_factorisations_of_one_curve(monkeypatch: pytest.MonkeyPatch) -> None:
    counted: list[int] = []

    def counting(matrix: Any, pattern: Pattern | None) -> Factor:
        counted.append(matrix.shape[0])
        return factorise(matrix, pattern)

    monkeypatch.setattr("solver.axisymmetric.condensed_system.factorise", counting)
    scenes = [under(with_modulus(modulus), force=force) for modulus in MODULI for force in (1e-4, 1e-3, 2e-3)]
    found = evaluate_many(scenes, "axisymmetric", 0.05)
    assert all(isinstance(one, Result) for one in found)
    assert 0 < len(counted) <= 8  # a light mesh, its lower orders at one and at the stiffest modulus, the coarse one for loads
    stresses = np.array([one.stress_inner for one in found[:3] if isinstance(one, Result)])
    np.testing.assert_allclose(stresses / stresses[0], [1, 10, 20], rtol=1e-12)


def test_moduli_that_no_curve_takes_are_answered_alone() -> None:
    """A range so wide that no curve spans it leaves the moduli that alone can be answered."""
    extreme = [*MODULI, 1e-9, 1e25]
    found = evaluate_many([with_modulus(modulus) for modulus in extreme], "axisymmetric", 0.05)
    for one, modulus in zip(found, extreme, strict=True):
        single = alone(with_modulus(modulus), "axisymmetric", False)
        assert isinstance(one, Result) == isinstance(single, Result)
    assert all(isinstance(one, Result) for one in found[: len(MODULI)])


@pytest.mark.parametrize("evaluator", ["axisymmetric", "closed-form", "auto"])
def test_limits_are_for_each_answer(evaluator: str) -> None:
    found = evaluate_many([with_modulus(modulus) for modulus in MODULI], evaluator, limits=Limits(seconds=1e-9))
    assert all(isinstance(one, LimitReached) for one in found)


def test_what_is_wrong_for_all_is_said_at_once() -> None:
    with pytest.raises(InputError, match="accuracy"):
        evaluate_many([OURS], accuracy=2.0)
    with pytest.raises(InputError, match="evaluator"):
        evaluate_many([OURS], "closed")
    assert evaluate_many([]) == []
