"""Which column of a file, or which channel of an instrument, is which film, and what its numbers are worth.

On the command line ``inner=CH1 mV``: the column's name or its number from 1, and what one of its numbers is worth, a unit or a
number with a unit. A TOML file says the same,

    rate = "10 kHz"         # left out: the file has a column of times, or tells its rate
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
from typing import Any

from hw.common.errors import InvalidSource
from hw.foreign.units import NUMBER, SECONDS, VOLTS, quantity, read_rate, refusal
from hw.foreign.volts import CHANNELS

KEYS = (*CHANNELS, "time")
TOP = ("rate", "range")
LARGEST_MAP = 10_000  # bytes: what tomllib takes for a dotted key grows with the square of its length
EXAMPLE = "'inner=CH1 mV': a column's name or number and the unit or worth of its numbers"
_ENTRY = re.compile(rf"(?P<name>.+?)(?:\s+(?P<number>{NUMBER}))?\s+(?P<unit>\S+)")


@dataclass(frozen=True)
class Column:
    """One column as it is asked for.

    Attributes:
        text: as it was written: it may be a name with blanks, which only the file can tell.
        name: of the column, or its number from 1.
        worth: V, or s for times, of one of its numbers; None: as the file says.
        scaled: whether a number said so, and not the unit alone: that may differ from what the file says.
    """

    text: str
    name: str
    worth: float | None = None
    scaled: bool = False


@dataclass(frozen=True)
class ColumnMap:
    """What is known of a file beside what stands in it; everything may be left out.

    Attributes:
        columns: by ``inner``, ``outer``, ``force``, ``time``.
        rate: samples per second, Hz.
        range: V, at and beyond which values count as saturated.
    """

    columns: dict[str, Column] = field(default_factory=dict)
    rate: float | None = None
    range: float | None = None

    @classmethod
    def of(cls, texts: Sequence[str] = (), rate: str | None = None) -> ColumnMap:
        """Read what the command line says: ``KEY=COLUMN`` or the name of a TOML file, each later one over the earlier.

        Raises:
            InvalidSource: no such key, unit or file.
        """
        known = cls()
        for text in texts:
            known = known.with_text(text)
        return known if rate is None else replace(known, rate=read_rate(rate))

    def with_text(self, text: str) -> ColumnMap:
        """Return it with one more text of the command line."""
        key, equals, value = (part.strip() for part in text.partition("="))
        if equals and key in KEYS:
            return replace(self, columns=self.columns | {key: column(key, value)})
        if text.endswith(".toml"):
            return self.with_file(Path(text))
        raise refusal("column", repr(text), f"{EXAMPLE}, for {', '.join(KEYS)}; or a TOML file")

    def with_file(self, path: Path) -> ColumnMap:
        """Return it with what a TOML file says."""
        try:
            if not os.path.isfile(path) or path.stat().st_size > LARGEST_MAP:  # a pipe would wait, a device never end
                raise refusal("column", path, f"a TOML file of at most {LARGEST_MAP} bytes that is there")
            told = tomllib.loads(path.read_text(encoding="utf-8"))
            repr(told)  # as messages may: nested too deeply for that it is refused here
        except OSError as fault:
            raise refusal("column", path, f"a TOML file that can be read ({fault.strerror})") from fault
        except RecursionError as fault:
            raise refusal("column", path, "a TOML file without deep nesting") from fault
        except ValueError as fault:
            raise refusal("column", path, f"a TOML file ({fault})") from fault
        unknown = [key for key in told if key not in (*KEYS, *TOP)]
        if unknown:
            raise refusal(f"{path.name}: {unknown[0]}", repr(told[unknown[0]]), ", ".join((*TOP, *KEYS)))
        columns = self.columns | {key: _entry(f"{path.name}: {key}", key, told[key]) for key in KEYS if key in told}
        span = quantity(f"{path.name}: range", told["range"], VOLTS, "10 V") if "range" in told else self.range
        rate = read_rate(told["rate"], f"{path.name}: rate") if "rate" in told else self.rate
        if span is not None and span <= 0:
            raise refusal(f"{path.name}: range", repr(told["range"]), "above 0")
        return ColumnMap(columns, rate, span)


def column(key: str, text: str) -> Column:
    """Read ``CH1``, ``CH1 mV`` or ``CH1 0.5 mV``.

    Raises:
        InvalidSource: it is empty, or worth nothing.
    """
    if not text:
        raise refusal(f"column {key}", repr(text), EXAMPLE)
    match = _ENTRY.fullmatch(text)
    if match is None or match["unit"] not in _units(key):
        return Column(text, text)
    return _worth(key, Column(text, match["name"]), None if match["number"] is None else float(match["number"]), match["unit"])


def _units(key: str) -> dict[str, float]:
    return SECONDS if key == "time" else VOLTS


def _worth(key: str, named: Column, factor: float | None, unit: str) -> Column:
    """A column one of whose numbers is worth so many of a unit, or one. Raises ``InvalidSource``."""
    worth = (1.0 if factor is None else factor) * _units(key)[unit]
    if not 1e-15 < abs(worth) < 1e6 or (key == "time" and worth < 0):
        raise refusal(f"column {key}", repr(named.text), "numbers that are worth between 1e-15 and 1e6 V, or s above 0")
    return replace(named, worth=worth, scaled=factor is not None)


def _entry(where: str, key: str, value: Any) -> Column:
    """Read an entry of a TOML file: a text, a column's number, or a table."""
    if isinstance(value, str | int) and not isinstance(value, bool):
        return column(key, str(value))
    if not isinstance(value, dict) or value.get("column", "") == "" or set(value) - {"column", "unit", "scale"}:
        raise refusal(where, repr(value), "a text like 'CH1 mV', or a table with column, unit and scale")
    name, unit, scale = str(value["column"]), value.get("unit"), value.get("scale")
    if scale is not None and (isinstance(scale, bool) or not isinstance(scale, int | float)):
        raise refusal(f"{where}.scale", repr(scale), "a number: how many of the unit one number of the file is worth")
    if unit is None and scale is None:
        return Column(name, name)
    units = ", ".join(_units(key))
    if unit is None:
        raise refusal(f"{where}.unit", "missing", f"beside scale, one of {units}")
    if not isinstance(unit, str) or unit not in _units(key):
        raise refusal(f"{where}.unit", repr(unit), units)
    return _worth(key, Column(name, name), None if scale is None else float(str(scale)), unit)  # of what is too large, inf


def channel_numbers(columns: ColumnMap) -> dict[str, int]:
    """Return the number of an instrument's channel for each name: inner on 1, outer on 2, unless they are mapped.

    Raises:
        InvalidSource: something that is no channel's number, or one channel twice.
    """
    texts = {"inner": "1", "outer": "2"} | {key: one.text for key, one in columns.columns.items()}
    for key, text in texts.items():
        if key not in CHANNELS or not re.fullmatch(r"(?i)(ch(annel)?\s*)?[1-8]", text):
            raise refusal(f"column {key}", repr(text), "a channel's number from 1 to 8, for inner, outer and force; no more")
    numbers = {key: int(texts[key][-1]) for key in CHANNELS if key in texts}
    if len(set(numbers.values())) < len(numbers):
        raise InvalidSource(f"column = {numbers}: allowed: another channel for each")
    return numbers
