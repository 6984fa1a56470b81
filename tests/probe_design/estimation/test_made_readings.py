"""Readings that are made in Python are checked as those of a file are."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

from geometry import InputError, Scene
from probe_design import estimate
from probe_design.estimation.made_readings import add_si_units, check_readings
from probe_design.estimation.measurements import Reading, build_scan_reading
from probe_design.surveys.record import SurveyRecord
from tests.support.paths import ROOT

SCENE = Scene.from_file(ROOT / "examples" / "scene.toml")
GOOD = Reading(1e-3, -2e-3, 0.4, 0.01, stiffness=80.0, x_sd=5e-4, force=5e-3)


@pytest.mark.parametrize(
    ("numbers", "words"),
    [
        ({"ratio": -0.4}, r"\.ratio = -0.4: allowed: a number above 0"), ({"ratio": np.nan}, r"\.ratio = nan"),
        ({"noise": 0.0}, r"\.noise"), ({"noise": np.inf}, r"\.noise"), ({"blank": "no"}, r"\.blank"),
        ({"x": np.nan}, r"\.x"), ({"x": None}, r"\.x = missing"), ({"x": 8.0}, r"\.x = 8000 mm"), ({"y": "3"}, r"\.y .*unit"),
        ({"x_sd": -1e-3}, r"\.x_sd"), ({"y_sd": np.nan}, r"\.y_sd"),
        ({"force": -1.0}, r"\.force"), ({"stiffness": np.inf}, r"\.stiffness"),
    ],
)  # fmt: skip
def test_numbers_of_readings_made_in_python_are_checked(numbers: dict[str, object], words: str) -> None:
    """Places in mm and negative deviations were computed with; NaN ended in warnings of numpy."""
    with pytest.raises(InputError, match=r"readings\[1\]" + words):
        check_readings((GOOD, replace(GOOD, **numbers)), SCENE, is_scan=True)  # type: ignore[arg-type]


def test_good_readings_pass_unchanged_also_as_numbers_of_numpy() -> None:
    """`np.float64(0.008) m` was refused as a place."""
    expected = replace(GOOD, stiffness_noise=0.01)
    assert check_readings((GOOD,), SCENE, is_scan=True) == (expected,)
    entries = {key: np.float64(value) if isinstance(value, float) else value for key, value in asdict(GOOD).items()}
    row = add_si_units(entries | {"blank": np.bool_(False)})
    assert build_scan_reading("", row, SCENE) == expected


def test_estimate_checks_readings_made_in_python() -> None:
    """A noise of 0 was a division by zero, a place off the tissue an error of pydantic."""
    for made, words in ((Reading(0.0, 0.0, 0.5, 0.0), "noise"), (Reading(8.0, 0.0, 0.5, 0.01), r"\.x"), (GOOD, "x_sd")):
        with pytest.raises(InputError, match=words):
            estimate(SCENE, readings=(made,))


@pytest.mark.parametrize(("key", "value"), [("ratio", "abc"), ("ratio", float("nan")), ("x", None), ("noise", [])])
def test_a_damaged_record_of_a_survey_is_refused(tmp_path: Path, key: str, value: object) -> None:
    """It was a defect of the program."""
    press = {"reading": asdict(GOOD) | {key: value}, "file": "press-001.probe", "probability": [0.5, 0.5]}
    (tmp_path / "survey.json").write_text(json.dumps({"settings": {}, "presses": [press]}))
    with pytest.raises(InputError, match="that cannot be read"):
        SurveyRecord.open(tmp_path, SCENE, {})
