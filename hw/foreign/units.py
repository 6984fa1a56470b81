"""Read units as data loggers and oscilloscopes write them, and build refusals that name key, value and what is allowed."""

from __future__ import annotations

import math
import re

from hw.common.errors import InvalidSource

_SI_PREFIXES = {"": 1.0, "n": 1e-9, "u": 1e-6, "µ": 1e-6, "μ": 1e-6, "m": 1e-3, "k": 1e3}
VOLT_UNITS = {prefix + "V": factor for prefix, factor in _SI_PREFIXES.items()}
VOLT_UNITS |= {"volt": 1.0, "volts": 1.0, "Volt": 1.0, "Volts": 1.0, "millivolt": 1e-3, "millivolts": 1e-3}
SECOND_UNITS = {prefix + "s": factor for prefix, factor in _SI_PREFIXES.items() if prefix != "k"}
SECOND_UNITS |= {"sec": 1.0, "Sec": 1.0, "secs": 1.0, "second": 1.0, "Second": 1.0, "seconds": 1.0, "Seconds": 1.0, "min": 60.0}
RATE_UNITS = {prefix + unit: factor for prefix, factor in (("", 1.0), ("k", 1e3), ("M", 1e6)) for unit in ("Hz", "S/s", "Sa/s")}
NUMBER_PATTERN = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
MIN_RATE_HZ, MAX_RATE_HZ = 1e-3, 1e9  # Hz


def build_refusal(key: str, value: object, allowed: str) -> InvalidSource:
    """Build the error that refuses a value, in one line."""
    text = " ".join(str(value).split())
    return InvalidSource(f"{key} = {text if len(text) <= 100 else text[:97] + '...'}: allowed: {allowed}")


def read_quantity(key: str, text: object, units: dict[str, float], example: str) -> float:
    """Read a number with one of the units; return it in SI.

    Raises
    ------
    InvalidSource
        The text has no such unit, or no number.
    """
    match = re.fullmatch(rf"({NUMBER_PATTERN})\s*(\S+)", str(text).strip())
    if match is None or match[2] not in units or not math.isfinite(float(match[1])):
        raise build_refusal(key, repr(text), f"a number with its unit, such as {example!r}")
    return float(match[1]) * units[match[2]]


def read_rate(text: object, key: str = "rate") -> float:
    """Read a rate such as ``"10 kHz"``; return samples per second. Raises ``InvalidSource``."""
    rate = read_quantity(key, text, RATE_UNITS, "10 kHz")
    if not MIN_RATE_HZ <= rate <= MAX_RATE_HZ:
        raise build_refusal(key, repr(text), f"{MIN_RATE_HZ:g} to {MAX_RATE_HZ:g} Hz")
    return rate
