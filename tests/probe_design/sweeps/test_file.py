"""Sweep files: what is asked, how designs are drawn, what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from geometry import InputError, Scene, read_scene
from probe_design.sweeps.constraints import evaluate_condition
from probe_design.sweeps.designs import DesignSampling
from probe_design.sweeps.file import build_scene, read_sweep, sweep_from_dict
from probe_design.sweeps.summary_page import compute_sobol_indices
from tests.support.paths import SCENE
from tests.support.sweeps import DEPTH, GAP, grid, toml


class TestFile:
    def test_a_grid_has_every_combination_the_last_changing_fastest(self) -> None:
        made_sweep = sweep_from_dict(grid(3, 2))
        assert [values for _, values in made_sweep.list_designs()] == [
            (g, d) for g in (5e-5, 1.25e-4, 2e-4) for d in (0.006, 0.012)
        ]

    @pytest.mark.parametrize(("settings", "accuracy"), [({}, 0.2), ({"accuracy": 0.05}, 0.05)])
    def test_an_accuracy_that_is_left_out_is_that_of_the_scene(self, settings: dict[str, Any], accuracy: float) -> None:
        scene = read_scene(SCENE).replace({"reading.accuracy": 0.2})
        assert sweep_from_dict({"scene": scene, "variables": {"probe.gap": ["0.1 mm"]}} | settings).accuracy == accuracy
        assert sweep_from_dict(grid(3, 2)).accuracy == 0.01

    def test_values_reach_the_scene(self) -> None:
        changes = {"inclusion[0].depth": ["11 mm"], "probe.outer_radius": ["8 mm"], "contact.interface": ["frictionless"],
                   "load.indentation": ["3 um"]}  # fmt: skip
        made_sweep = sweep_from_dict({"scene": SCENE, "variables": changes})
        scene = build_scene(made_sweep.base, made_sweep.keys, made_sweep.list_designs()[0][1])
        assert (scene.inclusion[0].depth, scene.probe.outer_radius, scene.probe.area_ratio) == (0.011, 0.008, None)
        assert (scene.contact.interface, scene.load.force, scene.load.indentation) == ("frictionless", None, 3e-6)

    def test_a_material_is_varied_by_name_and_a_varied_modulus_has_none(self) -> None:
        base = read_scene(SCENE).model_dump(exclude_unset=True)
        base["probe"]["inner"] = {"material": "dragon-skin-30"}
        names = ["ecoflex-00-10", "dragon-skin-20"]
        made_sweep = sweep_from_dict({"scene": Scene.model_validate(base), "variables": {"probe.inner.material": names}})
        blocks = [build_scene(made_sweep.base, made_sweep.keys, values).probe.inner for _, values in made_sweep.list_designs()]
        assert [(block.material, block.youngs_modulus) for block in blocks] == [(names[0], 36070.0), (names[1], 478e3)]
        moduli = {"probe.inner.youngs_modulus": ["100 kPa", "600 kPa", "1 MPa"]}
        made_sweep = sweep_from_dict({"scene": Scene.model_validate(base), "variables": moduli})
        blocks = [build_scene(made_sweep.base, made_sweep.keys, values).probe.inner for _, values in made_sweep.list_designs()]
        assert [(block.material, block.youngs_modulus) for block in blocks] == [(None, 1e5), (None, 6e5), (None, 1e6)]

    @pytest.mark.parametrize("kind", ["sobol", "latin-hypercube", "saltelli"])
    def test_samples_are_in_range_and_the_same_every_time(self, kind: str) -> None:
        variables = {
            "probe.gap": GAP | {"scale": "log"},
            "inclusion.depth": DEPTH,
            "contact.interface": ["bonded", "frictionless"],
        }
        made_sweep = sweep_from_dict({"scene": SCENE, "sample": {"kind": kind, "n": 64, "seed": 5}, "variables": variables})
        designs = made_sweep.list_designs()
        assert designs == made_sweep.list_designs()
        assert len(designs) == (64 * 5 if kind == "saltelli" else 64)
        gaps, depths, kinds = zip(*(values for _, values in designs), strict=True)
        assert 5e-5 <= min(gaps) < 5.5e-5
        assert np.mean(np.log(gaps)) == pytest.approx(np.log(1e-4), abs=0.05)  # geometric mean of the range
        assert np.mean(depths) == pytest.approx(0.009, rel=0.02)
        assert 0.4 < kinds.count("bonded") / len(kinds) < 0.6

    def test_a_saltelli_sample_is_what_salib_expects(self) -> None:
        """Sobol indices of the Ishigami function: Saltelli et al., Global Sensitivity Analysis (2008), section 4.5."""
        u = np.array(DesignSampling("saltelli", 4096, 1)._draw_points(3))
        x = np.pi * (2 * u - 1)
        y = np.sin(x[:, 0]) + 7 * np.sin(x[:, 1]) ** 2 + 0.1 * x[:, 2] ** 4 * np.sin(x[:, 0])
        indices = compute_sobol_indices(y, 3)
        for (first, first_off, total, total_off), known in zip(
            indices, ((0.3139, 0.5576), (0.4424, 0.4424), (0.0, 0.2437)), strict=True
        ):
            assert abs(first - known[0]) < max(1.5 * first_off, 0.005)
            assert abs(total - known[1]) < max(1.5 * total_off, 0.005)
            assert max(first_off, total_off) < 0.1

    @pytest.mark.parametrize(
        ("text", "kept_ones"),
        [
            ("probe.gap < 0.025 * probe.inner_radius", [1, 1, 0]),  # of 4 mm
            ("'0.1 mm' <= probe.gap < '0.2 mm'", [0, 1, 0]),
            ("probe.gap < '0.1 mm' or not probe.gap < '0.2 mm'", [1, 0, 1]),
            ("(probe.gap / '0.1 mm') ** 2 - 1 >= 0 and probe.gap != '0.1 mm'", [0, 0, 1]),
            ("probe.gap * probe.outer.youngs_modulus > '7 N/m' and -probe.gap < 0", [0, 1, 1]),  # of 80 kPa
            ("probe.gap ** 2 < 2.5e-3 * '4 mm**2'", [1, 0, 0]),
        ],
    )
    def test_constraints(self, text: str, kept_ones: list[int]) -> None:
        job = sweep_from_dict({"scene": SCENE, "variables": {"probe.gap": [5e-5, 0.99e-4 if "inner" in text else 1e-4, 2e-4]},
                                 "constraints": [text]})  # fmt: skip
        assert [number for number, _ in job.list_designs()] == [place for place, is_kept in enumerate(kept_ones) if is_kept]

    @pytest.mark.parametrize(
        "text",
        ["__import__('os').system('true')", "probe.gap", "probe.gap < 'red'",
         "probe.gap < '2 kPa'", "probe.gap < 0.05", "probe.gap + 1 < '1 m'",
         "probe.gap < probe.area_ratio", "probe.gap ** probe.gap < 1", "probe.gap < 'nan m'",
         "probe.gup < 1", "[1] < [2]", "probe.gap < 1 / 0",
         "(lambda: 1)() < 2", "probe.gap <", "10.0 ** 10.0 ** 10.0 > 1", "contact.interface < 1",
         "1 < " + "(" * 300 + "1" + ")" * 300, "1 < " + "-" * 900 + "1", "1 < " + "+".join(["1"] * 400),
         "not " * 240 + "1 < 2", "1 < 2 and " * 99 + "1 < 3" * 9, "1 < 2if 1 else 2", "a" + ".a" * 490 + " < 1"],
    )  # fmt: skip
    def test_what_is_no_condition_is_refused(self, text: str) -> None:
        made_sweep = sweep_from_dict({"scene": SCENE, "variables": {"probe.gap": [1e-4]}, "constraints": [text]})
        with pytest.raises(InputError, match=r"constraints|variable"):
            made_sweep.list_designs()

    def test_a_key_whose_place_a_variable_takes_is_in_no_condition(self) -> None:
        """The scene has an area ratio, which says nothing of the designs."""
        table = {"scene": SCENE, "variables": {"probe.outer_radius": [0.006, 0.008]}, "constraints": ["probe.area_ratio < 2"]}
        with pytest.raises(InputError, match=r"probe\.area_ratio"):
            sweep_from_dict(table).list_designs()

    def test_numbers_may_be_numpys(self) -> None:
        values = {"probe.gap": np.array([1e-4, 2e-4]), "inclusion.depth": [np.float64(0.009)]}
        made_sweep = sweep_from_dict({"scene": SCENE, "variables": values})
        assert [values for _, values in made_sweep.list_designs()] == [(1e-4, 0.009), (2e-4, 0.009)]

    def test_each_side_is_read_once(self) -> None:
        assert evaluate_condition("a.b > 1 and a.b < 3", lambda name: (np.array([1.0, 2.0, 3.0]), ""), 3).tolist() == [
            False,
            True,
            False,
        ]

    @pytest.mark.parametrize(
        ("old", "new", "word"),
        [
            ("evaluator", "evaluater", "evaluater"),
            ('"closed-form"', '"magic"', "evaluator"),
            ("probe.gap", "probe.gup", "gup"),
            ("inclusion[0]", "inclusion[1]", "inclusion[1]"),
            ('"0.05 mm"', "0.05", "unit is missing"),
            ('"0.05 mm"', '"0.05 Pa"', "probe.gap.from"),
            ('"0.05 mm"', '"5 mm"', "probe.gap.to"),
            ('"log"', '"cubic"', "scale"),
            ('"latin-hypercube"', '"random"', "sample.kind"),
            ("n = 300", "n = 0", "sample.n"),
            ("seed", "speed", "sample.speed"),
            ('"0.05 mm"', "1e999", "unit is missing"),
            ("scene.toml", "absent.toml", "absent.toml"),
            ("[sample]", "[sample", "sweep.toml"),
            ("[sample]", "time_limit = 5\n[sample]", "unit is missing"),
            ("[sample]", "time_limit = '0 s'\n[sample]", "time_limit"),
        ],
    )
    def test_refusals_name_the_key(self, old: str, new: str, word: str, tmp_path: Path) -> None:
        path = toml(tmp_path)
        path.write_text(path.read_text().replace(old, new, 1))
        with pytest.raises(InputError) as refused:
            read_sweep(path)
        assert word in str(refused.value)

    @pytest.mark.parametrize(
        ("variables", "word"),
        [
            ({"probe.gap": []}, "a list of values"),
            ({"probe.inner.poisson_ratio": [0.3, float("nan")]}, "finite numbers"),
            ({"probe.inner.poisson_ratio": [10**400]}, "finite numbers"),
            ({"probe.inner.poisson_ratio": {"from": -1.5e308, "to": 1.5e308, "points": 3}}, "narrower"),
            ({"contact.interface": ["bonded", True]}, "one kind"),
            ({"probe.gap": {"from": 1e-4, "to": 2e-4, "points": 10**9}}, "whole number"),
            (
                {name: {"from": 1e-4, "to": 2e-4, "points": 1000} for name in ("probe.gap", "probe.height", "inclusion.x")},
                "at most",
            ),
            ({"inclusion.depth": [0.009], "inclusion[0].depth": [0.009]}, "each key once"),
            ({5: [1.0]}, "keys of the scene file"),
            ({"probe.gäp": [1.0]}, "keys of the scene file"),
            ({}, "a table of variables"),
        ],
    )
    def test_what_no_file_can_ask_for_either(self, variables: dict[Any, Any], word: str) -> None:
        with pytest.raises(InputError, match=word):
            sweep_from_dict({"scene": SCENE, "variables": variables}).list_designs()


@pytest.mark.parametrize("count", [0, 2])
def test_the_inclusion_is_named_where_there_is_not_one(count: int) -> None:
    scene = read_scene(SCENE)
    bodies = [scene.inclusion[0].model_dump(exclude_unset=True) | {"x": 0.015 * k} for k in range(count)]
    tables = {"scene": scene.model_dump(exclude_unset=True) | {"inclusion": bodies}, "variables": {"inclusion.depth": [0.009]}}
    tables["scene"] = Scene.model_validate(tables["scene"])
    with pytest.raises(InputError, match=rf"inclusion\[NUMBER\]\.depth: the scene has {count} inclusions"):
        sweep_from_dict(tables)
