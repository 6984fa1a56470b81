"""Design files: what they say, and what is refused in one line."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from geometry.common.errors import InputError
from geometry.scenes.scene_file import scene_to_toml
from probe_design.design_report.population_report import write_design_file
from probe_design.populations.design_file import Design, design_from_dict, is_design, read_design, read_design_source
from probe_design.populations.entries import Range
from probe_design.populations.template import build_template
from tests.support.paths import ROOT

EXAMPLES = ROOT / "examples"


def design(**tables: Any) -> Design:
    return design_from_dict({"scene": "scene.toml", **tables}, EXAMPLES, True)


def test_the_template_reads_as_the_defaults() -> None:
    read = design_from_dict(tomllib.loads(build_template()), EXAMPLES, True)
    assert read == Design(scene=read.scene)


def test_the_template_s_examples_are_allowed() -> None:
    text = build_template().replace("\n# ", "\n").replace("\n[[population.layer]]", "")
    lines = [
        line
        for line in text.splitlines()
        if not line.startswith(("A ", "#", "thickness", "modulus", "observable", "film", "bond"))
    ]
    read = design_from_dict(tomllib.loads("\n".join(lines)), EXAMPLES, True)
    assert read.variables.materials
    assert read.limits.outer_radius == 8e-3
    assert read.population.depth == Range((3e-3, 20e-3), continuous=True)


def test_every_key_says_what_it_means() -> None:
    for name in ("population", "protocol", "noise", "limits", "variables", "objective"):
        fields = getattr(Design(scene=design().scene), name).__class__.model_fields
        assert [key for key, field in fields.items() if not field.description] == []


@pytest.mark.parametrize(
    ("tables", "key", "allowed"),
    [
        ({"populaton": {}}, "populaton", "did you mean 'population'?"),
        ({"population": {"dept": ["3 mm", "4 mm"]}}, "population.dept", "did you mean 'depth'?"),
        ({"population": {"depth": ["3 mm", 4]}}, "population.depth", "the unit is missing"),
        ({"population": {"depth": ["5 mm", "4 mm"]}}, "population.depth", "the higher end comes first"),
        ({"population": {"layer": [{"thickness": "1 mm"}]}}, "population.layer", "at most 0"),
        ({"population": {"samples": 0}}, "population.samples", "from 1 to 4096"),
        ({"noise": {"charge": "1 N"}}, "noise.charge", "no unit that converts to C"),
        ({"noise": {"white": -1}}, "noise.white", "a number from 0 to 10"),
        ({"protocol": {"positions": ["-1 mm", "1 mm", 0]}}, "protocol.positions", "from 1 to 101"),
        ({"protocol": {"positions": [-1, 1, 3]}}, "protocol.positions", "the unit is missing"),
        ({"protocol": {"false_alarm": float("nan")}}, "protocol.false_alarm", "0.0001 to 0.5"),
        ({"objective": {"maximise": "slope"}}, "objective.maximise", "'detection'"),
        ({"objective": {"statistic": "median"}}, "objective.statistic", "'mean', or a number between 0 and 1"),
        ({"objective": {"maximise": "resolved", "statistic": 0.1}}, "objective.statistic", "'mean' with maximise = 'resolved'"),
        ({"variables": {"gap": ["1 mm"]}}, "variables.gap", "not a list of two"),
        ({"variables": {"gap": {"choices": ["1 mm"], "step": "1 mm"}}}, "variables.gap", "choices beside bounds"),
        ({"variables": {"area_ratio": [2, 1]}}, "variables.area_ratio", "the lower bound is not below"),
        ({"limits": {"charge": ["2 pC", "1 pC"]}}, "limits.charge", "the least first"),
        ({"limits": 3}, "limits", "a table, [limits]"),
    ],
)
def test_refusals_name_key_and_remedy(tables: dict[str, Any], key: str, allowed: str) -> None:
    with pytest.raises(InputError) as fault:
        design(**tables)
    assert fault.value.key == key
    assert allowed in str(fault.value)
    assert "\n" not in str(fault.value)


def test_a_folder_of_optimize_is_its_question_about_its_recommended_probe(tmp_path: Path) -> None:
    scans = ROOT / "examples" / "scans" / "one-clear.toml"
    with pytest.raises(InputError, match="without question"):
        read_design_source(tmp_path)
    question = read_design(scans)
    (tmp_path / "question.toml").write_text(write_design_file(question))
    scene = question.scene.replace({"probe.gap": "0.3 mm"})
    (tmp_path / "design.toml").write_text(scene_to_toml(scene))
    design = read_design_source(tmp_path)
    assert isinstance(design, Design)
    assert design.scene.probe.gap == pytest.approx(0.3e-3)
    assert design.population == question.population


def test_fractions_may_be_percentages() -> None:
    made = design(protocol={"false_alarm": "7 %"}, limits={"tissue_strain": "10%"}, noise={"white": "1 %"})
    assert (made.protocol.false_alarm, made.limits.tissue_strain, made.noise.white) == (0.07, 0.1, 0.01)
    with pytest.raises(InputError, match=r"protocol\.false_alarm = '7 x%'"):
        design(protocol={"false_alarm": "7 x%"})


def test_a_population_without_an_inclusion_needs_its_sizes(tmp_path: Path) -> None:
    text = (EXAMPLES / "scene.toml").read_text(encoding="utf-8")
    (tmp_path / "scene.toml").write_text(text.split("[[inclusion]]")[0] + "[load]\nforce = '1 mN'\n", encoding="utf-8")
    (tmp_path / "design.toml").write_text("scene = 'scene.toml'\n[population]\ndepth = '9 mm'\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"population.diameter = missing"):
        read_design(tmp_path / "design.toml")


def test_calibrations_are_found_beside_the_file(tmp_path: Path) -> None:
    (tmp_path / "scene.toml").write_text((EXAMPLES / "scene.toml").read_text(encoding="utf-8"), encoding="utf-8")
    (tmp_path / "design.toml").write_text("scene = 'scene.toml'\n[noise]\ncalibration = 'probe.toml'\n", encoding="utf-8")
    assert read_design(tmp_path / "design.toml").noise.calibration == str(tmp_path / "probe.toml")


def test_a_scene_file_is_no_design_file() -> None:
    assert not is_design(tomllib.loads((EXAMPLES / "scene.toml").read_text(encoding="utf-8")))
    assert is_design({"scene": "scene.toml"})


@pytest.mark.parametrize(
    ("value_range", "sd"), [(Range((1.0, np.e), continuous=True), 1 / np.sqrt(12)), (Range((1.0, np.e**2)), 1.0)]
)
def test_deviations_are_those_of_draws(value_range: Range, sd: float) -> None:
    drawn = np.log(value_range.compute_quantiles((np.arange(20_000) + 0.5) / 20_000))
    assert value_range.deviation == pytest.approx(sd)
    assert drawn.std() == pytest.approx(sd, rel=1e-3)
