"""Read oscilloscopes by SCPI over VISA (``pip install '.[scope]'``): inner on channel 1, outer on 2, unless mapped.

Each chunk is one acquisition. The time between two acquisitions is unknown, so that a gap of unknown length separates them.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib import import_module
from typing import Any, ClassVar

import numpy as np
from usb.core import USBError

from hw.common.errors import Busy, Disconnected, HardwareError, InvalidSource, NotFound, ProtocolError, Timeout, TransferError
from hw.common.samples import Gap, Samples
from hw.common.transport import Chunk, Header, make_timestamp
from hw.oscilloscope.scpi import DIALECTS, Dialect, find_dialect
from hw.usb.faults import translate_fault
from hw.usb.find import load_libusb

FILM_CHANNELS = {"inner": 1, "outer": 2}
PER_DIVISION = 100  # samples per division, of oscilloscopes whose rate follows from the time base
RATE_TOLERANCE = 0.01  # largest relative difference between the requested and the actual rate
_ACQUISITION_TIMEOUT_S = 10.0  # s for one acquisition
_GAP_REASON = "a new acquisition"
_BY_STATUS: dict[str, type[HardwareError]] = {
    "error_timeout": Timeout, "error_resource_not_found": NotFound, "error_resource_busy": Busy, "error_resource_locked": Busy,
    "error_connection_lost": Disconnected, "error_io": TransferError, "error_invalid_resource_name": InvalidSource,
}  # fmt: skip


class ScopeTransport:
    """Take acquisitions from an open VISA resource.

    Parameters
    ----------
    resource
        A pyvisa resource, or any object with ``query``, ``write``, ``query_binary_values`` and ``close``.
    name
        The resource string.
    numbers
        Channel numbers by signal, in the order of the columns.
    rate
        Requested rate, Hz; None: the rate of the present time base.

    Raises
    ------
    HardwareError
        The oscilloscope does not respond, or belongs to no known family.
    InvalidSource
        It does not sample at that rate.
    """

    def __init__(self, resource: Any, name: str, numbers: dict[str, int] = FILM_CHANNELS, rate: float | None = None) -> None:
        """Set the rate, and take the first acquisition, whose scales the header states."""
        self._resource, self._name, self._numbers = resource, name, numbers
        try:
            with translate_faults(name):
                identity = resource.query("*IDN?").strip()
                self._dialect = find_dialect(identity)
                if rate is not None:
                    self._write(tuple(word.format(rate=rate, division=PER_DIVISION / rate) for word in self._commands.rate))
                self._first: Chunk | None = self._acquire()
        except HardwareError:
            self.close()
            raise
        acquisition = json.loads(self._first.note)
        scaling = [DIALECTS[self._dialect].read_scaling(response) for response in acquisition["scales"]]
        scale = tuple(channel_scaling.step for channel_scaling in scaling)  # V per code
        maker, model, serial, firmware = (*str(identity).split(","), "", "", "")[:4]
        source: dict[str, object] = {
            "transport": "visa", "serial": serial, "firmware": firmware, "model": f"{maker} {model}", "resource": name,
            "started": make_timestamp(), "scale": list(scale),
        }  # fmt: skip
        if rate is not None and abs(rate * scaling[0].interval - 1) > RATE_TOLERANCE:
            self.close()
            text = f"rate = {rate:g} Hz: {name} samples at {1 / scaling[0].interval:.6g} Hz"
            raise InvalidSource(f"{text}: allowed: that rate, or none and the time base set on the instrument")
        self.header = Header(
            "waveforms", 1 / scaling[0].interval, channels=tuple(numbers), scale=scale, size=0, stream=0, source=source
        )

    @classmethod
    def open(cls, name: str, numbers: dict[str, int] = FILM_CHANNELS, rate: float | None = None) -> ScopeTransport:
        """Open a resource by its full name, such as ``USB0::0x1AB1::0x04CE::DS1ZA1::INSTR``; resources are never listed.

        Parameters
        ----------
        name
            The resource string.
        numbers
            Channel numbers by signal.
        rate
            Requested rate, Hz.

        Raises
        ------
        InvalidSource
            Pyvisa is not installed, or does not know this kind of resource.
        HardwareError
            The resource cannot be opened.
        """
        try:
            visa = import_module("pyvisa")
            load_libusb()  # pyusb, and so pyvisa-py, uses this libusb from now on
            manager = visa.ResourceManager("@py")
        except (ImportError, ValueError) as missing:
            raise InvalidSource("oscilloscopes need pyvisa: pip install '.[scope]'") from missing
        with translate_faults(name, missing="not found, or not to be opened by this user: check plug, name and udev rule"):
            resource = manager.open_resource(name, timeout=1000 * _ACQUISITION_TIMEOUT_S)
            if name.upper().endswith("SOCKET"):
                resource.read_termination = resource.write_termination = "\n"
        return cls(resource, name, numbers, rate)

    def read(self) -> Chunk:
        """Return the next acquisition.

        Raises
        ------
        HardwareError
            The oscilloscope does not respond, or was disconnected.
        """
        first, self._first = self._first, None
        with translate_faults(self._name):
            return first or self._acquire()

    def close(self) -> None:
        """Release the oscilloscope."""
        with suppress(Exception):  # VISA may raise anything if the oscilloscope is disconnected
            self._resource.close()

    @property
    def _commands(self) -> Dialect:
        """The commands of the instrument's family."""
        return DIALECTS[self._dialect]

    def _acquire(self) -> Chunk:
        """Take one acquisition and read all its channels; the chunk's note describes how to decode their codes."""
        dialect = self._commands
        self._write(dialect.acquire)
        self._wait_for_response(*dialect.finished)
        scales, blocks = [], []
        for channel in self._numbers.values():
            self._write(tuple(word.format(channel=channel) for word in dialect.select))
            scales.append(self._resource.query(dialect.scaling).strip())
            blocks.append(self._resource.query_binary_values(dialect.data, datatype="B", container=bytes))
        note = {"dialect": self._dialect, "scales": scales, "lengths": [len(block) for block in blocks]}
        return Chunk(b"".join(blocks), note=json.dumps(note))

    def _write(self, commands: tuple[str, ...]) -> None:
        """Send commands that have no response."""
        for command in commands:
            self._resource.write(command)

    def _wait_for_response(self, query: str, expected: str) -> None:
        """Repeat a query until its response is the ``expected`` one of a complete acquisition. Raises ``Timeout``."""
        limit = time.monotonic() + _ACQUISITION_TIMEOUT_S
        while self._resource.query(query).strip() != expected:
            if time.monotonic() > limit:
                raise Timeout(f"{self._name}: no acquisition in {_ACQUISITION_TIMEOUT_S:g} s: set the trigger to automatic")
            time.sleep(0.02)


