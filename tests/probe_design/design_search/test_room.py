"""What a design file lets vary: bounds, steps, choices, materials; every refusal names key and remedy in one line."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
import pytest

from geometry.common.errors import InputError
from geometry.scenes.catalogue import find_material
from geometry.scenes.scene import Scene
from geometry.scenes.scene_tables import BlockTissue
from probe_design.data.builtin import read_typical_scenes
from probe_design.design_search.search_space import build_search_space
from probe_design.design_search.variables import read_vector
from probe_design.populations.design_file import design_from_dict, read_design
from tests.support.paths import EXAMPLES
from tests.support.searches import design


def test_what_is_left_out_varies_round_the_start() -> None:
    search_space = build_search_space(design())
    assert search_space.combinations == 1
    assert search_space.free == list(range(6))
    assert np.all(search_space.low <= read_vector(read_typical_scenes()["on-axis"]))


def test_fixed_is_the_start_and_choices_and_steps_are_grids() -> None:
    search_space = build_search_space(
        design(
            variables={
                "inner_radius": "fixed",
                "gap": {"choices": [3e-4, 1e-4]},
                "height": {"bounds": [1.95e-3, 2.6e-3], "step": 2e-4},
            }
        )
    )
    assert search_space.low[0] == search_space.high[0] == 4e-3
    assert search_space.grids["gap"] == (1e-4, 3e-4)
    assert search_space.grids["height"] == pytest.approx((2e-3, 2.2e-3, 2.4e-3, 2.6e-3), rel=1e-12)
    assert search_space.combinations == 8
    assert search_space.pin(next(search_space.iterate_combinations()).pinned).free == [1, 4, 5]


def test_materials_pick_modulus_and_poissons_ratio_together() -> None:
    names = ("dragon-skin-30", "ecoflex-00-10")
    search_space = build_search_space(design(variables={"materials": list(names)}))
    assert search_space.combinations == 4
    start = read_vector(read_typical_scenes()["on-axis"])
    for combination in search_space.iterate_combinations():
        made = search_space.build_scene(
            np.array([*start[:4], *(find_material(name).youngs_modulus for name in combination.materials)]), combination
        )
        assert made is not None
        for name, block in zip(combination.materials, (made.probe.inner, made.probe.outer), strict=True):
            cast = find_material(name)
            assert (block.youngs_modulus, block.poisson_ratio) == (cast.youngs_modulus, cast.poisson_ratio)
            assert block.material == name


def test_a_modulus_that_is_searched_takes_the_starts_material_away() -> None:
    start = read_typical_scenes()["on-axis"].model_dump(exclude_unset=True)
    start["probe"]["outer"] = {"material": "ecoflex-00-50"}
    search_space = build_search_space(design_from_dict({"scene": Scene.model_validate(start)}))
    start_values = read_vector(search_space.scene)
    combination = next(search_space.iterate_combinations())
    unchanged, stiffer = (
        search_space.build_scene(start_values * np.array([1, 1, 1, 1, 1, factor]), combination) for factor in (1.0, 1.2)
    )
    assert unchanged is not None
    assert stiffer is not None
    assert (unchanged.probe.outer.material, stiffer.probe.outer.material) == ("ecoflex-00-50", None)


def test_the_example_of_a_shelf_offers_nine_pairs() -> None:
    search_space = build_search_space(read_design(EXAMPLES / "shelf.toml"))
    assert search_space.combinations == 9
    assert {combination.materials for combination in search_space.iterate_combinations()} == set(
        product(("ecoflex-00-30", "dragon-skin-10", "dragon-skin-30"), repeat=2)
    )
    assert search_space.outer_radius == 8e-3


@pytest.mark.parametrize(("length", "breadth"), [(0.012, 0.1), (0.1, 0.012)])
def test_a_probe_is_narrower_than_the_shorter_side_of_its_tissue(length: float, breadth: float) -> None:
    scene = read_typical_scenes()["on-axis"]
    block = {"shape": "block", "length": length, "breadth": breadth, "depth": 0.05, "youngs_modulus": 3e3, "poisson_ratio": 0.45}
    tables = {"scene": scene.model_copy(update={"tissue": BlockTissue.model_validate(block)}), "limits": {"outer_radius": 20e-3}}
    assert build_search_space(design(**tables)).outer_radius == pytest.approx(0.95 * 6e-3, rel=1e-12)


def test_what_a_workshop_gets_keeps_grids_and_limits() -> None:
    search_space = build_search_space(design(variables={"inner_radius": {"choices": [3.137e-3]}}, limits={"outer_radius": 5e-3}))
    combination = next(search_space.iterate_combinations())
    made = search_space.build_scene(np.array([3.137e-3, 0.7, 1.234e-4, 3e-3, 5e5, 5e4]), combination)
    assert made is not None
    assert made.probe.inner_radius == 3.137e-3
    assert made.probe.tube_radius <= 5e-3
    assert search_space.admits_scene(made)


CARELESS = [
    ({"variables": {"gap": {"choices": ["0.1 kPa"]}}}, "variables.gap"),
    ({"variables": {"gap": {"choices": []}}}, "variables.gap"),
    ({"variables": {"gap": ["-1 mm", "1 mm"]}}, "variables.gap"),
    ({"variables": {"gap": {"bounds": ["0.1 mm", "0.5 mm"], "step": "1 nm"}}}, "variables.gap.step"),
    ({"variables": {"inner_modulus": ["1 mm", "2 mm"]}}, "variables.inner_modulus"),
    ({"variables": {"area_ratio": ["1 mm", "2 mm"]}}, "variables.area_ratio"),
    ({"variables": {"materials": ["dragonskin-30"]}}, "did you mean 'dragon-skin-30'"),
    ({"variables": {"materials": ["dragon-skin-30"], "inner_modulus": "fixed"}}, "variables.inner_modulus"),
    ({"variables": {"materials": ["pvdf-28"]}}, "variables.materials[0]"),
    ({"variables": {"hight": ["1 mm", "2 mm"]}}, "did you mean 'height'"),
    ({"limits": {"outer_radius": "1 mm"}, "variables": {"inner_radius": "fixed"}}, "limits.outer_radius"),
    ({"limits": {"outer_radius": "-8 mm"}}, "limits.outer_radius"),
    ({"limits": {"height": "1 um"}, "variables": {"height": "fixed"}}, "limits.height"),
    ({"limits": {"force": "8 mm"}}, "limits.force"),
    ({"limits": {"wall": "9 mm"}}, "as it is left out"),
    ({"limits": {"force": "0 N"}}, "limits.force"),
    ({"limits": {"gap_closure": 3}}, "limits.gap_closure"),
    ({"limits": {"tissue_strain": -0.1}}, "limits.tissue_strain"),
    ({"limits": {"charge": ["3 pC", "1 pC"]}}, "limits.charge"),
]


@pytest.mark.parametrize(("tables", "named"), CARELESS)
def test_careless_files_are_refused_in_one_line(tables: dict[str, Any], named: str) -> None:
    with pytest.raises(InputError) as refused:
        build_search_space(design(units_required=True, **tables))
    assert named in str(refused.value)
    assert "\n" not in str(refused.value)
    assert refused.value.exit_code == 2
