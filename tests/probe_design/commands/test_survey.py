"""`survey` with the virtual probe: from press to press, interrupted and continued, and its recordings read again."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest

from geometry.common.json_types import JsonObject
from tests.support.paths import ROOT
from tests.support.program import refused, run

TUMOUR = """
[[inclusion]]
diameter = "10 mm"
depth = "9 mm"
x = "4 mm"
y = "-5 mm"
youngs_modulus = "30 kPa"
poisson_ratio = 0.45
"""
KEYS = {
    "stop",
    "presses",
    "detectable_probability",
    "hidden",
    "files",
    "probability",
    "tumours",
    "by_number",
    "next",
    "provenance",
}


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """With a design of at most one tumour, and a hidden one."""
    folder = tmp_path_factory.mktemp("survey")
    text = (ROOT / "examples" / "scans" / "one-clear.toml").read_text()
    (folder / "design.toml").write_text(text.replace("least_cover", "tumours = 1\nleast_cover"))
    (folder / "hide.toml").write_text(TUMOUR)
    return folder


def survey(place: Path, presses: int, output: str, design: str = "design.toml") -> JsonObject:
    words = ("--virtual", "--hide", "hide.toml", "--presses", str(presses), "-o", output, "--json")
    ended = run("survey", design, *words, cwd=place)
    assert ended.returncode == 0, ended.stderr
    result: JsonObject = json.loads(ended.stdout)
    return result


@pytest.mark.slow
def test_survey_continues_as_if_it_had_not_been_interrupted(place: Path) -> None:
    """Its recordings, located afterwards, are the readings that it had; and its scan's file is one of `locate`."""
    whole = survey(place, 4, "whole")
    assert whole.keys() >= KEYS
    assert whole["stop"]["reason"] in ("presses", "tumour")
    first = survey(place, 1, "parts")
    assert first["stop"]["reason"] == "presses"
    half = place / "parts" / "press-002.probe"
    half.write_bytes(b"half")  # of an interrupted press: it stays, and the next has another name
    assert survey(place, 4, "parts")["probability"] == whole["probability"]
    assert (place / "parts" / "scan.csv").read_bytes() == (place / "whole" / "scan.csv").read_bytes()
    assert half.read_bytes() == b"half"
    count = len(whole["presses"])
    names = {path.name for path in (place / "whole").iterdir()}
    assert names >= {f"press-{k:03d}.probe" for k in range(1, count + 1)} | {f"map-{k:03d}.png" for k in range(1, count + 1)}
    assert names >= {"report.html", "sequence.png", "survey.json", "scan.csv"}
    words = [word for k in range(1, count + 1) for word in ("--reading", f"whole/press-{k:03d}.probe")]
    read_again = run("locate", "design.toml", *words, "--json", cwd=place)
    assert read_again.returncode == 0, read_again.stderr
    by_file = run("locate", "design.toml", "--readings", "whole/scan.csv", "--json", cwd=place)
    results = [json.loads(ended.stdout) for ended in (read_again, by_file)]
    assert results[0]["probability"] == pytest.approx(results[1]["probability"], rel=1e-6)
    assert results[0]["probability"][0] == pytest.approx(whole["probability"][0], rel=0.3)


@pytest.mark.slow
def test_survey_under_two_loads_locates_the_hidden_tumour(place: Path) -> None:
    """There is a baseline reading under each; recordings state their loads; it continues; the tumour lies where it is hidden."""
    text = (place / "design.toml").read_text().replace("blank = true", 'blank = true\nloads = ["10 mN", "2 mN"]')
    (place / "loads.toml").write_text(text)
    whole, _ = (survey(place, presses, output, "loads.toml") for presses, output in ((25, "loads"), (3, "loads-parts")))
    assert survey(place, 25, "loads-parts", "loads.toml")["probability"] == whole["probability"]
    scans = [(place / name / "scan.csv").read_text() for name in ("loads", "loads-parts")]
    assert scans[0] == scans[1]
    rows = list(csv.DictReader(scans[0].splitlines()))
    assert [row["force"] for row in rows[:2]] == ["0.002 N", "0.01 N"]
    assert [row["blank"] for row in rows[:3]] == ["true", "true", "false"]
    assert whole["stop"]["reason"] == "tumour"
    for name, truth in (("x", 4e-3), ("y", -5e-3), ("depth", 9e-3), ("diameter", 10e-3)):
        low, high = whole["tumours"][0][name]["interval_90"]
        assert low < truth < high, name
    assert "force, mN" in (place / "loads" / "report.html").read_text()
    words = [word for k in range(1, len(rows) + 1) for word in ("--reading", f"loads/press-{k:03d}.probe")]
    ended = [run("locate", "loads.toml", *part, "--json", cwd=place) for part in (words, ("--readings", "loads/scan.csv"))]
    results = [json.loads(part.stdout)["probability"] for part in ended]
    assert results[0] == pytest.approx(results[1], rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--virtual", "--seed", "3", "-o", "{place}/whole"), "with another seed"),
        (("--virtual", "--hide", "{place}/design.toml", "-o", "{place}/new"), "tables [[inclusion]]"),
        (("--hide", "{place}/hide.toml", "-o", "{place}/new"), "nothing without --virtual"),
        (("--virtual", "--replay", "a.probe", "-o", "{place}/new"), "one of --virtual, --replay and --device"),
        (("--replay", "absent.probe", "-o", "{place}/new"), "a file that is there"),
        (("--virtual",), "--output"),
    ],
)
def test_refusals(place: Path, words: tuple[str, ...], message: str) -> None:
    survey(place, 1, "whole") if not (place / "whole").exists() else None
    assert message in refused("survey", place / "design.toml", *(word.format(place=place) for word in words))
    assert not (place / "new").exists()


def test_locate_takes_readings_or_recordings(place: Path) -> None:
    assert "--reading RECORDING once for each press" in refused("locate", place / "design.toml")


def test_read_hides_a_tumour_from_its_prediction(place: Path) -> None:
    """The prediction is that of the scene; the virtual tissue has a tumour more, below the probe."""
    shallow = TUMOUR.replace('"9 mm"', '"7 mm"').replace('x = "4 mm"', "").replace('y = "-5 mm"', "")
    (place / "below.toml").write_text(shallow)
    scene = ROOT / "examples" / "scene.toml"
    plain, hiding = (
        json.loads(run("read", scene, "--virtual", "--seconds", "4", "--json", *words).stdout)
        for words in ((), ("--hide", place / "below.toml"))
    )
    assert abs(hiding["ratio"] / plain["ratio"] - 1) > 0.02
