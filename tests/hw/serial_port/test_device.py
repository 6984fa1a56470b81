"""A board on a serial port: the other end of a pseudo-terminal, written from docs/reference/protocol.md with ``struct`` alone."""

from __future__ import annotations

import os
import select
import struct
import sys
import threading
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import SimpleNamespace

import numpy as np
import pytest

from hw.common.errors import Disconnected, InvalidSource, NotFound, ProtocolError, Timeout
from hw.common.samples import Samples
from hw.reader import Reader
from hw.serial_port import device
from hw.serial_port.device import SerialDevice
from hw.serial_port.packets import encode_request, encode_response, find_response
from hw.wire.stream import Patience, StreamTransport
from tests.support.hw.frame_truth import SCALE, codes_at

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="Windows has no pseudo-terminals")
SIZE, ROWS = 64, 10


class Board(threading.Thread):
    """Respond to requests and, once started, sends frames; ``spoil`` is done to each frame's bytes by its number."""

    def __init__(self, spoil=None, deaf: bool = False, size: int = SIZE, most: int = 2000) -> None:  # type: ignore[no-untyped-def]
        super().__init__(daemon=True)
        self.master, slave = os.openpty()
        os.set_blocking(self.master, False)  # a port that nobody reads is full at some time, and the board goes on waiting
        self.port = os.ttyname(slave)
        self.slave, self.spoil, self.deaf, self.size, self.max_rows = slave, spoil or (lambda k, data: data), deaf, size, most
        self.stream, self.sent, self.rate, self.requests = 0, 0, 100_000, list[int]()
        self.unplugged = False

    def encode_response(self, number: int, value: int, data: int) -> bytes:
        if number == 1:
            return struct.pack("<BBHII4f16s", 1, 2, self.size, self.rate, 4_000_000, SCALE, SCALE, 0, 0, b"pty 1")
        if number == 2:
            self.rate = data
        if number == 3:
            self.stream, self.sent = value, 0
        if number == 4:
            self.stream = 0
        return struct.pack("<HHIQ", self.stream, 0, self.sent, ROWS * self.sent) if number == 5 else b""

    def frame(self) -> bytes:
        codes = codes_at(np.arange(ROWS * self.sent, ROWS * (self.sent + 1)))
        body = (
            struct.pack("<2sBBIQHBB", b"PD", 1, 2, self.sent, ROWS * self.sent, self.stream, ROWS, 0)
            + codes.astype("<i2").tobytes()
        )
        body = body.ljust(SIZE - 4, b"\0")
        return body + struct.pack("<I", zlib.crc32(body))

    def send(self, data: bytes) -> None:
        while data and not self.unplugged:
            with suppress(BlockingIOError):
                data = data[os.write(self.master, data) :]
            select.select([], [self.master], [], 0.01 if data else 0.0)

    def run(self) -> None:
        waiting = b""
        try:
            while not self.unplugged:
                idle = not self.stream or self.sent >= self.max_rows
                if select.select([self.master], [], [], 0.01 if idle else 0.0)[0]:
                    waiting += os.read(self.master, 4096)
                while len(waiting) >= 14:
                    magic, _, number, value, data, crc = struct.unpack("<2sBBHII", waiting[:14])
                    assert (magic, crc) == (b"PQ", zlib.crc32(waiting[:10]))
                    waiting = waiting[14:]
                    self.requests.append(number)
                    if not self.deaf:
                        data = self.encode_response(number, value, data)
                        body = struct.pack("<2sBBH", b"PA", 1, number, len(data)) + data
                        self.send(body + struct.pack("<I", zlib.crc32(body)))
                if self.stream and self.sent < self.max_rows:
                    self.send(self.spoil(self.sent, self.frame()))
                    self.sent += 1
        except OSError:  # nobody listens any more
            return
        finally:
            os.close(self.master)


@contextmanager
def board(**settings: object) -> Iterator[Board]:
    made = Board(**settings)  # type: ignore[arg-type]
    made.start()
    yield made
    os.close(made.slave)
    made.unplugged = True
    made.join(10.0)


def read(made: Board, rows: int) -> Samples:
    with Reader(StreamTransport(SerialDevice(made.port))) as reader:
        return reader.collect(rows / reader.header.rate)


def right(samples: Samples) -> bool:
    return bool((samples.volts == codes_at(samples.index) * SCALE).all())


