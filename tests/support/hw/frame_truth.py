"""Frames as docs/reference/protocol.md lays them down, apart from the code that is tested."""

from __future__ import annotations

import numpy as np

from hw.common.samples import CHANNEL_NAMES
from hw.common.transport import Header
from hw.wire.decoder import FrameDecoder
from hw.wire.frames import Codes, FrameLayout

SCALE, STREAM = 2.0**-10, 77
MAGIC_CODE = int.from_bytes(b"PD", "little")  # as a sample's value it looks like the beginning of a frame


def codes_at(index: np.ndarray, channels: int = 2) -> Codes:
    """What every index calls for: no two neighbours alike, now and then the magic itself; never at the range's ends."""
    columns = [(7919 * index + 31 * channel) % 65533 - 32766 for channel in range(channels)]
    codes = np.column_stack(columns)
    codes[index % 5 == 0, 0] = MAGIC_CODE
    return codes.astype(np.int16)


def make_decoder(layout: FrameLayout, scale: float, stream: int) -> FrameDecoder:
    channels = CHANNEL_NAMES[: layout.channels]
    return FrameDecoder(Header("frames", 1e5, channels, (scale,) * layout.channels, layout.size, stream, {}))


def crc32(data: bytes) -> int:
    """CRC-32 as docs/reference/protocol.md defines it, bit by bit."""
    register = 0xFFFFFFFF
    for byte in data:
        register ^= byte
        for _ in range(8):
            register = register >> 1 ^ (0xEDB88320 if register & 1 else 0)
    return register ^ 0xFFFFFFFF
