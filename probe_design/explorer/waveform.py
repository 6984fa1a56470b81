"""Decimate samples for the live waveform: the minimum and maximum of each of a few hundred intervals."""

from __future__ import annotations

import json
from collections import deque
from typing import NamedTuple

import numpy as np

from geometry.common.arrays import Floats
from hw.common.samples import Samples

COLUMNS = 240  # intervals that are drawn
MIN_WINDOW_S, MIN_PERIODS = 2.0, 4.0  # of the time that is drawn
MV_PER_V = 1e3


class Column(NamedTuple):
    """What is drawn of one interval: its number, minima and maxima of the channels, V, and whether a value is clipped."""

    number: int
    low: Floats
    high: Floats
    is_clipped: bool


class Waveform:
    """The last seconds of all channels.

    Parameters
    ----------
    frequency
        Of the load, Hz.
    """

    def __init__(self, frequency: float) -> None:
        self._window = max(MIN_WINDOW_S, MIN_PERIODS / frequency)
        self._columns: deque[Column] = deque(maxlen=COLUMNS)
        self._channels: tuple[str, ...] = ()
        self._width = 1  # samples of a column

    def add(self, block: Samples) -> None:
        """Add the next samples."""
        if not len(block):
            return
        self._channels, self._width = block.channels, max(1, round(self._window * block.rate / COLUMNS))
        numbers = block.index // self._width
        starts = np.flatnonzero(np.diff(numbers, prepend=numbers[0] - 1))
        low, high = (reduce.reduceat(block.volts, starts) for reduce in (np.minimum, np.maximum))
        clipped = np.logical_or.reduceat(block.saturated.any(axis=1), starts)
        for k, number in enumerate(numbers[starts].tolist()):
            column = Column(number, low[k], high[k], bool(clipped[k]))
            if self._columns and self._columns[-1].number == number:  # the last block ended within this column
                last = self._columns.pop()
                column = Column(
                    number, np.minimum(low[k], last.low), np.maximum(high[k], last.high), column.is_clipped or last.is_clipped
                )
            self._columns.append(column)

    def to_json(self) -> str:
        """Return the columns as JSON: name, minima and maxima, mV, of each channel; columns that are clipped; the time, s.

        Columns whose samples were lost are null.
        """
        last = self._columns[-1].number if self._columns else 0
        columns = {column.number - last + COLUMNS - 1: column for column in self._columns if column.number > last - COLUMNS}

        def list_volts(name: str, channel: int) -> list[float | None]:
            """Return an end of each column's range, mV."""
            return [
                round(MV_PER_V * float(getattr(columns[k], name)[channel]), 4) if k in columns else None for k in range(COLUMNS)
            ]

        channels = [
            {"name": name, "low": list_volts("low", channel), "high": list_volts("high", channel)}
            for channel, name in enumerate(self._channels)
        ]
        clipped = [k for k, column in columns.items() if column.is_clipped]
        return json.dumps({"seconds": self._window, "channels": channels, "clipped": clipped})
