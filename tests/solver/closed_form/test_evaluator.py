"""The closed form of many scenes at once: bit for bit what each gives on its own, whatever comes with it."""

from __future__ import annotations

import random
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from geometry import InputError, Scene, read_scene
from geometry.common.arrays import Floats
from solver import Result
from solver.closed_form.designs import build_parameters
from solver.closed_form.evaluator import ClosedForm, ClosedFormForces, solve_columns
from tests.support.paths import SCENE
from tests.support.random_scenes import in_a_block, scenes

KINDS = {"least_cover": 0.05, "farthest": 3.0, "tumours": 3}  # some are covered by too little


def alone(scene: Scene) -> Result | str:
    try:
        return replace(ClosedForm().evaluate(scene), seconds=0.0)
    except InputError as refusal:
        return str(refusal)


def result_or_message(answer: Result | InputError) -> Result | str:
    return replace(answer, seconds=0.0) if isinstance(answer, Result) else str(answer)


@pytest.mark.slow
@settings(max_examples=15)
@given(st.lists(scenes(**KINDS), min_size=2, max_size=9), st.integers(0, 99))
def test_each_is_answered_as_on_its_own(drawn: list[Scene], seed: int) -> None:
    all_scenes = [*drawn, *map(in_a_block, drawn), *drawn[:2]]
    random.Random(seed).shuffle(all_scenes)
    assert [result_or_message(answer) for answer in ClosedForm().evaluate_many(all_scenes)] == [
        alone(scene) for scene in all_scenes
    ]


@pytest.mark.slow
@settings(max_examples=15)
@given(scenes(**KINDS), st.integers(2, 140))
def test_bits_do_not_depend_on_the_columns_beside(scene: Scene, count: int) -> None:
    """Neither on their number, nor on the place among them; also where one is singular."""
    shape, values = build_parameters(scene)
    columns = values[:, None] * (1 + 1e-3 * np.arange(count))
    together = solve_columns(shape, columns)
    for k in (0, 1, count // 2, count - 1):
        for alone, together_values in zip(solve_columns(shape, columns[:, k : k + 1]), together, strict=True):
            assert np.array_equal(alone[0], together_values[k], equal_nan=True)


def test_there_are_groups_and_refusals() -> None:
    """What is drawn above has scenes of one structure, and some that are refused."""
    drawn: list[Scene] = []

    @settings(max_examples=40)
    @given(scenes(**KINDS))
    def draw(scene: Scene) -> None:
        drawn.append(scene)

    draw()
    shapes = Counter(build_parameters(scene)[0] for scene in drawn)
    assert max(shapes.values()) > 1
    assert 0 < sum(isinstance(answer, InputError) for answer in ClosedForm().evaluate_many(drawn)) < len(drawn)


NEAR = (1e-4, 1e-5)  # of 0.5: where rounding does not matter, and two points tell how answers go on
BODIES = {"tissue": 1e-6, "inner": 1e-12, "outer": 1e-12}


def with_ratio(scene: Scene, body: str, ratio: float) -> Scene:
    if body == "tissue":
        return scene.model_copy(update={"tissue": scene.tissue.model_copy(update={"poisson_ratio": ratio})})
    block = getattr(scene.probe, body).model_copy(update={"poisson_ratio": ratio})
    return scene.model_copy(update={"probe": scene.probe.model_copy(update={body: block})})


def quantities(forces: ClosedFormForces) -> Floats:
    """The logarithms of both totals, of their ratio, and the log-sensitivity."""
    inner, outer = np.log(forces.films.forces.sum(axis=1))
    return np.array([inner, outer, inner - outer, forces.films.log_sensitivity])


@pytest.mark.parametrize("body", BODIES)
@settings(max_examples=10)
@given(scene=scenes(least_cover=0.1, farthest=3.0, tumours=3))
def test_up_to_the_largest_poisson_ratio_rounding_stays_below_the_stated_errors(body: str, scene: Scene) -> None:
    """Results go on from where rounding does not matter: to within half of the stated 95 % quantile."""
    if len(scene.inclusion) > 1:
        first = scene.inclusion[0].model_copy(update={"target": True})
        scene = scene.model_copy(update={"inclusion": (first, *scene.inclusion[1:])})
    scenes_near = [with_ratio(scene, body, 0.5 - step) for step in (*NEAR, BODIES[body])]
    farthest, nearer, last = ClosedForm().compute_films(scenes_near)
    if isinstance(farthest, InputError):
        return
    assert not isinstance(nearer, InputError)
    assert not isinstance(last, InputError)
    derivative = (quantities(farthest) - quantities(nearer)) / (NEAR[0] - NEAR[1])
    deviation = quantities(last) - quantities(nearer) - derivative * (BODIES[body] - NEAR[1])
    stated = nearer.errors
    assert np.all(np.abs(deviation) < 0.5 * np.array([*stated.log_totals, stated.log_ratio, stated.sensitivity]))


@pytest.mark.parametrize("body", BODIES)
def test_beyond_the_largest_poisson_ratio_it_refuses(body: str) -> None:
    """log_sensitivity came out as 4.8e6 there."""
    scene, key = read_scene(SCENE), {"tissue": "tissue"}.get(body, f"probe.{body}")
    assert isinstance(ClosedForm().evaluate(with_ratio(scene, body, 0.5 - BODIES[body])), Result)
    with pytest.raises(InputError, match=rf"{key}\.poisson_ratio up to 0\.49+,") as refusal:
        ClosedForm().evaluate(with_ratio(scene, body, 0.5 - BODIES[body] / 2))
    largest = float(str(refusal.value).split("up to ")[1].split(",")[0])
    assert isinstance(ClosedForm().evaluate(with_ratio(scene, body, largest)), Result)
    plain = scene.model_copy(update={"inclusion": ()})
    assert isinstance(ClosedForm().evaluate(with_ratio(plain, "tissue", 0.4999999999)), Result)
