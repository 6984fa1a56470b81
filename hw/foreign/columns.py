"""Map a file's columns, or an instrument's channels, to the films, with their units.

On the command line ``inner=CH1 mV``: the column's name or its number from 1, then the unit of its numbers, or a number with a
unit. A TOML file holds the same settings,

    rate = "10 kHz"         # left out: the file has a column of times, or states its rate
    range = "10 V"          # values at or beyond it count as saturated; left out: integers at the end of their range
    time = "Time ms"
    inner = "CH1 mV"        # or a table: column = "CH1", unit = "mV", scale = 1.0
    outer = "CH2 mV"
    force = "CH3 0.01 V"
"""

from __future__ import annotations

import os
import re
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from hw.common.errors import InvalidSource
from hw.foreign.units import NUMBER_PATTERN, SECOND_UNITS, VOLT_UNITS, build_refusal, read_quantity, read_rate
from hw.foreign.volts import CHANNEL_NAMES

COLUMN_KEYS = (*CHANNEL_NAMES, "time")
SETTING_KEYS = ("rate", "range")
LARGEST_MAP = 10_000  # bytes: what tomllib takes for a dotted key grows with the square of its length
COLUMN_EXAMPLE = "'inner=CH1 mV': a column's name or number and the unit of its numbers"
_ENTRY_PATTERN = re.compile(rf"(?P<name>.+?)(?:\s+(?P<number>{NUMBER_PATTERN}))?\s+(?P<unit>\S+)")


@dataclass(frozen=True)
class Column:
    """A column that the user selects.

    Attributes
    ----------
    text
        As it was written. It may be a name with blanks, which only the file's own names can show.
    name
        Of the column, or its number from 1.
    worth
        Value of the number 1 in the column, V, or s for times; None: the file's own unit.
    scaled
        Whether the user gave a factor with the unit, which may differ from the file's unit.
    """

    text: str
    name: str
    worth: float | None = None
    scaled: bool = False


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
        known = cls()
        for text in texts:
            known = known.add_text(text)
        return known if rate is None else replace(known, rate=read_rate(rate))

    def add_text(self, text: str) -> ColumnMap:
        """Return the map extended by one text of the command line."""
        key, equals, value = (part.strip() for part in text.partition("="))
        if equals and key in COLUMN_KEYS:
            return replace(self, columns=self.columns | {key: parse_column(key, value)})
        if text.endswith(".toml"):
            return self.add_file(Path(text))
        raise build_refusal("column", repr(text), f"{COLUMN_EXAMPLE}, for {', '.join(COLUMN_KEYS)}; or a TOML file")

    def add_file(self, path: Path) -> ColumnMap:
        """Return the map extended by a TOML file."""
        try:
            if not os.path.isfile(path) or path.stat().st_size > LARGEST_MAP:  # a pipe would wait, a device never end
                raise build_refusal("column", path, f"a TOML file of at most {LARGEST_MAP} bytes that is there")
            table = tomllib.loads(path.read_text(encoding="utf-8"))
            repr(table)  # messages print it: too deep nesting is refused here
        except OSError as fault:
            raise build_refusal("column", path, f"a TOML file that can be read ({fault.strerror})") from fault
        except RecursionError as fault:
            raise build_refusal("column", path, "a TOML file without deep nesting") from fault
        except ValueError as fault:
            raise build_refusal("column", path, f"a TOML file ({fault})") from fault
        unknown = [key for key in table if key not in (*COLUMN_KEYS, *SETTING_KEYS)]
        if unknown:
            raise build_refusal(f"{path.name}: {unknown[0]}", repr(table[unknown[0]]), ", ".join((*SETTING_KEYS, *COLUMN_KEYS)))
        columns = self.columns | {key: _read_entry(f"{path.name}: {key}", key, table[key]) for key in COLUMN_KEYS if key in table}
        span = read_quantity(f"{path.name}: range", table["range"], VOLT_UNITS, "10 V") if "range" in table else self.range
        rate = read_rate(table["rate"], f"{path.name}: rate") if "rate" in table else self.rate
        if span is not None and span <= 0:
            raise build_refusal(f"{path.name}: range", repr(table["range"]), "above 0")
        return ColumnMap(columns, rate, span)


def parse_column(key: str, text: str) -> Column:
    """Read a column from ``CH1``, ``CH1 mV`` or ``CH1 0.5 mV``.

    Raises
    ------
    InvalidSource
        The text is empty, or its factor is out of range.
    """
    if not text:
        raise build_refusal(f"column {key}", repr(text), COLUMN_EXAMPLE)
    match = _ENTRY_PATTERN.fullmatch(text)
    if match is None or match["unit"] not in _get_units(key):
        return Column(text, text)
    return _set_worth(
        key, Column(text, match["name"]), None if match["number"] is None else float(match["number"]), match["unit"]
    )


def _get_units(key: str) -> dict[str, float]:
    return SECOND_UNITS if key == "time" else VOLT_UNITS


def _set_worth(key: str, column: Column, factor: float | None, unit: str) -> Column:
    """Return a column with the SI value of one of its numbers: ``factor`` units, or one. Raises ``InvalidSource``."""
    worth = (1.0 if factor is None else factor) * _get_units(key)[unit]
    if not 1e-15 < abs(worth) < 1e6 or (key == "time" and worth < 0):
        raise build_refusal(f"column {key}", repr(column.text), "numbers that are worth between 1e-15 and 1e6 V, or s above 0")
    return replace(column, worth=worth, scaled=factor is not None)


def _read_entry(label: str, key: str, value: object) -> Column:
    """Read an entry of a TOML file: a text, a column's number, or a table."""
    if isinstance(value, str | int) and not isinstance(value, bool):
        return parse_column(key, str(value))
    if not isinstance(value, dict) or value.get("column", "") == "" or set(value) - {"column", "unit", "scale"}:
        raise build_refusal(label, repr(value), "a text like 'CH1 mV', or a table with column, unit and scale")
    name, unit, scale = str(value["column"]), value.get("unit"), value.get("scale")
    if scale is not None and (isinstance(scale, bool) or not isinstance(scale, int | float)):
        raise build_refusal(f"{label}.scale", repr(scale), "a number: how many of the unit one number of the file is worth")
    if unit is None and scale is None:
        return Column(name, name)
    units = ", ".join(_get_units(key))
    if unit is None:
        raise build_refusal(f"{label}.unit", "missing", f"beside scale, one of {units}")
    if not isinstance(unit, str) or unit not in _get_units(key):
        raise build_refusal(f"{label}.unit", repr(unit), units)
    return _set_worth(key, Column(name, name), None if scale is None else float(str(scale)), unit)  # too large integers: inf


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
    numbers = {key: int(texts[key][-1]) for key in CHANNEL_NAMES if key in texts}
    if len(set(numbers.values())) < len(numbers):
        raise InvalidSource(f"column = {numbers}: allowed: another channel for each")
    return numbers
