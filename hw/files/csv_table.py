"""Read text files of columns, as data loggers, oscilloscopes and spreadsheets write them.

The separator of cells (semicolon, tab, comma, blanks), decimal commas, the first row of numbers, names and units of the columns
are detected from the file itself. A row that does not fit the others is refused with its line number, never skipped.
"""

from __future__ import annotations

import csv
import math
import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hw.common.errors import InvalidSource
from hw.common.samples import Floats
from hw.files.columns import NUMBER_PATTERN, SECOND_UNITS, VOLT_UNITS, build_refusal
from hw.files.table import ColumnTable

LARGEST_FILE = 400_000_000  # bytes, which take a minute
SAMPLE_LINES = 300  # lines from which the layout is detected
MISSING_WORDS = {"", "nan", "na", "n/a", "#n/a", "null", "none", "-", "--", "---"}
OVERLOAD_VALUES = {"inf": math.inf, "+inf": math.inf, "-inf": -math.inf, "ovf": math.inf, "ol": math.inf, "infinity": math.inf}
_POINT_NUMBER, _COMMA_NUMBER = re.compile(NUMBER_PATTERN), re.compile(r"[-+]?(?:\d+,?\d*|,\d+)(?:[eE][-+]?\d+)?")
_COMMA_TO_POINT = str.maketrans(",.", ".?")  # a point in a file of decimal commas separates thousands: such a cell is refused
_BRACKETED_UNIT = re.compile(r"(.*\S)?\s*[(\[]\s*([^()\[\]]*)\s*[)\]]")
_INTERVAL_NAME = re.compile(r"sample interval|x?-?incr(ement)?|tinc", re.IGNORECASE)
_INLINE_INTERVAL = re.compile(rf"tinc\s*=\s*({NUMBER_PATTERN})", re.IGNORECASE)


@dataclass(frozen=True)
class TextLayout:
    """The layout of a text file.

    Attributes
    ----------
    delimiter
        Separator of cells; None for blanks.
    comma
        Whether decimals have a comma.
    width
        Number of cells in a row of numbers.
    begin
        Index of the first row of numbers, from 0.
    """

    delimiter: str | None
    comma: bool
    width: int
    begin: int


def read_csv(path: Path) -> ColumnTable:
    """Read a text file of columns.

    Raises
    ------
    InvalidSource
        The file cannot be read, or has no rows of numbers.
    """
    lines = _read_text(path).splitlines()
    while lines and not lines[-1].strip().strip(",;"):  # empty lines at the end, as spreadsheets write them
        lines.pop()
    layout = _detect_layout(lines, path)
    head = list(_split_cells(lines[: layout.begin], layout.delimiter))
    (first,) = _split_cells(lines[layout.begin : layout.begin + 1], layout.delimiter)
    names, units = _read_names(head, first, delimited=layout.delimiter is not None)

    def read(wanted: list[int]) -> Floats:
        """Return the numbers of the columns of these indices, shape (rows, columns)."""
        return _read_numbers(path, layout, lines, wanted)

    return ColumnTable(path.name, names, units, read, _read_rate(lines[: layout.begin], head), source={"transport": "csv"})


def _read_text(path: Path) -> str:
    """Return the text of a file in UTF-8, UTF-16 or Latin-1. Raises ``InvalidSource`` if it is too long or no text."""
    try:
        if path.stat().st_size > LARGEST_FILE:
            raise build_refusal(
                str(path), f"{path.stat().st_size} bytes", f"up to {LARGEST_FILE} bytes of text: longer ones as HDF5"
            )
        data = path.read_bytes()
    except OSError as fault:
        raise InvalidSource(f"{path} cannot be read ({fault.strerror})") from fault
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return data.decode("utf-16", "replace")
    if b"\0" in data[:10_000]:
        raise build_refusal(str(path), "no text", "a text file of columns; HDF5 as .h5, sound as .wav")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def _split_cells(lines: list[str], delimiter: str | None) -> Iterator[list[str]]:
    """Yield the cells of each line, without blanks around them; if the delimiter is None, blanks separate the cells."""
    if delimiter is None:
        return ([cell.strip('"') for cell in line.split()] for line in lines)
    return ([cell.strip() for cell in row] for row in _split_records(lines, delimiter))


