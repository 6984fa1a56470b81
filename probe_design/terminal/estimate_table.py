"""An estimate as a person reads it: a table and a sentence."""

from __future__ import annotations

from rich.table import Table

from probe_design.estimation.estimate import Estimate
from probe_design.estimation.reasons import NAMES, shown
from probe_design.estimation.strength import Interval


def sentence(told: Estimate) -> str:
    """Say what was found, in one sentence or two."""
    name = NAMES[told.unknown]
    if told.value is not None:
        return f"{name} = {shown(told.unknown, told.value)}, 95 % interval {_between(told.unknown, told.interval)}"
    instead = [] if told.unknown == "depth" or told.depth is None else [_depth(told)]
    if told.strength is not None:
        given = " (the scene's)" if told.strength_interval is None else _sized(told.strength_interval)
        instead.append(f"strength {told.strength * 1e9:.4g} mm^3{given}")
    left = f" What can be told: {', '.join(instead)}." if instead else ""
    return f"{name} is not identifiable: {told.reason}.{left}"


def estimate_table(told: Estimate) -> Table:
    """Return an estimate as a table."""
    table = Table(title=f"{told.evaluator}, {told.seconds:.2g} s")
    for heading in ("quantity", "value", "95 % interval"):
        table.add_column(heading, justify="left" if heading == "quantity" else "right")
    value = "not identifiable" if told.value is None else shown(told.unknown, told.value)
    table.add_row(told.unknown, value, _between(told.unknown, told.interval))
    table.add_row("by the noise alone", "", _between(told.unknown, told.interval_of_noise))
    if told.unknown != "depth" and told.depth is not None:
        table.add_row("depth", shown("depth", told.depth), _optional("depth", told.depth_interval))
    if told.strength is not None:
        table.add_row("strength", f"{told.strength * 1e9:.4g} mm^3", _sized(told.strength_interval, "given").strip(" ()"))
    if told.error_estimate is not None:
        table.add_row("error_estimate", f"{told.error_estimate:.2g}", "")
    return table


def _depth(told: Estimate) -> str:
    assert told.depth is not None
    where = " (the scene's)" if told.depth_interval is None else f" ({_between('depth', told.depth_interval)})"
    return f"depth {shown('depth', told.depth)}{where}"


def _optional(unknown: str, interval: Interval | None) -> str:
    return "given" if interval is None else _between(unknown, interval)


def _between(unknown: str, interval: Interval) -> str:
    low, high = (None if end is None else shown(unknown, end) for end in interval)
    return _words(low, high)


def _sized(interval: Interval | None, otherwise: str = "") -> str:
    if interval is None:
        return otherwise
    low, high = (None if end is None else f"{end * 1e9:.4g}" for end in interval)
    return f" ({_words(low, high)} mm^3)" if low or high else " (open)"


def _words(low: str | None, high: str | None) -> str:
    if low is None and high is None:
        return "open"
    return f"above {low}" if high is None else f"below {high}" if low is None else f"{low} to {high}"
