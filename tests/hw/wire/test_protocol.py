"""The vendor protocol: bytes are laid out as docs/reference/protocol.md states, and what it prints is what the commands print."""

from __future__ import annotations

import re
import struct
from dataclasses import replace

import numpy as np
import pytest

from docs.make_protocol import build_test_vectors, format_descriptors, format_test_vectors
from hw.common.errors import ProtocolError
from hw.wire.frames import FrameLayout, encode_frame
from hw.wire.protocol import Info, Status
from tests.support.hw.frame_truth import crc32, make_decoder
from tests.support.paths import ROOT


def test_frame_is_laid_out_as_documented() -> None:
    layout = FrameLayout(64, 2)
    frame = encode_frame(
        layout, np.array([[1, -2]], np.int16), stream=0x0D0E, sequence=0x01020304, index=0x05060708090A0B0C, flags=0x31
    )
    body = bytes.fromhex("50 44 01 02 04030201 0c0b0a0908070605 0e0d 01 31 0100 feff") + bytes(36)
    assert frame == body + crc32(body).to_bytes(4, "little")
    assert crc32(b"123456789") == 0xCBF43926


@pytest.mark.parametrize(("size", "channels"), [(31, 2), (1025, 2), (64, 1), (64, 4)])
def test_layouts_that_are_not_laid_down(size: int, channels: int) -> None:
    with pytest.raises(ProtocolError, match="allowed: 32 to 1024 bytes, 2 or 3 channels"):
        FrameLayout(size, channels)


def test_answers_come_back() -> None:
    info = Info(3, 12_500.125, 1e6, (0.5, 0.25, 2.0**-20), "board 1.2")
    assert Info.decode(info.encode()) == info
    status = Status(65535, 3, 2**32 - 1, 2**60)
    assert Status.decode(status.encode()) == status
    assert len(info.encode()) == 44
    assert len(status.encode()) == 16


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "0 bytes, not 44"), (b"\x02" + bytes(60), "speaks version 2"),
        (replace(Info(2, 1.0, 1.0, (1.0, 1.0), ""), channels=4).encode(), "states 4 channels"),
        (Info(2, 0.0, 1.0, (1.0, 1.0), "").encode(), "0.0 Hz"), (Info(2, 1.0, 1.0, (float("nan"), 1.0), "").encode(), "nan"),
    ],
)  # fmt: skip
def test_answers_that_are_refused(data: bytes, message: str) -> None:
    with pytest.raises(ProtocolError, match=message):
        Info.decode(data)


def test_documented_descriptors_are_the_printed_ones_and_add_up() -> None:
    printed = format_descriptors()
    assert printed in (ROOT / "docs" / "reference" / "protocol.md").read_text(encoding="utf-8")
    store, answer = (bytes.fromhex("".join(re.findall(r"(?m)^[0-9a-f]{4}  (.*)$", part))) for part in printed.split("\n\n"))
    assert int.from_bytes(store[2:4], "little") == len(store) == 5 + store[5]
    assert int.from_bytes(answer[8:10], "little") == len(answer) == int.from_bytes(store[29:31], "little")
    position, kinds = 0, []
    while position < len(answer):  # each descriptor begins with its length and type
        length, kind = struct.unpack_from("<HH", answer, position)
        position, kinds = position + length, [*kinds, kind]
    assert (position, kinds) == (len(answer), [0, 3, 4])


def test_documented_vectors_are_the_printed_ones() -> None:
    printed = format_test_vectors()
    text = (ROOT / "docs" / "reference" / "protocol.md").read_text(encoding="utf-8")
    assert printed in text
    dumps = re.findall(r"(?m)^((?:[0-9a-f]{4}  .*\n)+)", printed + "\n")
    assert len(dumps) == len(build_test_vectors()) == 3
    for dump, (layout, codes, frame) in zip(dumps, build_test_vectors().values(), strict=True):
        data = bytes.fromhex("".join(line[6:] for line in dump.splitlines()))
        assert data == frame
        assert len(data) == layout.size
        assert data[-4:] == crc32(data[:-4]).to_bytes(4, "little")
        stream = int.from_bytes(data[16:18], "little")
        np.testing.assert_array_equal(make_decoder(layout, 1.0, stream).feed(data).volts, codes)
