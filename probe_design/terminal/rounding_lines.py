"""Describe a rounded design: each size before and after, and the effect on ratio and log-sensitivity."""

from __future__ import annotations

from typing import TYPE_CHECKING

from geometry.scenes.probe import mm

if TYPE_CHECKING:
    from probe_design.workshop.rounding import Rounding, RoundingCost


def rounding_lines(rounding: Rounding) -> list[str]:
    """Return the rounded sizes and the effect of rounding, one line each."""
    lines = [f"rounded: {one.key} = {mm(one.before)} to {mm(one.after)}" for one in rounding.changes]
    lines = lines or [f"rounded: nothing, all sizes are multiples of {mm(rounding.step)}"]
    before, after = rounding.before, rounding.after
    if before is None or after is None:
        return lines
    return [*lines, *(f"{key}: {_change(before, after, key)}" for key in ("ratio", "log_sensitivity"))]


def _change(before: RoundingCost, after: RoundingCost, key: str) -> str:
    """Return a number before and after rounding, and its relative change, as text."""
    old, new = getattr(before, key), getattr(after, key)
    if old is None or new is None:
        return "none"
    share = f" ({100 * (new / old - 1):+.2g} %)" if old else ""
    errors = [one.error_estimate for one in (before, after) if one.error_estimate is not None]
    within = f", each within {100 * max(errors):.2g} %" if key == "ratio" and errors else ""
    return f"{old:.5g} to {new:.5g}{share} by {after.evaluator}{within}"
