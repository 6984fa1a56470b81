"""Oscilloscopes: the responses of three families, by a fake resource, and pyvisa-py itself against a server on a socket."""

from __future__ import annotations

import socketserver
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from usb.core import USBError

from hw.common.errors import Disconnected, HardwareError, InvalidSource, NotFound, ProtocolError, Timeout
from hw.common.transport import Chunk
from hw.files.columns import ColumnMap, resolve_channel_numbers
from hw.oscilloscope.transport import ScopeTransport, translate_faults
from hw.reader import Reader

INTERVAL, POINTS = 2e-5, 600
CODES = (np.arange(POINTS) % 200 + 20, np.arange(POINTS) * 7 % 200 + 20)  # of eight bits, unsigned


ANSWERS = {
    "KEYSIGHT TECHNOLOGIES,DSOX1204G,CN1,2.1": "+0,+2,+600,+1,{interval},-6E-3,+0,{step},2.0E-2,+128",
    "RIGOL TECHNOLOGIES,DS1104Z,DS1,00.04": "0,0,600,1,{interval},-6e-3,0,{step},{origin},127",
    "TEKTRONIX,MSO24,C1,FV:1.0": "{interval};{step};0.0;2.0E-2",
}  # each family's words for the same scales
SCALES = (":WAVEFORM:PREAMBLE?", "WFMOUTPRE:XINCR?;YMULT?;YOFF?;YZERO?")


class Scope:
    """Respond as a family's programming guide lays down; channel 1 has 1 mV a code, channel 2 0.5 mV, both 20 mV offset."""

    def __init__(self, identity: str) -> None:
        self.identity, self.words, self.channel, self.closed = identity, list[str](), 1, False

    @property
    def signed(self) -> bool:
        return self.identity.startswith("TEK")

    def write(self, word: str) -> None:
        self.words.append(word)
        if "SOURCE" in word:
            self.channel = int(word[-1])

    def query(self, word: str) -> str:
        if word == "*IDN?":
            return self.identity + "\n"
        if word in ("*OPC?", ":TRIGGER:STATUS?"):
            return {"*OPC?": "1\n", ":TRIGGER:STATUS?": "STOP\n"}[word]
        assert word == SCALES[self.signed]
        step = 1e-3 / self.channel
        return ANSWERS[self.identity].format(interval=INTERVAL, step=step, origin=-0.02 / step) + "\n"

    def query_binary_values(self, word: str, datatype: str, container: type) -> bytes:
        assert (word, datatype, container) in ((":WAVEFORM:DATA?", "B", bytes), ("CURVE?", "B", bytes))
        return self.codes()

    def codes(self) -> bytes:
        codes = CODES[self.channel - 1] - 128 * self.signed
        return codes.astype(np.int8 if self.signed else np.uint8).tobytes()

    def close(self) -> None:
        self.closed = True


def truth(identity: str) -> np.ndarray:
    middle = {"K": 128, "R": 127, "T": 128}[identity[0]]
    return np.column_stack([1e-3 / (1 + k) * (CODES[k] - middle) + 0.02 for k in range(2)])


