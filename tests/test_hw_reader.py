"""Reader, recovery and recordings, with a virtual probe on a virtual bus."""

from __future__ import annotations

import errno
import hashlib
import json
import struct
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from usb.core import NoBackendError, USBError, USBTimeoutError

from hw.errors import (
    AccessDenied,
    Busy,
    Disconnected,
    HardwareError,
    InvalidSource,
    NotFound,
    Overrun,
    ProtocolError,
    Stalled,
    Timeout,
    TransferError,
)
from hw.firmware import Fault, Halted, Kind
from hw.frames import HIGHEST, LOWEST
from hw.protocol import START
from hw.reader import Reader
from hw.recording import KIND, Recorder, read_recording, sha256
from hw.samples import Floats, Gap, Samples
from hw.transport import Chunk
from hw.usb import Patience, UsbTransport
from hw.usb_faults import meaning
from hw.virtual import Virtual, virtual

RATE, SCALE = 1e5, 2.0**-12
LOST = "frames were lost or damaged on the way"
HURRIED = Patience(silence=0.0, absence=0.2)


def signals(t: Floats) -> Floats:
    """Volts that are whole counts, different for every index of a test."""
    index = np.rint(t * RATE).astype(np.int64)
    return np.column_stack([7919 * index % 65533 - 32766, 104729 * index % 65533 - 32766]) * SCALE


def probe(*faults: Fault, packet: int = 64) -> Virtual:
    return virtual(signals, RATE, serial="V1", faults=faults, scale=SCALE, packet=packet)


def read(source: Virtual, seconds: float = 0.02, patience: Patience = HURRIED) -> Samples:
    with Reader(UsbTransport("V1", backend=source, patience=patience)) as reader:
        return reader.collect(seconds)


def right(samples: Samples) -> bool:
    return bool((samples.volts == signals(samples.times)).all())


@pytest.mark.parametrize("packet", [64, 511, 512, 513, 1024])
def test_every_sample_once(packet: int) -> None:
    found = read(probe(packet=packet), 1.0)
    np.testing.assert_array_equal(found.index, np.arange(100_000))
    assert right(found)
    assert found.whole() is found
    assert (found.rate, found.channels) == (RATE, ("inner", "outer"))
    assert found.source["serial"] == "V1"
    assert found.source["scale"] == [SCALE, SCALE]


@pytest.mark.parametrize(
    ("kind", "count", "lost", "reason"),
    [
        ("drop", 3, 30, LOST), ("corrupt", 2, 20, LOST), ("cut", 4, 10, LOST), ("repeat", 3, 0, ""), ("silence", 1, 0, ""),
        ("overrun", 2, 20, "the device's buffer ran over"), ("stall", 3, 30, "the endpoint was halted"),
        ("error", 2, 20, "the bus failed"),
        ("unplug", 1, 10, "the device was unplugged, and came back at bus 1 address 3"),
    ],
)  # fmt: skip
def test_fault_becomes_a_gap(kind: Kind, count: int, lost: int, reason: str) -> None:
    found = read(probe(Fault(kind, 70, count, 0.02)), patience=Patience(absence=1.0))
    assert found.gaps == ((Gap(700, lost, reason),) if lost else ())
    assert right(found)
    np.testing.assert_array_equal(found.index, [*range(700), *range(700 + lost, 2000)])


def test_faults_with_data_between_are_borne_for_ever() -> None:
    found = read(probe(*(Fault("stall", at) for at in range(0, 1000, 100))), 0.2)
    assert len(found.gaps) == 10
    assert right(found)


def test_lost_power_is_a_gap_of_unknown_length() -> None:
    found = read(probe(Fault("power", 70)))
    assert [(gap.first, gap.count) for gap in found.gaps] == [(700, -1)]
    np.testing.assert_array_equal(found.index, [*range(700), *range(701, 2000)])
    begun_anew = replace(found, index=np.where(found.index > 700, found.index - 701, found.index))
    assert right(begun_anew)


@pytest.mark.parametrize(
    ("kind", "error", "remedy"),
    [
        ("stall", Stalled, "unplug it and plug it in again"), ("error", TransferError, "try another cable or port"),
        ("unplug", Disconnected, "check plug and cable"), ("silence", Timeout, "it is there and says nothing"),
    ],
)  # fmt: skip
def test_lasting_fault_is_named(kind: Kind, error: type[HardwareError], remedy: str) -> None:
    with pytest.raises(error, match=remedy) as caught:
        read(probe(Fault(kind, 70, 1000, 1.0)))
    assert isinstance(caught.value.__cause__, USBError)
    assert "\n" not in str(caught.value)
    assert caught.value.exit_code == 1


