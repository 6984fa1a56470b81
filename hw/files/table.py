"""Use a table as a source of samples: choose columns, scale numbers to volts, turn times into an index."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from hw.common.samples import CHANNEL_NAMES, Bools, Floats, Ints
from hw.files.columns import COLUMN_EXAMPLE, SECOND_UNITS, VOLT_UNITS, Column, ColumnMap, build_refusal
from hw.files.volts import VoltsTransport, build_volts_header

TIME_NAMES = ("time", "t", "times", "x", "x-axis", "zeit", "second", "seconds", "timestamp")
MAX_VOLTS = 100.0  # V: no charge amplifier gives more, so a larger value means a wrong unit
OVERLOAD_VALUE = 1e30  # instruments write values of this size or larger for an overload
MAX_JITTER = 0.25  # of the interval: largest deviation of a time from the even grid
RATE_TOLERANCE = 0.005  # largest relative difference between the stated rate and that of the times


@dataclass(frozen=True)
class ColumnTable:
    """The columns of a file, as the reader of its format provides them.

    Attributes
    ----------
    path
        Of the file, for messages.
    names
        Of its columns; empty texts where they have none.
    units
        Of its columns as the file states them; empty texts where it states none.
    read
        Returns the columns of the given indices (from 0), shape (n, k); NaN where a value is missing.
    rate
        Hz, if the file states it without a column of times.
    ends
        Lowest and highest number that a column can hold; values at or beyond them are saturated.
    source
        Other properties for the header.
    """

    path: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    read: Callable[[list[int]], Floats]
    rate: float | None = None
    ends: tuple[float, float] | None = None
    source: dict[str, object] = field(default_factory=dict)

    def find(self, key: str, wanted: Column | None) -> tuple[int, Column] | None:
        """Return the index of a signal's column and its selection; None if it is not selected and no column has its name.

        Parameters
        ----------
        key
            The signal: inner, outer, force or time.
        wanted
            The user's selection; None: by the column's name.

        Raises
        ------
        InvalidSource
            The selected column does not exist, or several have its name.
        """
        lower = [name.lower() for name in self.names]
        if wanted is None:
            matches = [k for k, name in enumerate(lower) if name == key or (key == "time" and name in TIME_NAMES)]
            return (matches[0], Column(key, key)) if matches else None
        # the whole text may be a name with blanks; otherwise its last words are a unit
        for name, column in {wanted.text: Column(wanted.text, wanted.text), wanted.name: wanted}.items():
            if lower.count(name.lower()) > 1:
                raise self.refuse_column(key, repr(name), f"a number where names are alike: {self.describe_columns()}")
            if name.lower() in lower:
                return lower.index(name.lower()), column
        if wanted.name.isdecimal() and 1 <= int(wanted.name) <= len(self.names):
            return int(wanted.name) - 1, wanted
        raise self.refuse_column(key, repr(wanted.text), self.describe_columns())

    def find_scale(self, key: str, number: int, wanted: Column) -> float:
        """Return the value of the number 1 in a column, V, or s for times.

        Parameters
        ----------
        key
            The signal: inner, outer, force or time.
        number
            Index of its column, from 0.
        wanted
            The column's selection, perhaps with a unit.

        Raises
        ------
        InvalidSource
            The unit is not known, or file and user state different units.
        """
        stated_unit = self.units[number]
        file_scale = (SECOND_UNITS if key == "time" else VOLT_UNITS).get(stated_unit)
        if wanted.scale is not None and file_scale is not None and not wanted.has_factor and wanted.scale != file_scale:
            raise self.refuse_column(key, repr(wanted.text), f"the unit that the file has, {stated_unit}")
        scale = wanted.scale if wanted.scale is not None else file_scale
        if scale is None:
            missing = f"a unit: the file has {stated_unit!r}" if stated_unit else "a unit: the file has none"
            name, unit = self.names[number] or number + 1, "ms" if key == "time" else "mV"
            raise self.refuse_column(key, f"without {missing}", f"--column '{key}={name} {unit}', say, or 0.5 {unit}")
        return scale

    def describe_columns(self) -> str:
        """Return the numbers and names of all columns as text."""
        return "one of the columns " + ", ".join(f"{k} {name}".strip() for k, name in enumerate(self.names, 1))

    def refuse_column(self, key: str, value: object, allowed: str) -> Exception:
        """Build the error that refuses the column of a signal."""
        return build_refusal(f"{self.path}: column {key}", value, allowed)


def convert_table(table: ColumnTable, columns: ColumnMap) -> VoltsTransport:
    """Read the selected columns of a table as volts.

    Raises
    ------
    InvalidSource
        Information is missing or contradictory.
    """
    chosen = _choose_columns(table, columns)
    time, channels = chosen.pop("time", None), tuple(chosen)
    numbers = [number for number, _ in chosen.values()]
    scales = np.array([table.find_scale(key, *choice) for key, choice in chosen.items()])
    values = table.read(numbers if time is None else [*numbers, time[0]])
    if not len(values):
        raise build_refusal(table.path, "no rows", "a file with samples")
    times = None if time is None else values[:, -1] * table.find_scale("time", *time)
    values = values[:, : len(numbers)]
    saturated = _find_saturated(table, columns, values, scales)
    values[np.abs(values) >= OVERLOAD_VALUE] = 0.0  # marked as saturated; their sizes would count as a wrong unit
    volts, is_complete = np.nan_to_num(values * scales), ~np.isnan(values).any(axis=1)
    _check_volts(table, channels, volts[is_complete])
    rate, index = _compute_clock(table, columns, times, len(values))
    if times is not None:
        is_complete &= np.isfinite(times)
    header = build_volts_header(rate, channels, **({"replayed": table.path, "started": ""} | table.source))
    return VoltsTransport(header, index[is_complete], volts[is_complete], saturated[is_complete])


def _choose_columns(table: ColumnTable, columns: ColumnMap) -> dict[str, tuple[int, Column]]:
    """Return index and selection of each column that is read, by signal. Raises ``InvalidSource`` for a wrong selection."""
    wanted = columns.columns
    matches = {key: table.find(key, wanted.get(key)) for key in (*CHANNEL_NAMES, "time")}
    chosen = {key: match for key, match in matches.items() if match is not None}
    for key in CHANNEL_NAMES[:2]:
        if key not in chosen:
            example = COLUMN_EXAMPLE.replace("inner", key, 1)
            raise table.refuse_column(key, "missing", f"{table.describe_columns()}, as {example}")
    has_rate = columns.rate is not None or table.rate is not None
    if has_rate and "time" not in wanted and "time" in chosen and table.units[chosen["time"][0]] not in SECOND_UNITS:
        del chosen["time"]  # a count of samples, say
    used = [number for number, _ in chosen.values()]
    for key, (number, _) in chosen.items():
        name = table.names[number].lower()
        if used.count(number) > 1 or (name in CHANNEL_NAMES and name != key):
            allowed = "each its own column" if used.count(number) > 1 else f"a column that is not named {name}"
            raise table.refuse_column(key, repr(table.names[number] or number + 1), allowed)
    return chosen


def _find_saturated(table: ColumnTable, columns: ColumnMap, values: Floats, scales: Floats) -> Bools:
    """Return which values (rows, columns) are at the end of a range, of the same shape.

    The range is that of the instrument, which writes OVERLOAD_VALUE, of the file's numbers, or the user's ``range``; ``scales``
    are the values of the number 1 in each column, V.
    """
    saturated = np.abs(values) >= OVERLOAD_VALUE
    if table.ends is not None:
        saturated |= (values <= table.ends[0]) | (values >= table.ends[1])
    if columns.range is not None:
        saturated |= np.abs(values * scales) >= columns.range * (1 - 1e-9)  # 1e-9: rounding
    return np.asarray(saturated)


def _check_volts(table: ColumnTable, channels: tuple[str, ...], volts: Floats) -> None:
    """Refuse a table without complete rows, or with voltages so large that their unit must be wrong.

    ``volts`` holds the complete rows, shape (n, channels).
    """
    if not len(volts):
        raise build_refusal(table.path, "no row with numbers in all columns", "a file with samples")
    largest = np.abs(volts).max(axis=0)
    worst = int(np.argmax(largest))
    if largest[worst] > MAX_VOLTS:
        allowed = f"up to {MAX_VOLTS:g} V, as charge amplifiers give: is its unit right?"
        raise table.refuse_column(channels[worst], f"{largest[worst]:.3g} V", allowed)


def _compute_clock(table: ColumnTable, columns: ColumnMap, times: Floats | None, count: int) -> tuple[float, Ints]:
    """Return the rate in Hz and the index of each row, shape (count,); the index of a row without a time is 0.

    Parameters
    ----------
    table, columns
        The table, and the user's information, for a stated rate.
    times
        Of the rows, s, NaN where missing; None if the table has no times.
    count
        Number of rows.
    """
    stated_rate = columns.rate if columns.rate is not None else table.rate
    if times is None:
        if stated_rate is None:
            allowed = "--rate '10 kHz', or a column of times: --column 'time=1 s'"
            raise build_refusal(f"{table.path}: rate", "missing", allowed)
        return stated_rate, np.arange(count)
    is_known = np.isfinite(times)
    if is_known.sum() < 2:
        raise table.refuse_column("time", "without two numbers", "times of samples")
    rate, known_index = fit_even_times(times[is_known], np.flatnonzero(is_known), table.path)
    if stated_rate is not None and abs(rate / stated_rate - 1) > RATE_TOLERANCE:
        allowed = f"that of {table.path}'s times, {rate:.6g} Hz; or correct their unit"
        raise build_refusal("rate", f"{stated_rate:g} Hz", allowed)
    index = np.zeros(count, np.int64)
    index[is_known] = known_index
    return rate, index


def fit_even_times(times: Floats, rows: Ints, path: str) -> tuple[float, Ints]:
    """Fit an even grid with gaps to times; return its rate in Hz and the index of each time.

    Parameters
    ----------
    times
        (n,), s.
    rows
        (n,) rows of the file, from 0, for messages.
    path
        Of the file, for messages.

    Raises
    ------
    InvalidSource
        The times do not increase, or are not evenly spaced.
    """
    steps = np.diff(times)
    reversals = np.flatnonzero(steps <= 0)
    if len(reversals):
        allowed = "times that increase: is it the right column, are its decimals enough? --rate does without it"
        text = f"{times[reversals[0] + 1]:.9g} s in row {rows[reversals[0] + 1] + 1}"
        raise build_refusal(f"{path}: column time", text, allowed)
    index = np.concatenate([[0], np.cumsum(np.rint(steps / np.median(steps)).astype(np.int64))])
    interval, begin = np.polyfit(index.astype(float), times - times[0], 1)  # straight line: time = begin + interval * index
    deviations = np.abs(times - times[0] - begin - interval * index) / interval
    worst = int(np.argmax(deviations))
    if not deviations[worst] <= MAX_JITTER or (np.diff(index) < 1).any():
        distance = f"{deviations[worst]:.2g} intervals of {interval:.4g} s off its place"
        text = f"{times[worst]:.9g} s in row {rows[worst] + 1}, {distance}"
        raise build_refusal(f"{path}: column time", text, "even intervals: record with a fixed rate")
    return float(1 / interval), index
