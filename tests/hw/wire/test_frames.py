"""The decoder: whatever happens to the bytes, right samples or marked gaps, never wrong samples."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hw.common.errors import ProtocolError
from hw.common.samples import Samples, join_samples
from hw.wire.decoder import FrameDecoder
from hw.wire.frames import MAX_CODE, MIN_CODE, OVERRUN_FLAG, SATURATED_FLAG, Codes, FrameLayout, encode_frame
from tests.support.hw.frame_truth import SCALE, STREAM, codes_at, crc32, make_decoder


def frames_of(layout: FrameLayout, count: int, sequence: int = 0, index: int = 0, stream: int = STREAM) -> list[bytes]:
    begins = index + layout.rows * np.arange(count)
    codes = [codes_at(begin + np.arange(layout.rows), layout.channels) for begin in begins]
    return encoded(layout, codes, begins, sequence, stream)


def encoded(layout: FrameLayout, codes: list[Codes], begins: np.ndarray, sequence: int, stream: int = STREAM) -> list[bytes]:
    return [encode_frame(layout, codes[k], stream=stream, sequence=sequence + k, index=int(begins[k])) for k in range(len(codes))]


def decoder(layout: FrameLayout) -> FrameDecoder:
    return make_decoder(layout, SCALE, STREAM)


def fed(reader: FrameDecoder, data: bytes, step: int) -> Samples:
    return join_samples([reader.feed(data[start : start + step]) for start in range(0, len(data), step)] or [reader.feed(b"")])


def check_truth(samples: Samples) -> None:
    """Every row is what its index calls for; rows and gaps together cover all indices up to the last, once each."""
    np.testing.assert_array_equal(samples.volts, codes_at(samples.index, samples.volts.shape[1]) * SCALE)
    lost = [np.arange(gap.first, gap.first + gap.count) for gap in samples.gaps]
    covered = np.sort(np.concatenate([samples.index, *lost]))
    np.testing.assert_array_equal(covered, np.arange(len(covered)))


@pytest.mark.parametrize("channels", [2, 3])
@pytest.mark.parametrize("size", [32, 64, 511, 512, 513, 1024])
@pytest.mark.parametrize("step", [1, 63, 511, 512, 513, 100_000])
def test_any_packet_size_in_any_read_size(size: int, channels: int, step: int) -> None:
    layout = FrameLayout(size, channels)
    count = 2 if step == 1 else 9
    samples = fed(decoder(layout), b"".join(frames_of(layout, count)), step)
    check_truth(samples)
    assert samples.gaps == ()
    assert len(samples) == count * layout.rows


damages = st.lists(
    st.tuples(
        st.sampled_from(["drop", "repeat", "flip", "cut", "garbage", "late", "half-repeat"]),
        st.integers(0, 11),
        st.integers(0, 1 << 20),
    ),
    max_size=6,
)


@given(
    damages,
    st.lists(st.integers(1, 700), min_size=1, max_size=8),
    st.sampled_from([64, 65, 128]),
    st.sampled_from([0, 2**32 - 5]),
)
def test_any_damage_gives_right_samples_or_gaps(
    damage: list[tuple[str, int, int]], steps: list[int], size: int, sequence: int
) -> None:
    layout = FrameLayout(size, 2)
    frames = frames_of(layout, 16, sequence)
    bytes_of, untouched = list(frames), set(range(12))
    for kind, k, damage_seed in damage:
        bytes_of[k], whole = spoiled(kind, bytes_of[k], frames[max(k - 1, 0)], damage_seed)
        if not whole:
            untouched.discard(k)
    data, reader, parts = b"".join(bytes_of), decoder(layout), []
    position = 0
    while position < len(data):
        step = steps[len(parts) % len(steps)]
        parts.append(reader.feed(data[position : position + step]))
        position += step
    samples = join_samples(parts)
    check_truth(samples)
    assert {k * layout.rows for k in untouched} <= set(samples.index.tolist())


def spoiled(kind: str, frame: bytes, previous: bytes, damage_seed: int) -> tuple[bytes, bool]:
    """Return what becomes of a frame's bytes, and whether the frame is still whole in them."""
    position = damage_seed % max(1, len(frame))
    if kind == "flip" and frame:
        return frame[:position] + bytes([frame[position] ^ 1 << damage_seed % 8]) + frame[position + 1 :], False
    return {
        "drop": (b"", False), "repeat": (frame * 2, True), "cut": (frame[:position], False), "flip": (frame, False),
        "garbage": (struct.pack("<I", damage_seed) * (damage_seed % 97) + frame, True), "late": (frame + previous, True),
        "half-repeat": (frame[: position // 2] + frame, True),
    }[kind]  # fmt: skip


@given(st.integers(0, 63), st.integers(1, 255))
def test_no_flipped_byte_passes(position: int, mask: int) -> None:
    layout = FrameLayout(64, 2)
    frame = bytearray(frames_of(layout, 1)[0])
    frame[position] ^= mask
    assert len(decoder(layout).feed(bytes(frame))) == 0


def test_million_samples_arrive_once_each() -> None:
    layout = FrameLayout(64, 2)
    codes = codes_at(np.arange(1_000_000))
    begins = np.arange(0, 1_000_000, layout.rows)
    data = b"".join(encoded(layout, [codes[begin : begin + layout.rows] for begin in begins], begins, 2**32 - 1000))
    samples = fed(decoder(layout), data, 16_411)
    np.testing.assert_array_equal(samples.index, np.arange(1_000_000))
    np.testing.assert_array_equal(samples.volts, codes * SCALE)
    assert samples.gaps == ()


def test_magic_cut_in_two_after_garbage() -> None:
    layout = FrameLayout(64, 2)
    reader, frame = decoder(layout), frames_of(layout, 1)[0]
    assert len(reader.feed(bytes(100) + frame[:1])) == 0
    assert len(reader.feed(frame[1:])) == 10
    assert reader.skipped == 100


@pytest.mark.parametrize("rows", [0, 11, 255])
def test_frames_that_state_impossible_rows_count_for_nothing(rows: int) -> None:
    layout = FrameLayout(64, 2)
    first, odd, last = frames_of(layout, 3)
    body = odd[:18] + bytes([rows]) + odd[19:-4]
    samples = decoder(layout).feed(first + body + crc32(body).to_bytes(4, "little") + last)
    check_truth(samples)
    assert [(gap.first, gap.count) for gap in samples.gaps] == [(10, 10)]


def test_part_filled_frames() -> None:
    layout = FrameLayout(64, 2)
    data = b""
    for begin, rows in ((0, 10), (10, 1), (11, 7), (18, 10)):
        data += encode_frame(layout, codes_at(begin + np.arange(rows)), stream=STREAM, sequence=0, index=begin)
    samples = decoder(layout).feed(data)
    check_truth(samples)
    assert len(samples) == 28


def test_flags() -> None:
    layout = FrameLayout(64, 2)
    ends, flags = np.array([[MAX_CODE, 0], [0, MIN_CODE], [1, 1]], np.int16), OVERRUN_FLAG | SATURATED_FLAG << 1
    first = encode_frame(layout, ends, stream=STREAM, sequence=0, index=0)
    second = encode_frame(layout, np.array([[1, 1]], np.int16), stream=STREAM, sequence=1, index=5, flags=flags)
    samples = decoder(layout).feed(first + second)
    np.testing.assert_array_equal(samples.saturated, [[True, False], [False, True], [False, False], [False, True]])
    assert samples.overruns == 1
    assert [(gap.first, gap.count, gap.reason) for gap in samples.gaps] == [(3, 2, "the device's buffer ran over")]


def test_lost_beginning_is_a_gap() -> None:
    layout = FrameLayout(64, 2)
    samples = decoder(layout).feed(b"".join(frames_of(layout, 3)[1:]))
    check_truth(samples)
    assert [(gap.first, gap.count) for gap in samples.gaps] == [(0, 10)]


def test_restarted_stream_is_never_spliced() -> None:
    layout = FrameLayout(64, 2)
    reader = decoder(layout)
    first_samples = reader.feed(b"".join(frames_of(layout, 2)))
    stale, new = frames_of(layout, 3)[2], b"".join(frames_of(layout, 2, stream=STREAM + 1))
    second_samples = reader.feed(stale + new, STREAM + 1, "unplugged")
    samples = join_samples([first_samples, second_samples])
    assert [(gap.first, gap.count, gap.reason) for gap in samples.gaps] == [(20, -1, "unplugged")]
    np.testing.assert_array_equal(samples.index, [*range(20), *range(21, 41)])
    np.testing.assert_array_equal(second_samples.volts, codes_at(np.arange(20)) * SCALE)


def test_frames_of_another_kind_are_refused_at_last() -> None:
    reader = decoder(FrameLayout(64, 2))
    data = b"".join(frames_of(FrameLayout(64, 3), 1000))
    with pytest.raises(ProtocolError, match=r"no valid frame in \d+ bytes.*2 channels and frames of 64 bytes"):
        fed(reader, data * 3, 6400)
