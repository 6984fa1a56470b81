"""What every source of raw bytes has in common: a header that tells how to decode them, and chunks."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from typing import Any, Protocol

from hw.common.samples import Samples


@dataclass(frozen=True)
class Chunk:
    """What one read returned, exactly as it came.

    Attributes:
        data: the bytes; none when nothing came in time.
        stream: the number that the device was told with START.
        note: what happened before the read: the reason of the gap that may follow.
        time: when it returned, s since any moment; None: not known.
    """

    data: bytes
    stream: int = 0
    note: str = ""
    time: float | None = None


@dataclass(frozen=True)
class Header:
    """All that the decoding of chunks needs, and where they come from.

    Attributes:
        kind: "frames" (the vendor stream) or "waveforms" (an oscilloscope's).
        rate: Hz.
        channels: names, in the order of the columns.
        scale: volts per count of each channel.
        size: bytes in a frame; 0 for waveforms.
        stream: the first stream's number.
        source: serial, firmware, transport, started, whatever else is known.
    """

    kind: str
    rate: float
    channels: tuple[str, ...]
    scale: tuple[float, ...]
    size: int
    stream: int
    source: dict[str, Any]

    def as_dict(self) -> dict[str, Any]:
        """Return the header as plain values."""
        return asdict(self)


class Transport(Protocol):
    """A source of chunks."""

    @property
    def header(self) -> Header:
        """Return what decoding needs."""

    def read(self) -> Chunk | None:
        """Return the next chunk; None when the source has ended. A device starts at the first call. Raises ``HardwareError``."""

    def close(self) -> None:
        """Stop and let go of the device; never raises."""


class Decoder(Protocol):
    """Turns chunks into samples."""

    def feed(self, data: bytes, stream: int | None = None, note: str = "") -> Samples:
        """Return the samples that the chunk completes, perhaps none."""


def now() -> str:
    """Return the time as ISO 8601, UTC."""
    return datetime.now(UTC).isoformat(timespec="milliseconds")
