"""Readings on references one by one: checked at once, read again, mixed of recorded and live ones, resumed."""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from geometry import InputError
from hw.common.samples import Floats
from hw.reader import Reader
from hw.recordings.recording import compute_sha256
from hw.signal.measurement import Measurement
from hw.signal.reading_fit import ReadingFit
from hw.signal.waveform import Flawed
from hw.simulation.virtual import make_virtual_probe
from probe_design.built_probe import film_forces, reading
from probe_design.built_probe.calibration import calibrate
from probe_design.built_probe.virtual_probe import BuiltProperties, build_signals
from probe_design.commands import hardware_sources, reference_readings
from probe_design.commands.hardware_request import ReferenceRequest
from probe_design.commands.hardware_sources import HardwareSetup, build_openers, list_new_recordings, list_recorded_files
from probe_design.commands.main import cli
from solver.results.result import Result
from tests.support.hw.benches import BENCH, scene, shares
from tests.support.hw.faulty_probe import Fault, make_faulty_probe
from tests.support.paths import SCENE

SETUP = HardwareSetup(scene(), BENCH)
PINS = BENCH.reference[:3]
GOOD: tuple[Fault, ...] = ()
LOST = (Fault("drop", 20),)
Devices = Callable[[list[tuple[Fault, ...]]], None]


def volts(k: int) -> Callable[[Floats], Floats]:
    return build_signals(BuiltProperties(), BENCH, scene(), 0.1 * np.array([0.5, 0.5]), [3, k])


@pytest.fixture
def devices(monkeypatch: pytest.MonkeyPatch) -> Devices:
    """One virtual board after the other in place of the probe on USB, and somebody who presses it on what is asked for."""
    real = Reader.open

    connected = itertools.count(0, 100)  # boards that are connected later have other noise

    def connect(faults: list[tuple[Fault, ...]]) -> None:
        first = next(connected)
        boards = iter(
            [make_faulty_probe(volts(first + k), 500.0, channels=3, scale=2e-6, faults=fault) for k, fault in enumerate(faults)]
        )
        opened: Any = lambda name, *options: real(next(boards) if name == "usb" else name, *options)  # noqa: E731
        monkeypatch.setattr(hardware_sources.Reader, "open", opened)

    monkeypatch.setattr(reference_readings, "ask_for", lambda *what: None)
    return connect


def read(source: ReferenceRequest, capsys: pytest.CaptureFixture[str]) -> tuple[list[str], str]:
    readings = reference_readings.read_references(SETUP, source, PINS, 0)
    files = [reading.file for reading in readings]
    assert [len(reading.samples) for reading in readings] == [2500] * 3
    assert [path is None or len(compute_sha256(path)) == 64 for path in files] == [True] * 3
    return ["" if path is None else path.name for path in files], capsys.readouterr().err