def test_every_sample_once() -> None:
    with board() as made:
        samples = read(made, 3000)
    np.testing.assert_array_equal(samples.index, np.arange(3000))
    assert right(samples)
    assert (samples.rate, samples.gaps, samples.source["firmware"]) == (100.0, (), "pty 1")
    assert made.requests[:3] == [4, 1, 3]


def test_a_board_starts_when_it_is_read() -> None:
    with board() as made, Reader(StreamTransport(SerialDevice(made.port))) as reader:
        assert made.stream == 0
        next(iter(reader.blocks(1.0)))
        assert made.stream > 0


def test_the_serial_number_is_the_board_s_and_not_the_port_s(monkeypatch: pytest.MonkeyPatch) -> None:
    with board() as made, Reader.open(f"serial:{made.port}") as reader:
        assert (reader.header.source["serial"], reader.header.source["port"]) == ("", made.port)
        known = SimpleNamespace(comports=lambda: [SimpleNamespace(device=made.port, serial_number="A17")])
        monkeypatch.setitem(sys.modules, "serial.tools.list_ports", known)
        assert device._find_serial_number(made.port) == "A17"


def test_rate_is_asked_for() -> None:
    with board() as made, Reader.open(f"serial:{made.port}", 250.0) as reader:
        assert reader.header.rate == 250.0
        assert right(reader.collect(1.0))


@pytest.mark.parametrize(
    "spoil",
    [
        lambda k, data: b"" if k in (7, 8) else data,
        lambda k, data: data[:20] + b"\xff" + data[21:] if k in (7, 8) else data,
        lambda k, data: data[:13] if k in (7, 8) else data,
    ],
    ids=["lost", "damaged", "cut"],
)
def test_what_the_line_loses_is_a_gap(spoil: object) -> None:
    with board(spoil=spoil) as made:
        samples = read(made, 1000)
    assert [(gap.first, gap.count) for gap in samples.gaps] == [(70, 20)]
    assert right(samples)


def test_noise_between_frames_is_skipped() -> None:
    with board(spoil=lambda k, data: b"PDPAPQ" * (k % 3) + data) as made:
        samples = read(made, 1000)
    assert samples.gaps == ()
    assert right(samples)


def test_a_port_without_a_probe(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(device, "RESPONSE_TIMEOUT_S", 0.05)
    monkeypatch.setattr(SerialDevice, "wake_seconds", 0.1)
    with board(deaf=True) as made, pytest.raises(Timeout, match="is it the probe's port"):
        StreamTransport(SerialDevice(made.port))
    with board(size=7) as made, pytest.raises(ProtocolError, match="frames of 7 bytes"):
        StreamTransport(SerialDevice(made.port))
    with pytest.raises(NotFound, match="no such port"):
        StreamTransport(SerialDevice("/dev/absent"))
    with pytest.raises(InvalidSource, match="rate"):
        StreamTransport(SerialDevice("/dev/absent"), rate=-1.0)


def test_silence_and_unplugging_end_the_reading() -> None:
    with board(most=20) as made:
        silent = StreamTransport(SerialDevice(made.port), patience=Patience(silence=0.0))
        with pytest.raises(Timeout, match="does not respond: unplug"):
            Reader(silent).collect(100.0)
        silent.close()
    with board(most=20) as made:
        gone = StreamTransport(SerialDevice(made.port), patience=Patience(absence=0.0))
        made.unplugged = True
        made.join()
        with pytest.raises(Disconnected, match="did not come back"):
            Reader(gone).collect(100.0)
        gone.close()


def test_without_pyserial(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "serial", None)
    with pytest.raises(InvalidSource, match="pip install pyserial"):
        StreamTransport(SerialDevice("/dev/absent"))


def test_packets_are_found_among_frames() -> None:
    """The bytes that docs/reference/protocol.md lays down, by hand, and whatever stands around them."""
    by_hand = b"PQ\x01\x03\x34\x12\x00\x00\x00\x00"
    assert encode_request(3, 0x1234) == by_hand + struct.pack("<I", zlib.crc32(by_hand))
    assert find_response(b"PA\x01" + b"xPA" + encode_response(5, b"abc") + b"rest", 5) == (True, b"abc", b"PA\x01xPArest")
    assert find_response(encode_response(5 | 0x80), 5) == (False, b"", b"")
    assert find_response(encode_response(5, b"abc")[:-1], 5) is None
