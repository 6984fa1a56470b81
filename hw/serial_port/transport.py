"""The vendor stream over a serial port, with recovery: what was lost becomes a gap, never a splice.

A port that goes away is opened again by its name; if the board still counts the same stream, the gap's length follows from its
counter; if not, another stream is begun and the gap's length is unknown.
"""

from __future__ import annotations

import errno
import os
import random
import struct
import time
from contextlib import suppress
from importlib import import_module
from typing import Any

from hw.common.errors import Busy, Disconnected, HardwareError, InvalidSource, NotFound, ProtocolError, Timeout, TransferError
from hw.common.transport import Chunk, Header, now
from hw.serial_port.packets import found, request
from hw.wire.frames import CHANNELS, LARGEST, SMALLEST
from hw.wire.protocol import GET_INFO, GET_STATUS, SET_RATE, START, STOP, Info, Status

BAUD = 115_200  # which a CDC board ignores
PATIENCE = 1.0  # s, for one answer
WAKING = 3.0  # s: some boards start anew when their port is opened
LARGEST_READ = 1 << 16
_KINDS: dict[int | None, type[HardwareError]] = {errno.ENOENT: NotFound, errno.EBUSY: Busy, errno.EAGAIN: Busy}


class SerialTransport:
    """Reads one probe on a serial port.

    Args:
        port: its name, ``/dev/ttyACM0`` or ``COM3``.
        rate: Hz to ask for; None: as it is.
        silence: s without a byte before giving up.
        absence: s after the port went away before giving up.

    Raises:
        InvalidSource: pyserial is not installed, or no rate that a board can be asked for.
        HardwareError: no such port, busy, access denied, or no probe answers.
    """

    def __init__(self, port: str, rate: float | None = None, silence: float = 3.0, absence: float = 10.0) -> None:
        if rate is not None and not 1e-3 <= rate <= 4e6:
            raise InvalidSource(f"rate = {rate} Hz: allowed: 0.001 to 4000000 Hz")
        self._name, self._silence, self._absence = port, silence, absence
        self._stream, self._heard, self._note, self._rest = random.randint(1, 0xFFFF), time.monotonic(), "", b""
        self._started = False
        self._port = self._opened()
        try:
            self.header = self._begin(rate)
        except HardwareError:
            self._port.close()
            raise
        except OSError as fault:
            self._port.close()
            raise self._named(fault) from fault

    def read(self) -> Chunk:
        """Return what came; no bytes when none did in time. The first call starts the stream.

        Raises:
            HardwareError: the port went away and did not come back, or nothing was heard for long.
        """
        if not self._started:
            self._start()
        data, self._rest = self._rest, b""
        try:
            data += self._port.read(max(1, min(self._port.in_waiting, LARGEST_READ)))
        except OSError as fault:  # pyserial's own exception is one
            self._reopen(fault)
        if data:
            self._heard = time.monotonic()
        elif time.monotonic() - self._heard > self._silence:
            raise Timeout(f"serial:{self._name}: it is there and says nothing: unplug it and plug it in again")
        note, self._note = self._note, "" if data else self._note
        return Chunk(data, self._stream, note, time.monotonic())

    def close(self) -> None:
        """Stop the stream and let go of the port."""
        with suppress(OSError):  # a flush would wait for ever for a board that no longer listens
            self._port.write(request(STOP))
        self._port.close()

    def _opened(self) -> Any:
        try:
            serial = import_module("serial")
        except ImportError as missing:
            raise InvalidSource("serial ports need pyserial: pip install pyserial") from missing
        try:
            port = serial.Serial(self._name, BAUD, timeout=0.1, write_timeout=PATIENCE, exclusive=True)
        except (OSError, ValueError) as fault:
            raise self._named(fault) from fault
        return port

    def _named(self, fault: Exception) -> HardwareError:
        """Return the error of our family for what pyserial raised."""
        text, number = f"serial:{self._name}", getattr(fault, "errno", None)
        if number in (errno.EACCES, errno.EPERM) or isinstance(fault, PermissionError):
            remedy = "join the port's group (sudo usermod -aG dialout $USER), log out and in again; or another program holds it"
            return TransferError(f"{text}: access denied: {remedy}")
        kind = _KINDS.get(number, NotFound if isinstance(fault, ValueError) else TransferError)
        remedies = {NotFound: "there is no such port: is the board plugged in?", Busy: "another program holds it: close that"}
        return kind(f"{text}: {remedies.get(kind, 'it cannot be read')} ({' '.join(str(fault).split())})")

    def _begin(self, rate: float | None) -> Header:
        """Wake the board, set the rate and describe what will come."""
        self._awake()
        if rate is not None:
            self._ask(SET_RATE, data=round(1e3 * rate))
        told = self._ask(GET_INFO)
        info = Info.decoded(told)
        (size,) = struct.unpack_from("<H", told, 2)
        if not SMALLEST <= size <= LARGEST:
            raise ProtocolError(f"serial:{self._name} states frames of {size} bytes: allowed: {SMALLEST} to {LARGEST}")
        source: dict[str, Any] = {
            "transport": "serial", "serial": _serial_number(self._name), "port": self._name, "firmware": info.firmware,
            "started": now(), "scale": list(info.scale),
        }  # fmt: skip
        channels = CHANNELS[: info.channels]
        return Header("frames", info.rate, channels, scale=info.scale, size=size, stream=self._stream, source=source)

    def _start(self) -> None:
        try:
            self._ask(START, self._stream)
        except OSError as fault:
            self._reopen(fault)
        self._started, self._heard = True, time.monotonic()
        self.header.source["started"] = now()

    def _awake(self) -> None:
        """Stop what a program that died may have left running; a board that has just begun may miss the first requests."""
        limit = time.monotonic() + WAKING
        while True:
            try:
                self._ask(STOP)
            except Timeout:
                if time.monotonic() > limit:
                    raise
            else:
                self._port.reset_input_buffer()
                self._rest = b""
                return

    def _ask(self, number: int, value: int = 0, data: int = 0) -> bytes:
        """Return the answer to a request; what came around it is kept.

        Raises:
            Timeout: nobody answers.
            ProtocolError: the board refuses.
        """
        self._port.write(request(number, value, data))
        limit = time.monotonic() + PATIENCE
        buffer = b""
        while time.monotonic() < limit:
            buffer += self._port.read(max(1, min(self._port.in_waiting, LARGEST_READ)))
            if told := found(buffer, number):
                granted, answer, around = told
                self._rest += around
                if not granted:
                    raise ProtocolError(
                        f"serial:{self._name} refuses request {number} of docs/reference/protocol.md: correct its firmware"
                    )
                return answer
        raise Timeout(
            f"serial:{self._name} does not answer request {number} of docs/reference/protocol.md: is it the probe's port?"
        )

    def _reopen(self, fault: Exception) -> None:
        """Open the port again and go on with the stream if the board still counts it; begin another if not."""
        self._port.close()
        limit = time.monotonic() + self._absence
        while not self._resumed():
            if time.monotonic() > limit:
                text = f"serial:{self._name}: it went away and did not come back: check plug and cable, then read again"
                raise Disconnected(text) from fault
            time.sleep(0.05)
        self._note, self._heard = "the port went away", time.monotonic()

    def _resumed(self) -> bool:
        try:
            self._port = self._opened()
            if Status.decoded(self._ask(GET_STATUS)).stream != self._stream:
                self._stream = self._stream % 0xFFFF + 1
                self._rest = b""
                self._ask(START, self._stream)
        except (HardwareError, OSError):
            self._port.close()
            return False
        return True


def _serial_number(port: str) -> str:
    """Return the serial number of the USB board behind a port, "" where the system knows none."""
    with suppress(Exception):  # whatever a system's list of ports may hold
        for one in import_module("serial.tools.list_ports").comports():
            if os.path.realpath(one.device) == os.path.realpath(port):
                return str(one.serial_number or "")
    return ""