@pytest.mark.parametrize("identity", ANSWERS)
def test_families(identity: str, tmp_path: Path) -> None:
    scope = Scope(identity)
    with Reader(ScopeTransport(scope, "here")) as reader:
        live = reader.collect(1.5 * POINTS * INTERVAL, record=tmp_path / "run.probe")
    assert scope.closed
    assert live.rate == pytest.approx(1 / INTERVAL)
    assert live.source["serial"] == identity.split(",")[2]
    np.testing.assert_allclose(live.volts[:POINTS], truth(identity), atol=1e-12)
    assert [(gap.first, gap.count, gap.reason) for gap in live.gaps] == [(POINTS, -1, "a new acquisition")]
    np.testing.assert_array_equal(live.index, [*range(POINTS), *range(POINTS + 1, POINTS * 3 // 2)])
    with Reader.open(f"replay:{tmp_path / 'run.probe'}") as reader:
        repeated = reader.collect(1.5 * POINTS * INTERVAL)
    np.testing.assert_array_equal(repeated.volts, live.volts)
    assert repeated.gaps == live.gaps


@pytest.mark.parametrize("identity", ANSWERS)
def test_force_on_any_channel(identity: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Inner on 2, outer on 1, force on 4, which has 0.25 mV a code."""
    monkeypatch.setattr(Scope, "codes", lambda self: CODES_OF[self.signed][self.channel].tobytes())
    numbers = resolve_channel_numbers(ColumnMap.from_texts(("inner=2", "outer=CH1", "force=4")))
    with Reader(ScopeTransport(Scope(identity), "here", numbers)) as reader:
        live = reader.collect(POINTS * INTERVAL, record=tmp_path / "run.probe")
    assert live.channels == ("inner", "outer", "force")
    middle = {"K": 128, "R": 127, "T": 128}[identity[0]]
    by_hand = [1e-3 / k * (CODES[k % 2] - middle) + 0.02 for k in numbers.values()]
    np.testing.assert_allclose(live.volts, np.column_stack(by_hand), atol=1e-12)
    with Reader.open(f"replay:{tmp_path / 'run.probe'}") as reader:
        np.testing.assert_array_equal(reader.collect(POINTS * INTERVAL).volts, live.volts)


CODES_OF = {signed: {k: (CODES[k % 2] - 128 * signed).astype(np.int8 if signed else np.uint8) for k in (1, 2, 4)}
            for signed in (False, True)}  # fmt: skip


@pytest.mark.parametrize("words", [("force=9",), ("force=1",), ("time=3",), ("inner=CH2 mV",), ("outer=first",)])
def test_what_is_no_channel_is_refused(words: tuple[str, ...]) -> None:
    with pytest.raises(InvalidSource, match=r"allowed: (a channel|another channel)"):
        resolve_channel_numbers(ColumnMap.from_texts(words))


def test_rate_is_asked_for_and_checked() -> None:
    scope = Scope("RIGOL TECHNOLOGIES,DS1104Z,DS1,00.04")
    ScopeTransport(scope, "here", rate=1 / INTERVAL)
    assert ":TIMEBASE:MAIN:SCALE 0.002" in scope.words  # 100 samples a division, of 20 us
    with pytest.raises(InvalidSource, match="rate = 1000 Hz: here samples at 50000 Hz"):
        ScopeTransport(Scope("KEYSIGHT TECHNOLOGIES,DSOX1204G,CN1,2.1"), "here", rate=1000.0)


def test_codes_at_the_ends_are_saturated(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Scope, "codes", lambda self: bytes([0, 100, 255, 254]))
    with Reader(ScopeTransport(Scope("RIGOL TECHNOLOGIES,DS1104Z,DS1,00.04"), "here")) as reader:
        block = next(reader.blocks())
    np.testing.assert_array_equal(block.saturated, np.repeat([[True], [False], [True], [False]], 2, axis=1))


def test_unknown_family_is_refused() -> None:
    scope = Scope("ACME,1,2,3")
    with pytest.raises(ProtocolError, match="only families of keysight, rigol, tektronix are known"):
        ScopeTransport(scope, "here")
    assert scope.closed


def test_changed_time_base_is_refused() -> None:
    transport = ScopeTransport(Scope("TEKTRONIX,MSO24,C1,FV:1.0"), "here")
    first = transport.read()
    reader = Reader(transport)
    changed = Chunk(first.data, note=first.note.replace(str(INTERVAL), str(2 * INTERVAL)))
    transport._first = changed
    with pytest.raises(ProtocolError, match="leave the time base as it was"):
        next(reader.blocks())


def test_faults_of_visa_are_named() -> None:
    pyvisa = pytest.importorskip("pyvisa")
    status = pyvisa.constants.StatusCode
    for fault, kind in [
        (pyvisa.VisaIOError(status.error_timeout), Timeout), (pyvisa.VisaIOError(status.error_resource_not_found), NotFound),
        (pyvisa.VisaIOError(status.error_connection_lost), Disconnected), (pyvisa.InvalidSession(), Disconnected),
        (USBError("No such device", -4, 19), Disconnected), (ValueError("no langid"), Disconnected),
        (ConnectionResetError("reset"), Disconnected),
    ]:  # fmt: skip
        with pytest.raises(HardwareError) as caught, translate_faults("USB0::INSTR"):
            raise fault
        assert type(caught.value) is kind
        assert caught.value.__cause__ is fault
        assert "\n" not in str(caught.value)


class Line(socketserver.StreamRequestHandler):
    """A Rigol on a socket: commands by line, blocks by IEEE 488.2; disappears after a given number of acquisitions."""

    left = 2

    def handle(self) -> None:
        scope, done = Scope("RIGOL TECHNOLOGIES,DS1104Z,DS1,00.04"), 0
        for line in self.rfile:
            word = line.decode().strip()
            done += word == ":SINGLE"
            if done > self.left:
                return
            if word == ":WAVEFORM:DATA?":
                self.wfile.write(b"#9%09d" % POINTS + scope.codes() + b"\n")
            elif word.endswith("?"):
                self.wfile.write(scope.query(word).encode())
            else:
                scope.write(word)


@pytest.fixture
def resource() -> Iterator[str]:
    pytest.importorskip("pyvisa_py")
    with socketserver.ThreadingTCPServer(("127.0.0.1", 0), Line) as server:
        server.daemon_threads = True
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"TCPIP0::127.0.0.1::{server.server_address[1]}::SOCKET"
        server.shutdown()


def test_through_pyvisa_itself(resource: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hw.oscilloscope.transport._ACQUISITION_TIMEOUT_S", 1.0)
    with Reader.open(f"visa:{resource}") as reader:
        blocks = reader.blocks()
        for _ in range(2):
            np.testing.assert_allclose(next(blocks).volts, truth("RIGOL"), atol=1e-12)
        with pytest.raises(HardwareError, match="TCPIP0"):
            next(blocks)


@pytest.mark.parametrize(("name", "kind"), [("nonsense", InvalidSource), ("TCPIP0::127.0.0.1::1::SOCKET", HardwareError)])
def test_resources_that_cannot_be_opened(name: str, kind: type[HardwareError]) -> None:
    pytest.importorskip("pyvisa_py")
    with pytest.raises(kind, match=name[:6]):
        Reader.open(f"visa:{name}")
