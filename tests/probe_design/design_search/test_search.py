"""The search in closed form: exact gradients, all of few combinations tried, the same each time, limits that only take."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
import pytest

from geometry.common.errors import Refusal
from geometry.scenes.catalogue import find_material
from geometry.scenes.scene_tables import Load
from probe_design.data.builtin import read_typical_scenes
from probe_design.design_search.choices import search_combinations
from probe_design.design_search.population_objective import PopulationObjective
from probe_design.design_search.search_space import SearchSpace, build_search_space
from probe_design.design_search.variables import ProbeSizes, read_vector
from probe_design.populations.design_file import Design
from solver.planning.load_limits import build_load_rule
from tests.support.searches import design

POPULATION = {"depth": [5e-3, 15e-3], "diameter": [5e-3, 12e-3], "object": [2e4, 1e5], "tissue": [4e3, 8e3], "samples": 8}
PROTOCOL = {"positions": [-8e-3, 0.0, 8e-3, 4e-3], "stiffness": True}


def make_design(**tables: Any) -> Design:
    return design(**{"population": POPULATION, "protocol": PROTOCOL, **tables})


def ready(made: Design) -> tuple[PopulationObjective, SearchSpace]:
    search_space = build_search_space(made)
    return PopulationObjective.from_design(made, max(search_space.outer_radius, 7.6e-3)), search_space


def ignore_progress(done: int, total: int) -> None:
    assert 0 <= done <= total


@pytest.mark.parametrize("maximise", ["detection", "resolved", "information", "place_error"])
@pytest.mark.parametrize("blank", [True, False])
def test_gradients_are_exact_at_taylors_rate(maximise: str, blank: bool) -> None:
    noise = {"white": 0.002, "stiffness_white": 0.002, "charge": 1e-15}  # so small that some are resolved
    spread = {"x": [-4e-3, 4e-3]} if maximise == "place_error" else {}
    protocol = PROTOCOL | {"blank": blank} | ({"positions": [-6e-3, 7e-3], "raster": True} if spread else {})
    made = make_design(
        objective={"maximise": maximise}, protocol=protocol, limits={"force": 5e-4}, noise=noise, population=POPULATION | spread
    )
    objective, search_space = ready(made)
    start = read_vector(made.scene)
    direction = np.array([0.8, 0.6, 0.2, -0.4, 0.3, 0.5])

    def moved(step: complex) -> Any:
        probes = ProbeSizes.from_vector((start * np.exp(step * direction))[:, None]).build_parameters(search_space.start_poisson)
        return objective.compute_tumour_values(probes, lambda totals: np.full(totals.shape[:2], 5e-4))[0]

    derivative = moved(1e-30j).imag / 1e-30  # of each tumour: of their mean a remainder may pass through zero
    left = [np.linalg.norm(moved(step) - moved(0.0) - step * derivative) for step in (0.08, 0.04, 0.02)]
    assert np.log2(left[0] / left[1]) == pytest.approx(2, abs=0.35)
    assert np.log2(left[1] / left[2]) == pytest.approx(2, abs=0.2)
    derivatives = objective.gradient(start, search_space.start_poisson, list(range(6)))[1][0]
    expected = -derivative.mean() / moved(0.0).mean() if spread else derivative.mean()  # of a place error minus its logarithm
    assert derivatives @ direction == pytest.approx(expected, rel=1e-9)


def test_all_of_few_combinations_are_tried_and_the_best_is_brute_forces() -> None:
    grids = {
        "inner_radius": [2e-3, 3e-3, 4e-3], "area_ratio": [0.5, 1.5], "gap": [1e-4, 3e-4], "height": [2e-3, 5e-3],
        "inner_modulus": [1e5, 1e6], "outer_modulus": [1e5],
    }  # fmt: skip
    made = make_design(
        variables={key: {"choices": values} for key, values in grids.items()}, limits={"outer_radius": 6e-3, "force": 5e-3}
    )
    objective, search_space = ready(made)
    chosen = search_combinations(objective, search_space, ignore_progress)
    assert chosen.exhaustive
    assert "all 48 combinations" in chosen.how
    designs = np.array(list(product(*grids.values()))).T
    values = objective.evaluate_designs(designs, search_space.start_poisson)
    values[ProbeSizes.from_vector(designs).outer_radius > 6e-3] = -np.inf
    values[ProbeSizes.from_vector(designs).wall < search_space.wall] = -np.inf
    assert chosen.choices[0].value == pytest.approx(values.max(), rel=1e-9)
    np.testing.assert_allclose(chosen.choices[0].design, designs[:, values.argmax()], rtol=1e-9)


SHELF = ["ecoflex-00-30", "dragon-skin-10", "dragon-skin-30"]


def cast_of(inner: str, outer: str) -> dict[str, Any]:
    """The usual scene with blocks of two materials, written into it as numbers."""
    scene = read_typical_scenes()["on-axis"]
    blocks = zip(("inner", "outer"), (find_material(inner), find_material(outer)), strict=True)
    numbers = [(f"probe.{block}.", material) for block, material in blocks]
    moduli = {f"{key}youngs_modulus": material.youngs_modulus for key, material in numbers}
    return {"scene": scene.replace(moduli | {f"{key}poisson_ratio": material.poisson_ratio for key, material in numbers})}


@pytest.mark.slow
@pytest.mark.parametrize("maximise", ["detection", "information"])
def test_three_materials_are_answered_with_the_best_of_all_pairs(maximise: str) -> None:
    """Each pair by a search of its own, in which moduli and Poisson's ratios stand in the scene and no shelf is named."""
    free = {"inner_radius": [1.5e-3, 4e-3], "area_ratio": [0.3, 3.0], "gap": "fixed", "height": "fixed"}
    tables = {"limits": {"outer_radius": 6e-3, "force": 5e-3}, "objective": {"maximise": maximise}, "noise": {"charge": 1e-15}}
    tables |= {"population": {**POPULATION, "samples": 4}, "protocol": {**PROTOCOL, "positions": [-4e-3, 4e-3]}}
    chosen = search_combinations(*ready(make_design(variables=free | {"materials": SHELF}, **tables)), ignore_progress)
    assert chosen.exhaustive
    held = free | {"inner_modulus": "fixed", "outer_modulus": "fixed"}
    pairs = list(product(SHELF, SHELF))
    alone = [
        search_combinations(*ready(make_design(variables=held, **tables, **cast_of(*pair))), ignore_progress).choices[0].value
        for pair in pairs
    ]
    best = chosen.choices[0]
    assert best.combination.materials == pairs[int(np.argmax(alone))]
    assert best.value == pytest.approx(max(alone), rel=1e-5)
    assert max(alone) > (1 + 5e-5) * sorted(alone)[-2]  # or either of two might be the best
    assert {name.split("materials ")[1] for name in chosen.best} == {" / ".join(pair) for pair in pairs}