def test_samples_before_a_lasting_fault_are_kept(tmp_path: Path) -> None:
    with Reader(UsbTransport("V1", backend=probe(Fault("stall", 70, 1000)), patience=HURRIED)) as reader:
        blocks = reader.blocks(0.02, tmp_path / "run.probe")
        assert next(blocks).index[-1] == 699
        with pytest.raises(Stalled):
            list(blocks)
    with Reader.open(f"replay:{tmp_path / 'run.probe'}") as reader:
        assert len(reader.collect()) == 700


@given(st.lists(st.tuples(st.sampled_from(["drop", "corrupt", "cut", "repeat", "overrun", "stall", "error", "silence", "unplug"]),
    st.integers(0, 180), st.integers(1, 3)), max_size=6), st.sampled_from([64, 100, 513]))  # fmt: skip
def test_any_faults_give_right_samples_or_gaps(faults: list[tuple[Kind, int, int]], packet: int) -> None:
    source = probe(*(Fault(*fault) for fault in faults), packet=packet)
    try:
        found = read(source, patience=Patience(attempts=100))
    except Timeout:  # the end of the stream may be in a gap, and nothing after it
        pytest.fail("the stream never ends")
    assert right(found)
    lost = [np.arange(gap.first, gap.first + gap.count) for gap in found.gaps]
    covered = np.sort(np.concatenate([found.index, *lost]))
    np.testing.assert_array_equal(covered, np.arange(len(covered)))


def test_saturation_is_marked_where_it_is() -> None:
    source = virtual(lambda t: np.column_stack([40_000 * np.sin(t * 700), 0 * t]) * SCALE, RATE, "V1", scale=SCALE)
    found = read(source)
    truth = 40_000 * np.sin(found.times * 700)
    np.testing.assert_array_equal(found.saturated[:, 0], (np.rint(truth) >= HIGHEST) | (np.rint(truth) <= LOWEST))
    assert not found.saturated[:, 1].any()
    assert found.saturated[:, 0].any()


def test_three_channels_and_another_rate() -> None:
    source = virtual(lambda t: np.column_stack([t, 2 * t, 3 * t]), RATE, "V1", channels=3, scale=2.0**-10)
    with Reader.open(source, rate=1000.0) as reader:
        found = reader.collect(2.0)
    assert (found.rate, found.channels, len(found)) == (1000.0, ("inner", "outer", "force"), 2000)
    np.testing.assert_allclose(found.volts, np.arange(2000)[:, None] / 1000 * [1, 2, 3], atol=2.0**-11)


def test_calibration_takes_only_whole_samples() -> None:
    with pytest.raises(Overrun, match="ran over 1 times"):
        read(probe(Fault("overrun", 70))).whole()
    with pytest.raises(TransferError, match="from index 700 on were lost"):
        read(probe(Fault("drop", 70))).whole()


def test_device_is_stopped_at_the_end() -> None:
    source = probe()
    with Reader.open(source) as reader:
        reader.collect(0.01)
        assert source.firmware.stream
    assert source.firmware.stream == 0


def test_progress_and_blocks() -> None:
    told: list[float] = []
    with Reader.open(probe()) as reader:
        reader.collect(0.2, progress=told.append)
    assert told == sorted(told)
    assert told[-1] == 0.2
    assert len(told) > 2


@pytest.mark.parametrize("source", ["", "usbs", "visa:", "replay", "virtual:x"])
def test_unknown_sources(source: str) -> None:
    with pytest.raises(InvalidSource, match="allowed: usb, usb:SERIAL, visa:RESOURCE, replay:FILE") as caught:
        Reader.open(source)
    assert caught.value.exit_code == 2


@pytest.mark.parametrize("rate", [0.0, -1.0, float("nan"), 1e9])
def test_impossible_rates(rate: float) -> None:
    with pytest.raises(InvalidSource, match=r"rate = .* allowed: 0.001 to 4000000 Hz"):
        Reader.open(probe(), rate)


@pytest.mark.parametrize("seconds", [0.0, -1.0, float("nan"), float("inf"), 1e-9])
def test_impossible_durations(seconds: float) -> None:
    with Reader.open(probe()) as reader, pytest.raises(InvalidSource, match="allowed: a sample, 1e-05 s, or more"):
        reader.collect(seconds)


def test_probe_that_a_dead_program_left_running() -> None:
    source = probe()
    source.firmware.control(START, 9, b"")
    with Reader.open(source, rate=50_000.0) as reader:
        assert reader.header.rate == 50_000.0
        assert reader.collect(0.01).index[0] == 0


