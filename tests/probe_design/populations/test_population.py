"""Draws of tumours: where they lie, that they are repeated, and that those of the verification are others."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from geometry.common.errors import InputError
from geometry.scenes.scene import Scene
from geometry.scenes.scene_file import scene_to_dict
from geometry.scenes.scene_tables import Inclusion
from probe_design.populations.population import MAX_TISSUES, ScenePopulation, TumourDraw
from tests.support.designs import example_design

WIDE = {"depth": ["3 mm", "20 mm"], "diameter": ["5 mm", "15 mm"], "x": ["-30 mm", "30 mm"], "tissue": ["4 kPa", "9 kPa"]}


def drawn(samples: int, *, unseen: bool = False, **population: object) -> TumourDraw:
    design = example_design(population=population)
    return ScenePopulation.from_scene(design.scene, design.population).draw_tumours(samples, unseen=unseen)


def test_every_tumour_drawn_is_one_of_a_scene() -> None:
    draw = drawn(100, **WIDE)
    for k in range(len(draw)):
        body = Inclusion(
            depth=draw.depth[k], diameter=draw.diameter[k], x=draw.x[k], youngs_modulus=draw.youngs_modulus[k], poisson_ratio=0.45
        )
        scene = draw.tissues[draw.tissue[k]]
        Scene.model_validate(scene.model_dump(exclude_unset=True) | {"inclusion": (body.model_dump(exclude_unset=True),)})
        assert draw.depth[k] - draw.diameter[k] / 2 >= max(0.5e-3, 0.1 * draw.diameter[k])


def test_what_does_not_fit_is_drawn_again_and_said_so() -> None:
    draw = drawn(64, **WIDE)
    assert len(draw) == 64
    assert draw.misfits > 0
    assert f"{draw.misfits} of {draw.misfits + 64}" in (draw.note or "")
    assert drawn(64, depth=["15 mm", "20 mm"], diameter=["5 mm", "8 mm"]).note is None


def test_draws_fill_their_ranges_evenly() -> None:
    draw = drawn(256, depth=["10 mm", "20 mm"], object=["10 kPa", "100 kPa"], tissue=["4 kPa", "9 kPa"])
    for values, low, high in ((draw.depth, 10e-3, 20e-3), (draw.youngs_modulus, 1e4, 1e5)):
        for tissue in range(MAX_TISSUES):  # not only in all, but in each tissue
            shares = np.log(values[draw.tissue == tissue] / low) / np.log(high / low)
            assert np.histogram(shares, 4, (0, 1))[0] == pytest.approx(16, abs=1)


def test_a_draw_is_repeated_and_the_verification_s_is_another() -> None:
    once, repeated, unseen, other_seed = (
        drawn(32, **WIDE),
        drawn(32, **WIDE),
        drawn(32, unseen=True, **WIDE),
        drawn(32, seed=1, **WIDE),
    )
    assert np.array_equal(once.depth, repeated.depth)
    for draw in (unseen, other_seed):
        assert not set(once.depth.tolist()) & set(draw.depth.tolist())


def test_lists_are_equally_likely() -> None:
    draw = drawn(90, depth=["10 mm", "12 mm", "14 mm"], x={"values": ["-2 mm", "2 mm"]})
    assert {f"{depth:.3f}" for depth in draw.depth} == {"0.010", "0.012", "0.014"}
    assert set(np.round(draw.x, 6)) == {-2e-3, 2e-3}
    assert np.unique(draw.depth, return_counts=True)[1].min() >= 26


def test_one_tumour_is_a_population_of_one() -> None:
    draw = drawn(64)
    assert (len(draw), draw.depth[0], draw.diameter[0], draw.youngs_modulus[0]) == (1, 9e-3, 8e-3, 30e3)


def test_tumours_stay_clear_of_layers() -> None:
    tables = scene_to_dict(example_design().scene)
    tables["tissue"]["layer"] = [{"thickness": "2 mm", "youngs_modulus": "50 kPa", "poisson_ratio": 0.45}]
    ranges = {"depth": ["3 mm", "20 mm"], "diameter": ["3 mm", "9 mm"], "layer": [{"thickness": ["1 mm", "3 mm"]}]}
    design = example_design(scene=tables, population=ranges)
    draw = ScenePopulation.from_scene(design.scene, design.population).draw_tumours(40)
    faces = np.array([draw.tissues[k].tissue.interfaces[0] for k in draw.tissue])
    assert np.ptp(faces) > 0
    assert np.all(np.abs(draw.depth - faces) >= 0.6 * draw.diameter * (1 - 1e-12))


def test_ranges_in_which_nothing_fits_are_refused() -> None:
    with pytest.raises(InputError, match=r"population = 0 of \d+ tumours fit"):
        drawn(8, depth=["3 mm", "4 mm"], diameter=["9 mm", "15 mm"])


@pytest.mark.parametrize(
    ("ranges", "reason"),
    [
        ({"depth": ["1 mm", "2 mm"], "diameter": "8 mm"}, "not under the least cover"),
        ({"depth": "9 mm", "diameter": "8 mm", "least_cover": "20 mm"}, "not under the least cover"),
        ({"depth": ["80 mm", "90 mm"], "diameter": "8 mm"}, "side or bottom"),
        ({"depth": "20 mm", "diameter": "8 mm", "x": ["80 mm", "90 mm"]}, "side or bottom"),
    ],
)
def test_tumours_that_do_not_fit_are_refused_with_the_reason(ranges: dict[str, Any], reason: str) -> None:
    design = example_design(population={"object": "20 kPa", **ranges})
    with pytest.raises(InputError, match=reason) as refused:
        ScenePopulation.from_scene(design.scene, design.population).draw_tumours(8)
    assert "\n" not in str(refused.value)
