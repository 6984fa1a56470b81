"""Readings fitted as they come: the result of one fit of the whole, whatever their length."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hw.common.samples import Gap, Samples
from hw.signal.reading_fit import ReadingFit
from hw.signal.sine_fit import NoSine
from tests.support.hw.fits import fit_sine

RATE, LOAD = 100.0, 5.003
TRUE = np.array([0.9e-3, -1.6e-3, 1e-2])
PIECE = 1200  # rows: 60 cycles


def reading(seconds: float) -> Samples:
    t = np.arange(round(seconds * RATE)) / RATE
    volts = np.outer(np.cos(2 * np.pi * LOAD * t), TRUE) + 1e-5 * np.random.default_rng(1).standard_normal((len(t), 3))
    unsaturated = np.zeros(volts.shape, bool)
    return Samples(
        RATE,
        ("inner", "outer", "force"),
        index=np.arange(len(t)),
        volts=volts,
        saturated=unsaturated,
        gaps=(),
        overruns=0,
        source={},
    )


def fitted(whole: Samples, piece_rows: int = 70) -> ReadingFit:
    running = ReadingFit(5.0, force=True, rows=PIECE)
    for start in range(0, len(whole), piece_rows):
        part = whole.select_from(int(whole.index[start]))
        running.add(part.select_before(int(whole.index[start + piece_rows])) if start + piece_rows < len(whole) else part)
    return running


def test_pieces_tell_what_the_whole_tells() -> None:
    whole = reading(100.0)
    fit, whole_fit = fitted(whole).fit(), fit_sine(whole, 5.0)
    spread = np.sqrt(np.diag(whole_fit.covariance)[::2])
    assert np.all(np.abs(np.abs(fit.amplitudes) - np.abs(TRUE)) < 4 * spread)
    assert np.sqrt(np.diag(fit.covariance)[::2]) == pytest.approx(spread, rel=0.1)
    assert (fit.rows, len(fit.blocks)) == (10_000, 12 * 9)
    assert fit.seconds == pytest.approx(100.0, rel=2e-3)


def test_memory_holds_two_pieces() -> None:
    running = fitted(reading(200.0))
    assert sum(len(part) for part in running._waiting) < 2 * PIECE


def test_gaps_are_counted_and_stretches_fitted_one_by_one() -> None:
    whole = reading(60.0)
    index = whole.index + (whole.index >= 3333)
    fit = fitted(replace(whole, index=index, gaps=(Gap(3333, -1, "unplugged"),)))
    assert fit.losses.gaps == 1
    assert np.abs(fit.fit().amplitudes) == pytest.approx(np.abs(TRUE), rel=2e-3)


def test_a_load_that_is_off_in_one_piece_is_said_at_the_end() -> None:
    """The reading goes on and is recorded: nothing is lost by it."""
    whole = reading(100.0)
    whole.volts[4000:6500] = 0.0
    running = fitted(whole)
    assert running.losses.gaps == 0
    with pytest.raises(NoSine, match="shows no change"):
        running.fit()
    with pytest.raises(NoSine, match="no samples"):
        ReadingFit(5.0, force=True).fit()
