"""Read the vendor stream over a serial port, with recovery: lost samples become a gap.

A port that is disconnected is opened again by its name. If the board still counts the same stream, the gap's length follows from
its counter. If not, another stream is started and the gap's length is unknown.
"""

from __future__ import annotations

import errno
import os
import random
import struct
import time
from contextlib import suppress
from importlib import import_module
from typing import TYPE_CHECKING

from hw.common.errors import Busy, Disconnected, HardwareError, InvalidSource, NotFound, ProtocolError, Timeout, TransferError
from hw.common.samples import CHANNEL_NAMES
from hw.common.transport import Chunk, Header, make_timestamp
from hw.serial_port.packets import encode_request, find_answer
from hw.wire.frames import MAX_FRAME_BYTES, MIN_FRAME_BYTES
from hw.wire.protocol import GET_INFO, GET_STATUS, SET_RATE, START, STOP, Info, Status

if TYPE_CHECKING:
    import serial


BAUD_RATE = 115_200  # a CDC board ignores it
ANSWER_TIMEOUT_S = 1.0  # s for one response
WAKE_TIMEOUT_S = 3.0  # s: some boards restart when their port is opened
LARGEST_READ = 1 << 16
_ERROR_BY_ERRNO: dict[int | None, type[HardwareError]] = {errno.ENOENT: NotFound, errno.EBUSY: Busy, errno.EAGAIN: Busy}