def test_board_that_knows_no_requests(monkeypatch: pytest.MonkeyPatch) -> None:
    source = probe()

    def refuses(request: int, value: int, data: bytes) -> bytes:
        raise Halted

    monkeypatch.setattr(source.firmware, "control", refuses)
    with pytest.raises(ProtocolError, match=r"probe V1 refuses the requests of docs/protocol.md"):
        Reader.open(source)


def test_other_serial_is_not_found() -> None:
    with pytest.raises(NotFound, match=r"probe V2 .* is not connected: .*V1"):
        UsbTransport("V2", backend=probe())


def test_replay_is_what_was_read(tmp_path: Path) -> None:
    path = tmp_path / "run.probe"
    faults = [Fault("drop", 30), Fault("stall", 60), Fault("power", 90), Fault("silence", 120)]
    with Reader.open(probe(*faults)) as reader:
        live = reader.collect(0.02, record=path)
    with Reader.open(f"replay:{path}") as reader:
        again = reader.collect(0.02)
    assert len(live.gaps) == 3
    assert (again.gaps, again.overruns, again.rate) == (live.gaps, live.overruns, live.rate)
    np.testing.assert_array_equal(again.index, live.index)
    np.testing.assert_array_equal(again.volts, live.volts)
    assert again.source == live.source | {"replayed": str(path)}


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
    recording = read_recording(cut)
    chunks = list(recording.chunks())
    full = list(read_recording(recorded).chunks())
    assert chunks == full[: len(chunks)]
    assert recording.cut is not None
    assert "was cut or damaged at byte" in recording.cut
    assert sum(len(chunk.data) + 24 + len(chunk.note) for chunk in chunks) <= end - header


def test_damaged_recording_ends_at_the_damage(recorded: Path) -> None:
    data = bytearray(recorded.read_bytes())
    data[data.index(b"READ", data.index(b"READ") + 1) + 30] ^= 1
    path = recorded.with_name("damaged.probe")
    path.write_bytes(data)
    with Reader.open(f"replay:{path}") as reader:
        found = reader.collect()
    assert right(found)
    assert 0 < len(found) < 30_000
    assert "damaged.probe was cut or damaged" in found.source["cut"]


def test_recording_is_laid_out_as_documented(tmp_path: Path) -> None:
    transport = UsbTransport("V1", backend=probe())
    with Recorder(tmp_path / "a", transport.header) as recorder:
        recorder.write(Chunk(b"bytes", 7, "note"))
    line, _, rest = (tmp_path / "a").read_bytes().partition(b"\n")
    told = json.loads(line)
    assert (told.pop("format"), told.pop("version")) == (KIND, 1)
    assert told == json.loads(json.dumps(asdict(transport.header)))
    tag, _, stream, note, length = struct.unpack_from("<4sdHHI", rest)
    assert (tag, stream, note, length, rest[20:29]) == (b"READ", 7, 4, 5, b"notebytes")
    assert rest[33:37] == b"DONE"
    assert len(rest) == 33 + 24
    assert sha256(tmp_path / "a") == hashlib.sha256((tmp_path / "a").read_bytes()).hexdigest()


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
    Recorder(tmp_path / "x", UsbTransport("V1", backend=probe()).header).close()
    with Reader.open(f"replay:{tmp_path / 'x'}") as reader, pytest.raises(Timeout, match="no samples"):
        reader.collect()


@pytest.mark.parametrize(
    ("fault", "kind"),
    [
        (USBTimeoutError("", None, 60), Timeout), (USBError("", -7, 60), Timeout), (USBError("", -9, None), Stalled),
        (USBError("", -4, 6), Disconnected), (USBError("", None, errno.ENODEV), Disconnected),
        (USBError("", -3, 13), AccessDenied), (USBError("", -6, 16), Busy), (USBError("", -1, 5), TransferError),
        (USBError("", -99, None), TransferError), (NotImplementedError(), AccessDenied), (NoBackendError(""), NotFound),
        (ProtocolError(""), TransferError),
    ],
)  # fmt: skip
def test_meaning_of_faults_by_class_and_code(fault: Exception, kind: type[HardwareError]) -> None:
    """libusb's codes (libusb.h) tell, whatever a system's errno says: 60 is ETIMEDOUT on macOS, ENOSTR on Linux."""
    assert meaning(fault) is kind


def test_access_denied_prints_the_shipped_rule() -> None:
    rule = 'SUBSYSTEM=="usb", ATTR{idVendor}=="1209", ATTR{idProduct}=="0001", MODE="0660", TAG+="uaccess"'
    shipped = (Path(__file__).parents[1] / "hw" / "60-probe-design.rules").read_text(encoding="utf-8")
    assert rule in shipped.splitlines()
    assert rule in str(AccessDenied("probe V1"))