@pytest.mark.slow
def test_many_combinations_are_branched_and_it_is_said() -> None:
    made = make_design(
        variables={"inner_radius": {"step": 1e-4}, "gap": {"step": 5e-5}, "height": "fixed"}, limits={"force": 5e-3}
    )
    objective, search_space = ready(made)
    chosen = search_combinations(objective, search_space, ignore_progress)
    assert not chosen.exhaustive
    assert "not all tried" in chosen.how
    best = chosen.choices[0]
    for name, values in search_space.grids.items():
        assert best.design[search_space.names.index(name)] in values
    relaxed = make_design(variables={"height": "fixed"}, limits={"force": 5e-3})
    free = search_combinations(*ready(relaxed), ignore_progress).choices[0].value
    assert best.value <= free + 1e-6
    assert best.value > free - 0.02


@pytest.mark.slow
def test_the_same_question_has_the_same_answer_and_a_tighter_limit_no_better_one() -> None:
    choices = []
    for limit in (7e-3, 7e-3, 6e-3, 5e-3):
        choice = search_combinations(*ready(make_design(limits={"outer_radius": limit, "force": 5e-3})), ignore_progress).choices[
            0
        ]
        choices.append((choice.value, choice.design.tolist()))
    assert choices[0] == choices[1]
    assert choices[0][0] >= choices[2][0] - 1e-7  # searches of other ranges end 5e-8 apart where the limit does not bind
    assert choices[2][0] >= choices[3][0] - 1e-7


