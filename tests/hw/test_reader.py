"""Reader and recovery, with a virtual probe on a virtual bus."""

from __future__ import annotations

import signal
from dataclasses import replace
from threading import Event, Thread

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hw.common.clock import Clock
from hw.common.drain import Drain
from hw.common.errors import Overrun, Timeout, TransferError
from hw.common.samples import Gap
from hw.common.transport import Chunk
from hw.reader import Reader
from hw.simulation.virtual import make_virtual_probe
from hw.wire.frames import MAX_CODE, MIN_CODE
from hw.wire.stream import Patience
from tests.support.hw.faulty_probe import Fault, Kind
from tests.support.hw.virtual_probes import LOST, RATE, SCALE, probe, read, right


@pytest.mark.parametrize("packet", [64, 511, 512, 513, 1024])
def test_every_sample_once(packet: int) -> None:
    samples = read(probe(packet=packet), 1.0)
    np.testing.assert_array_equal(samples.index, np.arange(100_000))
    assert right(samples)
    assert samples.require_complete() is samples
    assert (samples.rate, samples.channels) == (RATE, ("inner", "outer"))
    assert (samples.source["transport"], samples.source["serial"]) == ("virtual", "V1")
    assert samples.source["scale"] == [SCALE, SCALE]


@pytest.mark.parametrize(
    ("kind", "count", "lost", "reason"),
    [
        ("drop", 3, 30, LOST), ("corrupt", 2, 20, LOST), ("cut", 4, 10, LOST), ("repeat", 3, 0, ""), ("silence", 1, 0, ""),
        ("overrun", 2, 20, "the device's buffer ran over"), ("stall", 3, 30, "the endpoint was halted"),
        ("error", 2, 20, "the bus failed"),
        ("unplug", 1, 10, "the device was unplugged, and came back at bus 1 address 3"),
    ],
)  # fmt: skip
def test_fault_becomes_a_gap(kind: Kind, count: int, lost: int, reason: str) -> None:
    samples = read(probe(Fault(kind, 70, count, 0.02)), patience=Patience(absence=1.0))
    assert samples.gaps == ((Gap(700, lost, reason),) if lost else ())
    assert right(samples)
    np.testing.assert_array_equal(samples.index, [*range(700), *range(700 + lost, 2000)])


def test_faults_with_data_between_are_borne_for_ever() -> None:
    samples = read(probe(*(Fault("stall", position) for position in range(0, 1000, 100))), 0.2)
    assert len(samples.gaps) == 10
    assert right(samples)


def test_frame_whose_checksum_ends_in_a_zero_is_kept_before_a_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    """The stream's number is drawn, and enters the checksum: one stream in 256 lost its last whole frame."""
    for stream in range(1, 257):
        monkeypatch.setattr("hw.wire.stream.random.randint", lambda low, high, stream=stream: stream)
        assert read(probe(Fault("error", 70)), 0.01).gaps == (Gap(700, 10, "the bus failed"),)


def test_lost_power_is_a_gap_of_unknown_length() -> None:
    samples = read(probe(Fault("power", 70)))
    assert [(gap.first, gap.count) for gap in samples.gaps] == [(700, -1)]
    np.testing.assert_array_equal(samples.index, [*range(700), *range(701, 2000)])
    begun_anew = replace(samples, index=np.where(samples.index > 700, samples.index - 701, samples.index))
    assert right(begun_anew)


@given(st.lists(st.tuples(st.sampled_from(["drop", "corrupt", "cut", "repeat", "overrun", "stall", "error", "silence", "unplug"]),
    st.integers(0, 180), st.integers(1, 3)), max_size=6), st.sampled_from([64, 100, 513]))  # fmt: skip
def test_any_faults_give_right_samples_or_gaps(faults: list[tuple[Kind, int, int]], packet: int) -> None:
    source = probe(*(Fault(*fault) for fault in faults), packet=packet)
    try:
        samples = read(source, patience=Patience(attempts=100))
    except Timeout:  # the end of the stream may be in a gap, and nothing after it
        pytest.fail("the stream never ends")
    assert right(samples)
    lost = [np.arange(gap.first, gap.first + gap.count) for gap in samples.gaps]
    covered = np.sort(np.concatenate([samples.index, *lost]))
    np.testing.assert_array_equal(covered, np.arange(len(covered)))


