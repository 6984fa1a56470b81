"""`probe-design curve` as a user runs it."""

from __future__ import annotations

import json
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest

from tests.support.paths import REFERENCE
from tests.support.program import refused, run
from tests.support.references import named

SCENE = REFERENCE / "axisymmetric" / "soft-cyst.toml"


def test_json_and_picture(tmp_path: Path) -> None:
    picture = tmp_path / "curve.png"
    ended = run("curve", SCENE, "--from", "100 Pa", "--to", "1 MPa", "--points", "11", "--json", "--plot", picture)
    assert ended.returncode == 0, ended.stderr
    assert ended.stderr == ""
    output = json.loads(ended.stdout)
    modulus, ratio, log_sensitivity = (np.array(output[key]) for key in ("youngs_modulus", "ratio", "log_sensitivity"))
    assert modulus == pytest.approx(np.geomspace(100, 1e6, 11), rel=1e-12)
    assert len(ratio) == len(log_sensitivity) == len(output["error_estimate"]) == 11
    assert max(output["error_estimate"]) <= 0.01
    # the integral of the log-sensitivity is ln of the ratio: Simpson's rule on a logarithmic scale, to its own error
    step = np.log(modulus[1] / modulus[0])
    simpson = (
        step
        / 3
        * (log_sensitivity[0] + 4 * log_sensitivity[1::2].sum() + 2 * log_sensitivity[2:-1:2].sum() + log_sensitivity[-1])
    )
    assert simpson == pytest.approx(np.log(ratio[-1] / ratio[0]), rel=0.02)
    assert matplotlib.image.imread(picture).shape[:2] == (1050, 1200)


def test_table(tmp_path: Path) -> None:
    ended = run("curve", SCENE, "--points", "3")
    assert ended.returncode == 0
    assert "log_sensitivity" in ended.stdout
    assert "youngs_modulus, kPa" in ended.stdout
    assert "│                1000 │" in ended.stdout


def test_curve_passes_through_evaluate() -> None:
    reference = named("axisymmetric", "soft-cyst")
    modulus = reference.scene.inclusion[0].youngs_modulus
    ends = ("--from", f"{modulus} Pa", "--to", f"{2 * modulus} Pa", "--points", "2")
    ended = run("curve", SCENE, *ends, "--accuracy", "0.001", "--json")
    output = json.loads(ended.stdout)
    assert output["ratio"][0] == pytest.approx(reference.ratio, rel=output["error_estimate"][0])
    assert output["log_sensitivity"][0] == pytest.approx(reference.log_sensitivity, rel=5e-3)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((SCENE, "--from", "1000"), ("from", "unit is missing")),
        ((SCENE, "--from", "1 mm"), ("from", "1 mm")),
        ((SCENE, "--from", "1 MPa", "--to", "1 kPa"), ("to", "above from")),
        ((SCENE, "--from", "1 kPa", "--to", "1 kPa"), ("to", "above from")),
        ((SCENE, "--points", "1"), ("points",)),
        ((SCENE, "--accuracy", "0"), ("accuracy",)),
        ((SCENE, "--plot", "curve.bmp"), ("plot", ".png")),
        ((REFERENCE / "axisymmetric" / "homogeneous.toml",), ("inclusion",)),
    ],
)
def test_refusals_are_one_line_and_exit_2(arguments: tuple[str | Path, ...], words: tuple[str, ...]) -> None:
    line = refused("curve", *arguments)
    for word in words:
        assert word in line


def test_a_picture_that_cannot_be_written_leaves_no_file(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("no folder")
    ended = run("curve", SCENE, "--points", "2", "--plot", tmp_path / "file" / "curve.png")
    assert ended.returncode == 2
    assert ended.stderr.count("\n") == 1
    assert ended.stdout == ""  # refused before the work
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
