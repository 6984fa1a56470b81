"""Every file that is read, corrupted: it is taken, or refused in one line with exit code 2."""

from __future__ import annotations

import json
import os
import struct
import tomllib
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import tomli_w
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from geometry import InputError, read_scene
from geometry.scenes.base_sizes import find_base_sizes
from hw.common.errors import HardwareError, InvalidSource
from hw.reader import Reader
from hw.recordings.recording import Recording
from probe_design.built_probe.bench import read_bench
from probe_design.built_probe.calibration_record import read_record
from probe_design.estimation.measurements import read_readings
from probe_design.sweeps.file import read_sweep
from tests.support.hw.virtual_probes import probe
from tests.support.mutations import garbled, mutated
from tests.support.paths import EXAMPLES, ROOT, SCENE
from tests.support.program import refused

READINGS = {"reading": [{"x": "-10 mm", "ratio": 0.6, "noise": 0.05}, {"ratio": 0.62, "stiffness": "80 N/m"}]}
CSV = b"x, y, ratio, noise, stiffness, stiffness_noise\n-8 mm, 0 mm, 0.55, 0.05, 79 N/m, 0.02\n0 mm, 0 mm, 0.62, 0.05, 81, 0.02\n"
CALIBRATION = {
    "format": "probe-design calibration", "version": 2, "software": "probe-design", "date": "2024-01-01T00:00:00+00:00",
    "charge_unit": 2e-11, "device": "virtual", "frequency": 5.0, "absolute": True, "entries": ["a", "b", "c", "d"],
    "matrix": [[1.0, 0.01], [0.02, 0.9]], "covariance": [[1e-4 * (i == j) for j in range(4)] for i in range(4)],
    "cross_talk_resolved": [True, False], "offsets": [0.0, 0.1], "offsets_sd": [1e-3, 1e-3], "chi_square": 3.0,
    "degrees_of_freedom": 4, "variables": ["probe.gap"], "slopes": [[0.1], [0.0], [0.0], [0.2]], "workshop": [2e-5],
    "warnings": ["none"],
    "reading": [{"on": "pin", "films": [0.1, 0.2], "films_sd": [1e-3, 1e-3], "force": 0.1, "sha256": "ab" * 32, "file": "r"}],
    "scene": tomllib.loads(SCENE.read_text()),
    "bench": tomllib.loads((ROOT / "probe_design" / "data" / "bench.toml").read_text()),
}  # fmt: skip
SWEEP = {
    "scene": tomllib.loads(SCENE.read_text()), "evaluator": "closed-form", "accuracy": 0.1, "time_limit": "9 s",
    "sample": {"kind": "sobol", "n": 4, "seed": 1}, "constraints": ["probe.gap < 0.1 * probe.inner_radius"],
    "variables": {
        "probe.gap": {"from": "0.1 mm", "to": "0.3 mm", "scale": "log"}, "inclusion.depth": {"from": "8 mm", "to": "9 mm"},
    },
}  # fmt: skip


def _scene(path: Path) -> None:
    find_base_sizes(read_scene(path).probe)


def _calibration(path: Path) -> None:
    read = read_record(path)
    read.build_scene()
    read.build_bench()


def _readings(path: Path) -> None:
    read_readings(path, read_scene(SCENE), 0.05)


def _recording(path: Path) -> None:
    with Reader.open(f"replay:{path}") as reader:
        reader.collect()


@dataclass(frozen=True)
class Format:
    """A kind of file: a right one as tables or, where it has none, bytes; and what reads it."""

    suffix: str
    right: Any
    read: Callable[[Path], object]

    @property
    def content(self) -> bytes:
        return self.right if isinstance(self.right, bytes) else tomli_w.dumps(self.right).encode()


FORMATS = {
    "scene": Format(".toml", tomllib.loads((EXAMPLES / "two-tumours.toml").read_text()), _scene),
    "bench": Format(".toml", CALIBRATION["bench"], read_bench),
    "calibration": Format(".toml", CALIBRATION, _calibration),
    "sweep": Format(".toml", SWEEP, lambda path: read_sweep(path).list_designs()),
    "readings": Format(".toml", READINGS, _readings),
    "readings as CSV": Format(".csv", CSV, _readings),
}
MANY = settings(max_examples=400, suppress_health_check=list(HealthCheck))
FEW = settings(max_examples=25, suppress_health_check=list(HealthCheck))


def taken_or_refused(form: Format, content: bytes, folder: Path) -> None:
    path = folder / f"file{form.suffix}"
    path.write_bytes(content)
    try:
        form.read(path)
    except (InputError, HardwareError) as fault:
        line = str(fault)
    else:
        line = ""
    assert "\n" not in line
    assert len(line) < 2000