def test_saturation_is_marked_where_it_is() -> None:
    source = make_virtual_probe(lambda t: np.column_stack([40_000 * np.sin(t * 700), 0 * t]) * SCALE, RATE, "V1", scale=SCALE)
    samples = read(source)
    truth = 40_000 * np.sin(samples.times * 700)
    np.testing.assert_array_equal(samples.saturated[:, 0], (np.rint(truth) >= MAX_CODE) | (np.rint(truth) <= MIN_CODE))
    assert not samples.saturated[:, 1].any()
    assert samples.saturated[:, 0].any()


def test_three_channels_and_another_rate() -> None:
    source = make_virtual_probe(lambda t: np.column_stack([t, 2 * t, 3 * t]), RATE, "V1", channels=3, scale=2.0**-10)
    with Reader.open(source, rate=1000.0) as reader:
        samples = reader.collect(2.0)
    assert (samples.rate, samples.channels, len(samples)) == (1000.0, ("inner", "outer", "force"), 2000)
    np.testing.assert_allclose(samples.volts, np.arange(2000)[:, None] / 1000 * [1, 2, 3], atol=2.0**-11)


def test_calibration_takes_only_whole_samples() -> None:
    with pytest.raises(Overrun, match="ran over 1 times"):
        read(probe(Fault("overrun", 70))).require_complete()
    with pytest.raises(TransferError, match="from index 700 on were lost"):
        read(probe(Fault("drop", 70))).require_complete()


def test_device_is_stopped_at_the_end() -> None:
    source = probe()
    with Reader.open(source) as reader:
        reader.collect(0.01)
        assert source.firmware.stream
    assert source.firmware.stream == 0


def test_a_board_starts_when_it_is_read() -> None:
    """Whatever is computed between opening and reading costs no samples: 4 of 10 s were lost."""
    source = probe()
    with Reader.open(source) as reader:
        assert source.firmware.stream == 0
        next(iter(reader.blocks(0.01)))
        assert source.firmware.stream > 0


def test_a_board_that_was_reset_and_stays_on_the_bus_is_started_again() -> None:
    """It sent nothing more, and after 3 s the reading ended."""
    samples = read(probe(Fault("reset", 70)), patience=Patience(silence=0.0))
    assert [(gap.first, gap.count, gap.reason) for gap in samples.gaps] == [(700, -1, "the device was reset")]
    assert right(replace(samples, index=np.where(samples.index > 700, samples.index - 701, samples.index)))


class Counting:
    """A transport that counts how often it was read."""

    header = None

    def __init__(self) -> None:
        self.reads, self.enough = 0, Event()

    def read(self) -> Chunk | None:
        self.reads += 1
        if self.reads == 300:
            self.enough.set()
        return Chunk(b"x" * self.reads) if self.reads <= 300 else None

    def close(self) -> None:
        """Nothing is held."""


def test_somebody_reads_while_nobody_fetches() -> None:
    transport = Counting()
    drain = Drain(transport)
    chunks = iter(drain)
    assert next(chunks).data == b"x"
    assert transport.enough.wait(60)
    assert drain.is_behind
    assert [len(chunk.data) for chunk in chunks] == list(range(2, 301))
    drain.close()


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="Windows has no interval timer")
def test_an_interrupt_at_any_point_leaves_nothing_locked() -> None:
    """The thread could wait for ever on a lock that the interrupted reader holds, and whoever closes for the thread."""
    random = np.random.default_rng(1)
    previous = signal.signal(signal.SIGALRM, _interrupted)
    try:
        for _ in range(30):
            drain = Drain(Endless())
            try:
                signal.setitimer(signal.ITIMER_REAL, random.uniform(1e-4, 3e-3))
                for _ in drain:
                    pass
            except InterruptedError:
                pass
            finally:
                signal.setitimer(signal.ITIMER_REAL, 0)
            closing = Thread(target=drain.close, daemon=True)
            closing.start()
            closing.join(60)
            assert not closing.is_alive()
    finally:
        signal.signal(signal.SIGALRM, previous)


def _interrupted(*_: object) -> None:
    raise InterruptedError


class Endless(Counting):
    """Chunks without an end."""

    def read(self) -> Chunk:
        return Chunk(b"x")


def test_time_stamps_show_a_wrong_rate() -> None:
    """A board that states 100 kS/s and sends 90: 50 ms of samples take 55 ms."""
    with Reader.open(probe()) as reader:
        blocks = list(reader.blocks(8.0))
    for passed, wrong in ((0.05, False), (0.0505, False), (0.05 / 0.9, True), (0.05 / 1.1, True)):
        clock, said = Clock(RATE), None
        for block in blocks:
            said = clock.describe_difference(Chunk(b"", 1, "", passed * int(block.index[-1]) / 5000), block)
        assert (said is not None) == wrong
        assert said is None or "samples a second, not the stated 100000" in said
