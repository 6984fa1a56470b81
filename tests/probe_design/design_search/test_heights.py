"""Blocks of heights of their own: a seventh variable, in file, search, scene and report alike."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from geometry.common.errors import InputError
from geometry.scenes.scene import Scene
from geometry.scenes.units import SI_CONTEXT
from geometry.scenes.variables import list_values
from probe_design.built_probe.block_predictions import express_by_outer_radius
from probe_design.data.builtin import read_typical_scenes
from probe_design.design_search.choices import search_combinations
from probe_design.design_search.population_objective import PopulationObjective
from probe_design.design_search.robustness import draw_built_probes
from probe_design.design_search.search_space import build_search_space
from probe_design.design_search.variables import SEPARATE_HEIGHT_NAMES, ProbeSizes, read_vector
from probe_design.tolerancing.uncertain_numbers import list_uncertain_numbers
from solver.closed_form.designs import PROBE_PARAMETERS, build_parameters
from tests.support.searches import design

SCENE = read_typical_scenes()["on-axis"]
FEW = {
    "population": {"depth": [5e-3, 15e-3], "samples": 4},
    "protocol": {"positions": [-8e-3, 8e-3, 2]},
    "limits": {"force": 5e-3},
}
OUTER_HEIGHT_INDEX = SEPARATE_HEIGHT_NAMES.index("outer_height")
POISSON = SCENE.probe.inner.poisson_ratio, SCENE.probe.outer.poisson_ratio


def set_heights(inner: float, outer: float) -> Scene:
    probe = SCENE.probe.model_dump(exclude={"height"}, exclude_unset=True) | {"inner_height": inner, "outer_height": outer}
    return Scene.model_validate(SCENE.model_dump(exclude_unset=True) | {"probe": probe}, context=SI_CONTEXT)


def stepped() -> Scene:
    return set_heights(3e-3, 4.5e-3)


def build_objective(**tables: Any) -> PopulationObjective:
    return PopulationObjective.from_design(design(**{**FEW, **tables}), 8e-3)


def test_a_key_of_either_height_frees_both() -> None:
    search_space = build_search_space(design(variables={"inner_height": [2e-3, 4e-3]}, limits={"height": 6e-3}))
    assert search_space.names[3] == "inner_height"
    assert search_space.names[OUTER_HEIGHT_INDEX] == "outer_height"
    assert (search_space.low[3], search_space.high[3], search_space.high[OUTER_HEIGHT_INDEX]) == (
        2e-3,
        4e-3,
        6e-3,
    )
    held = build_search_space(design(variables={"inner_height": "fixed", "outer_height": {"choices": [2e-3, 5e-3]}}))
    assert held.low[3] == held.high[3] == SCENE.probe.core_height
    assert held.grids == {"outer_height": (2e-3, 5e-3)}
    assert "outer_height 5 mm" in [*held.iterate_combinations()][1].description


def test_what_a_start_of_two_heights_leaves_out_stays_of_two() -> None:
    assert len(build_search_space(design(scene=stepped())).low) == 7
    assert len(build_search_space(design(scene=stepped(), variables={"height": [2e-3, 5e-3]})).low) == 6
    assert len(build_search_space(design()).low) == 6


@pytest.mark.parametrize(
    ("tables", "named"),
    [
        ({"variables": {"height": "fixed", "inner_height": ["1 mm", "2 mm"]}}, "variables.height"),
        ({"variables": {"outer_height": ["2 mm", "1 mm"]}}, "variables.outer_height"),
        ({"variables": {"outer_height": {"choices": ["8 mm"]}}, "limits": {"height": "6 mm"}}, "limits.height"),
        (
            {"variables": {"height": {"bounds": ["2 mm", "9 mm"], "step": "3 mm"}}, "limits": {"height": "2.5 mm"}},
            "limits.height",
        ),
        ({"scene": stepped(), "variables": {"height": "fixed"}}, "inner_height and outer_height"),
    ],
)
def test_careless_heights_are_refused(tables: dict[str, Any], named: str) -> None:
    with pytest.raises(InputError, match=named):
        build_search_space(design(units_required=True, **tables))


def test_the_formulas_are_asked_for_the_probe_that_the_scene_has() -> None:
    probes = ProbeSizes.from_scene(stepped()).build_parameters(POISSON)
    np.testing.assert_allclose(
        probes, build_parameters(stepped().model_copy(update={"inclusion": ()}))[1][: len(PROBE_PARAMETERS)], rtol=1e-12
    )


def test_equal_heights_are_worth_what_one_height_is_and_slopes_are_exact() -> None:
    objective, six = build_objective(), read_vector(SCENE)
    seven = np.append(six, six[3])
    assert objective.evaluate_designs(seven[:, None], POISSON)[0] == pytest.approx(
        objective.evaluate_designs(six[:, None], POISSON)[0], rel=1e-12
    )
    derivatives = objective.gradient(seven, POISSON, [3, OUTER_HEIGHT_INDEX])[1][0]
    assert derivatives.sum() == pytest.approx(objective.gradient(six, POISSON, [3])[1][0, 0], rel=1e-9)
    step = 1e-3 * (np.arange(7) == OUTER_HEIGHT_INDEX)[:, None] * np.array([1, -1])
    upper, lower = objective.evaluate_designs(seven[:, None] * np.exp(step), POISSON)
    assert derivatives[1] == pytest.approx((upper - lower) / 2e-3, rel=1e-3)


def test_the_best_of_all_pairs_of_heights_is_brute_forces() -> None:
    held = dict.fromkeys(("inner_radius", "area_ratio", "gap", "inner_modulus", "outer_modulus"), "fixed")
    inner, outer = [2e-3, 3e-3, 5e-3], [1.5e-3, 3e-3, 6e-3]
    made = design(**FEW, variables=held | {"inner_height": {"choices": inner}, "outer_height": {"choices": outer}})
    objective, search_space = PopulationObjective.from_design(made, 8e-3), build_search_space(made)
    best = search_combinations(objective, search_space, lambda done, total: None).choices[0]
    designs = [
        read_vector(set_heights(inner_height, outer_height), SEPARATE_HEIGHT_NAMES)
        for inner_height in inner
        for outer_height in outer
    ]
    worth = objective.evaluate_designs(np.array(designs).T, POISSON)
    np.testing.assert_allclose(best.design, designs[int(worth.argmax())], rtol=1e-9)
    scene = search_space.build_scene(best.design, best.combination)
    assert scene is not None
    assert (scene.probe.core_height, scene.probe.tube_height) == (best.design[3], best.design[OUTER_HEIGHT_INDEX])
    assert search_space.admits_scene(scene)


def test_a_search_of_two_heights_ends_no_lower_than_one_of_one() -> None:
    held = dict.fromkeys(("inner_radius", "area_ratio", "gap", "inner_modulus", "outer_modulus"), "fixed")
    worth = []
    for heights in ({"height": [2e-3, 6e-3]}, {"inner_height": [2e-3, 6e-3], "outer_height": [2e-3, 6e-3]}):
        made = design(**FEW, variables=held | heights)
        worth.append(
            search_combinations(PopulationObjective.from_design(made, 8e-3), build_search_space(made), lambda done, total: None)
            .choices[0]
            .value
        )
    assert worth[1] >= worth[0] - 1e-6


def test_rounded_and_exact_scenes_have_both_heights() -> None:
    search_space = build_search_space(design(variables={"outer_height": [2e-3, 6e-3]}))
    x, combination = np.array([3e-3, 0.7, 2e-4, 3.0001e-3, 5e5, 5e4, 4.4444e-3]), next(search_space.iterate_combinations())
    exact, made = search_space.build_exact_scene(x, combination), search_space.build_scene(x, combination)
    assert exact is not None
    assert made is not None
    assert list_values(exact)["probe.outer_height"] == 4.4444e-3
    assert (made.probe.core_height, made.probe.tube_height) == (3e-3, 4.44e-3)
    lying = {combination.name for combination in search_space.list_limits(exact.model_copy(deep=True)) if combination.active}
    assert not lying & {"least outer_height", "largest outer_height"}


def test_a_workshop_errs_in_both_heights() -> None:
    drawn = express_by_outer_radius(stepped())
    variables = list_uncertain_numbers(drawn)
    built, _, _ = draw_built_probes(drawn, variables, np.random.default_rng(3).standard_normal((len(variables), 64)))
    assert len(built) == 7
    deviations = {item.name: item.sd for item in variables}
    for row, height, name in ((3, 3e-3, "inner"), (OUTER_HEIGHT_INDEX, 4.5e-3, "outer")):
        assert built[row].mean() == pytest.approx(height, rel=0.01)
        assert built[row].std() == pytest.approx(deviations[f"probe.{name}_height"], rel=0.25)
    assert abs(np.corrcoef(built[3], built[OUTER_HEIGHT_INDEX])[0, 1]) < 0.3