@pytest.mark.parametrize("form", FORMATS.values(), ids=FORMATS.keys())
def test_right_files_are_taken(form: Format, tmp_path: Path) -> None:
    path = tmp_path / f"file{form.suffix}"
    path.write_bytes(form.content)
    form.read(path)


def structure(form: Format, folder: Path, data: st.DataObject) -> None:
    try:
        text = tomli_w.dumps(data.draw(mutated(form.right)))
    except ValueError:  # an integer of more digits than Python writes
        return
    taken_or_refused(form, text.encode("utf-8", "surrogatepass"), folder)


TABLES = {name: form for name, form in FORMATS.items() if not isinstance(form.right, bytes)}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("corrupted")


@pytest.mark.parametrize("form", TABLES.values(), ids=TABLES.keys())
@given(st.data())
@FEW
def test_other_tables(form: Format, folder: Path, data: st.DataObject) -> None:
    structure(form, folder, data)


@pytest.mark.slow
@pytest.mark.parametrize("form", TABLES.values(), ids=TABLES.keys())
@given(st.data())
@MANY
def test_many_other_tables(form: Format, folder: Path, data: st.DataObject) -> None:
    structure(form, folder, data)


@pytest.mark.parametrize("form", FORMATS.values(), ids=FORMATS.keys())
@given(st.data())
@FEW
def test_other_bytes(form: Format, folder: Path, data: st.DataObject) -> None:
    taken_or_refused(form, data.draw(garbled(form.content)), folder)


@pytest.mark.slow
@pytest.mark.parametrize("form", FORMATS.values(), ids=FORMATS.keys())
@given(st.data())
@MANY
def test_many_other_bytes(form: Format, folder: Path, data: st.DataObject) -> None:
    taken_or_refused(form, data.draw(garbled(form.content)), folder)


# recordings: a line of JSON and binary records


@pytest.fixture(scope="module")
def recorded(folder: Path) -> bytes:
    with Reader.open(probe()) as reader:
        reader.collect(0.02, record=folder / "run.probe")
    return (folder / "run.probe").read_bytes()


def headed(header: object, body: bytes) -> bytes:
    return json.dumps(header, default=str).encode() + b"\n" + body


def recorded_waveforms(note: str, data: bytes) -> bytes:
    source = {"transport": "visa", "serial": "1", "scale": [1e-3, 1e-3]}
    header = {"format": "probe-design recording", "version": 1, "kind": "waveforms", "rate": 1000.0, "size": 0, "stream": 0}
    encoded = note.encode("utf-8", "surrogatepass")[:65535]
    body = struct.pack("<4sdHHI", b"READ", 0.0, 0, len(encoded), len(data)) + encoded + data
    names = {"channels": ["inner", "outer"], "scale": [1e-3, 1e-3], "source": source}
    return headed(header | names, body + struct.pack("<I", zlib.crc32(body)))


RECORDING = Format(".probe", b"", _recording)
PREAMBLE = "0,0,3,1,1e-3,0,0,1e-3,0,128"
NOTE = {"dialect": "rigol", "scales": [PREAMBLE, PREAMBLE], "lengths": [3, 3]}


def corrupted_recording(recorded: bytes, folder: Path, data: st.DataObject) -> None:
    line, _, body = recorded.partition(b"\n")
    kind = data.draw(st.sampled_from(["header", "header", "bytes", "note"]))
    if kind == "header":
        content = headed(data.draw(mutated(json.loads(line))), body)
    elif kind == "bytes":
        content = data.draw(garbled(recorded))
    else:
        content = recorded_waveforms(json.dumps(data.draw(mutated(NOTE)), default=str), b"\x01\x80\xff" * 2)
    taken_or_refused(RECORDING, content, folder)


@given(st.data())
@FEW
def test_corrupted_recordings(recorded: bytes, folder: Path, data: st.DataObject) -> None:
    corrupted_recording(recorded, folder, data)


@pytest.mark.slow
@given(st.data())
@MANY
def test_many_corrupted_recordings(recorded: bytes, folder: Path, data: st.DataObject) -> None:
    corrupted_recording(recorded, folder, data)


def test_waveforms_are_read(folder: Path) -> None:
    path = folder / "waveforms.probe"
    path.write_bytes(recorded_waveforms(json.dumps(NOTE), b"\x80\x81\x7f" * 2))
    with Reader.open(f"replay:{path}") as reader:
        assert reader.collect().volts[:, 1].tolist() == pytest.approx([0, 1e-3, -1e-3])


