"""From recordings to E_object in one command: the truth inside the interval, places and refusals."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hw.reader import Reader
from tests.support import program
from tests.support.paths import SCENE

VERIFIED = str(SCENE.parent / "verified-bench.toml")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """With a soft scene, a calibration and two readings, the second one as JSON too."""
    place = tmp_path_factory.mktemp("field")
    (place / "scene.toml").write_text(SCENE.read_text().replace('force = "10 mN"', 'force = "5 mN"'))
    for words in (
        ("calibrate", "scene.toml", "--virtual", "--bench", VERIFIED, "--seconds", "5", "-o", "probe.toml"),
        ("read", "scene.toml", "--virtual", "--calibration", "probe.toml", "--seed", "1", "--record", "a.probe"),
        ("read", "scene.toml", "--virtual", "--calibration", "probe.toml", "--seed", "2", "--record", "b.probe"),
        ("read", "scene.toml", "--replay", "b.probe", "--calibration", "probe.toml", "--json"),  # with its last packet whole
    ):
        ended = program.run(*words, cwd=place)
        assert ended.returncode == 0, ended.stderr
    (place / "b.json").write_text(ended.stdout)
    _of_another_probe(place)
    shutil.copy(place / "a.probe", place / "copy.probe")
    (place / "link.probe").symlink_to(place / "a.probe")
    nameless = {key: value for key, value in json.loads(ended.stdout).items() if key != "probe"}
    (place / "nameless.json").write_text(json.dumps(nameless))
    with Reader.open(f"replay:{place / 'b.probe'}") as reader:
        samples = reader.collect()
    table = 1e3 * np.column_stack([samples.times, samples.volts[:, :2]])  # as a spreadsheet would save it, with fewer digits
    head = "time (ms),inner (mV),outer (mV)"
    np.savetxt(place / "b.csv", table, fmt=("%.3f", "%.4f", "%.4f"), delimiter=",", header=head, comments="")
    return place


def _of_another_probe(place: Path) -> None:
    """Write other.json, read with a probe whose gap is twice as wide."""
    (place / "other.toml").write_text((place / "scene.toml").read_text().replace('gap = "0.1 mm"', 'gap = "0.2 mm"'))
    ended = program.run("read", "other.toml", "--virtual", "--seed", "3", "--json", cwd=place)
    assert ended.returncode == 0, ended.stderr
    (place / "other.json").write_text(ended.stdout)


def run_json(folder: Path, *words: str) -> dict[str, Any]:
    ended = program.run("estimate", "scene.toml", *words, "--json", cwd=folder)
    assert ended.returncode == 0, ended.stderr
    output: dict[str, Any] = json.loads(ended.stdout)
    return output


@pytest.mark.slow
def test_recordings_to_the_modulus(folder: Path) -> None:
    output = run_json(folder, "--calibration", "probe.toml", "--reading", "a.probe", "b.probe")
    low, high = output["interval"]
    assert low < 30e3 < high < 4 * low  # the scene's tumour
    single = run_json(folder, "--reading", "b.json")
    assert len(output["noise"]) == 2
    assert single["noise"][0] < output["noise"][1]  # two share the calibration's error


@pytest.mark.slow
def test_json_is_the_same_as_its_recording(folder: Path) -> None:
    first = run_json(folder, "--reading", "b.json")
    second = run_json(folder, "--reading", "b.probe", "--calibration", "probe.toml")
    for key in ("interval", "noise", "youngs_modulus", "warnings"):
        assert first[key] == second[key], key


def test_two_readings_with_equal_values_are_two(folder: Path) -> None:
    ended = program.run("read", "scene.toml", "--replay", "a.probe", "--calibration", "probe.toml", "--json", cwd=folder)
    equal = json.loads((folder / "b.json").read_text()) | {"fingerprint": json.loads(ended.stdout)["fingerprint"]}
    (folder / "equal.json").write_text(json.dumps(equal))
    assert len(run_json(folder, "--reading", "b.json", "equal.json")["noise"]) == 2


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("--reading", "a.probe", "a.probe"), "the same samples"),
        (("--reading", "a.probe", "a.probe, x=-8 mm"), "the same samples"),
        (("--reading", "copy.probe", "--reading", "a.probe"), "the same samples"),
        (("--reading", "link.probe", "a.probe"), "the same samples"),
        (("--reading", "b.json", "b.probe"), "the same samples"),
        (("--reading", "b.json", "b.json, x=-8 mm"), "the same samples"),
        (("--reading", "b.json", "b.csv"), "the same samples"),
        (("--reading", "other.json"), "one of the scene's probe: probe.outer_radius"),
        (("--reading", "nameless.json"), "probe = missing"),
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
    ended = program.run("estimate", "scene.toml", *words, cwd=folder)
    assert (ended.returncode, ended.stdout, ended.stderr.count("\n")) == (2, "", 1), ended.stderr
    assert expected in ended.stderr
