"""Map a file's columns, or an instrument's channels, to the films, with units as data loggers and oscilloscopes write them.

On the command line ``inner=CH1 mV``: the column's name or its number from 1, then the unit of its numbers, or a number with a
unit. A TOML file holds the same settings,

    rate = "10 kHz"         # left out: the file has a column of times, or states its rate
    range = "10 V"          # values at or beyond it count as saturated; left out: integers at the end of their range
    time = "Time ms"
    inner = "CH1 mV"
    outer = "CH2 mV"
    force = "CH3 0.01 V"
"""

from __future__ import annotations

import math
import os
import re
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from hw.common.errors import InvalidSource
from hw.common.samples import CHANNEL_NAMES

_SI_PREFIXES = {"": 1.0, "n": 1e-9, "u": 1e-6, "µ": 1e-6, "μ": 1e-6, "m": 1e-3, "k": 1e3}
VOLT_UNITS = {prefix + "V": factor for prefix, factor in _SI_PREFIXES.items()}
VOLT_UNITS |= {"volt": 1.0, "volts": 1.0, "Volt": 1.0, "Volts": 1.0, "millivolt": 1e-3, "millivolts": 1e-3}
SECOND_UNITS = {prefix + "s": factor for prefix, factor in _SI_PREFIXES.items() if prefix != "k"}
SECOND_UNITS |= {"sec": 1.0, "Sec": 1.0, "secs": 1.0, "second": 1.0, "Second": 1.0, "seconds": 1.0, "Seconds": 1.0, "min": 60.0}
RATE_UNITS = {prefix + unit: factor for prefix, factor in (("", 1.0), ("k", 1e3), ("M", 1e6)) for unit in ("Hz", "S/s", "Sa/s")}
NUMBER_PATTERN = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
MIN_RATE_HZ, MAX_RATE_HZ = 1e-3, 1e9  # Hz
COLUMN_KEYS = (*CHANNEL_NAMES, "time")
SETTING_KEYS = ("rate", "range")
MAX_MAP_BYTES = 10_000  # what tomllib takes for a dotted key grows with the square of its length
COLUMN_EXAMPLE = "'inner=CH1 mV': a column's name or number and the unit of its numbers"
_ENTRY_PATTERN = re.compile(rf"(?P<name>.+?)(?:\s+(?P<number>{NUMBER_PATTERN}))?\s+(?P<unit>\S+)")


def build_refusal(key: str, value: object, allowed: str) -> InvalidSource:
    """Build the error that refuses a value, in one line: the entry's name ``key``, the value, and the values allowed."""
    text = " ".join(str(value).split())
    return InvalidSource(f"{key} = {text if len(text) <= 100 else text[:97] + '...'}: allowed: {allowed}")


