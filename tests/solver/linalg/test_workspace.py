"""What evaluators keep: by key, within a limit, oldest out first, nothing twice counted, an evaluation's own spared."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp

from geometry import InputError, read_scene
from solver import evaluate, evaluator
from solver.axisymmetric.evaluator import Axisymmetric
from solver.equivalent_inclusion.evaluator import EquivalentInclusion
from solver.linalg import workspace
from solver.linalg.cholesky import Pattern, factorise
from solver.linalg.workspace import Workspace, get_process_workspace, get_workspace, keep_result, measure_bytes, use_workspace
from tests.support.paths import REFERENCE
from tests.support.random_scenes import scaled

SHALLOW = REFERENCE / "axisymmetric" / "shallow.toml"
SCENE = REFERENCE / "off-axis" / "pair-off-axis.toml"


@dataclass
class Thing:
    """Something with an array."""

    array: Any
    foreign_bytes: int = 0


def thousand() -> Thing:
    return Thing(np.zeros(125))


def test_a_key_is_made_once() -> None:
    held, made = Workspace(), []
    for _ in range(2):
        assert held.keep("key", lambda: made.append(1) or "value") == "value"
    assert made == [1]


def test_the_oldest_go_first() -> None:
    held = Workspace(limit=2700)
    first, second = held.keep(1, thousand), held.keep(2, thousand)
    assert held.keep(1, thousand) is first
    held.begin()
    held.keep(3, thousand)
    assert held.bytes_held == 2000
    assert held.keep(1, thousand) is first
    assert held.keep(2, thousand) is not second


def test_what_an_evaluation_uses_stays_until_the_next() -> None:
    held = Workspace(limit=2700)
    for key in range(5):
        held.keep(key, thousand)
    assert held.bytes_held == 5000
    held.begin()
    held.make_room()
    assert held.bytes_held == 2000
    held.make_room(wanted=2000)
    assert held.bytes_held == 0


def test_what_grows_is_measured_anew() -> None:
    held = Workspace(limit=2500)
    thing = held.keep(1, thousand)
    thing.array = np.zeros(1000)
    assert held.bytes_held == 8000
    held.begin()
    held.keep(2, thousand)
    held.make_room()
    assert held.bytes_held == 1000


def test_values_are_seldom_measured_again(monkeypatch: pytest.MonkeyPatch) -> None:
    held, measured = Workspace(limit=4e5), []
    measure = Workspace._measure
    monkeypatch.setattr(Workspace, "_measure", lambda self: measured.append(self._evaluation) or measure(self))
    for key in range(2000):  # of 1000 bytes each: the limit holds 400 of them
        held.begin()
        held.keep(key, thousand)
        held.make_room(wanted=1000)
    assert 0 < len(measured) <= 100
    assert 1e5 < held.bytes_held <= 4e5


def test_clear() -> None:
    held = Workspace()
    held.keep(1, thousand)
    held.clear()
    assert held.bytes_held == 0


def test_shared_arrays_and_views_count_once() -> None:
    array = np.zeros((10, 10))
    assert measure_bytes([array, array[2:], array.T.reshape(-1)[:3], {"a": (array,)}]) == 800 + 800  # the reshaped is a copy
    held = Workspace()
    for key in range(3):
        held.keep(key, lambda: Thing(array))
    assert held.bytes_held == 800


def test_sparse_matrices_and_what_libraries_hold_count() -> None:
    matrix = sp.csc_array(sp.diags_array([-np.ones(99), 3 * np.ones(100), -np.ones(99)], offsets=[-1, 0, 1]))
    assert measure_bytes(matrix) == matrix.data.nbytes + matrix.indices.nbytes + matrix.indptr.nbytes
    assert measure_bytes(Thing(np.zeros(1), 1000)) == 1008
    assert measure_bytes(factorise(matrix, Pattern())) > 8 * 199


def test_functions_keep_where_one_works() -> None:
    calls = []

    @keep_result
    def double(x: int) -> int:
        calls.append(x)
        return 2 * x

    with use_workspace(Workspace()) as mine:
        assert (double(1), double(1), double(2)) == (2, 2, 4)
        assert get_workspace() is mine
    with use_workspace(Workspace()):
        double(1)
    assert calls == [1, 2, 1]
    assert get_workspace() is get_process_workspace()


@pytest.mark.parametrize(("given", "limit"), [(None, 1e9), ("0.25", 2.5e8), ("0", 0.0)])
def test_the_limit_comes_from_the_environment(given: str | None, limit: float, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(workspace.LIMIT_VARIABLE, raising=False)
    if given is not None:
        monkeypatch.setenv(workspace.LIMIT_VARIABLE, given)
    assert get_process_workspace.__wrapped__().limit == limit


@pytest.mark.parametrize("given", ["", "much", "-1", "nan", "inf", "1 GB"])
def test_a_limit_that_is_none_is_refused(given: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(workspace.LIMIT_VARIABLE, given)
    with pytest.raises(InputError, match=f"{workspace.LIMIT_VARIABLE} = .*: allowed: a number of GB"):
        get_process_workspace.__wrapped__()


@pytest.mark.slow
def test_answers_do_not_depend_on_what_is_kept() -> None:
    scene = read_scene(SCENE)
    with use_workspace(Workspace(limit=0)) as nothing:
        poor = evaluate(scene, "equivalent-inclusion", 0.01).as_dict()
        nothing.begin()
        nothing.make_room()
        assert nothing.bytes_held == 0
    with use_workspace(Workspace()) as ample:
        rich = [evaluate(scene, "equivalent-inclusion", 0.01).as_dict() for _ in range(2)]
        assert 1e7 < ample.bytes_held < 1e9
    for answer in (poor, *rich):
        del answer["seconds"]
    assert poor == rich[0] == rich[1]


@pytest.mark.parametrize("evaluator", [Axisymmetric, EquivalentInclusion])
def test_evaluators_with_workspaces_of_their_own_do_not_share(evaluator: type[Axisymmetric | EquivalentInclusion]) -> None:
    unused = Workspace()
    first, second = (evaluator(workspace=Workspace()) for _ in range(2))
    with use_workspace(unused):
        first.evaluate(read_scene(SHALLOW), 0.05)
    assert unused.bytes_held == second.workspace.bytes_held == 0 < first.workspace.bytes_held
    second.evaluate(read_scene(SHALLOW), 0.05)
    assert second.workspace.bytes_held == first.workspace.bytes_held
    first_ids, second_ids = ({id(entry.value) for entry in held.workspace._entries.values()} for held in (first, second))
    assert not first_ids & second_ids


def test_an_evaluator_takes_the_workspace_that_it_is_given_or_made_in() -> None:
    mine = Workspace()
    assert evaluator("axisymmetric", workspace=mine) == evaluator("axisymmetric")
    assert Axisymmetric().workspace is get_process_workspace()
    with use_workspace(mine):
        assert Axisymmetric().workspace is mine


def test_a_limit_is_held_from_scene_to_scene() -> None:
    evaluator = EquivalentInclusion(workspace=Workspace(limit=3e7))
    max_bytes = 0
    for times in (1.0, 1.2, 1.4):
        evaluator.evaluate(scaled(read_scene(SHALLOW), lengths=times, moduli=times**2), 0.05)
        max_bytes = max(max_bytes, evaluator.workspace.bytes_held)
        evaluator.workspace.begin()
        evaluator.workspace.make_room()
        assert 0 < evaluator.workspace.bytes_held <= 3e7
    assert max_bytes > 3e7  # something had to go