@dataclass(frozen=True)
class _Acquisition:
    """The note of a chunk: the family's name, and for each channel the response with its scales and its number of bytes."""

    dialect: str
    scales: tuple[str, ...]
    lengths: tuple[int, ...]
    __pydantic_config__: ClassVar = {"strict": True, "extra": "forbid"}


def _parse_note(note: str, size: int) -> _Acquisition:
    """Return the contents of a chunk's note. Raises ``InvalidSource`` if it does not fit the chunk's ``size`` bytes."""
    from pydantic import TypeAdapter, ValidationError

    try:
        acquisition = TypeAdapter(_Acquisition).validate_json(note)
    except ValidationError as fault:
        raise InvalidSource("the recording holds what no oscilloscope of ours has sent") from fault
    is_complete = 2 <= len(acquisition.scales) == len(acquisition.lengths) <= 3
    if acquisition.dialect not in DIALECTS or not is_complete or min(acquisition.lengths) < 1 or sum(acquisition.lengths) != size:
        raise InvalidSource("the recording holds an acquisition whose note does not fit its bytes")
    return acquisition


class WaveformDecoder:
    """A decoder that turns acquisitions, live or recorded, into samples; ``header`` is that of their source."""

    def __init__(self, header: Header) -> None:
        self.header = header
        self._next = 0

    def feed(self, data: bytes, stream: int | None = None, note: str = "") -> Samples:
        """Return the samples of one acquisition.

        Raises
        ------
        ProtocolError
            Lengths or intervals of the channels differ from each other, or from the header.
        InvalidSource
            The recorded note has another form.
        """
        acquisition = _parse_note(note, len(data))
        dialect = DIALECTS[acquisition.dialect]
        if len(acquisition.lengths) != len(self.header.channels):
            raise InvalidSource("the recording holds an acquisition of other channels than it says")
        lengths, begin, columns = acquisition.lengths, 0, []
        for length, response in zip(lengths, acquisition.scales, strict=True):
            scaling = dialect.read_scaling(response)
            if length != lengths[0] or abs(scaling.interval * self.header.rate - 1) > 1e-9:
                raise ProtocolError(f"channels of {lengths} samples, every {scaling.interval} s: leave the time base as it was")
            columns.append(dialect.decode(data[begin : begin + length], scaling))
            begin += length
        volts, saturated = (np.column_stack(column) for column in zip(*columns, strict=True))
        gaps = (Gap(self._next, -1, _GAP_REASON),) if self._next else ()  # none before the first acquisition
        first = self._next + len(gaps)  # a gap of unknown length takes up one index
        self._next = first + lengths[0]
        index = np.arange(first, self._next)
        return Samples(
            self.header.rate,
            self.header.channels,
            index=index,
            volts=volts,
            saturated=saturated,
            gaps=gaps,
            overruns=0,
            source=self.header.source,
        )


@contextmanager
def translate_faults(name: str, missing: str = "") -> Iterator[None]:
    """Translate exceptions of pyvisa, pyvisa-py and pyusb into subclasses of ``HardwareError``.

    Parameters
    ----------
    name
        Of the resource.
    missing
        Message for opening, where pyvisa-py does not distinguish a missing device from denied access.
    """
    try:
        yield
    except USBError as fault:
        raise translate_fault(fault, name) from fault
    except HardwareError:
        raise
    except (ValueError, OSError) as fault:  # pyvisa-py raises both when the plug is pulled
        detail = f"({' '.join(str(fault).split())})"
        if missing:
            raise NotFound(f"{name}: {missing} {detail}") from fault
        raise Disconnected(f"{name}: it went away: check plug and cable {detail}") from fault
    except Exception as fault:
        status = getattr(getattr(fault, "error_code", None), "name", "")
        if type(fault).__name__ not in ("VisaIOError", "InvalidSession"):
            raise
        kind = _BY_STATUS.get(status, Disconnected if type(fault).__name__ == "InvalidSession" else TransferError)
        raise kind(f"{name}: {' '.join(str(fault).split())}") from fault
