"""What is shown while a reading runs: curves as text, its last seconds, terminals."""

from __future__ import annotations

from collections.abc import Iterator
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from hw.common.errors import HardwareError, InvalidSource
from hw.common.samples import Samples
from hw.reader import Reader
from hw.signal.covariance import propagate_complex_covariance, split_parts
from hw.signal.measurement import Measurement
from hw.signal.reading_fit import ReadingFit
from probe_design.built_probe.film_forces import measure_samples
from probe_design.built_probe.virtual_probe import BuiltProperties, build_signals
from probe_design.measuring.acquisition import fit_reading, select_last
from probe_design.terminal.live import BLANK_CODE_POINT, draw_chart, show_live
from tests.support.hw.benches import BENCH, calibrate, films, sampled, scene, shares
from tests.support.hw.faulty_probe import Fault, make_faulty_probe
from tests.support.hw.fits import fit_sine


def test_chart_of_a_falling_line() -> None:
    lines = draw_chart([np.array([3.0, 1.0])], width=32, height=4).splitlines()
    cells = [line[12:] for line in lines]
    assert [len(line) for line in lines] == [32] * 4
    assert lines[0].split()[0] == "3"
    assert lines[3].split()[0] == "1"
    assert ord(cells[0][0]) & 0x01  # the uppermost dot of the first cell, and the lowest right one of the last
    assert ord(cells[3][-1]) & 0x80
    for k, row in enumerate(cells):  # the line is in the k-th quarter, and nowhere else
        used = [i for i, character in enumerate(row) if ord(character) != BLANK_CODE_POINT]
        assert 5 * k - 1 <= min(used) <= max(used) <= 5 * (k + 1)


def test_chart_of_a_constant_is_drawn() -> None:
    assert "1" in draw_chart([np.ones(3)], width=20, height=2)


def probe(faults: tuple[Fault, ...] = (), seed: int = 0) -> Reader:
    volts = build_signals(BuiltProperties(), BENCH, scene(), films(shares().log_ratios)[3], seed)
    return Reader.open(make_faulty_probe(volts, 500.0, channels=3, scale=2e-6, faults=faults))


def test_collected_is_what_the_reader_gives() -> None:
    looks: list[Samples] = []
    running = ReadingFit(5.0, force=True)
    with probe() as reader:
        fit_reading(reader, 4.0, None, running, show=looks.append, last=1.0)
    with probe() as reader:
        whole = reader.collect(4.0)
    assert running.fit().amplitudes == pytest.approx(fit_sine(whole, 5.0).amplitudes, rel=1e-9)
    assert all(len(look) <= 500 for look in looks)
    assert len(select_last(whole, 1.0).index) == 500


def test_what_a_look_raises_does_not_end_the_reading() -> None:
    def look(samples: Samples) -> None:
        raise HardwareError("too little yet")

    running = ReadingFit(5.0, force=True)
    with probe() as reader:
        fit_reading(reader, 3.0, None, running, show=look, last=1.0)
    assert running.fit().rows == 1500


class Failing:
    """A reader that ends in an error, or at once."""

    def __init__(self, fault: Exception | None) -> None:
        self.fault = fault

    def blocks(self, seconds: float | None, record: Path | None) -> Iterator[Samples]:
        if self.fault is not None:
            raise self.fault
        yield from ()


@pytest.mark.parametrize(
    ("fault", "kind"), [(HardwareError("gone"), HardwareError), (OSError("full"), OSError), (None, InvalidSource)]
)
def test_errors_of_the_reader_come_through(fault: Exception | None, kind: type[Exception]) -> None:
    reader: Any = Failing(fault)
    with pytest.raises(kind):
        fit_reading(reader, 1.0, None, ReadingFit(5.0, force=True), show=lambda samples: None, last=1.0)


def test_lost_frames_are_marked_by_read_and_refused_by_calibrate() -> None:
    with probe((Fault("drop", 30, 4),)) as reader:
        lossy = reader.collect(8.0)
    reading_made = measure_samples(lossy, BENCH)
    assert reading_made.losses.gaps == 1
    assert reading_made.fit.rows < 4000
    with probe() as reader:
        whole = measure_samples(reader.collect(8.0), BENCH)
    assert abs(compute_charge_ratio(reading_made) - compute_charge_ratio(whole)) < 5 * compute_ratio_sd(whole)
    with pytest.raises(HardwareError, match="lost"):
        calibrate(scene(), BENCH, [lossy] * 7, shares())


def compute_charge_ratio(measurement: Measurement) -> complex:
    return complex(measurement.charges[0] / measurement.charges[1])


def compute_ratio_sd(measurement: Measurement) -> float:
    covariance = propagate_complex_covariance(
        lambda charges: split_parts(charges[:1] / charges[1:]), measurement.charges, measurement.covariance
    )
    return float(np.sqrt(np.trace(covariance)))


@pytest.mark.parametrize(("terminal", "width"), [(True, 90), (False, 90), (True, 24)])
def test_following_shows_numbers(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], terminal: bool, width: int
) -> None:
    from probe_design.built_probe.reading import compute_reading as compare_reading
    from probe_design.built_probe.reading import predict_scene

    predicted = predict_scene(scene(), 0.01)
    screen = StringIO()
    console = Console(file=screen, force_terminal=terminal, width=width, height=40)
    monkeypatch.setattr("probe_design.terminal.live.find_terminal", lambda: console if terminal else None)
    samples = sampled(build_signals(BuiltProperties(), BENCH, scene(), films(shares().log_ratios)[3], 1))
    with show_live(lambda part: compare_reading(measure_samples(part, BENCH), scene(), BENCH, predicted)) as show:
        show(samples)
        show(samples)
    shown = screen.getvalue() if terminal else capsys.readouterr().err
    assert "ratio" in shown
    assert "±" in shown
    assert "\u2026" not in shown
    assert ("\x1b" in shown) == terminal
    assert any(ord(character) > BLANK_CODE_POINT for character in shown) == terminal
