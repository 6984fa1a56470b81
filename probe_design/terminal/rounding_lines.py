"""Describe a rounded design: each size before and after, and the effect on ratio and log-sensitivity."""

from __future__ import annotations

from typing import TYPE_CHECKING

from geometry.scenes.probe import format_mm

if TYPE_CHECKING:
    from probe_design.workshop.rounding import Rounding, RoundingCost


def write_rounding_lines(rounding: Rounding) -> list[str]:
    """Return the rounded sizes and the effect of rounding, one line each."""
    lines = [f"rounded: {change.key} = {format_mm(change.before)} to {format_mm(change.after)}" for change in rounding.changes]
    lines = lines or [f"rounded: nothing, all sizes are multiples of {format_mm(rounding.step)}"]
    cost_before, cost_after = rounding.before, rounding.after
    if cost_before is None or cost_after is None:
        return lines
    return [*lines, *(f"{key}: {_describe_change(cost_before, cost_after, key)}" for key in ("ratio", "log_sensitivity"))]


def _describe_change(cost_before: RoundingCost, cost_after: RoundingCost, key: str) -> str:
    """Return a number before and after rounding, and its relative change, as text."""
    old, new = getattr(cost_before, key), getattr(cost_after, key)
    if old is None or new is None:
        return "none"
    change_text = f" ({100 * (new / old - 1):+.2g} %)" if old else ""
    errors = [cost.error_estimate for cost in (cost_before, cost_after) if cost.error_estimate is not None]
    error_text = f", each within {100 * max(errors):.2g} %" if key == "ratio" and errors else ""
    return f"{old:.5g} to {new:.5g}{change_text} by {cost_after.evaluator}{error_text}"
