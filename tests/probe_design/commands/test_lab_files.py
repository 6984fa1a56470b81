"""Files of other programs through the command `read`: the same result as from the probe itself, or one line and exit code 2."""

from __future__ import annotations

import json
import wave
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hw.reader import Reader
from tests.support import program
from tests.support.paths import SCENE

SECONDS = ("--seconds", "4")


def run_json(*arguments: str | Path) -> dict[str, Any]:
    ended = program.run("read", SCENE, *arguments, "--json")
    assert ended.returncode == 0, ended.stderr
    output: dict[str, Any] = json.loads(ended.stdout)
    return output


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """With one reading of the virtual probe as every kind of file, and what was read live."""
    place = tmp_path_factory.mktemp("lab")
    live = run_json("--virtual", *SECONDS, "--record", place / "run.probe")
    (place / "live.json").write_text(json.dumps(live))
    with Reader.open(f"replay:{place / 'run.probe'}") as reader:
        samples = reader.collect(4.0)
    rows = np.column_stack([samples.times, 1e3 * samples.volts])
    body = "\n".join(";".join(f"{value:.12g}".replace(".", ",") for value in row) for row in rows)
    (place / "run.csv").write_text("Zeit (s);A (mV);B (mV);C (mV)\n" + body + "\n", encoding="latin-1")
    with wave.open(str(place / "run.wav"), "wb") as file:
        file.setnchannels(3)
        file.setsampwidth(2)
        file.setframerate(round(samples.rate))
        file.writeframes(np.rint(samples.volts / 2e-6).astype("<i2").tobytes())
    return place


MAPS = {
    "run.csv": ("--column", "time=Zeit", "--column", "inner=A", "--column", "outer=B", "--column", "force=C mV"),
    "run.wav": tuple(word for key, n in (("inner", 1), ("outer", 2), ("force", 3))
                     for word in ("--column", f"{key}={n} 65.536 mV")),
}  # fmt: skip


@pytest.mark.parametrize("name", MAPS)
def test_the_same_reading_from_any_file(name: str, folder: Path) -> None:
    live, replayed = json.loads((folder / "live.json").read_text()), run_json("--replay", folder / name, *MAPS[name])
    for key in ("ratio", "ratio_uncertainty", "stress_inner", "stress_outer", "reference_force", "frequency"):
        assert replayed[key] == pytest.approx(live[key], rel=1e-6), key


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--replay", "run.csv"), "column inner = missing"),
        (("--replay", "run.csv", *MAPS["run.csv"], "--rate", "2 kHz"), "rate = 2000 Hz"),
        (("--replay", "run.wav", *MAPS["run.csv"]), "column inner = 'A'"),
        (("--replay", "run.probe", "--rate", "1 kHz"), "states its columns"),
        (("--replay", "run.probe", "--column", "inner=1 V"), "states its columns"),
        (("--replay", "absent.csv"), "no such file"),
        (("--replay", "run.csv", "--record", "more.probe"), "nothing beside --replay alone"),
        (("--virtual", "--rate", "1 kHz"), "nothing beside --virtual"),
    ],
)
def test_refusals_are_one_line(arguments: tuple[str, ...], words: str, folder: Path) -> None:
    ended = program.run("read", SCENE, *arguments, cwd=folder)
    assert (ended.returncode, ended.stdout, ended.stderr.count("\n")) == (2, "", 1), ended.stderr
    assert words in ended.stderr
