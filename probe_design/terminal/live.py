"""Show numbers and curves during a reading: updated in place on a terminal, plain lines elsewhere."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import numpy as np
from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from geometry.common.arrays import Floats
from hw.common.samples import Samples
from probe_design.built_probe.reading import StressReading
from probe_design.measuring.acquisition import select_last
from probe_design.terminal.console import find_terminal, write_message

SHOWN_TIME_S = 1.0  # s of the films' voltages that are drawn
MIN_PERIODS = 4.0
MIN_WINDOW_S = 4.0  # s: shortest window that a live number is computed from

BLANK_CODE_POINT = 0x2800  # of Unicode's Braille patterns, which have two by four dots in each character
DOT_BITS = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]])  # bits of the dots, row by row from the top
LABEL_WIDTH = 11  # characters of the labels of the vertical axis

Show = Callable[[Samples], None]


def compute_live_window(frequency: float) -> float:
    """Return the duration of samples from which a live number is computed, s, for a frequency of the load, Hz."""
    return max(MIN_PERIODS / frequency, MIN_WINDOW_S)


@contextmanager
def show_live(compare: Callable[[Samples], StressReading]) -> Iterator[Show]:
    """Yield a function that shows the latest samples; ``compare`` converts them to a reading."""
    console = find_terminal()
    ratios: list[float] = []

    def compare_and_store(samples: Samples) -> StressReading:
        """Return the reading of some samples, and store its ratio for the curve."""
        reading = compare(samples)
        if reading.ratio is not None:
            ratios.append(reading.ratio)
        return reading

    if console is None:
        yield lambda samples: write_message(_format_line(samples, compare_and_store(samples)))
        return
    with Live(console=console, transient=True, auto_refresh=False) as live:
        yield lambda samples: live.update(_build_picture(samples, compare_and_store(samples), ratios, console), refresh=True)


def _format_line(samples: Samples, reading: StressReading) -> str:
    """Return time, ratio and stresses as one line."""
    stresses = f"stresses {reading.stress_inner:.4g} and {reading.stress_outer:.4g} Pa"
    return f"{samples.index[-1] / samples.rate:.1f} s: ratio {_format_ratio(reading)}, {stresses}"


def _build_picture(samples: Samples, reading: StressReading, ratios: list[float], console: Console) -> Group:
    """Build the live picture: a table of the latest numbers, and curves of the films' voltages and of the ratio.

    Parameters
    ----------
    samples
        The latest ones.
    reading
        Computed from them.
    ratios
        Of all live readings so far.
    console
        For its width and encoding.
    """
    table = Table(show_header=False, box=None)
    for _ in range(2):
        table.add_column(overflow="fold")  # a number is folded, never cut, on a narrow terminal
    rows = {
        "time, s": f"{samples.index[-1] / samples.rate:.1f}",
        "ratio": _format_ratio(reading),
        "stress inner, Pa": f"{reading.stress_inner:.5g} ± {reading.stress_inner_uncertainty:.1g}",
        "stress outer, Pa": f"{reading.stress_outer:.5g} ± {reading.stress_outer_uncertainty:.1g}",
        "gaps, overruns": f"{len(samples.gaps)}, {samples.overruns}",
    }
    for name, value in rows.items():
        table.add_row(name, value)
    if "utf" not in console.encoding.lower():
        return Group(table)
    width = min(console.width - 2, 100)
    last = select_last(samples, SHOWN_TIME_S).volts[:, :2].T * 1e3
    films = draw_chart([volts - volts.mean() for volts in last], width, 8)
    ratio = draw_chart([np.array(ratios or [0.0])], width, 5)
    return Group(table, Text(f"films, mV, last {SHOWN_TIME_S:g} s"), Text(films), Text("ratio"), Text(ratio))


def _format_ratio(reading: StressReading) -> str:
    """Return the ratio with its uncertainty; a dash where there is none."""
    return "-" if reading.ratio is None else f"{reading.ratio:.5g} ± {reading.ratio_uncertainty:.1g}"


def draw_chart(curves: Sequence[Floats], width: int = 60, height: int = 8) -> str:
    """Return a chart of curves as ``height`` lines of Braille patterns; the values of a curve are evenly spaced.

    Parameters
    ----------
    curves
        Each of shape (n,), n >= 1; a curve may be longer or shorter than the others.
    width
        Characters, axis included.
    height
        lines.
    """
    columns = max(2 * (width - LABEL_WIDTH - 1), 2)  # of dots, two in each character right of the labels and one blank
    low, high = min(float(line.min()) for line in curves), max(float(line.max()) for line in curves)
    span = high - low if high > low else max(abs(high), 1e-30)  # above 0 for constant curves, too
    grid = np.zeros((4 * height, columns), dtype=bool)
    for curve in curves:
        positions = np.linspace(0, len(curve) - 1, columns)
        values = np.interp(positions, np.arange(len(curve)), curve)
        rows = np.rint((high - values) / span * (4 * height - 1)).astype(int).clip(0, 4 * height - 1)
        for column, (first, last) in enumerate(zip(rows, np.append(rows[1:], rows[-1]), strict=True)):
            grid[min(first, last) : max(first, last) + 1, column] = True  # joins this dot to the next one's row
    cells = (grid.reshape(height, 4, columns // 2, 2) * DOT_BITS[:, None, :]).sum(axis=(1, 3))
    labels = [f"{high:.4g}", *[""] * (height - 2), f"{low:.4g}"]
    return "\n".join(
        f"{label:>{LABEL_WIDTH}} " + "".join(chr(BLANK_CODE_POINT + cell) for cell in row)
        for label, row in zip(labels, cells, strict=True)
    )