def _split_records(lines: list[str], delimiter: str) -> Iterator[list[str]]:
    """Yield the cells of each line. Lines are split one by one, so that a quote that is not closed ends with its line."""
    for line in lines:  # without quotes a plain split does, which is faster
        yield next(csv.reader([line], delimiter=delimiter)) if '"' in line else line.split(delimiter)


def _detect_layout(lines: list[str], path: Path) -> TextLayout:
    """Return the layout in which most cells of the first lines are numbers.

    All delimiters are tried with decimal points and decimal commas. A layout's score is the fraction of numbers among the cells
    of its rows, and then the number of rows.

    Raises
    ------
    InvalidSource
        No layout gives rows of two numbers or more.
    """
    sample = lines[:SAMPLE_LINES]
    best: tuple[tuple[float, int], TextLayout] | None = None
    for delimiter in (";", "\t", ",", None):
        cells = list(_split_cells(sample, delimiter))
        for comma in (False, True):
            rows = [[_is_number(cell, comma) for cell in row] for row in cells]
            widths = Counter(len(row) for row in rows if sum(row) > 1)
            if not widths:
                continue
            width = widths.most_common(1)[0][0]
            begin = _find_first_row(cells, rows, width)
            if begin is None:
                continue
            body = [row for row in rows[begin:] if len(row) == width]
            score = (sum(map(sum, body)) / (width * len(body)), len(body))
            if best is None or score > best[0]:
                best = score, TextLayout(delimiter, comma, width, begin)
    if best is None:
        raise build_refusal(str(path), "no rows of two numbers or more", "a text file of columns, one for each film")
    return best[1]


def _find_first_row(cells: list[list[str]], rows: list[list[bool]], width: int) -> int | None:
    """Return the index of the first row with numbers in the columns where most rows have numbers; None if there is none.

    Parameters
    ----------
    cells
        Of each row.
    rows
        Whether each of these cells is a number.
    width
        Number of cells in most rows of numbers.
    """
    usual = [row for row in rows if len(row) == width and sum(row) > 1]
    columns = [k for k in range(width) if 2 * sum(row[k] for row in usual) > len(usual)]
    if not columns:
        return None
    for index, row in enumerate(rows):
        fits = len(row) == width and any(row[k] for k in columns)
        if fits and all(row[k] or _is_missing(cells[index][k]) for k in columns):
            return index
    return None


def _is_number(cell: str, comma: bool) -> bool:
    """Return whether a cell is a number, with a decimal comma if ``comma`` is true, else with a decimal point."""
    return (_COMMA_NUMBER if comma else _POINT_NUMBER).fullmatch(cell) is not None


def _is_missing(cell: str) -> bool:
    """Return whether a cell states that its number is missing or out of range."""
    return cell.lower() in MISSING_WORDS or cell.lower() in OVERLOAD_VALUES