@pytest.mark.parametrize(
    ("key", "value"),
    [("rate", "fast"), ("rate", 0.0), ("rate", float("nan")), ("channels", 5), ("channels", ["inner"]), ("scale", [None, None]),
     ("scale", [1e308, 1e308]), ("size", 10**400), ("size", 7), ("stream", -1), ("source", []), ("kind", ["frames"]),
     ("kind", "waves"), ("source", {"serial": float("nan")}), ("version", "1"), ("format", {}), ("extra", 1)],
)  # fmt: skip
def test_a_header_of_wrong_types_is_no_recording(recorded: bytes, tmp_path: Path, key: str, value: object) -> None:
    line, _, body = recorded.partition(b"\n")
    (tmp_path / "x").write_bytes(headed(json.loads(line) | {key: value}, body))
    with pytest.raises(InvalidSource, match=r"^\S+ is not a recording: it does not begin with the line that describes it"):
        Recording(tmp_path / "x")


# from the command line


def special(name: str, folder: Path) -> Path:
    """A path that is no such file: absent, a folder, empty, a pipe that nobody writes to, without end, nested, not UTF-8."""
    path = folder / f"{name.replace(' ', '-')}.toml"
    if name == "a folder":
        path.mkdir()
    elif name == "a pipe":
        os.mkfifo(path)
    elif name == "without end":
        path.symlink_to("/dev/zero")
    elif name != "absent":
        contents = {"empty": b"", "nested": b"a = " + b"[" * 100_000, "not UTF-8": "a = 'é'".encode("utf-16")}
        path.write_bytes(contents[name])
    return path


COMMAND_LINES: dict[str, tuple[str, ...]] = {
    "evaluate": ("evaluate", "FILE"),
    "optimize": ("optimize", "FILE", "-o", "OUT"),
    "export": ("export", "FILE", "-o", "OUT"),
    "sweep": ("sweep", "FILE", "-o", "OUT"),
    "tradeoff": ("tradeoff", "FILE", "-o", "OUT"),
    "readings": ("estimate", str(SCENE), "--readings", "FILE"),
    "bench": ("read", "--virtual", "--bench", "FILE"),
    "calibration": ("check", "--virtual", "--calibration", "FILE"),
    "recording": ("read", "--replay", "FILE"),
}


@pytest.mark.parametrize("command", COMMAND_LINES.values(), ids=COMMAND_LINES.keys())
@pytest.mark.parametrize("name", ["absent", "a folder", "empty", "a pipe", "without end", "nested", "not UTF-8"])
def test_what_is_no_such_file_is_refused(name: str, command: tuple[str, ...], tmp_path: Path) -> None:
    path = special(name, tmp_path)
    line = refused(*({"FILE": path, "OUT": tmp_path / "out"}.get(word, word) for word in command))
    assert "defect" not in line


def test_a_recording_without_samples_is_refused(recorded: bytes, tmp_path: Path) -> None:
    (tmp_path / "x.probe").write_bytes(recorded.partition(b"\n")[0] + b"\n")
    assert "no samples" in refused("read", SCENE, "--replay", tmp_path / "x.probe")


def test_a_recording_whose_name_is_too_long_is_refused(tmp_path: Path) -> None:
    assert "no such file" in refused("read", SCENE, "--replay", tmp_path / f"{'x' * 5000}.probe")


def write_other(name: str, folder: Path) -> Path:
    """What is no file of triangles: a pipe that nobody writes to, without end, huge but empty, a loop, a folder, a long name."""
    path = folder / "body.stl"
    if name == "a pipe":
        os.mkfifo(path)
    elif name == "sparse":
        with path.open("wb") as file:
            file.truncate(10 * 2**30)
    elif name != "a long name":
        path.symlink_to({"without end": "/dev/zero", "a loop": path.name, "a folder": folder}[name])
    return folder / f"{'x' * 5000}.stl" if name == "a long name" else path


@pytest.mark.skipif(os.name == "nt", reason="such files are POSIX systems'")
@pytest.mark.parametrize("command", ["evaluate", "plan"])
@pytest.mark.parametrize("name", ["a pipe", "without end", "a loop", "a folder", "sparse", "a long name"])
def test_what_is_no_surface_is_refused(name: str, command: str, tmp_path: Path) -> None:
    scene = tomllib.loads(SCENE.read_text())
    body = {key: value for key, value in scene["inclusion"][0].items() if key != "diameter"}
    text = tomli_w.dumps(scene | {"inclusion": [body | {"surface": str(write_other(name, tmp_path))}]})
    (tmp_path / "scene.toml").write_text(text)
    assert "inclusion[0].surface" in refused(command, tmp_path / "scene.toml", "--json")
