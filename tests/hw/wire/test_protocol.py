"""The vendor protocol: bytes are laid out as docs/reference/protocol.md says, and what it prints is what the commands print."""

from __future__ import annotations

import re
import struct
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from hw.common.errors import ProtocolError
from hw.wire.decoder import Format, FrameDecoder
from hw.wire.frames import Frame, FrameLayout, build_test_vectors, encode_frames
from hw.wire.protocol import Info, Status
from tests.support.hw.frame_truth import STREAM, codes_at, crc32
from tests.support.paths import ROOT


def test_many_frames_at_once_are_the_single_ones() -> None:
    layout = FrameLayout(65, 3)
    codes = codes_at(np.arange(4 * layout.rows), 3)
    single = [Frame(2**32 - 2 + k, 7 + 6 * k, STREAM, codes[6 * k : 6 * k + 6], 0x21).encode(layout) for k in range(4)]
    assert encode_frames(layout, stream=STREAM, sequence=2**32 - 2, index=7, codes=codes, flags=0x21) == b"".join(single)


def test_frame_is_laid_out_as_documented() -> None:
    layout = FrameLayout(64, 2)
    frame = Frame(0x01020304, 0x05060708090A0B0C, 0x0D0E, np.array([[1, -2]], np.int16), 0x31).encode(layout)
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
    printed = subprocess.run(
        [sys.executable, "-m", "hw.usb.descriptors"], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout
    assert printed.strip() in (ROOT / "docs" / "reference" / "protocol.md").read_text(encoding="utf-8")
    store, answer = (bytes.fromhex("".join(re.findall(r"(?m)^[0-9a-f]{4}  (.*)$", part))) for part in printed.split("\n\n"))
    assert int.from_bytes(store[2:4], "little") == len(store) == 5 + store[5]
    assert int.from_bytes(answer[8:10], "little") == len(answer) == int.from_bytes(store[29:31], "little")
    position, kinds = 0, []
    while position < len(answer):  # each descriptor begins with its length and type
        length, kind = struct.unpack_from("<HH", answer, position)
        position, kinds = position + length, [*kinds, kind]
    assert (position, kinds) == (len(answer), [0, 3, 4])


def test_documented_vectors_are_the_printed_ones() -> None:
    printed = subprocess.run(
        [sys.executable, "-m", "hw.wire.frames"], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout
    text = (ROOT / "docs" / "reference" / "protocol.md").read_text(encoding="utf-8")
    assert printed.strip() in text
    dumps = re.findall(r"(?m)^((?:[0-9a-f]{4}  .*\n)+)", printed + "\n")
    assert len(dumps) == len(build_test_vectors()) == 3
    for dump, (layout, frame) in zip(dumps, build_test_vectors().values(), strict=True):
        data = bytes.fromhex("".join(line[6:] for line in dump.splitlines()))
        assert len(data) == layout.size
        assert data[-4:] == crc32(data[:-4]).to_bytes(4, "little")
        reader = FrameDecoder(Format(1e5, (1.0,) * layout.channels, layout.size, frame.stream), {})
        np.testing.assert_array_equal(reader.feed(data).volts, frame.codes)
