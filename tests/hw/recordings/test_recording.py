"""Recordings: whole, cut, damaged, and replayed."""

from __future__ import annotations

import hashlib
import json
import re
import resource
import struct
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hw.common.errors import (
    InvalidSource,
    Stalled,
    Timeout,
    TransferError,
)
from hw.common.transport import Chunk
from hw.reader import Reader
from hw.recordings.recording import FILE_FORMAT, Recorder, Recording, compute_sha256
from hw.usb.device import UsbDevice
from hw.wire.stream import StreamTransport
from tests.support.hw.faulty_probe import Fault
from tests.support.hw.virtual_probes import HURRIED, probe, right


def test_samples_before_a_lasting_fault_are_kept(tmp_path: Path) -> None:
    with Reader(StreamTransport(UsbDevice("V1", probe(Fault("stall", 70, 1000))), patience=HURRIED)) as reader:
        blocks = reader.blocks(0.02, tmp_path / "run.probe")
        assert next(blocks).index[-1] == 699
        with pytest.raises(Stalled):
            list(blocks)
    with Reader.open(f"replay:{tmp_path / 'run.probe'}") as reader:
        assert len(reader.collect()) == 700


def test_replay_is_what_was_read(tmp_path: Path) -> None:
    path = tmp_path / "run.probe"
    faults = [Fault("drop", 30), Fault("stall", 60), Fault("power", 90), Fault("silence", 120)]
    with Reader.open(probe(*faults)) as reader:
        live = reader.collect(0.02, record=path)
    with Reader.open(f"replay:{path}") as reader:
        repeated = reader.collect(0.02)
    assert len(live.gaps) == 3
    assert (repeated.gaps, repeated.overruns, repeated.rate) == (live.gaps, live.overruns, live.rate)
    np.testing.assert_array_equal(repeated.index, live.index)
    np.testing.assert_array_equal(repeated.volts, live.volts)
    assert repeated.source == live.source | {"replayed": str(path)}


def test_recording_is_never_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "run.probe"
    path.write_text("mine")
    with Reader.open(probe()) as reader, pytest.raises(FileExistsError):
        reader.collect(0.01, record=path)
    assert path.read_text() == "mine"


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recording") / "run.probe"
    with Reader.open(probe()) as reader:
        reader.collect(0.3, record=path)
    return path


@given(st.data())
def test_cut_recording_is_whole_up_to_the_cut(recorded: Path, data: st.DataObject) -> None:
    whole = recorded.read_bytes()
    header = whole.index(b"\n") + 1
    end = data.draw(st.integers(header, len(whole) - 1))
    cut = recorded.with_name("cut.probe")
    cut.write_bytes(whole[:end])
    recording = Recording(cut)
    chunks = list(recording.read_chunks())
    full = list(Recording(recorded).read_chunks())
    assert chunks == full[: len(chunks)]
    assert recording.cut is not None
    assert "was cut or damaged at byte" in recording.cut
    assert sum(len(chunk.data) + 24 + len(chunk.note) for chunk in chunks) <= end - header


@settings(max_examples=25)
@given(st.data())
def test_one_flipped_bit_costs_a_frame(recorded: Path, data: st.DataObject) -> None:
    """It ended the recording before, without a word: up to half of the samples were lost."""
    content = bytearray(recorded.read_bytes())
    position = data.draw(st.integers(content.index(b"\n") + 1, len(content) - 25))
    content[position] ^= 1 << data.draw(st.integers(0, 7))
    path = recorded.with_name("damaged.probe")
    path.write_bytes(content)
    with Reader.open(f"replay:{path}") as reader:
        samples = reader.collect()
    assert right(samples)
    assert len(samples) >= 30_000 - 2 * 10  # two frames of ten, where it makes a magic of what is none
    assert len(samples) + sum(gap.count for gap in samples.gaps) in (30_000, 30_000 - 10)  # the last frame leaves no gap
    assert "is damaged at byte" in samples.notes[0]
    with pytest.raises(TransferError, match="read again"):
        samples.require_complete()


def test_damage_in_the_middle_is_a_gap_with_its_reason(recorded: Path) -> None:
    content = recorded.read_bytes()
    positions = [match.start() for match in re.finditer(b"READ", content)]
    path = recorded.with_name("wiped.probe")
    path.write_bytes(content[: positions[2] + 50] + bytes(positions[4] - positions[2] - 50) + content[positions[4] :])
    with Reader.open(f"replay:{path}") as reader:
        samples = reader.collect()
    assert right(samples)
    assert [gap.reason for gap in samples.gaps] == [f"the recording is damaged at byte {positions[2]}"]
    assert len(samples) + samples.gaps[0].count == 30_000


