"""Present an estimate: a table, a sentence and advice."""

from __future__ import annotations

from geometry.common.percent import format_percent
from probe_design.estimation.estimate_result import Estimate, ExpectedInterval
from probe_design.estimation.intervals import Interval
from probe_design.estimation.reasons import UNKNOWN_NAMES, format_value
from probe_design.reporting.table import Table
from probe_design.terminal.result_tables import OBSERVABLE_WORDS


def write_sentence(estimate: Estimate) -> str:
    """Return the estimate in one or two sentences."""
    name = UNKNOWN_NAMES.get(estimate.unknown, estimate.unknown)
    if estimate.value is not None:
        value, interval = format_value(estimate.unknown, estimate.value), _describe_interval(estimate.unknown, estimate.interval)
        return f"{name} = {value}, 95 % interval {interval}"
    alternatives = []
    if estimate.unknown != "depth" and estimate.depth is not None:
        interval = _describe_optional("depth", estimate.depth_interval, "the scene's")
        alternatives.append(f"depth {format_value('depth', estimate.depth)} ({interval})")
    if estimate.strength is not None:
        interval = _describe_strength(estimate.strength_interval, "the scene's")
        alternatives.append(f"strength {estimate.strength * 1e9:.4g} mm^3 ({interval})")
    alternatives_text = f" What can be estimated: {', '.join(alternatives)}." if alternatives else ""
    return f"{name} is not identifiable: {estimate.reason}.{alternatives_text}"


def list_advice(estimate: Estimate) -> list[str]:
    """Return the advice what to measure next, with expected intervals, one line each; nothing if it was not requested."""
    next_reading = estimate.next
    if next_reading is None:
        return []
    lines = [f"next: {next_reading.verdict}"]
    if next_reading.reading is not None:
        lines += [
            f"  expected with {expected.told}: {_describe_expected(estimate.unknown, expected)}"
            for expected in (next_reading.reading, *next_reading.others[:2])
        ]
    if next_reading.together is not None:
        lines.append(
            f"  expected with {next_reading.together.told}: {_describe_expected(estimate.unknown, next_reading.together)}"
        )
    return lines


def _describe_expected(unknown: str, expected: ExpectedInterval) -> str:
    """Describe an expected interval, its width, and the probability that the unknown is identifiable."""
    width_text = "open in most cases" if expected.width is None else f"ends a factor of {expected.width:.3g} apart"
    return (
        f"{_describe_interval(unknown, expected.interval)}, {width_text}; identifiable with a probability of "
        f"{expected.identifiable:.2g}"
    )


def build_estimate_table(estimate: Estimate) -> Table:
    """Return an estimate as a table."""
    value = "not identifiable" if estimate.value is None else format_value(estimate.unknown, estimate.value)
    rows = [
        (estimate.unknown, value, _describe_interval(estimate.unknown, estimate.interval)),
        ("by the noise alone", "", _describe_interval(estimate.unknown, estimate.interval_of_noise)),
    ]
    if estimate.interval_if_known is not None:
        rows.append(("with all else known", "", _describe_interval(estimate.unknown, estimate.interval_if_known)))
    if estimate.unknown != "depth" and estimate.depth is not None:
        rows.append(
            ("depth", format_value("depth", estimate.depth), _describe_optional("depth", estimate.depth_interval, "given"))
        )
    if estimate.strength is not None:
        interval = _describe_strength(estimate.strength_interval, "given")
        rows.append(("strength", f"{estimate.strength * 1e9:.4g} mm^3", interval))
    if estimate.error_estimate is not None:
        rows.append(("error_estimate", format_percent(estimate.error_estimate), ""))
    title = f"{estimate.evaluator}, {estimate.seconds:.2g} s, {_describe_noise(estimate)}"
    return Table(("quantity", "value", "95 % interval"), rows, title)


def _describe_noise(estimate: Estimate) -> str:
    """Describe the noise of the readings, and the uncertainty of nuisances, the other uncertain numbers of the scene."""
    min_noise, max_noise = min(estimate.noise), max(estimate.noise)
    nuisances = [f"{name} known to {format_percent(sd, 3)}" for name, sd in estimate.nuisances.items()]
    noise = f"noise {100 * min_noise:g}{f' to {100 * max_noise:g}' if max_noise > min_noise else ''} %"
    return ", ".join([f"{noise} on the ratio of {OBSERVABLE_WORDS[estimate.observable]}", *nuisances])


def _describe_optional(unknown: str, interval: Interval | None, otherwise: str) -> str:
    """Describe an interval of an unknown in its unit; without an interval, return ``otherwise``."""
    return otherwise if interval is None else _describe_interval(unknown, interval)


def _describe_interval(unknown: str, interval: Interval) -> str:
    """Describe an interval of an unknown, in its unit."""
    low, high = (None if end is None else format_value(unknown, end) for end in interval)
    return _join_ends(low, high)


def _describe_strength(interval: Interval | None, otherwise: str) -> str:
    """Describe an interval of the strength, given in m^3, in mm^3; without an interval, return ``otherwise``."""
    if interval is None:
        return otherwise
    low, high = (None if end is None else f"{end * 1e9:.4g}" for end in interval)  # 1e9 mm^3 are 1 m^3
    return f"{_join_ends(low, high)} mm^3" if low or high else "open"


def _join_ends(low: str | None, high: str | None) -> str:
    """Join the texts of both ends of an interval; None is an open end."""
    if low is None and high is None:
        return "open"
    return f"above {low}" if high is None else f"below {high}" if low is None else f"{low} to {high}"
