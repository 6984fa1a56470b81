"""The closed form of many scenes at once: bit for bit what each gives on its own, whatever comes with it."""

from __future__ import annotations

import random
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from geometry import InputError, Scene
from solver import Result
from solver.closed_form.designs import forces, parameters
from solver.closed_form.level import ClosedForm, _variants
from tests.support.random_scenes import in_a_block, scenes

KINDS = {"least_cover": 0.05, "farthest": 3.0, "tumours": 3}  # some are covered by too little


def alone(scene: Scene) -> Result | str:
    try:
        return replace(ClosedForm().evaluate(scene), seconds=0.0)
    except InputError as refusal:
        return str(refusal)


def told(found: Result | InputError) -> Result | str:
    return replace(found, seconds=0.0) if isinstance(found, Result) else str(found)


@settings(max_examples=15)
@given(st.lists(scenes(**KINDS), min_size=2, max_size=9), st.integers(0, 99))
def test_each_is_answered_as_on_its_own(drawn: list[Scene], seed: int) -> None:
    every = [*drawn, *map(in_a_block, drawn), *drawn[:2]]
    random.Random(seed).shuffle(every)
    assert [told(one) for one in ClosedForm().evaluate_many(every)] == [alone(scene) for scene in every]


@pytest.mark.slow
@settings(max_examples=15)
@given(scenes(**KINDS), st.integers(2, 140))
def test_bits_do_not_depend_on_the_columns_beside(scene: Scene, count: int) -> None:
    """Neither on their number, nor on the place among them; also where one is singular."""
    shape, values = parameters(scene)
    columns = [_variants(values * (1 + 1e-3 * k)) for k in range(count)]
    with np.errstate(all="ignore"):
        together = forces(shape, np.concatenate(columns, axis=1))
        for k in (0, 1, count // 2, count - 1):
            for one, every in zip(forces(shape, columns[k]), together, strict=True):
                assert np.array_equal(one, every[4 * k : 4 * k + 4], equal_nan=True)


def test_there_are_groups_and_refusals() -> None:
    """What is drawn above has scenes of one structure, and some that are refused."""
    drawn: list[Scene] = []

    @settings(max_examples=40)
    @given(scenes(**KINDS))
    def draw(scene: Scene) -> None:
        drawn.append(scene)

    draw()
    shapes = Counter(parameters(scene)[0] for scene in drawn)
    assert max(shapes.values()) > 1
    assert 0 < sum(isinstance(one, InputError) for one in ClosedForm().evaluate_many(drawn)) < len(drawn)
