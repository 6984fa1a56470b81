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
from probe_design.built_probe.reading import Read
from probe_design.measuring.acquisition import window
from probe_design.terminal.braille_chart import chart
from probe_design.terminal.console import message, rich_console

SHOWN = 1.0  # s of the films' voltages that are drawn
LEAST_PERIODS = 4.0
LONGEST = 4.0  # s: shortest window that a live number is computed from

Show = Callable[[Samples], None]


def followed(frequency: float) -> float:
    """Return the window for a live number, s, at a frequency of the load, Hz."""
    return max(LEAST_PERIODS / frequency, LONGEST)


@contextmanager
def following(judge: Callable[[Samples], Read]) -> Iterator[Show]:
    """Yield a function that shows the latest samples; ``compare`` converts them to a reading."""
    console = rich_console()
    ratios: list[float] = []

    def judged(samples: Samples) -> Read:
        reading = judge(samples)
        if reading.ratio is not None:
            ratios.append(reading.ratio)
        return reading

    if not console.is_terminal:
        yield lambda samples: message(_line(samples, judged(samples)))
        return
    with Live(console=console, transient=True, auto_refresh=False) as live:
        yield lambda samples: live.update(_picture(samples, judged(samples), ratios, console), refresh=True)


def _line(samples: Samples, reading: Read) -> str:
    stresses = f"stresses {reading.stress_inner:.4g} and {reading.stress_outer:.4g} Pa"
    return f"{samples.index[-1] / samples.rate:.1f} s: ratio {_ratio(reading)}, {stresses}"


def _picture(samples: Samples, reading: Read, ratios: list[float], console: Console) -> Group:
    table = Table(show_header=False, box=None)
    for _ in range(2):
        table.add_column(overflow="fold")  # a number is folded, never cut, on a narrow terminal
    rows = {
        "time, s": f"{samples.index[-1] / samples.rate:.1f}",
        "ratio": _ratio(reading),
        "stress inner, Pa": f"{reading.stress_inner:.5g} +- {reading.stress_inner_uncertainty:.1g}",
        "stress outer, Pa": f"{reading.stress_outer:.5g} +- {reading.stress_outer_uncertainty:.1g}",
        "gaps, overruns": f"{len(samples.gaps)}, {samples.overruns}",
    }
    for name, value in rows.items():
        table.add_row(name, value)
    if "utf" not in console.encoding.lower():
        return Group(table)
    width = min(console.width - 2, 100)
    last = window(samples, SHOWN).volts[:, :2].T * 1e3
    films = chart([one - one.mean() for one in last], width, 8)
    ratio = chart([np.array(ratios or [0.0])], width, 5)
    return Group(table, Text(f"films, mV, last {SHOWN:g} s"), Text(films), Text("ratio"), Text(ratio))


def _ratio(reading: Read) -> str:
    return "-" if reading.ratio is None else f"{reading.ratio:.5g} +- {reading.ratio_uncertainty:.1g}"
