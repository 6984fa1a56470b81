"""Use a table as a source of samples: choose columns, scale numbers to volts, turn times into an index."""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass, field

import numpy as np

from hw.common.samples import Bools, Floats, Ints
from hw.common.transport import Chunk, FileTransport
from hw.foreign.columns import COLUMN_EXAMPLE, Column, ColumnMap
from hw.foreign.units import SECOND_UNITS, VOLT_UNITS, build_refusal
from hw.foreign.volts import CHANNEL_NAMES, build_volts_header, pack_samples, replace_infinities

TIME_NAMES = ("time", "t", "times", "x", "x-axis", "zeit", "second", "seconds", "timestamp")
MAX_VOLTS = 100.0  # V: no charge amplifier gives more, so a larger value means a wrong unit
OVERLOAD_VALUE = 1e30  # instruments write values of this size or larger for an overload
MAX_JITTER = 0.25  # of the interval: largest deviation of a time from the even grid
RATE_TOLERANCE = 0.005  # largest relative difference between the stated rate and that of the times
CHUNK_ROWS = 1 << 15  # rows of a chunk


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
        """Return the index of a signal's column and its selection; None if it is not selected and no column has its name."""
        lower = [name.lower() for name in self.names]
        if wanted is None:
            matches = [k for k, name in enumerate(lower) if name == key or (key == "time" and name in TIME_NAMES)]
            return (matches[0], Column(key, key)) if matches else None
        for name, column in {wanted.text: Column(wanted.text, wanted.text), wanted.name: wanted}.items():
            if lower.count(name.lower()) > 1:
                raise build_refusal(
                    f"{self.path}: column {key}", repr(name), f"a number where names are alike: {self._list_columns()}"
                )
            if name.lower() in lower:
                return lower.index(name.lower()), column
        if wanted.name.isdecimal() and 1 <= int(wanted.name) <= len(self.names):
            return int(wanted.name) - 1, wanted
        raise build_refusal(f"{self.path}: column {key}", repr(wanted.text), self._list_columns())

    def find_worth(self, key: str, number: int, wanted: Column) -> float:
        """Return the value of the number 1 in a column, V, or s for times.

        Raises
        ------
        InvalidSource
            The unit is not known, or file and user state different units.
        """
        units, stated = SECOND_UNITS if key == "time" else VOLT_UNITS, self.units[number]
        file_worth = units.get(stated)
        if wanted.worth is not None and file_worth is not None and not wanted.scaled and wanted.worth != file_worth:
            raise build_refusal(f"{self.path}: column {key}", repr(wanted.text), f"the unit that the file has, {stated}")
        worth = wanted.worth if wanted.worth is not None else file_worth
        if worth is None:
            missing = f"a unit: the file has {stated!r}" if stated else "a unit: the file has none"
            name, unit = self.names[number] or number + 1, "ms" if key == "time" else "mV"
            raise build_refusal(
                f"{self.path}: column {key}", f"without {missing}", f"--column '{key}={name} {unit}', say, or 0.5 {unit}"
            )
        return worth

    def _list_columns(self) -> str:
        return "one of the columns " + ", ".join(f"{k} {name}".strip() for k, name in enumerate(self.names, 1))

    def explain_missing(self, key: str) -> Exception:
        """Return the error for a signal without a column."""
        return build_refusal(
            f"{self.path}: column {key}", "missing", f"{self._list_columns()}, as {COLUMN_EXAMPLE.replace('inner', key, 1)}"
        )