def read_quantity(key: str, text: object, units: dict[str, float], example: str) -> float:
    """Read a number with a unit; return it in SI units.

    Parameters
    ----------
    key
        Name of the entry, for messages.
    text
        Such as "10 kHz".
    units
        SI value of each allowed unit.
    example
        An allowed text, for messages.

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
    """Read a rate such as ``"10 kHz"``; return samples per second. Raises ``InvalidSource`` if it is not allowed."""
    rate = read_quantity(key, text, RATE_UNITS, "10 kHz")
    if not MIN_RATE_HZ <= rate <= MAX_RATE_HZ:
        raise build_refusal(key, repr(text), f"{MIN_RATE_HZ:g} to {MAX_RATE_HZ:g} Hz")
    return rate


@dataclass(frozen=True)
class Column:
    """A column that the user selects.

    Attributes
    ----------
    text
        As it was written. It may be a name with blanks, which only the file's own names can show.
    name
        Of the column, or its number from 1.
    scale
        Value of the number 1 in the column, V, or s for times; None: the file's own unit.
    has_factor
        Whether the user gave a factor with the unit, which may differ from the file's unit.
    """

    text: str
    name: str
    scale: float | None = None
    has_factor: bool = False


@dataclass(frozen=True)
class ColumnMap:
    """The user's information on a file, in addition to its contents; everything may be left out.

    Attributes
    ----------
    columns
        Selected columns by ``inner``, ``outer``, ``force``, ``time``.
    rate
        Samples per second, Hz.
    range
        Voltage at and beyond which values count as saturated, V.
    """

    columns: dict[str, Column] = field(default_factory=dict)
    rate: float | None = None
    range: float | None = None

    @classmethod
    def from_texts(cls, texts: Sequence[str] = (), rate: str | None = None) -> ColumnMap:
        """Read texts of the command line: ``KEY=COLUMN`` or names of TOML files; later ones override earlier ones.

        Raises
        ------
        InvalidSource
            No such key, unit or file.
        """
        column_map = cls()
        for text in texts:
            key, equals, value = (part.strip() for part in text.partition("="))
            if equals and key in COLUMN_KEYS:
                column_map = replace(column_map, columns=column_map.columns | {key: parse_column(key, value)})
            elif text.endswith(".toml"):
                column_map = column_map.add_file(Path(text))
            else:
                raise build_refusal("column", repr(text), f"{COLUMN_EXAMPLE}, for {', '.join(COLUMN_KEYS)}; or a TOML file")
        return column_map if rate is None else replace(column_map, rate=read_rate(rate))

    def add_file(self, path: Path) -> ColumnMap:
        """Return the map with the entries of a TOML file, which override its own. Raises ``InvalidSource``."""
        table = _read_toml(path)
        columns, rate, voltage_range = dict(self.columns), self.rate, self.range
        for key, value in table.items():
            label = f"{path.name}: {key}"
            if key == "rate":
                rate = read_rate(value, label)
            elif key == "range":
                voltage_range = read_quantity(label, value, VOLT_UNITS, "10 V")
                if voltage_range <= 0:
                    raise build_refusal(label, repr(value), "above 0")
            elif key not in COLUMN_KEYS:
                raise build_refusal(label, repr(value), ", ".join((*SETTING_KEYS, *COLUMN_KEYS)))
            elif isinstance(value, bool) or not isinstance(value, str | int):
                raise build_refusal(label, repr(value), "a text like 'CH1 mV', or a column's number")
            else:
                columns[key] = parse_column(key, str(value))
        return ColumnMap(columns, rate, voltage_range)


def _read_toml(path: Path) -> dict[str, object]:
    """Return the content of a TOML file of at most MAX_MAP_BYTES. Raises ``InvalidSource`` if it cannot be read."""
    if not os.path.isfile(path) or os.path.getsize(path) > MAX_MAP_BYTES:  # a pipe would wait, a device never end
        raise build_refusal("column", path, f"a TOML file of at most {MAX_MAP_BYTES} bytes that is there")
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
        repr(table)  # messages print it: too deep nesting is refused here
    except OSError as fault:
        raise build_refusal("column", path, f"a TOML file that can be read ({fault.strerror})") from fault
    except RecursionError as fault:
        raise build_refusal("column", path, "a TOML file without deep nesting") from fault
    except ValueError as fault:
        raise build_refusal("column", path, f"a TOML file ({fault})") from fault
    return table


def parse_column(key: str, text: str) -> Column:
    """Read a column from ``CH1``, ``CH1 mV`` or ``CH1 0.5 mV``.

    Raises
    ------
    InvalidSource
        The text is empty, or its factor is out of range.
    """
    if not text:
        raise build_refusal(f"column {key}", repr(text), COLUMN_EXAMPLE)
    units = SECOND_UNITS if key == "time" else VOLT_UNITS
    match = _ENTRY_PATTERN.fullmatch(text)
    if match is None or match["unit"] not in units:  # a name alone, perhaps with blanks
        return Column(text, text)
    scale = float(match["number"] or 1.0) * units[match["unit"]]
    if not 1e-15 < abs(scale) < 1e6 or (key == "time" and scale < 0):
        raise build_refusal(f"column {key}", repr(text), "numbers that are worth between 1e-15 and 1e6 V, or s above 0")
    return Column(text, match["name"], scale, has_factor=match["number"] is not None)


def resolve_channel_numbers(columns: ColumnMap) -> dict[str, int]:
    """Return the instrument's channel number of each signal: inner 1, outer 2, unless they are mapped.

    Raises
    ------
    InvalidSource
        A text is not a channel's number, or a channel is used twice.
    """
    texts = {"inner": "1", "outer": "2"} | {key: column.text for key, column in columns.columns.items()}
    for key, text in texts.items():
        if key not in CHANNEL_NAMES or not re.fullmatch(r"(?i)(ch(annel)?\s*)?[1-8]", text):
            raise build_refusal(
                f"column {key}", repr(text), "a channel's number from 1 to 8, for inner, outer and force; no more"
            )
    numbers = {key: int(texts[key][-1]) for key in CHANNEL_NAMES if key in texts}  # the last character is the number
    if len(set(numbers.values())) < len(numbers):
        raise InvalidSource(f"column = {numbers}: allowed: another channel for each")
    return numbers
