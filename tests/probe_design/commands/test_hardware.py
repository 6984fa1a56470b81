"""The commands of the built probe as a user runs them: the whole loop, replay, refusals in one line, clean ends."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
import time
import tomllib
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from hw.reader import Reader
from probe_design.built_probe.virtual_probe import BuiltProperties
from tests.support import program
from tests.support.paths import DOCS, EXAMPLES, SCENE

PAGE = "".join((DOCS / "guides" / f"{name}.md").read_text(encoding="utf-8") for name in ("hardware", "calibrate"))
KEYS = {
    "ratio", "stress_inner", "stress_outer", "ratio_uncertainty", "stress_inner_uncertainty", "stress_outer_uncertainty", "gaps",
    "overruns", "predicted_ratio", "predicted_stress_inner", "predicted_stress_outer", "z_ratio",
}  # fmt: skip


def run(*arguments: str | Path, code: int = 0) -> program.Ended:
    ended = program.run(*arguments)
    assert ended.returncode == code, ended.stderr
    assert "defect" not in ended.stderr
    return ended


def run_json(*arguments: str | Path, code: int = 0) -> dict[str, Any]:
    output: dict[str, Any] = json.loads(run(*arguments, "--json", code=code).stdout)
    return output


def refused(*arguments: str | Path, code: int = 2) -> str:
    ended = run(*arguments, code=code)
    assert ended.stdout == ""
    assert ended.stderr.count("\n") == 1
    return ended.stderr


def documented(command: str) -> list[float]:
    """Numbers of the rows that the guides show below a command."""
    shown = next(block for block in PAGE.split("```console\n$ probe-design ")[1:] if block.startswith(command))
    return numbers(shown.split("```")[0])


VERIFIED = SCENE.parent / "verified-bench.toml"


def numbers(table: str) -> list[float]:
    rows = [line for line in table.splitlines() if line.startswith("│")]
    return [
        float(word)
        for row in rows
        for word in row.split("│")[2:]
        for word in word.split()[:1]
        if word not in ("-", "", "yes", "no", "nowhere")
    ]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """With a calibration of the virtual probe and its recordings."""
    place = tmp_path_factory.mktemp("bench")
    ended = run("calibrate", SCENE, "--virtual", "--bench", VERIFIED, "--record", place / "run.probe", "-o", place / "probe.toml")
    assert numbers(ended.stdout) == pytest.approx(documented("calibrate examples/scene.toml --virtual --bench"), rel=0.02)
    return place


def test_what_nobody_has_verified_is_counted_and_told(tmp_path: Path) -> None:
    """The built-in bench: a force sensor that no known load has confirmed, pin and ring that nobody has looked at."""
    ended = run("calibrate", SCENE, "--virtual", "-o", tmp_path / "probe.toml")
    assert numbers(ended.stdout) == pytest.approx(documented("calibrate examples/scene.toml --virtual -o"), rel=0.02)
    assert "nothing confirms the force channel's scale" in ended.stderr
    assert "does not state what fraction of their load pin" in ended.stderr
    spread = tomllib.loads((tmp_path / "probe.toml").read_text())["covariance"][0][0] ** 0.5
    assert 0.03 < spread < 0.05


@pytest.fixture(scope="module")
def other_calibration(folder: Path) -> Path:
    """The calibration of another board of the same drawing."""
    text = (folder / "probe.toml").read_text()
    assert '\nserial = "VIRTUAL"\n' in text
    (folder / "other.toml").write_text(text.replace('\nserial = "VIRTUAL"\n', '\nserial = "A17"\n'))
    return folder / "other.toml"


@pytest.mark.parametrize("command_name", ["read", "check", "estimate"])
def test_a_calibration_of_another_board_is_refused(folder: Path, other_calibration: Path, command_name: str) -> None:
    """Two probes of one drawing: a ratio of 0.70 +- 0.01 was read for 0.56."""
    source = ("--reading", folder / "run-3.probe") if command_name == "estimate" else ("--virtual",)
    message = refused(command_name, SCENE, *source, "--calibration", other_calibration)
    assert "serial number = A17 of the calibration; VIRTUAL of" in message
    assert "--any-probe" in message


def test_readings_of_another_board_are_taken_where_that_is_asked_for(folder: Path, other_calibration: Path) -> None:
    ended = run("read", SCENE, "--virtual", "--seconds", "4", "--calibration", other_calibration, "--any-probe")
    assert "serial numbers differ, as --any-probe allows" in ended.stderr


def test_a_reading_tells_its_board_and_one_of_another_is_refused_beside_it(folder: Path, tmp_path: Path) -> None:
    output = run_json("read", SCENE, "--virtual", "--seconds", "4")
    assert output["serial"] == "VIRTUAL"
    (tmp_path / "one.json").write_text(json.dumps(output | {"serial": "B2"}))
    words = ("--reading", tmp_path / "one.json", "--reading", folder / "run-3.probe", "--calibration", folder / "probe.toml")
    assert "serial number = B2 of" in refused("estimate", SCENE, *words)


def test_a_calibration_takes_readings_of_one_board(folder: Path, tmp_path: Path) -> None:
    recordings = [(folder / f"run-{k + 1}.probe").read_bytes() for k in range(7)]
    recordings[3] = recordings[3].replace(b'"serial": "VIRTUAL"', b'"serial": "A170000"', 1)
    paths = [tmp_path / f"{k}.probe" for k in range(7)]
    for path, content in zip(paths, recordings, strict=True):
        path.write_bytes(content)
    message = refused("calibrate", SCENE, *(word for path in paths for word in ("--replay", path)), "-o", tmp_path / "new.toml")
    assert "A170000 of block of 6 kPa" in message
    assert not (tmp_path / "new.toml").exists()


def test_a_board_that_nobody_knows_is_warned_of(folder: Path, tmp_path: Path) -> None:
    """What a spreadsheet has recorded has no serial number."""
    run("read", SCENE, "--virtual", "--seconds", "4", "--record", tmp_path / "one.probe")
    table = tmp_path / "one.csv"
    with Reader.open(f"replay:{tmp_path / 'one.probe'}") as reader:
        samples = reader.collect()
    columns = np.column_stack([samples.times, samples.volts])
    np.savetxt(table, columns, delimiter=",", header="time (s),inner (V),outer (V),force (V)", comments="")
    ended = run("read", SCENE, "--replay", table, "--calibration", folder / "probe.toml")
    assert "no serial number of the reading" in ended.stderr


@pytest.mark.parametrize("kind", ["csv", "h5"])
def test_millivolts_taken_as_volts_are_refused_without_a_force_channel(kind: str, tmp_path: Path) -> None:
    """Stresses came out a thousand times too large, exit code 0."""
    run("read", SCENE, "--virtual", "--seconds", "4", "--record", tmp_path / "one.probe")
    with Reader.open(f"replay:{tmp_path / 'one.probe'}") as reader:
        samples = reader.collect()
    columns = {"time": samples.times, "inner": 1e3 * samples.volts[:, 0], "outer": 1e3 * samples.volts[:, 1]}
    path = tmp_path / f"millivolts.{kind}"
    if kind == "csv":
        header = "time (s),inner (V),outer (V)"
        np.savetxt(path, np.stack(list(columns.values()), axis=1), delimiter=",", header=header, comments="")
    else:
        with h5py.File(path, "w") as file:
            for name, values in columns.items():
                file.create_dataset(name, data=values).attrs["units"] = "s" if name == "time" else "V"
    for command_name, option in (("read", "--replay"), ("estimate", "--reading")):
        assert "millivolts taken as volts" in refused(command_name, SCENE, option, path)


def test_calibrate_finds_the_true_gains_and_records_where_from(folder: Path) -> None:
    record = tomllib.loads((folder / "probe.toml").read_text())
    built = BuiltProperties()
    for k in (0, 1):  # of the films, and of amplifiers whose Cf differs; far above the corner |H| is 1/Cf
        truth, spread = built.gains[k][k] / built.capacitance[k], record["covariance"][3 * k][3 * k] ** 0.5
        assert abs(record["matrix"][k][k] - truth) < 3.5 * spread < 0.15  # the force sensor is not confirmed
    crossed = built.gains[0][1] / built.capacitance[0]
    assert abs(record["matrix"][0][1] - crossed) < 3.5 * record["covariance"][1][1] ** 0.5 < 8e-3  # of 0.7 % that a ring leaks
    assert len(record["reading"]) == 7
    for k, reading in enumerate(record["reading"]):
        content = (folder / f"run-{k + 1}.probe").read_bytes()
        assert reading["sha256"] == hashlib.sha256(content).hexdigest()
    assert record["scene"]["probe"]["inner_radius"] == "4 mm"
    assert record["software"].startswith("probe-design ")


def test_calibrate_again_from_the_recordings(folder: Path) -> None:
    replays = [word for k in range(7) for word in ("--replay", folder / f"run-{k + 1}.probe")]
    run("calibrate", SCENE, *replays, "--bench", VERIFIED, "--seconds", "10", "-o", folder / "again.toml")
    first, repeated = (tomllib.loads((folder / name).read_text()) for name in ("probe.toml", "again.toml"))
    assert repeated["matrix"] == first["matrix"]
    assert repeated["reading"] == first["reading"]


def test_one_recording_is_one_reading(folder: Path, tmp_path: Path) -> None:
    """The noise of one reading counted as that of two."""
    shutil.copy(folder / "run-3.probe", tmp_path / "copy.probe")
    files = (
        [folder / f"run-{k}.probe" for k in (1, 2, 3)]
        + [tmp_path / "copy.probe"]
        + [folder / f"run-{k}.probe" for k in (5, 6, 7)]
    )
    replays = [word for path in files for word in ("--replay", path)]
    assert "the same samples" in refused("calibrate", SCENE, *replays, "-o", tmp_path / "again.toml")
    assert not (tmp_path / "again.toml").exists()


def test_nothing_is_overwritten(folder: Path) -> None:
    content = (folder / "probe.toml").read_bytes()
    assert "not taken" in refused("calibrate", SCENE, "--virtual", "-o", folder / "probe.toml")
    assert (folder / "probe.toml").read_bytes() == content
    assert "never overwritten" in refused("read", SCENE, "--virtual", "--record", folder / "run-1.probe")


def test_read_calibrated_agrees_with_the_prediction(folder: Path) -> None:
    output = run_json("read", SCENE, "--virtual", "--calibration", folder / "probe.toml", "--seed", "3")
    assert output.keys() >= KEYS
    assert abs(output["z_ratio"]) < 3.5
    assert output["ratio_uncertainty"] < 0.02 * output["ratio"]  # by noise, leaks, warming
    assert (output["gaps"], output["overruns"], output["calibrated"]) == (0, 0, True)


def test_read_uncalibrated_is_off_and_says_by_how_much() -> None:
    output = run_json("read", SCENE, "--virtual", "--seconds", "5")
    assert output["ratio_uncertainty"] > 0.05 * output["ratio"]
    assert abs(output["ratio"] / output["predicted_ratio"] - 1) > 0.03
    assert any("not calibrated" in warning for warning in output["warnings"])


def test_read_without_scene_takes_the_built_in_one() -> None:
    output = run_json("read", "--virtual", "--seconds", "4")
    assert output.keys() >= KEYS
    assert output["predicted_ratio"] == pytest.approx(0.56295, rel=0.01)  # the probe of examples/scene.toml, by NGSolve


def test_replay_reads_what_was_read(tmp_path: Path) -> None:
    live = run_json("read", SCENE, "--virtual", "--seconds", "4", "--record", tmp_path / "one.probe")
    repeated = run_json("read", SCENE, "--replay", tmp_path / "one.probe", "--seconds", "4")
    commands = [output.pop("provenance")["command"] for output in (live, repeated)]
    assert repeated == live
    assert commands[0] != commands[1]


def test_check_passes_a_probe_as_drawn(folder: Path) -> None:
    output = run_json("check", "--virtual", "--calibration", folder / "probe.toml", "-o", folder / "check.json")
    assert (output["passed"], output["failed"]) == (True, False)
    assert {entry["variable"] for entry in output["tested"]} >= {"probe.inner_radius"}
    assert all(entry["reason"] for entry in output["untested"])
    assert json.loads((folder / "check.json").read_text()) == output


@pytest.mark.slow
def test_a_check_that_can_test_nothing_has_not_passed_and_does_not_fail() -> None:
    ended = run("check", SCENE, "--virtual", "--seconds", "5")
    assert "nothing could be tested" in ended.stdout
    assert "not tested: " in ended.stdout
    assert "within workshop tolerance" not in ended.stdout


@pytest.mark.slow
def test_check_fails_a_probe_off_its_drawing_and_says_why(folder: Path) -> None:
    words = ("--virtual", "--calibration", folder / "probe.toml", "--built", "probe.outer.youngs_modulus=92 kPa")
    ended = run("check", *words, "-o", folder / "failed.json", code=1)
    assert "outer.youngs_modulus" in ended.stdout
    assert "out of workshop tolerance: probe.outer.youngs_modulus, or reference.youngs_modulus, or " in ended.stdout
    shown = ended.stdout.split("what was tested")[0]
    assert numbers(shown) == pytest.approx(documented("check --virtual --calibration verified.toml --built"), rel=0.05, abs=0.01)
    output = json.loads((folder / "failed.json").read_text())
    assert (output["passed"], output["failed"]) == (False, True)
    best = next(entry for entry in output["explanations"] if entry["variable"] == "probe.outer.youngs_modulus")
    assert best["variable"] in output["alike"]
    assert abs(best["change"] - 12e3) < 3 * best["uncertainty"]


LONG = "x" * 5000 + ".probe"


def test_no_probe_is_one_line() -> None:
    assert "probe" in refused("read", SCENE, code=1)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("read", SCENE, "--virtual", "--device", "usb"), "one of --virtual, --replay and --device"),
        (("read", SCENE, "--device", "parallel:7"), "allowed"),
        (("read", SCENE, "--virtual", "--seconds", "-1"), "seconds"),
        (("read", SCENE, "--virtual", "--seconds", "long"), "seconds"),
        (("read", SCENE, "--virtual", "--calibration", "absent.toml"), "calibration"),
        (("read", SCENE, "--virtual", "--calibration", SCENE), "no format"),
        (("read", SCENE, "--virtual", "--bench", "absent.toml"), "bench"),
        (("read", SCENE, "--virtual", "--built", "probe.colour=3 mm"), "probe.inner_radius"),
        (("read", SCENE, "--built", "probe.gap=3 mm"), "without --virtual"),
        (("check", SCENE, "--replay", "a", "--replay", "b"), "one for each reading"),
        (("read", SCENE, "--virtual", "--memory", "0.1 GB"), "--memory raises the limit"),
        (("check", SCENE, "--virtual", "--memory", "0.1 GB"), "--memory raises the limit"),
        (("calibrate", SCENE, "--virtual", "-o", "unused.toml", "--memory", "0.1 GB"), "--memory raises the limit"),
        (("read", SCENE, "--virtual", "--time", "soon"), "time"),
        (("calibrate", SCENE, "--virtual"), "--output"),
        (("calibrate", SCENE, "--virtual", "-o", LONG), "name too long"),
        (("calibrate", SCENE, "--virtual", "--resume", "--record", LONG, "-o", "unused.toml"), "name too long"),
        (("check", SCENE, "--virtual", "-o", LONG), "name too long"),
        (("read", SCENE, "--virtual", "--record", LONG), "name too long"),
        (("calibrate", SCENE, "-o", "unused.toml"), "terminal"),
    ],
)
def test_bad_words_are_refused(arguments: tuple[str | Path, ...], words: str) -> None:
    assert words in refused(*arguments)
    assert not Path("unused.toml").exists()


def test_too_short_a_record_is_one_line(tmp_path: Path) -> None:
    assert "cycles" in refused("calibrate", SCENE, "--virtual", "--seconds", "2", "-o", tmp_path / "probe.toml", code=1)
    assert list(tmp_path.iterdir()) == []


def test_a_calibration_of_another_probe_is_refused(folder: Path) -> None:
    assert "of this probe" in refused("read", EXAMPLES / "paper-study.toml", "--virtual", "--calibration", folder / "probe.toml")


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="Windows sends no SIGINT to one process")
def test_ctrl_c_ends_cleanly(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "probe_design", "read", str(SCENE), "--virtual", "--seconds", "1e6"]
    running = subprocess.Popen([*command, "--record", str(tmp_path / "long.probe")], stdout=-1, stderr=-1, text=True)
    assert running.stderr
    while "ratio" not in running.stderr.readline():
        time.sleep(0.05)
    running.send_signal(signal.SIGINT)
    output, errors = running.communicate(timeout=60)
    assert (running.returncode, output) == (130, "")
    assert "Traceback" not in errors
    assert run_json("read", SCENE, "--replay", tmp_path / "long.probe", "--seconds", "1")["ratio"] > 0


def test_without_a_scene_the_bench_has_a_probe_that_can_be_read(tmp_path: Path) -> None:
    """The outer film of the paper's probe gives a charge below its noise, so that no calibration could be made of it."""
    ended = run("calibrate", "--virtual", "-o", tmp_path / "probe.toml")
    assert ended.returncode == 0, ended.stderr
    ended = run("read", "--virtual", "--calibration", tmp_path / "probe.toml", "--json")
    assert ended.returncode == 0, ended.stderr
    reading = json.loads(ended.stdout)
    assert abs(reading["z_ratio"]) < 5
