"""Define and encode the frames of the vendor stream; ``docs/reference/protocol.md`` is the specification.

``python -m hw.wire.frames`` prints the test vectors of that document.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hw.common.errors import ProtocolError
from hw.common.samples import CHANNEL_NAMES

Codes = NDArray[np.int16]

FRAME_MAGIC = b"PD"
PROTOCOL_VERSION = 1
FRAME_HEADER = struct.Struct("<2sBBIQHBB")  # magic, version, channels, sequence, index, stream, rows, flags
CRC_FORMAT = struct.Struct("<I")
OVERRUN_FLAG = 0x01  # samples were lost in the device just before this frame
SATURATED_FLAG = 0x10  # << channel: the channel's amplifier was saturated during this frame
MIN_CODE, MAX_CODE = -32768, 32767  # codes that mean "at the end of the range, or beyond"
MIN_FRAME_BYTES, MAX_FRAME_BYTES = 32, 1024  # bytes in a frame


@dataclass(frozen=True)
class FrameLayout:
    """The layout of a device's frames.

    Attributes
    ----------
    size
        Bytes in a frame: the endpoint's wMaxPacketSize.
    channels
        Number of channels, 2 or 3.

    Raises
    ------
    ProtocolError
        The protocol has no such frames.
    """

    size: int
    channels: int

    def __post_init__(self) -> None:
        if not (MIN_FRAME_BYTES <= self.size <= MAX_FRAME_BYTES and 2 <= self.channels <= len(CHANNEL_NAMES)):
            raise ProtocolError(
                f"frames of {self.size} bytes, {self.channels} channels: allowed: 32 to 1024 bytes, 2 or 3 channels"
            )

    @property
    def rows(self) -> int:
        """Maximum number of samples per channel in a frame; at most 255, since one byte counts them."""
        return min(255, (self.size - FRAME_HEADER.size - CRC_FORMAT.size) // (2 * self.channels))

    @property
    def dtype(self) -> np.dtype[np.void]:
        """Structured type of a frame."""
        padding = self.size - FRAME_HEADER.size - CRC_FORMAT.size - 2 * self.channels * self.rows
        names = ["magic", "version", "channels", "sequence", "index", "stream", "rows", "flags", "codes", "padding", "crc"]
        kinds = ["S2", "u1", "u1", "<u4", "<u8", "<u2", "u1", "u1", ("<i2", (self.rows, self.channels)), f"V{padding}", "<u4"]
        return np.dtype([field for field in zip(names, kinds, strict=True) if field[1] != "V0"])


@dataclass(frozen=True)
class Frame:
    """The content of one frame.

    Attributes
    ----------
    sequence
        Number of the frame in its stream, modulo 2^32.
    index
        Of the first row since the stream was started; counts conversions, sent or not.
    stream
        The stream's number, as sent by the host with START.
    codes
        (rows, channels) int16.
    flags
        OVERRUN, SATURATED << channel.
    """

    sequence: int
    index: int
    stream: int
    codes: Codes
    flags: int = 0

    def encode(self, layout: FrameLayout) -> bytes:
        """Encode the frame as bytes; unused bytes are zero."""
        rows, channels = self.codes.shape
        if channels != layout.channels or not 1 <= rows <= layout.rows:
            raise ValueError(f"{rows} rows of {channels} channels do not fit {layout}")
        count = self.sequence % 2**32
        header = FRAME_HEADER.pack(FRAME_MAGIC, PROTOCOL_VERSION, channels, count, self.index, self.stream, rows, self.flags)
        body = (header + self.codes.astype("<i2").tobytes()).ljust(layout.size - CRC_FORMAT.size, b"\0")
        return body + CRC_FORMAT.pack(zlib.crc32(body))


def encode_frames(layout: FrameLayout, *, stream: int, sequence: int, index: int, codes: Codes, flags: int = 0) -> bytes:
    """Encode consecutive full frames at once, each as by ``Frame.encode``.

    Parameters
    ----------
    layout
        Of the frames.
    stream
        The stream's number.
    sequence
        Of the first.
    index
        Of its first row.
    codes
        (frames * layout.rows, channels) int16.
    flags
        Of every frame.
    """
    frames = np.zeros(len(codes) // layout.rows, layout.dtype)
    order = np.arange(len(frames))
    frames["magic"], frames["version"], frames["channels"] = FRAME_MAGIC, PROTOCOL_VERSION, layout.channels
    frames["sequence"] = (sequence + order) % 2**32
    frames["index"] = index + order * layout.rows
    frames["stream"], frames["rows"], frames["flags"] = stream, layout.rows, flags
    frames["codes"] = codes.reshape(len(frames), layout.rows, layout.channels)
    bodies = frames.view(np.uint8).reshape(len(frames), layout.size)[:, : -CRC_FORMAT.size]
    frames["crc"] = [zlib.crc32(body.tobytes()) for body in bodies]
    return frames.tobytes()


def build_test_vectors() -> dict[str, tuple[FrameLayout, Frame]]:
    """Return the test vectors: the frames whose bytes the specification prints."""
    ramp = np.arange(20, dtype=np.int16).reshape(10, 2)
    ends = np.array([[MAX_CODE, MIN_CODE, -1], [1, 2, 3]], np.int16)
    return {
        "64 bytes, two channels, the first frame of stream 1": (FrameLayout(64, 2), Frame(0, 0, 1, ramp)),
        "64 bytes, the last sequence number before it wraps": (FrameLayout(64, 2), Frame(2**32 - 1, 10 * (2**32 - 1), 1, -ramp)),
        "64 bytes, three channels, two rows, overrun, inner channel saturated": (
            FrameLayout(64, 3),
            Frame(7, 2**40, 0xBEEF, ends, OVERRUN_FLAG | SATURATED_FLAG),
        ),
    }


def format_hex(data: bytes) -> str:
    """Format bytes as lines of sixteen in hexadecimal, each with its offset."""
    return "\n".join(f"{offset:04x}  {data[offset : offset + 16].hex(' ')}" for offset in range(0, len(data), 16))


def main() -> None:
    """Print the test vectors."""
    print(f"CRC-32 of the nine bytes '123456789': {zlib.crc32(b'123456789'):08x}")
    for name, (layout, frame) in build_test_vectors().items():
        print(f"\n{name}:\n{format_hex(frame.encode(layout))}")


if __name__ == "__main__":
    main()
