"""Any data acquisition device as a source of samples: put what your driver gives in place of ``driver``, 30 lines in all.

``python examples/daq_adapter.py run.probe`` reads 2 s and writes a recording that ``probe-design read --replay run.probe`` reads.
"""

from __future__ import annotations

import sys

import numpy as np

from hw.common.transport import Chunk
from hw.files.volts import build_volts_header, pack_samples
from hw.reader import Reader

RATE, RANGE = 1000.0, 5.0  # samples per second and channel; volts at the end of the converter's range


def driver(first: int, count: int) -> np.ndarray:
    """Return rows of volts, (count, 2), from a sample on: here 10 mN at 5 Hz; with yours, what its read function returns."""
    turns = 2 * np.pi * 5.0 * np.arange(first, first + count) / RATE
    noise = np.random.default_rng(first).normal(0.0, 1e-7, (count, 2))
    return np.column_stack([8e-5 * np.sin(turns), 12e-5 * np.sin(turns)]) + noise


class DaqTransport:
    """What a reader needs: ``header``, ``read``, ``close``; every fault it raises is a ``hw.common.errors.HardwareError``."""

    def __init__(self) -> None:
        self.header = build_volts_header(RATE, ("inner", "outer"), transport="my DAQ", serial="1234")
        self._next = 0

    def read(self) -> Chunk:
        """Return the next 50 ms; an index that jumps states what was lost, a note of the chunk why."""
        volts = driver(self._next, 50)
        index = np.arange(self._next, self._next + len(volts))
        self._next += len(volts)
        return Chunk(pack_samples(index, volts, np.abs(volts) >= RANGE))

    def close(self) -> None:
        """Let go of the device."""


if __name__ == "__main__":
    with Reader(DaqTransport()) as reader:
        samples = reader.collect(2.0, record=sys.argv[1])
    print(f"{len(samples)} samples, {len(samples.gaps)} gaps")
