"""Outputs as the pages write them, and numbers as they read them."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path

FOLDER = Path(__file__).parent
EVALUATOR = "closed-form"  # of everything that follows a slider
LABELS = {
    "ratio": "ratio",
    "log_sensitivity": "log-sensitivity",
    "stiffness": "stiffness",
    "charge_ratio": "charge ratio",
    "charge_inner": "charge inner",
    "charge_outer": "charge outer",
}
UNITS = {"stiffness": ("N/m", 1.0), "charge_inner": ("pC", 1e12), "charge_outer": ("pC", 1e12)}  # unit on the page, per SI unit
MIN_ERROR_RELATIVE = 1e-6  # below which more digits of the number would tell a reader nothing
_DECIMAL_COMMA = re.compile(r"\s*([+-]?\d*),(\d+)(?![\d.,])(.*)")


@dataclass(frozen=True)
class Reading:
    """A number with its error, SI; ``value`` is None where it is not known."""

    value: float | None
    error: float | None


def convert_decimal_comma(text: str) -> str:
    """Return typed text with a decimal point in place of a decimal comma."""
    match = _DECIMAL_COMMA.fullmatch(text)
    return f"{match[1] or 0}.{match[2]}{match[3]}" if match else text


def format_number(value: float, error: float | None, unit: str = "") -> str:
    """Return a number with the digits that its error supports, the error and the unit."""
    if error is None:
        return " ".join(filter(None, (f"{value:.3g}", unit, "(error not stated)")))
    if not 0 < error < math.inf:
        text = f"{value:.4g}"
    elif error < MIN_ERROR_RELATIVE * abs(value):
        text = f"{value:.7g} ± {error:.1g}"
    else:
        decimals = max(0, 1 - math.floor(math.log10(error)))  # two digits of the error
        text = f"{value:.{decimals}f} ± {error:.{decimals}f}"
    return f"{text} {unit}".rstrip()
