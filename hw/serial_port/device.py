"""Communicate with one probe on a serial port (CDC): the same frames as on USB, with requests as packets among them."""

from __future__ import annotations

import errno
import os
import time
from contextlib import suppress
from importlib import import_module
from typing import TYPE_CHECKING

from hw.common.errors import Busy, Disconnected, HardwareError, InvalidSource, NotFound, ProtocolError, Timeout, TransferError
from hw.serial_port.packets import encode_request, find_response
from hw.wire.protocol import STOP

if TYPE_CHECKING:
    import serial


BAUD_RATE = 115_200  # a CDC board ignores it
RESPONSE_TIMEOUT_S = 1.0  # s for one response
MAX_READ_BYTES = 1 << 16
_ERROR_BY_ERRNO: dict[int | None, type[HardwareError]] = {errno.ENOENT: NotFound, errno.EBUSY: Busy, errno.EAGAIN: Busy}
_REMEDIES = {NotFound: "there is no such port: is the board plugged in?", Busy: "another program holds it: close that"}


class SerialDevice:
    """A probe on a serial port; see ``hw.wire.stream.ProbeDevice``.

    Parameters
    ----------
    port
        Its name, ``/dev/ttyACM0`` or ``COM3``.
    """

    packet = 0  # the board states the size of frames
    wake_seconds = 3.0  # some boards restart when their port is opened

    def __init__(self, port: str) -> None:
        """Store the port; ``open`` opens it."""
        self.place, self.subject, self._received = port, f"serial:{port}", b""

    def open(self) -> None:
        """Open the port.

        Raises
        ------
        InvalidSource
            Pyserial is not installed.
        HardwareError
            No such port, busy, or access denied.
        """
        try:
            import serial
        except ImportError as missing:
            raise InvalidSource("serial ports need pyserial: pip install pyserial") from missing
        try:
            self._port: serial.Serial = serial.Serial(
                self.place, BAUD_RATE, timeout=0.1, write_timeout=RESPONSE_TIMEOUT_S, exclusive=True
            )
        except (OSError, ValueError) as fault:
            raise self._translate_fault(fault) from fault

    def describe(self) -> dict[str, object]:
        """Return transport, serial number of the board and name of the port."""
        return {"transport": "serial", "serial": _find_serial_number(self.place), "port": self.place}

    def request(self, number: int, value: int = 0, data: int = 0) -> bytes:
        """Send a request and return the data of its response; bytes of the stream around it are kept for ``read``.

        Raises
        ------
        Timeout
            No response comes.
        ProtocolError
            The board refuses the request.
        """
        end = time.monotonic() + RESPONSE_TIMEOUT_S
        try:
            self._port.write(encode_request(number, value, data))
            buffer = b""
            while time.monotonic() < end:
                buffer += self._port.read(max(1, min(self._port.in_waiting, MAX_READ_BYTES)))
                if response := find_response(buffer, number):
                    granted, content, around = response
                    if not granted:
                        text = f"{self.subject} refuses request {number} of docs/reference/protocol.md"
                        raise ProtocolError(f"{text}: correct its firmware")
                    self._received += around
                    if number == STOP:  # what is left is of an earlier stream
                        self._port.reset_input_buffer()
                        self._received = b""
                    return content
        except OSError as fault:  # pyserial's exception is a subclass
            raise self._build_loss_error() from fault
        text = f"{self.subject} does not respond to request {number} of docs/reference/protocol.md"
        raise Timeout(f"{text}: is it the probe's port?")

    def read(self, size: int, seconds: float) -> tuple[bytes, HardwareError | None]:
        """Return at most ``size`` bytes that came within ``seconds``, besides those received before, and the fault, if any."""
        data, self._received = self._received, b""
        end = time.monotonic() + seconds
        try:
            while not data and time.monotonic() < end:
                data = self._port.read(max(1, min(self._port.in_waiting, size)))
        except OSError as fault:
            loss = self._build_loss_error()
            loss.__cause__ = fault
            return data, loss
        silent = Timeout(f"{self.subject}: it is connected but does not respond: unplug it and plug it in again")
        return data, None if data else silent

    def clear_halt(self) -> None:
        """Do nothing: a port does not halt."""

    def close(self, stop: bool = True) -> None:
        """Stop the stream if ``stop`` is true, and release the port."""
        if stop:
            with suppress(OSError):  # no flush: it would wait for ever for a board that no longer reads
                self._port.write(encode_request(STOP))
        self._port.close()

    def _build_loss_error(self) -> Disconnected:
        """Return the error for a port that was disconnected."""
        return Disconnected(f"{self.subject}: it went away and did not come back: check plug and cable, then read again")

    def _translate_fault(self, fault: Exception) -> HardwareError:
        """Translate an exception of opening a port into a ``HardwareError``."""
        number = getattr(fault, "errno", None)
        if number in (errno.EACCES, errno.EPERM) or isinstance(fault, PermissionError):
            remedy = "join the port's group (sudo usermod -aG dialout $USER), log out and in again; or another program holds it"
            return TransferError(f"{self.subject}: access denied: {remedy}")
        kind = _ERROR_BY_ERRNO.get(number, NotFound if isinstance(fault, ValueError) else TransferError)
        return kind(f"{self.subject}: {_REMEDIES.get(kind, 'it cannot be read')} ({' '.join(str(fault).split())})")


def _find_serial_number(port: str) -> str:
    """Return the serial number of the USB board at a port, "" if the system knows none."""
    with suppress(Exception):  # the list of ports is platform code that may raise anything
        for listed_port in import_module("serial.tools.list_ports").comports():
            if os.path.realpath(listed_port.device) == os.path.realpath(port):
                return str(listed_port.serial_number or "")
    return ""
