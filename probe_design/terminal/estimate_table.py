"""Present an estimate: a table, a sentence and advice."""

from __future__ import annotations

from rich.table import Table

from probe_design.estimation.answer import Estimate
from probe_design.estimation.next_reading import ExpectedInterval
from probe_design.estimation.reasons import NAMES, shown
from probe_design.estimation.strength import Interval


def sentence(estimate: Estimate) -> str:
    """Return the estimate in one or two sentences."""
    name = NAMES.get(estimate.unknown, estimate.unknown)
    if estimate.value is not None:
        value, interval = shown(estimate.unknown, estimate.value), _between(estimate.unknown, estimate.interval)
        return f"{name} = {value}, 95 % interval {interval}"
    instead = [] if estimate.unknown == "depth" or estimate.depth is None else [_depth(estimate)]
    if estimate.strength is not None:
        size = " (the scene's)" if estimate.strength_interval is None else _sized(estimate.strength_interval)
        instead.append(f"strength {estimate.strength * 1e9:.4g} mm^3{size}")
    left = f" What can be estimated: {', '.join(instead)}." if instead else ""
    return f"{name} is not identifiable: {estimate.reason}.{left}"


def advice(estimate: Estimate) -> list[str]:
    """Return the advice what to measure next, with expected intervals, one line each; nothing if it was not requested."""
    found = estimate.next
    if found is None:
        return []
    lines = [f"next: {found.verdict}"]
    if found.reading is not None:
        lines += [f"  expected with {one.told}: {_expected(estimate.unknown, one)}" for one in (found.reading, *found.others[:2])]
    if found.together is not None:
        lines.append(f"  expected with {found.together.told}: {_expected(estimate.unknown, found.together)}")
    return lines


def _expected(unknown: str, one: ExpectedInterval) -> str:
    apart = "open in most cases" if one.width is None else f"ends a factor of {one.width:.3g} apart"
    return f"{_between(unknown, one.interval)}, {apart}; identifiable with a probability of {one.identifiable:.2g}"


def estimate_table(estimate: Estimate) -> Table:
    """Return an estimate as a table."""
    table = Table(title=f"{estimate.evaluator}, {estimate.seconds:.2g} s, {_noise(estimate)}")
    for heading in ("quantity", "value", "95 % interval"):
        table.add_column(heading, justify="left" if heading == "quantity" else "right")
    value = "not identifiable" if estimate.value is None else shown(estimate.unknown, estimate.value)
    table.add_row(estimate.unknown, value, _between(estimate.unknown, estimate.interval))
    table.add_row("by the noise alone", "", _between(estimate.unknown, estimate.interval_of_noise))
    if estimate.interval_if_known is not None:
        table.add_row("with all else known", "", _between(estimate.unknown, estimate.interval_if_known))
    if estimate.unknown != "depth" and estimate.depth is not None:
        table.add_row("depth", shown("depth", estimate.depth), _optional("depth", estimate.depth_interval))
    if estimate.strength is not None:
        table.add_row("strength", f"{estimate.strength * 1e9:.4g} mm^3", _sized(estimate.strength_interval, "given").strip(" ()"))
    if estimate.error_estimate is not None:
        table.add_row("error_estimate", f"{estimate.error_estimate:.2g}", "")
    return table


def _noise(estimate: Estimate) -> str:
    least, most = min(estimate.noise), max(estimate.noise)
    rough = [f"{name} known to {100 * sd:.3g} %" for name, sd in estimate.nuisances.items()]
    return ", ".join([f"noise {least:g}{f' to {most:g}' if most > least else ''} on the ratio", *rough])


def _depth(estimate: Estimate) -> str:
    assert estimate.depth is not None
    where = " (the scene's)" if estimate.depth_interval is None else f" ({_between('depth', estimate.depth_interval)})"
    return f"depth {shown('depth', estimate.depth)}{where}"


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
