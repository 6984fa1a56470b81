"""examples/firmware: compiled without a warning, bit by bit what this project encodes and reads, whatever bytes it is sent."""

from __future__ import annotations

import re
import struct
import sys
import time
import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from docs.make_protocol import build_bos, build_descriptor_set
from hw.common.samples import Floats
from hw.reader import Reader
from hw.serial_port.device import SerialDevice
from hw.serial_port.packets import encode_request, encode_response
from hw.simulation.firmware import Firmware, Halted
from hw.usb.device import UsbDevice
from hw.wire.protocol import GET_INFO, GET_STATUS, SET_RATE, START, STOP, Info, Status
from hw.wire.stream import StreamTransport
from tests.support.hw.firmware_board import FIRMWARE, BoundBoard, ModelBoard, compile_firmware, posix_board, run_script

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="Windows has no pseudo-terminals")
SCALES, AMPLITUDE, DRIVE_HZ = (6e-9, 6e-9, 5e-8), 20_000, 5.0  # of posix_board.c
SCALE = 1e-4  # of tinyusb_core.c


def sine(index: np.ndarray, frequency: float, rate: float, amplitude: int) -> np.ndarray:
    """The drive as drive.h describes it: straight lines between 1024 rounded values a cycle, the phase in steps of 2^-32."""
    step = round(frequency / rate * 2**32)
    phase = index.astype(object) * step % 2**32
    sign = np.where(phase >= 2**31, -1, 1)
    fold = np.minimum(phase % 2**31, 2**31 - phase % 2**31)
    quarter = np.rint(32768 * np.sin(np.pi / 2 * np.arange(258) / 256)).astype(int)
    quarter[257] = quarter[256]
    low = quarter[(fold // 2**22).astype(int)]
    rise = quarter[(fold // 2**22).astype(int) + 1] - low
    value = (low + (rise * (fold % 2**22) + 2**21) // 2**22) * amplitude
    return (sign * ((value + 2**14) // 2**15)).astype(int)


def films(times: Floats, rate: float, channels: int) -> Floats:
    """Volts of posix_board.c."""
    value = sine(np.rint(times * rate).astype(int), DRIVE_HZ, rate, AMPLITUDE)
    columns = [np.fix(value * 27 / 40), value, value]
    return (np.column_stack(columns) * np.array(SCALES, np.float32).astype(float))[:, :channels]


def test_compiles_without_a_warning(tmp_path: Path) -> None:
    sources = sorted(FIRMWARE.glob("*.c"))
    assert sources
    for source in sources:
        compile_firmware([source], "-O2", "-c", "-o", str(tmp_path / "object.o"))


def test_the_page_s_code_compiles(tmp_path: Path) -> None:
    page = (FIRMWARE.parents[1] / "docs" / "guides" / "board.md").read_text(encoding="utf-8")
    (source,) = re.findall(r"```c\n(.*?)```", page, re.S)
    declared = '#include "probe_board.h"\nvoid dma_half_done(const int32_t (*rows)[2], unsigned count);\n'
    (tmp_path / "page.c").write_text(declared + source, encoding="utf-8")
    compile_firmware([tmp_path / "page.c"], "-c", "-Wno-unused-variable", "-o", str(tmp_path / "page.o"))


@pytest.mark.parametrize(("size", "channels", "rate"), [(64, 2, 20_000), (512, 3, 20_000), (33, 2, 20_000), (1024, 3, 100)])
def test_every_byte_is_that_of_the_virtual_probe(size: int, channels: int, rate: int) -> None:
    with posix_board("-f", "-s", str(size), "-c", str(channels), "-r", str(rate)) as port:
        transport = StreamTransport(SerialDevice(port))
        data = b""
        while len(data) < 40_000:
            data += transport.read().data
        transport.close()
    virtual = Firmware(lambda times: films(times, rate, channels), float(rate), SCALES[:channels], size)
    virtual.control(START, transport.header.stream, b"")
    assert data == virtual.send(len(data))


def test_the_reader_reads_a_board_that_interrupts() -> None:
    """Conversions come from a timer's signal, anywhere in the main loop; whatever a busy machine loses is a gap."""
    with posix_board("-r", "1000") as port:
        for rate in (2000.0, 500.0):
            with Reader.open(f"serial:{port}", rate) as reader:
                samples = reader.collect(0.5)
            np.testing.assert_array_equal(samples.volts, films(samples.times, rate, 2))
            lost = [np.arange(gap.first, gap.first + gap.count) for gap in samples.gaps]
            covered = np.sort(np.concatenate([samples.index, *lost]))
            np.testing.assert_array_equal(covered, np.arange(len(covered)))
            assert (samples.rate, samples.source["firmware"]) == (rate, "posix board 1")


def test_requests_while_it_runs_and_while_it_does_not() -> None:
    with posix_board("-s", "32", "-c", "3") as port:
        device = SerialDevice(port)
        device.open()
        device.request(STOP)
        device.request(SET_RATE, data=4_000_000_000)
        assert Info.decode(device.request(GET_INFO)).rate == 100_000.0  # the nearest that the board can do
        device.request(START, 7)
        time.sleep(0.3)  # nobody reads: the buffer of 100 ms runs over
        status = Status.decode(device.request(GET_STATUS))
        assert status.stream == 7
        assert status.overruns >= 1
        assert status.index > status.sequence  # one row in a frame: those that were dropped count
        device.request(STOP)
        assert Status.decode(device.request(GET_STATUS)).stream == 0
        device.close()


def test_the_virtual_probe_grants_and_refuses_as_the_board_does() -> None:
    model, virtual = ModelBoard(2, 64, 1000.0, 12, False), Firmware(codes_volts, 1000.0, (0.25, 0.5), 64)
    generator, steps = np.random.default_rng(5), [model.init()]
    for _ in range(300):
        number, value = int(generator.choice([2, 3, 4, 5, 6])), int(generator.integers(0, 3))
        data = generator.bytes(2) + bytes(generator.choice([1, 2, 2, 2, 3])) if number == SET_RATE else b""
        step, _ = model.control(number, value, data)
        try:
            answer = virtual.control(number, value, data)
        except Halted:
            steps.append((step, b"\0\0\0"))
        else:
            steps.append((step, struct.pack("<BH", 1, len(answer)) + answer))
    check(steps)


def test_a_frame_waits_50_ms_at_most() -> None:
    for rate, rows in ((1.0, 1), (20.0, 2), (100.0, 6), (180.0, 10), (1000.0, 10)):
        model = ModelBoard(2, 64, rate, 100, False)
        steps = [model.init(), model.control(START, 1, b""), model.convert(np.arange(60).reshape(30, 2), 0)]
        assert len(model.queue) == 30 // rows
        check([*steps, *(step for _ in range(30) for step in (model.peek(), model.release()))])


def check(steps: list[tuple[bytes, bytes]]) -> None:
    assert run_script(b"".join(step for step, _ in steps)) == b"".join(result for _, result in steps)


def spoil(generator: np.random.Generator) -> bytes:
    """Return bytes for a serial port: requests, right or wrong, cut or damaged, and noise that looks like them."""
    value = int(generator.choice([0, 1, 77, 65535]))
    data = encode_request(int(generator.integers(0, 8)), value, int(generator.choice([0, 1, 50_000, 2**32 - 1])))
    kind = generator.integers(0, 8)
    if kind == 0:
        return generator.bytes(int(generator.integers(0, 40)))
    if kind == 1:
        return data[: generator.integers(0, 14)]
    if kind == 2:
        k = int(generator.integers(0, 14))
        return data[:k] + bytes([data[k] ^ 1 << generator.integers(0, 8)]) + data[k + 1 :]
    if kind == 3:
        return b"PQPPQ\x01PQ"[: generator.integers(0, 9)] + data
    if kind == 4:  # another version, its checksum right
        body = data[:2] + bytes([generator.integers(0, 256)]) + data[3:10]
        return body + struct.pack("<I", zlib.crc32(body))
    return data


def draw_step(model: ModelBoard, generator: np.random.Generator) -> tuple[bytes, bytes]:
    kind = generator.integers(0, 10)
    if kind < 4:
        codes = generator.integers(-32768, 32768, (int(generator.integers(0, 60)), model.layout.channels))
        return model.convert(codes, int(generator.choice([0, 0, 1, 255])))
    if kind == 4:
        return model.set_flush(bool(generator.integers(0, 2)))
    if kind == 5 and generator.random() < 0.1:
        return model.reset()
    if model.is_serial:
        if kind % 2:
            return model.receive(b"".join(spoil(generator) for _ in range(3)))
        return model.transmit(int(generator.integers(0, 300)))
    if kind < 8:
        return model.peek() if generator.random() < 0.6 else model.release()
    number = int(generator.integers(0, 256) if generator.random() < 0.2 else generator.integers(0, 7))
    length = int(generator.choice([0, 3, 4, 4, 4, 5, 64, 4096]))
    return model.control(number, int(generator.choice([0, 1, 77, 65535])), generator.bytes(length))


@pytest.mark.parametrize("is_serial", [False, True], ids=["usb", "serial"])
def test_whatever_is_sent_it_does_what_the_page_says(is_serial: bool) -> None:
    """Random steps, under the sanitizers; after all of them the board still answers a request and starts a stream."""
    generator = np.random.default_rng(40)
    steps = list[tuple[bytes, bytes]]()
    for _ in range(40):
        channels, size = int(generator.integers(2, 4)), int(generator.choice([32, 33, 64, 512, 1024]))
        rate = float(generator.choice([1.0, 30.0, 1000.0, 4000.0]))
        capacity = int(rate / 10) // min(255, (size - 24) // (2 * channels)) + 2  # 100 ms, and one frame on its way
        model = ModelBoard(channels, size, rate, capacity, is_serial)
        steps += [model.init(), *(draw_step(model, generator) for _ in range(250))]
        if is_serial:
            steps += [
                model.transmit(65535),
                model.receive(bytes(14)),
                model.receive(encode_request(START, 9)),
                model.transmit(65535),
            ]
            assert steps[-1][1].endswith(encode_response(START))
        else:
            steps += [model.reset(), model.control(START, 9, b"")]
        assert model.stream == 9
    check(steps)


def test_frames_rates_and_memory_that_the_protocol_does_not_allow_are_refused() -> None:
    good = (2, 64, 0, 1000, 10_000_000, 1_000_000, 64 * 103)  # 100 ms of 10 kS/s are 100 frames of 10 rows
    bad = [{0: 1}, {0: 4}, {1: 31}, {1: 1025}, {3: 0}, {5: 999}, {4: 999_999}, {6: 64 * 103 - 1}, {6: 0}]
    settings = [good, *(tuple(change.get(k, value) for k, value in enumerate(good)) for change in bad)]
    output = run_script(b"".join(struct.pack("<cBHB4I", b"I", *values) for values in settings))
    assert output == b"\1" + bytes(len(bad))


def test_the_drive_is_a_sine_of_its_frequency() -> None:
    count = 20_000
    for frequency, rate, amplitude in (
        (5.0, 1000.0, 20_000),
        (137.111, 10_000.0, 32_767),
        (0.001, 4e6, 32_767),
        (499.0, 1000.0, 1),
    ):
        step = struct.pack("<cIIHI", b"D", round(1e3 * frequency), round(1e3 * rate), amplitude, count)
        output = run_script(step)
        assert output[0] == 1
        values, index = np.frombuffer(output[1:], "<i2"), np.arange(count)
        np.testing.assert_array_equal(values, sine(index, frequency, rate, amplitude))
        drift = 2 * np.pi * count / 2**33  # rad: half a step of the phase at every conversion
        assert np.abs(values - amplitude * np.sin(2 * np.pi * frequency * index / rate)).max() < 2 + amplitude * drift
    for frequency, rate, amplitude in ((500, 1000, 1), (1, 0, 1), (1, 1000, 32_768)):
        assert run_script(struct.pack("<cIIHI", b"D", frequency, rate, amplitude, 0)) == b"\0"


@pytest.mark.parametrize("bits", [8, 12, 16, 18, 24, 32])
def test_only_the_ends_of_a_converter_are_sent_as_ends(bits: int) -> None:
    top = 2 ** (bits - 1) - 1
    values = np.unique(np.linspace(-top - 1, top, 70_000).astype(np.int64))
    values = np.unique(np.clip(np.concatenate([values, [-top, 1 - top, top - 1, top - 2, -1, 0, 1]]), -top - 1, top))
    output = run_script(struct.pack("<cBI", b"S", bits, len(values)) + values.astype("<i4").tobytes())
    inner = np.clip(np.floor(values * 2.0 ** (16 - bits) + 0.5), -32767, 32766)
    expected = np.where(values == top, 32767, np.where(values == -top - 1, -32768, inner))
    np.testing.assert_array_equal(np.frombuffer(output, "<i2"), expected)


def test_the_checksum_is_that_of_zlib() -> None:
    data = b"123456789"
    assert run_script(struct.pack("<cH", b"K", len(data)) + data) == struct.pack("<I", 0xCBF43926)


@pytest.fixture
def bound() -> Iterator[BoundBoard]:
    board = BoundBoard()
    yield board
    board.end()


def codes_volts(times: Floats) -> Floats:
    """Volts of tinyusb_core.c."""
    index = np.rint(times * 1000.0).astype(np.int64)
    return np.column_stack([(7919 * index + 31 * c) % 65533 - 32766 for c in range(2)]) * float(np.float32(SCALE))


def test_tinyusb_shows_the_descriptors_of_the_page(bound: BoundBoard) -> None:
    assert bound.transfer(0x80, 6, 0x0100, 0, 64) == struct.pack(
        "<BBHBBBBHHHBBBB", 18, 1, 0x210, 0, 0, 0, 64, 0x1209, 1, 256, 1, 2, 3, 1
    )
    configuration = bound.transfer(0x80, 6, 0x0200, 0, 255)
    assert configuration is not None
    assert configuration[9:] == bytes([9, 4, 0, 0, 1, 0xFF, 0, 0, 0, 7, 5, 0x81, 2, 64, 0, 0])
    assert struct.unpack("<BBHBB", configuration[:6]) == (9, 2, 25, 1, 1)
    assert bound.transfer(0x80, 6, 0x0303, 0x0409, 255) == b"\x08\x03A\0001\0007\0"
    assert bound.transfer(0x80, 6, 0x0300, 0, 255) == b"\x04\x03\x09\x04"
    assert bound.transfer(0x80, 6, 0x0F00, 0, 255) == build_bos()
    assert bound.transfer(0xC0, 0x20, 0, 7, 255) == build_descriptor_set()


def test_the_reader_reads_through_tinyusb_bit_by_bit(bound: BoundBoard) -> None:
    transport = StreamTransport(UsbDevice("A17", bound))
    data = b"".join(transport.read().data for _ in range(40))
    virtual = Firmware(codes_volts, 1000.0, (SCALE, SCALE), 64)
    virtual.control(START, transport.header.stream, b"")
    assert data == virtual.send(len(data))
    bound.send_step(b"HN")  # the endpoint was halted: what waited there was lost on the way, and is sent again
    again = b"".join(transport.read().data for _ in range(3))
    assert again == virtual.send(len(again))
    transport.close()
    assert bound.transfer(0xC0, GET_STATUS, 0, 0, 4) == bytes(4)  # closing stops the stream


def test_what_tinyusb_must_stall_is_stalled(bound: BoundBoard) -> None:
    rate = struct.pack("<I", 500_000)
    assert bound.transfer(0x40, START, 5, 0, b"") == b""
    refused = [
        (0x40, SET_RATE, 0, 0, rate), (0x40, START, 0, 0, b""), (0xC0, 6, 0, 0, 64), (0x40, 0, 0, 0, b""), (0xC0, START, 1, 0, 4),
        (0x40, GET_INFO, 0, 0, b""), (0x40, STOP, 0, 1, b""), (0x41, STOP, 0, 0, b""), (0xC0, 0x20, 0, 4, 64),
    ]  # fmt: skip
    assert [bound.transfer(*request) for request in refused] == [None] * len(refused)
    assert bound.transfer(0xC0, GET_STATUS, 0, 0, 2) == b"\5\0"  # as much as the host asks for
    bound.send_step(b"B")  # a bus reset stops the stream
    assert bound.transfer(0xC0, GET_STATUS, 0, 0, 2) == b"\0\0"
    assert [bound.transfer(0x40, SET_RATE, 0, 0, data) for data in (b"", rate[:3], rate + b"\0", bytes(4000))] == [None] * 4
    assert bound.transfer(0x40, SET_RATE, 0, 0, rate) == b""
    generator = np.random.default_rng(8)
    for _ in range(500):
        kind, number = int(generator.choice([0x40, 0xC0, generator.integers(256)])), int(generator.integers(0, 8))
        length = int(generator.choice([0, 4, 64, 4096]))
        data = length if kind & 0x80 else generator.bytes(length)
        bound.transfer(kind, number, int(generator.integers(0, 3)), 0, data)
    assert bound.transfer(0x40, START, 6, 0, b"") == b""
    assert bound.transfer(0xC0, GET_STATUS, 0, 0, 64) == struct.pack("<HHIQ", 6, 0, 0, 0)