class TableTransport(FileTransport):
    """A transport of a table's rows as volts.

    Parameters
    ----------
    table
        Columns of a file.
    columns
        The user's selection.

    Raises
    ------
    InvalidSource
        Information is missing or contradictory.
    """

    def __init__(self, table: ColumnTable, columns: ColumnMap) -> None:
        self._table, self._map = table, columns
        chosen = self._choose_columns()
        time, channels = chosen.pop("time", None), tuple(chosen)
        numbers = [number for number, _ in chosen.values()]
        worths = np.array([table.find_worth(key, *choice) for key, choice in chosen.items()])
        values = table.read(numbers if time is None else [*numbers, time[0]])
        if not len(values):
            raise build_refusal(table.path, "no rows", "a file with samples")
        times = None if time is None else values[:, -1] * table.find_worth("time", *time)
        values = values[:, : len(numbers)]
        self._saturated = self._find_saturated(values, worths)
        self._volts, self._lost = replace_infinities(values * worths), np.isnan(values).any(axis=1)
        self._check_volts(channels)
        rate, self._index = self._compute_clock(times, len(values))
        self.header = build_volts_header(rate, channels, **({"replayed": table.path, "started": ""} | table.source))
        self._chunks = self._iterate_chunks()

    def _iterate_chunks(self) -> Generator[Chunk, None, None]:
        good = np.flatnonzero(~self._lost)
        for begin in range(0, len(good), CHUNK_ROWS):
            part = good[begin : begin + CHUNK_ROWS]
            yield Chunk(pack_samples(self._index[part], self._volts[part], self._saturated[part]))

    def _choose_columns(self) -> dict[str, tuple[int, Column]]:
        """Return index and selection of each column that is read, by signal."""
        table, wanted = self._table, self._map.columns
        matches = {key: table.find(key, wanted.get(key)) for key in (*CHANNEL_NAMES, "time")}
        chosen = {key: match for key, match in matches.items() if match is not None}
        for key in CHANNEL_NAMES[:2]:
            if key not in chosen:
                raise table.explain_missing(key)
        has_rate = self._map.rate is not None or table.rate is not None
        if has_rate and "time" not in wanted and "time" in chosen and table.units[chosen["time"][0]] not in SECOND_UNITS:
            del chosen["time"]  # a count of samples, say
        used = [number for number, _ in chosen.values()]
        for key, (number, _) in chosen.items():
            name = table.names[number].lower()
            if used.count(number) > 1 or (name in CHANNEL_NAMES and name != key):
                allowed = "each its own column" if used.count(number) > 1 else f"a column that is not named {name}"
                raise build_refusal(f"{table.path}: column {key}", repr(table.names[number] or number + 1), allowed)
        return chosen

    def _find_saturated(self, values: Floats, worths: Floats) -> Bools:
        saturated = np.abs(values) >= OVERLOAD_VALUE
        if self._table.ends is not None:
            saturated |= (values <= self._table.ends[0]) | (values >= self._table.ends[1])
        if self._map.range is not None:
            saturated |= np.abs(values * worths) >= self._map.range * (1 - 1e-9)
        values[np.abs(values) >= OVERLOAD_VALUE] = 0.0
        return np.asarray(saturated)

    def _check_volts(self, channels: tuple[str, ...]) -> None:
        if self._lost.all():
            raise build_refusal(self._table.path, "no row with numbers in all columns", "a file with samples")
        largest = np.abs(self._volts[~self._lost]).max(axis=0)
        worst = int(np.argmax(largest))
        if largest[worst] > MAX_VOLTS:
            allowed = f"up to {MAX_VOLTS:g} V, as charge amplifiers give: is its unit right?"
            raise build_refusal(f"{self._table.path}: column {channels[worst]}", f"{largest[worst]:.3g} V", allowed)

    def _compute_clock(self, times: Floats | None, count: int) -> tuple[float, Ints]:
        """Return the rate in Hz and the index of each row, shape (count,)."""
        stated = self._map.rate if self._map.rate is not None else self._table.rate
        if times is None:
            if stated is None:
                allowed = "--rate '10 kHz', or a column of times: --column 'time=1 s'"
                raise build_refusal(f"{self._table.path}: rate", "missing", allowed)
            return stated, np.arange(count)
        known = np.isfinite(times)
        self._lost |= ~known
        if known.sum() < 2:
            raise build_refusal(f"{self._table.path}: column time", "without two numbers", "times of samples")
        rate, index = fit_even_times(times[known], np.flatnonzero(known), self._table.path)
        if stated is not None and abs(rate / stated - 1) > RATE_TOLERANCE:
            raise build_refusal(
                "rate", f"{stated:g} Hz", f"that of {self._table.path}'s times, {rate:.6g} Hz; or correct their unit"
            )
        full_index = np.zeros(count, np.int64)
        full_index[known] = index
        return rate, full_index


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
        raise build_refusal(
            f"{path}: column time", f"{times[reversals[0] + 1]:.9g} s in row {rows[reversals[0] + 1] + 1}", allowed
        )
    index = np.concatenate([[0], np.cumsum(np.rint(steps / np.median(steps)).astype(np.int64))])
    interval, begin = np.polyfit(index.astype(float), times - times[0], 1)
    deviations = np.abs(times - times[0] - begin - interval * index) / interval
    worst = int(np.argmax(deviations))
    if not deviations[worst] <= MAX_JITTER or (np.diff(index) < 1).any():
        allowed = "even intervals: record with a fixed rate"
        text = (
            f"{times[worst]:.9g} s in row {rows[worst] + 1}, {deviations[worst]:.2g} intervals of {interval:.4g} s off its place"
        )
        raise build_refusal(f"{path}: column time", text, allowed)
    return float(1 / interval), index