class SerialTransport:
    """A transport that reads one probe on a serial port.

    Parameters
    ----------
    port
        Its name, ``/dev/ttyACM0`` or ``COM3``.
    rate
        Requested rate, Hz; None: the present rate.
    silence
        Time without a byte after which it gives up, s.
    absence
        Time after a disconnection after which it gives up, s.

    Raises
    ------
    InvalidSource
        Pyserial is not installed, or the rate is out of range.
    HardwareError
        No such port, busy, access denied, or no probe responds.
    """

    def __init__(self, port: str, rate: float | None = None, silence: float = 3.0, absence: float = 10.0) -> None:
        if rate is not None and not 1e-3 <= rate <= 4e6:
            raise InvalidSource(f"rate = {rate} Hz: allowed: 0.001 to 4000000 Hz")
        self._name, self._silence, self._absence = port, silence, absence
        self._stream, self._heard, self._note, self._buffered = random.randint(1, 0xFFFF), time.monotonic(), "", b""
        self._started = False
        self._port = self._open_port()
        try:
            self.header = self._begin(rate)
        except HardwareError:
            self._port.close()
            raise
        except OSError as fault:
            self._port.close()
            raise self._translate_fault(fault) from fault

    def read(self) -> Chunk:
        """Return the received bytes, empty if none came in time. The first call starts the stream.

        Raises
        ------
        HardwareError
            The port was disconnected and did not come back, or no byte came for ``silence`` s.
        """
        if not self._started:
            self._start()
        data, self._buffered = self._buffered, b""
        try:
            data += self._port.read(max(1, min(self._port.in_waiting, LARGEST_READ)))
        except OSError as fault:  # pyserial's exception is a subclass
            self._reopen(fault)
        if data:
            self._heard = time.monotonic()
        elif time.monotonic() - self._heard > self._silence:
            raise Timeout(f"serial:{self._name}: it is connected but does not answer: unplug it and plug it in again")
        note, self._note = self._note, "" if data else self._note
        return Chunk(data, self._stream, note, time.monotonic())

    def close(self) -> None:
        """Stop the stream and release the port."""
        with suppress(OSError):  # no flush: it would wait for ever for a board that no longer reads
            self._port.write(encode_request(STOP))
        self._port.close()

    def _open_port(self) -> serial.Serial:
        try:
            import serial
        except ImportError as missing:
            raise InvalidSource("serial ports need pyserial: pip install pyserial") from missing
        try:
            port = serial.Serial(self._name, BAUD_RATE, timeout=0.1, write_timeout=ANSWER_TIMEOUT_S, exclusive=True)
        except (OSError, ValueError) as fault:
            raise self._translate_fault(fault) from fault
        return port

    def _translate_fault(self, fault: Exception) -> HardwareError:
        """Translate an exception of pyserial into a ``HardwareError``."""
        text, number = f"serial:{self._name}", getattr(fault, "errno", None)
        if number in (errno.EACCES, errno.EPERM) or isinstance(fault, PermissionError):
            remedy = "join the port's group (sudo usermod -aG dialout $USER), log out and in again; or another program holds it"
            return TransferError(f"{text}: access denied: {remedy}")
        kind = _ERROR_BY_ERRNO.get(number, NotFound if isinstance(fault, ValueError) else TransferError)
        remedies = {NotFound: "there is no such port: is the board plugged in?", Busy: "another program holds it: close that"}
        return kind(f"{text}: {remedies.get(kind, 'it cannot be read')} ({' '.join(str(fault).split())})")

    def _begin(self, rate: float | None) -> Header:
        """Stop a running stream, set the rate and return the header."""
        self._wake()
        if rate is not None:
            self._ask(SET_RATE, data=round(1e3 * rate))
        reply = self._ask(GET_INFO)
        info = Info.decode(reply)
        (size,) = struct.unpack_from("<H", reply, 2)
        if not MIN_FRAME_BYTES <= size <= MAX_FRAME_BYTES:
            raise ProtocolError(
                f"serial:{self._name} states frames of {size} bytes: allowed: {MIN_FRAME_BYTES} to {MAX_FRAME_BYTES}"
            )
        source: dict[str, object] = {
            "transport": "serial", "serial": _find_serial_number(self._name), "port": self._name, "firmware": info.firmware,
            "started": make_timestamp(), "scale": list(info.scale),
        }  # fmt: skip
        channels = CHANNEL_NAMES[: info.channels]
        return Header("frames", info.rate, channels, scale=info.scale, size=size, stream=self._stream, source=source)

    def _start(self) -> None:
        try:
            self._ask(START, self._stream)
        except OSError as fault:
            self._reopen(fault)
        self._started, self._heard = True, time.monotonic()
        self.header.source["started"] = make_timestamp()

    def _wake(self) -> None:
        """Stop a stream that a killed program may have left running; repeat, since a restarting board misses requests."""
        limit = time.monotonic() + WAKE_TIMEOUT_S
        while True:
            try:
                self._ask(STOP)
            except Timeout:
                if time.monotonic() > limit:
                    raise
            else:
                self._port.reset_input_buffer()
                self._buffered = b""
                return

    def _ask(self, number: int, value: int = 0, data: int = 0) -> bytes:
        """Send a request and return the data of its response; bytes of the stream around it are kept for ``read``.

        Raises
        ------
        Timeout
            No response comes.
        ProtocolError
            The board refuses the request.
        """
        self._port.write(encode_request(number, value, data))
        limit = time.monotonic() + ANSWER_TIMEOUT_S
        buffer = b""
        while time.monotonic() < limit:
            buffer += self._port.read(max(1, min(self._port.in_waiting, LARGEST_READ)))
            if reply := find_answer(buffer, number):
                granted, answer, around = reply
                self._buffered += around
                if not granted:
                    raise ProtocolError(
                        f"serial:{self._name} refuses request {number} of docs/reference/protocol.md: correct its firmware"
                    )
                return answer
        raise Timeout(
            f"serial:{self._name} does not answer request {number} of docs/reference/protocol.md: is it the probe's port?"
        )

    def _reopen(self, fault: Exception) -> None:
        """Open the port again, and continue the stream if the board still counts it; start another if not."""
        self._port.close()
        limit = time.monotonic() + self._absence
        while not self._try_resume():
            if time.monotonic() > limit:
                text = f"serial:{self._name}: it went away and did not come back: check plug and cable, then read again"
                raise Disconnected(text) from fault
            time.sleep(0.05)
        self._note, self._heard = "the port went away", time.monotonic()

    def _try_resume(self) -> bool:
        try:
            self._port = self._open_port()
            if Status.decode(self._ask(GET_STATUS)).stream != self._stream:
                self._stream = self._stream % 0xFFFF + 1
                self._buffered = b""
                self._ask(START, self._stream)
        except (HardwareError, OSError):
            self._port.close()
            return False
        return True


def _find_serial_number(port: str) -> str:
    """Return the serial number of the USB board at a port, "" if the system knows none."""
    with suppress(Exception):  # the list of ports is platform code that may raise anything
        for listed_port in import_module("serial.tools.list_ports").comports():
            if os.path.realpath(listed_port.device) == os.path.realpath(port):
                return str(listed_port.serial_number or "")
    return ""
