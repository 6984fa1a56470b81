"""Show numbers and curves during a reading: updated in place on a terminal, plain lines elsewhere."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from hw.common.samples import Samples
from probe_design.built_probe.reading import StressReading
from probe_design.measuring.acquisition import select_last
from probe_design.terminal.braille_chart import draw_chart
from probe_design.terminal.console import find_terminal, write_message

SHOWN_TIME_S = 1.0  # s of the films' voltages that are drawn
MIN_PERIODS = 4.0
MIN_WINDOW_S = 4.0  # s: shortest window that a live number is computed from

Show = Callable[[Samples], None]


def compute_live_window(frequency: float) -> float:
    """Return the window for a live number, s, at a frequency of the load, Hz."""
    return max(MIN_PERIODS / frequency, MIN_WINDOW_S)


@contextmanager
def show_live(compare: Callable[[Samples], StressReading]) -> Iterator[Show]:
    """Yield a function that shows the latest samples; ``compare`` converts them to a reading."""
    console = find_terminal()
    ratios: list[float] = []

    def compare_and_store(samples: Samples) -> StressReading:
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
    stresses = f"stresses {reading.stress_inner:.4g} and {reading.stress_outer:.4g} Pa"
    return f"{samples.index[-1] / samples.rate:.1f} s: ratio {_format_ratio(reading)}, {stresses}"


def _build_picture(samples: Samples, reading: StressReading, ratios: list[float], console: Console) -> Group:
    table = Table(show_header=False, box=None)
    for _ in range(2):
        table.add_column(overflow="fold")  # a number is folded, never cut, on a narrow terminal
    rows = {
        "time, s": f"{samples.index[-1] / samples.rate:.1f}",
        "ratio": _format_ratio(reading),
        "stress inner, Pa": f"{reading.stress_inner:.5g} +- {reading.stress_inner_uncertainty:.1g}",
        "stress outer, Pa": f"{reading.stress_outer:.5g} +- {reading.stress_outer_uncertainty:.1g}",
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
    return "-" if reading.ratio is None else f"{reading.ratio:.5g} +- {reading.ratio_uncertainty:.1g}"
