"""From recordings to E_object in one command: the truth inside the interval, places and refusals."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from tests.support import program
from tests.support.paths import SCENE


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """With a soft scene, a calibration and two readings, the second one as JSON too."""
    place = tmp_path_factory.mktemp("field")
    (place / "scene.toml").write_text(SCENE.read_text().replace('force = "10 mN"', 'force = "5 mN"'))
    for words in (
        ("calibrate", "scene.toml", "--virtual", "--seconds", "5", "-o", "probe.toml"),
        ("read", "scene.toml", "--virtual", "--calibration", "probe.toml", "--seed", "1", "--record", "a.probe"),
        ("read", "scene.toml", "--virtual", "--calibration", "probe.toml", "--seed", "2", "--record", "b.h5", "--json"),
    ):
        ended = program.run(*words, cwd=place)
        assert ended.returncode == 0, ended.stderr
    (place / "b.json").write_text(ended.stdout)
    return place


def told(folder: Path, *words: str) -> dict[str, Any]:
    ended = program.run("estimate", "scene.toml", *words, "--json", cwd=folder)
    assert ended.returncode == 0, ended.stderr
    found: dict[str, Any] = json.loads(ended.stdout)
    return found


def test_recordings_to_the_modulus(folder: Path) -> None:
    found = told(folder, "--calibration", "probe.toml", "--reading", "a.probe", "b.h5")
    low, high = found["interval"]
    assert low < 30e3 < high < 4 * low  # the scene's tumour
    single = told(folder, "--reading", "b.json")
    assert len(found["noise"]) == 2
    assert single["noise"][0] < found["noise"][1]  # two share the calibration's error


@pytest.mark.slow
def test_json_is_the_same_as_its_recording(folder: Path) -> None:
    first = told(folder, "--reading", "b.json")
    second = told(folder, "--reading", "b.h5", "--calibration", "probe.toml")
    for key in ("interval", "noise", "youngs_modulus", "warnings"):
        assert first[key] == second[key], key


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("--reading", "a.probe", "a.probe"), "another file"),
        (("--reading", "copy.probe", "--reading", "a.probe"), "content is the same"),
        (("--reading", "b.json, z=3"), "x=-8 mm"),
        (("--reading", "b.json, x=8"), "unit is missing"),
        (("--reading", "b.json, x=3 km"), "x = "),
        (("--reading", "b.json, blank=perhaps"), "true or false"),
        (("--reading", "absent.json"), "a file that is there"),
        (("--reading", "x" * 5000), "a file that is there"),
        (("--reading", "b.json", "--ratio", "0.5"), "nothing beside --reading"),
        (("--reading", "b.json", "--noise", "0.05"), "nothing beside --reading"),
        (("b.json",), "one scene"),
        (("--reading", "scene.toml"), "not a recording"),
        (("--reading", "b.json, blank=true"), "blank"),
        ((), "--ratio, --readings and --reading"),
    ],
)
def test_refusals_are_one_line(words: tuple[str, ...], expected: str, folder: Path) -> None:
    shutil.copy(folder / "a.probe", folder / "copy.probe")
    ended = program.run("estimate", "scene.toml", *words, cwd=folder)
    assert (ended.returncode, ended.stdout, ended.stderr.count("\n")) == (2, "", 1), ended.stderr
    assert expected in ended.stderr