def _read_names(head: list[list[str]], first: list[str], delimited: bool) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return names and units of the columns from the rows above the numbers; a row of units may follow the row of names.

    Fewer names than columns are ambiguous and are ignored; so are more names, where blanks separate cells (``delimited`` false)
    and a name may itself hold blanks.
    """
    width = len(first)
    filled_rows = [row for row in head if sum(bool(cell) for cell in row) > 1]
    if not filled_rows:
        return ("",) * width, ("",) * width
    units: list[str] = []
    if len(filled_rows) > 1 and _are_units(filled_rows[-1][:width]):
        units = [cell.strip("()[] ") for cell in filled_rows.pop()]
    last = filled_rows[-1][filled_rows[-1][0] == "#" :]  # a header of numpy.savetxt begins with "#"
    name_count, cell_count = _find_row_length(last), _find_row_length(first)
    if name_count < cell_count or (name_count > cell_count and not delimited):
        return ("",) * width, ("",) * width
    names = [cell.lstrip("# ") for cell in [*last, *[""] * width][:width]]
    split = [_BRACKETED_UNIT.fullmatch(name) for name in names]
    bracketed = [match[2] if match and match[1] else "" for match in split]
    bare = [match[1] if match and match[1] else name for match, name in zip(split, names, strict=True)]
    return tuple(bare), tuple(([*units, *[""] * width][:width]) if units else bracketed)


def _find_row_length(cells: list[str]) -> int:
    """Return the number of cells of a row without the empty ones at its end."""
    return max((k for k, cell in enumerate(cells, 1) if cell), default=0)


def _are_units(cells: list[str]) -> bool:
    """Return whether more than half of the filled cells are units, so that the row is one of units."""
    known = [
        # "sequence" stands for a unit in files of Rigol oscilloscopes
        cell.strip("()[] ") in VOLT_UNITS.keys() | SECOND_UNITS.keys() or cell.lower() == "sequence"
        for cell in cells
        if cell
    ]
    return 2 * sum(known) > len(known)


def _read_rate(lines: list[str], head: list[list[str]]) -> float | None:
    """Return the rate in Hz from the sample interval in an oscilloscope's header, or None if no interval above 0 is there.

    The header is given twice, as ``lines`` of text and as ``head``, the cells of these lines.
    The interval is in s unless a unit follows. It stands to the right of its name, below it, or in the same cell.

    Raises
    ------
    InvalidSource
        The text after the interval is no unit of time.
    """
    intervals = [float(match[1]) for line in lines if (match := _INLINE_INTERVAL.search(line))]
    for index, row in enumerate(head):
        for k, cell in enumerate(row):
            if _INTERVAL_NAME.fullmatch(cell.strip('"')):
                cells_below = head[index + 1][k : k + 1] if index + 1 < len(head) else []
                numbers_beside = [text for text in row[k + 1 : k + 2] if _is_number(text, comma=False)]
                intervals += [float(text) * _get_unit_seconds(row[k + 2 : k + 3]) for text in numbers_beside]
                intervals += [float(text) for text in cells_below if _is_number(text, comma=False)]
    positive = [interval for interval in intervals if interval > 0]
    return 1 / positive[0] if positive else None


def _get_unit_seconds(next_cells: list[str]) -> float:
    """Return the seconds in the unit that the cell after an interval names; 1 where it is empty or holds a number."""
    unit = next_cells[0].strip("()[] ") if next_cells else ""
    if not unit or _is_number(unit, comma=False):
        return 1.0
    if unit not in SECOND_UNITS:
        raise build_refusal("sample interval", repr(unit), f"a unit of time after its number: {', '.join(SECOND_UNITS)}; or none")
    return SECOND_UNITS[unit]


def _read_numbers(path: Path, layout: TextLayout, lines: list[str], wanted: list[int]) -> Floats:
    """Return the numbers of the columns with the indices ``wanted``, shape (rows, columns).

    ``lines`` are all lines of the file, ``path`` is its path for messages.

    Raises
    ------
    InvalidSource
        A row has another number of cells than the others, or a cell is no number.
    """
    values = np.empty((len(lines) - layout.begin, len(wanted)))
    for i, row in enumerate(_split_cells(lines[layout.begin :], layout.delimiter)):
        if len(row) != layout.width:
            label = f"{path.name}: line {layout.begin + i + 1}"
            raise build_refusal(label, f"{len(row)} cells", f"{layout.width} as in the others: is the file cut?")
        for k, number in enumerate(wanted):
            cell = row[number]
            try:
                values[i, k] = float(cell.translate(_COMMA_TO_POINT) if layout.comma else cell)
            except ValueError:
                values[i, k] = _parse_word(f"{path.name}: line {layout.begin + i + 1}", cell)
    return values


def _parse_word(label: str, cell: str) -> float:
    """Return infinity for a word of overload, NaN for a missing number. Raises ``InvalidSource`` for other words."""
    if cell.lower() in OVERLOAD_VALUES:
        return OVERLOAD_VALUES[cell.lower()]
    if cell.lower() in MISSING_WORDS:
        return math.nan
    raise build_refusal(label, repr(cell), "a number, or nan where a sample is missing")
