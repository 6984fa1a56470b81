"""The firmware of examples/firmware, compiled and run; and a model of what docs/reference/protocol.md asks of it."""

from __future__ import annotations

import errno
import functools
import shutil
import struct
import subprocess
import tempfile
import zlib
from array import array
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from usb.core import USBError, USBTimeoutError

from hw.simulation.firmware import Firmware
from hw.simulation.virtual import VirtualProbe
from hw.wire.frames import FrameLayout, encode_frame
from hw.wire.protocol import Info, Status

ROOT = Path(__file__).resolve().parents[3]
FIRMWARE = ROOT / "examples" / "firmware"
SUPPORT = ROOT / "tests" / "support" / "hw"
SCRIPT, TINYUSB = SUPPORT / "firmware_script.c", SUPPORT / "tinyusb"
WARNINGS = ["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-Wconversion", "-Wsign-conversion", "-Wshadow"]
SANITIZERS = ["-g", "-O0", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
INFO = Info(2, 1000.0, 1000.0, (0.25, 0.5), "script of sixtee")  # the script's scale, and 16 characters of its name


def find_compiler() -> str:
    if compiler := shutil.which("gcc") or shutil.which("cc"):
        return compiler
    pytest.skip("no C compiler: apt-get install gcc libc6-dev")


def compile_firmware(sources: list[Path], *options: str) -> None:
    command = [find_compiler(), *WARNINGS, f"-I{FIRMWARE}", f"-I{TINYUSB}", *options, *map(str, sources)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@functools.cache
def build_program(main: Path) -> Path:
    """Compile a program with the firmware under the sanitizers, once in a process."""
    folder = tempfile.TemporaryDirectory(prefix="firmware-")
    program = Path(folder.name) / main.stem
    binding = [FIRMWARE / "tinyusb_board.c"] if main.stem == "tinyusb_core" else []
    compile_firmware([main, FIRMWARE / "probe_board.c", FIRMWARE / "drive.c", *binding], *SANITIZERS, "-o", str(program))
    _FOLDERS.append(folder)  # removed when the process ends
    return program


_FOLDERS: list[tempfile.TemporaryDirectory[str]] = []


@contextmanager
def posix_board(*options: str) -> Iterator[str]:
    """Run the board on a pseudo terminal and yield the terminal's name; its sanitizers must have had nothing to report."""
    program = build_program(FIRMWARE / "posix_board.c")
    pipe = subprocess.PIPE
    with subprocess.Popen([program, *options], stdin=pipe, stdout=pipe, stderr=pipe, text=True) as process:
        assert process.stdout is not None
        try:
            yield process.stdout.readline().strip()
        finally:
            _, errors = process.communicate("")
        assert (process.returncode, errors) == (0, "")


def run_script(script: bytes) -> bytes:
    done = subprocess.run([build_program(SCRIPT)], input=script, capture_output=True, check=False)
    assert (done.returncode, done.stderr) == (0, b"")
    return done.stdout


class BoundBoard(VirtualProbe):
    """The board as TinyUSB shows it: a backend of pyusb whose transfers go to tinyusb_core.c, descriptors included."""

    def __init__(self) -> None:
        pipe = subprocess.PIPE
        program = build_program(SUPPORT / "tinyusb_core.c")
        self._process = subprocess.Popen([program], stdin=pipe, stdout=pipe, stderr=pipe)
        super().__init__(Firmware(lambda times: np.zeros((len(times), 2)), 1000.0, (1.0, 1.0), 64), "A17", pace=False)

    def send_step(self, step: bytes) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(step)
        self._process.stdin.flush()

    def take(self, size: int) -> bytes:
        assert self._process.stdout is not None
        data = self._process.stdout.read(size)
        assert len(data) == size, self._process.communicate()[1].decode()
        return data

    def take_data(self) -> bytes:
        return self.take(int.from_bytes(self.take(2), "little"))

    def transfer(self, kind: int, number: int, value: int, index: int, data: bytes | int) -> bytes | None:
        """Return what a control transfer brings, or None if it is refused; ``data`` to the board, or how much from it."""
        length, sent = (data, b"") if isinstance(data, int) else (len(data), data)
        self.send_step(struct.pack("<cBBHHH", b"C", kind, number, value, index, length) + sent)
        return self.take_data() if self.take(1) == b"\1" else None

    def ctrl_transfer(
        self, dev_handle: int, bmRequestType: int, bRequest: int, wValue: int, wIndex: int, data: array[int], timeout: int
    ) -> int:
        is_in = bool(bmRequestType & 0x80)
        answer = self.transfer(bmRequestType, bRequest, wValue, wIndex, len(data) if is_in else bytes(data))
        if answer is None:
            raise USBError("Pipe error", -9, errno.EPIPE)
        memoryview(data).cast("B")[: len(answer)] = answer
        return len(answer) if is_in else len(data)

    def bulk_read(self, dev_handle: int, ep: int, intf: int, buff: array[int], timeout: int) -> int:
        data = b""
        while len(data) < len(buff):
            self.send_step(b"U")
            if not (packet := self.take_data()):
                break
            data += packet
        if not data:
            raise USBTimeoutError("Operation timed out", -7, errno.ETIMEDOUT)
        memoryview(buff).cast("B")[: len(data)] = data
        return len(data)

    def end(self) -> None:
        _, errors = self._process.communicate()
        assert (self._process.returncode, errors) == (0, b"")


class ModelBoard:
    """A board as the page describes it, over this project's own encoders. Each method returns the script's step and its result.

    ``capacity`` is the number of frames that are queued at most.
    """

    def __init__(self, channels: int, size: int, rate: float, capacity: int, is_serial: bool) -> None:
        self.layout, self.rate, self.highest, self.capacity, self.is_serial = (
            FrameLayout(size, channels),
            rate,
            rate,
            capacity,
            is_serial,
        )
        self.queue: list[bytes] = []
        self.rows: list[np.ndarray] = []
        self.stream = self.index = self.sent = self.overruns = self.flags = 0
        self.is_dropping = self.is_sending = self.takes_back = False
        self.received, self.out, self.partial = b"", b"", b""  # since the last request; the response; what is left of a frame

    def init(self) -> tuple[bytes, bytes]:
        rates = (1000, round(1e3 * self.highest), round(1e3 * self.rate), self.layout.size * (self.capacity + 1))
        return struct.pack("<cBHB4I", b"I", self.layout.channels, self.layout.size, self.is_serial, *rates), b"\1"

    def convert(self, codes: np.ndarray, saturated: int) -> tuple[bytes, bytes]:
        limit = min(self.layout.rows, 1 + int(self.rate / 20 + 1e-9))  # 50 ms after the first
        for row in codes if self.stream else []:
            if not self.rows and len(self.queue) == self.capacity:
                self.overruns += not self.is_dropping
                self.is_dropping = True
            else:
                self.flags, self.is_dropping = (self.flags if self.rows else int(self.is_dropping)), False
                self.rows.append(row)
                self.flags |= (saturated & (1 << self.layout.channels) - 1) << 4
            self.index += 1
            if len(self.rows) == limit:
                frame = {"stream": self.stream, "sequence": self.sent, "index": self.index - limit, "flags": self.flags}
                self.queue.append(encode_frame(self.layout, np.array(self.rows, np.int16), **frame))
                self.rows, self.sent = [], self.sent + 1
        return struct.pack("<cIB", b"V", len(codes), saturated) + codes.astype("<i2").tobytes(), b""

    def control(self, number: int, value: int, data: bytes) -> tuple[bytes, bytes]:
        granted, response = self.request(number, value, data)
        step = struct.pack("<cBHH", b"C", number, value, len(data)) + data
        return step, struct.pack("<BH", granted, len(response)) + response

    def request(self, number: int, value: int, data: bytes) -> tuple[bool, bytes]:
        if number == 1:
            scale = (0.25, 0.5, float(np.float32(1e-4)))[: self.layout.channels]
            size = self.layout.size if self.is_serial else 0
            return True, Info(self.layout.channels, self.rate, self.highest, scale, INFO.firmware, size).encode()
        if number == 5:
            return True, Status(self.stream, self.overruns, self.sent, self.index).encode()
        if number == 2 and not self.stream and len(data) == 4:
            self.rate = min(max(int.from_bytes(data, "little") / 1e3, 1.0), self.highest)
            return True, b""
        if number == 4 or (number == 3 and value):
            self.end_stream(self.takes_back)
            if number == 3:
                self.stream, self.index, self.sent, self.overruns, self.is_dropping = value, 0, 0, 0, False
            return True, b""
        return False, b""

    def end_stream(self, takes_back: bool) -> None:
        self.stream, self.rows = 0, []
        if takes_back:
            self.is_sending, self.partial = False, b""
        self.queue = self.queue[:1] if self.is_sending else []

    def reset(self) -> tuple[bytes, bytes]:
        self.end_stream(True)
        self.received = self.out = b""
        return b"B", b""

    def set_flush(self, takes_back: bool) -> tuple[bytes, bytes]:
        self.takes_back = takes_back
        return struct.pack("<cB", b"F", takes_back), b""

    def peek(self) -> tuple[bytes, bytes]:
        frame = self.queue[0] if self.queue else b""
        self.is_sending = bool(frame)
        return b"P", struct.pack("<H", len(frame)) + frame

    def release(self) -> tuple[bytes, bytes]:
        if self.is_sending:
            self.queue.pop(0)
        self.is_sending = False
        return b"L", b""

    def receive(self, data: bytes) -> tuple[bytes, bytes]:
        """Execute what ends a valid request: 14 bytes after the end of the last one."""
        taken = 0
        while taken < len(data) and not self.out:
            self.received += data[taken : taken + 1]
            taken += 1
            packet = self.received[-14:]
            if len(packet) == 14 and packet[:2] == b"PQ" and packet[10:] == struct.pack("<I", zlib.crc32(packet[:10])):
                number, value = packet[3], int.from_bytes(packet[4:6], "little")
                granted, response = self.request(number, value, packet[6:10]) if packet[2] == 1 else (False, b"")
                body = struct.pack("<2sBBH", b"PA", 1, number | 0x80 * (not granted), len(response)) + response
                self.received, self.out = b"", body + struct.pack("<I", zlib.crc32(body))
        return struct.pack("<cH", b"R", len(data)) + data, struct.pack("<H", taken)

    def transmit(self, capacity: int) -> tuple[bytes, bytes]:
        data = b""
        while len(data) < capacity and (self.partial or self.out or self.queue):
            if not self.partial and not self.out:
                self.partial, self.is_sending = self.queue[0], True
            if self.partial:
                part, self.partial = self.partial[: capacity - len(data)], self.partial[capacity - len(data) :]
                if not self.partial:
                    self.queue.pop(0)
                    self.is_sending = False
            else:
                part, self.out = self.out[: capacity - len(data)], self.out[capacity - len(data) :]
            data += part
        return struct.pack("<cH", b"T", capacity), struct.pack("<H", len(data)) + data
