"""Define the interface of a source of raw bytes: a header that describes how to decode them, and chunks."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from typing import Protocol

from hw.common.samples import Samples


@dataclass(frozen=True)
class Chunk:
    """The result of one read, unchanged.

    Attributes
    ----------
    data
        The bytes; empty when nothing came in time.
    stream
        The stream's number, as sent to the device with START.
    note
        What happened before the read: the reason of a gap that may follow.
    time
        When the read returned, s since an arbitrary moment; None: not known.
    """

    data: bytes
    stream: int = 0
    note: str = ""
    time: float | None = None


@dataclass(frozen=True)
class Header:
    """The data needed to decode chunks, and their origin.

    Attributes
    ----------
    kind
        "frames" (the vendor stream) or "waveforms" (an oscilloscope's).
    rate
        Hz.
    channels
        Names, in the order of the columns.
    scale
        Volts per count of each channel.
    size
        Bytes in a frame; 0 for waveforms.
    stream
        Number of the first stream.
    source
        Serial, firmware, transport, started and whatever else is known of the origin.
    """

    kind: str
    rate: float
    channels: tuple[str, ...]
    scale: tuple[float, ...]
    size: int
    stream: int
    source: dict[str, object]

    def as_dict(self) -> dict[str, object]:
        """Return the header as plain values."""
        return asdict(self)


class Transport(Protocol):
    """A source of chunks."""

    @property
    def header(self) -> Header:
        """The data needed to decode the chunks."""

    def read(self) -> Chunk | None:
        """Return the next chunk, None at the source's end. A device starts at the first call. Raises ``HardwareError``."""

    def close(self) -> None:
        """Stop and release the device; never raises."""


class FileTransport:
    """Base of transports of files, which prepare their ``header`` and an iterator of ``chunks``."""

    header: Header
    _chunks: Generator[Chunk, None, None]

    def read(self) -> Chunk | None:
        """Return the next chunk; None at the end."""
        return next(self._chunks, None)

    def close(self) -> None:
        """End the iterator, which closes its file."""
        self._chunks.close()


class Decoder(Protocol):
    """An object that turns chunks into samples."""

    def feed(self, data: bytes, stream: int | None = None, note: str = "") -> Samples:
        """Return the samples that a chunk's data complete, perhaps none; for the parameters see ``Chunk``."""


def make_timestamp() -> str:
    """Return the present time as an ISO 8601 text, UTC."""
    return datetime.now(UTC).isoformat(timespec="milliseconds")