def test_a_force_is_the_smallest_allowed_and_the_verification_uses_it() -> None:
    made = make_design(limits={"force": 5e-3, "indentation": 1e-4, "charge": [0.0, 1e-12]})
    objective, _ = ready(made)
    pressed = objective.rule.compute_pressed_design(made.scene)
    assert 0.99 * min(pressed.allowed.values()) <= pressed.force <= min(pressed.allowed.values())
    assert pressed.allowed[pressed.limited_by] == min(pressed.allowed.values())
    assert pressed.indentation <= 1e-4
    for tissue in objective.draw.replace_probe(made.scene.model_copy(update={"load": Load(force=pressed.force)})).tissues:
        rule = build_load_rule(tissue)
        assert rule.is_known(pressed.force)
        assert rule.bound_ratio_change(pressed.force) <= 0.01


def test_a_tighter_limit_of_force_strain_or_charge_takes_from_every_design() -> None:
    designs = read_vector(make_design().scene)[:, None] * np.linspace(0.8, 1.2, 5)
    wide, minima = make_design(limits={"force": 5e-3, "gap_closure": False}), []
    for limits in ({"force": 5e-3}, {"force": 2e-3}, {"indentation": 2e-5}, {"tissue_strain": 2e-3}, {"charge": [0.0, 3e-14]}):
        objective, search_space = ready(make_design(limits={"force": 5e-3, **limits}))
        minima.append(objective.evaluate_designs(designs, search_space.start_poisson))
    objective, search_space = ready(wide)
    assert np.all(np.array(minima) <= objective.evaluate_designs(designs, search_space.start_poisson) + 1e-12)
    assert np.all(minima[1] < minima[0])


def test_the_force_is_a_variable_of_which_each_design_has_the_largest_value_allowed() -> None:
    """Bounds, steps, choices and 'fixed'; a design without an allowed value is none."""
    limits = {"indentation": 1e-4, "gap_closure": False}
    start = make_design().scene
    vector, poisson = read_vector(start)[:, None], (start.probe.inner.poisson_ratio, start.probe.outer.poisson_ratio)
    free, _ = ready(make_design(limits={**limits, "force": 1.0}))
    allowed = min(free.rule.compute_pressed_design(start).allowed.values())
    entries: list[tuple[Any, float]] = [
        ({"choices": [0.3 * allowed, 0.6 * allowed, 2 * allowed]}, 0.6 * allowed),
        ({"step": 0.4 * allowed}, 0.8 * allowed),
        ([0.1 * allowed, 0.5 * allowed], 0.5 * allowed),
        ([0.1 * allowed, 3 * allowed], allowed),
    ]
    for entry, force in entries:
        pressed_start = start.replace({"load.force": 1.0})
        objective, _ = ready(make_design(limits=limits, variables={"force": entry}, scene=pressed_start))
        pressed = objective.rule.compute_pressed_design(start)
        assert pressed.force == pytest.approx(force, rel=0.01)
        assert pressed.force <= allowed
        held, _ = ready(make_design(limits={**limits, "force": pressed.force}))
        assert objective.evaluate_designs(vector, poisson) == pytest.approx(held.evaluate_designs(vector, poisson), rel=0.01)
    fixed, _ = ready(make_design(limits=limits, variables={"force": "fixed"}, scene=start.replace({"load.force": allowed / 2})))
    assert fixed.rule.compute_pressed_design(start).force == allowed / 2
    too_large, _ = ready(make_design(limits=limits, variables={"force": [2 * allowed, 3 * allowed]}))
    assert too_large.evaluate_designs(vector, poisson)[0] == -np.inf
    with pytest.raises(Refusal, match=r"variables\.force"):
        too_large.rule.compute_pressed_design(start)