def test_a_flawed_reading_is_read_again(devices: Devices, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """A lost frame in one of seven readings ended all seven."""
    devices([GOOD, LOST, GOOD, GOOD])
    files, said = read(ReferenceRequest(device="usb", seconds=5.0, record=tmp_path / "run.probe"), capsys)
    assert files == ["run-1.probe", "run-2-again2.probe", "run-3.probe"]
    assert "ring on the outer block: samples from index" in said
    assert "it is read again" in said


def test_what_is_flawed_thrice_is_refused_by_name(devices: Devices) -> None:
    devices([GOOD, LOST, LOST, LOST])
    with pytest.raises(Flawed, match="ring on the outer block: samples from index"):
        reference_readings.read_references(SETUP, ReferenceRequest(device="usb", seconds=5.0), PINS, 0)


def test_cycles_are_judged_at_each_reading(devices: Devices) -> None:
    """Not after the last of them."""
    devices([GOOD] * 3)
    with pytest.raises(Flawed, match=r"pin on the inner block: 4\.99 cycles"):
        reference_readings.read_references(SETUP, ReferenceRequest(device="usb", seconds=1.0), PINS, 0)


def test_a_calibration_is_resumed(devices: Devices, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    source = ReferenceRequest(device="usb", seconds=5.0, record=tmp_path / "run.probe")
    devices([GOOD, LOST, LOST, LOST])
    with pytest.raises(Flawed):
        reference_readings.read_references(SETUP, source, PINS, 0)
    with pytest.raises(InputError, match="a name that is not taken"):
        reference_readings.read_references(SETUP, source, PINS, 0)
    (tmp_path / "run-2-again3.probe").unlink()
    devices([GOOD, GOOD])
    files, _ = read(ReferenceRequest(device="usb", seconds=5.0, record=tmp_path / "run.probe", resume=True), capsys)
    assert files == ["run-1.probe", "run-2-again3.probe", "run-3.probe"]


def test_recorded_and_live_readings_are_mixed(devices: Devices, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    devices([GOOD] * 3)
    read(ReferenceRequest(device="usb", seconds=5.0, record=tmp_path / "run.probe"), capsys)
    devices([GOOD])
    kept = (tmp_path / "run-1.probe", tmp_path / "run-2.probe")
    assert read(ReferenceRequest(device="usb", replay=kept, seconds=5.0), capsys)[0] == ["run-1.probe", "run-2.probe", ""]


def test_read_predicts_before_the_board_starts(monkeypatch: pytest.MonkeyPatch) -> None:
    """It sent START, and computed while nobody read: 4 of 10 s were lost with a buffer of 100 ms."""
    board = make_virtual_probe(volts(0), 500.0, channels=3, scale=2e-6)
    real, running = Reader.open, []

    def predicts(*given: Any) -> Result:
        running.append(board.firmware.stream)
        return Result("none", 0.0, stress_inner=500.0, stress_outer=900.0, ratio=0.55, error_estimate=1e-3)

    monkeypatch.setattr(hardware_sources.Reader, "open", lambda name, *options: real(board))
    monkeypatch.setattr(reading, "predict_scene", predicts)
    ended = CliRunner().invoke(cli, ["read", str(SCENE), "--device", "usb", "--seconds", "5", "--json"])
    assert ended.exit_code == 0, ended.output
    assert running == [0]
    assert json.loads(ended.stdout)["samples"] == 2500


def test_rate_and_columns_beside_a_recording_of_ours_are_the_device_s(devices: Devices, tmp_path: Path) -> None:
    devices([GOOD])
    live = ReferenceRequest(device="usb", seconds=5.0, record=tmp_path / "run.probe")
    with build_openers(live, lambda: (), 1, pace=False)[0]() as reader:
        reader.collect(5.0, live.record)
    source = ReferenceRequest(device="usb", replay=(tmp_path / "run.probe",), rate="1 kHz", column=("force=4",))
    with build_openers(source, lambda: (), 2, pace=False)[0]() as reader:
        assert len(reader.collect(5.0)) == 2500


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"virtual": True, "device": "usb"}, "one of --virtual, --replay and --device"), ({"resume": True}, "without --record"),
        ({"replay": (Path("a"),) * 4}, "3: one for each reading"), ({"replay": (Path("a"),)}, "3: one for each reading"),
        ({"replay": (Path("a"),), "record": Path("b")}, "nothing beside --replay alone"),
    ],
)  # fmt: skip
def test_sources_that_contradict_each_other(given: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        build_openers(ReferenceRequest.build(given), lambda: (), 3, pace=False)


def test_each_reading_is_fitted_once(devices: Devices, monkeypatch: pytest.MonkeyPatch) -> None:
    """Readings were checked when they were taken, and fitted again for the gains."""
    devices([GOOD] * 3)
    fits: list[int] = []  # rows of each
    real = film_forces.measure

    def count_rows(reading: ReadingFit, *options: Any) -> Measurement:
        measurement = real(reading, *options)
        fits.append(measurement.fit.rows)
        return measurement

    monkeypatch.setattr(film_forces, "measure", count_rows)
    readings = reference_readings.read_references(SETUP, ReferenceRequest(device="usb", seconds=5.0), PINS, 0)
    known = replace(shares(), blocks=shares().blocks[:1])
    with pytest.raises(InputError, match="readings that agree"):  # pressed on the same thing thrice
        calibrate(SETUP.scene, BENCH.model_copy(update={"reference": PINS}), [reading.measurement for reading in readings], known)
    assert fits == [2500] * 3


@pytest.mark.parametrize("name", ["run.csv", "run.TXT", "run.wav", "run.h5"])
def test_a_recording_is_not_named_as_what_it_is_not(tmp_path: Path, name: str) -> None:
    """Raw data under such a name would be read as a table, and refused."""
    with pytest.raises(InputError, match=r"record = .*run.*: allowed: a name that ends in \.probe"):
        list_new_recordings(ReferenceRequest(device="usb", record=tmp_path / name), 1)
    assert list_new_recordings(ReferenceRequest(device="usb", record=tmp_path / "run"), 1) == (tmp_path / "run",)


def test_a_killed_reading_counts_as_recorded(tmp_path: Path) -> None:
    """Its name is taken, and who resumes gets it for the reading that it was."""
    source = ReferenceRequest(device="usb", record=tmp_path / "run.probe", resume=True)
    (tmp_path / "run-2.probe").touch()
    assert list_recorded_files(source, 3) == (None, tmp_path / "run-2.probe", None)
    with pytest.raises(InputError, match="a name that is not taken"):
        list_new_recordings(source.model_copy(update={"resume": False}), 3)