def test_a_full_disk_ends_the_recording_not_the_reading(tmp_path: Path) -> None:
    """A file may be as large as the limit on files allows: what reaches the disk until then is whole, and read again."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, limits[1]))
    try:
        with Reader.open(probe()) as reader:
            live = reader.collect(0.3, record=tmp_path / "run.probe")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert len(live) == 30_000
    assert right(live)
    assert "the recording ends early, whole up to there: file too large" in live.notes[0]
    with Reader.open(f"replay:{tmp_path / 'run.probe'}") as reader:
        repeated = reader.collect()
    assert right(repeated)
    np.testing.assert_array_equal(repeated.index, live.index[: len(repeated)])
    assert 0 < len(repeated) < 30_000


def test_a_disk_that_is_full_from_the_beginning_leaves_no_recording(tmp_path: Path) -> None:
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, limits[1]))
    try:
        with Reader.open(probe()) as reader, pytest.raises(OSError, match="File too large"):
            reader.collect(0.1, record=tmp_path / "run.probe")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_is_not_there_is_an_error(tmp_path: Path) -> None:
    with Reader.open(probe()) as reader, pytest.raises(FileNotFoundError):
        reader.collect(0.01, record=tmp_path / "none" / "run.probe")


KILLED = """
import sys, time
import numpy as np
from hw.reader import Reader
from hw.simulation.virtual import make_virtual_probe

source = make_virtual_probe(lambda times: np.column_stack([np.sin(31 * times), np.cos(31 * times)]), 1e4, scale=1e-4)
with Reader.open(source) as reader:
    for block in reader.blocks(60.0, record=sys.argv[1]):
        if block.index[-1] > 20_000:
            print("recorded", flush=True)
            time.sleep(1000)
"""


def test_a_killed_recording_is_read_up_to_the_kill(tmp_path: Path) -> None:
    with subprocess.Popen([sys.executable, "-c", KILLED, str(tmp_path / "a.probe")], stdout=subprocess.PIPE) as running:
        assert running.stdout is not None
        assert running.stdout.readline() == b"recorded\n"
        running.kill()
    with Reader.open(f"replay:{tmp_path / 'a.probe'}") as reader:
        samples = reader.collect()
    assert len(samples) > 20_000
    assert any("was cut" in note for note in samples.notes)
    np.testing.assert_allclose(samples.volts[:, 0], np.sin(31 * samples.times), atol=1e-4)


def test_a_cut_recording_says_so(recorded: Path) -> None:
    path = recorded.with_name("short.probe")
    path.write_bytes(recorded.read_bytes()[:-100])
    with Reader.open(f"replay:{path}") as reader:
        samples = reader.collect()
    assert "was cut" in samples.notes[0]
    with pytest.raises(TransferError, match="was cut"):
        samples.require_complete()


def test_recording_is_laid_out_as_documented(tmp_path: Path) -> None:
    transport = StreamTransport(UsbDevice("V1", probe()))
    with Recorder(tmp_path / "a", transport.header) as recorder:
        recorder.write(Chunk(b"bytes", 7, "note"))
    line, _, remainder = (tmp_path / "a").read_bytes().partition(b"\n")
    header = json.loads(line)
    assert (header.pop("format"), header.pop("version")) == (FILE_FORMAT, 1)
    assert header == json.loads(json.dumps(asdict(transport.header)))
    tag, _, stream, note, length = struct.unpack_from("<4sdHHI", remainder)
    assert (tag, stream, note, length, remainder[20:29]) == (b"READ", 7, 4, 5, b"notebytes")
    assert remainder[33:37] == b"DONE"
    assert len(remainder) == 33 + 24
    assert compute_sha256(tmp_path / "a") == hashlib.sha256((tmp_path / "a").read_bytes()).hexdigest()


@pytest.mark.parametrize("text", [b"", b"{}\n", b"[1]\n", b"\xff\xfe\n", b'{"format": "probe-design recording", "version": 1}\n'])
def test_not_a_recording(text: bytes, tmp_path: Path) -> None:
    path = tmp_path / "x"
    path.write_bytes(text)
    with pytest.raises(InvalidSource, match="is not a recording"):
        Reader.open(f"replay:{path}")


def test_recording_of_another_version(tmp_path: Path) -> None:
    path = tmp_path / "x"
    path.write_bytes(b'{"format": "probe-design recording", "version": 2}\n')
    with pytest.raises(InvalidSource, match="version 2: this program reads"):
        Reader.open(f"replay:{path}")


def test_empty_recording_has_no_samples(tmp_path: Path) -> None:
    Recorder(tmp_path / "x", StreamTransport(UsbDevice("V1", probe())).header).close()
    with Reader.open(f"replay:{tmp_path / 'x'}") as reader, pytest.raises(Timeout, match="no samples"):
        reader.collect()
