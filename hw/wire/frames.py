"""Define and encode the frames of the vendor stream; ``docs/reference/protocol.md`` is the specification."""

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
        """Refuse sizes and numbers of channels that the protocol does not allow."""
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


def encode_frame(layout: FrameLayout, codes: Codes, *, stream: int, sequence: int, index: int, flags: int = 0) -> bytes:
    """Encode one frame as bytes; unused bytes are zero.

    Parameters
    ----------
    layout
        Of the frame.
    codes
        (rows, channels) int16, at most ``layout.rows`` rows.
    stream
        The stream's number, as sent by the host with START.
    sequence
        Number of the frame in its stream; sent modulo 2^32.
    index
        Of the first row since the stream was started; counts conversions, sent or not.
    flags
        OVERRUN, SATURATED << channel.
    """
    rows, channels = codes.shape
    if channels != layout.channels or not 1 <= rows <= layout.rows:
        raise ValueError(f"{rows} rows of {channels} channels do not fit {layout}")
    header = FRAME_HEADER.pack(FRAME_MAGIC, PROTOCOL_VERSION, channels, sequence % 2**32, index, stream, rows, flags)
    body = (header + codes.astype("<i2").tobytes()).ljust(layout.size - CRC_FORMAT.size, b"\0")
    return body + CRC_FORMAT.pack(zlib.crc32(body))
