"""Read the rows of a CSV file of readings, as spreadsheets write them.

Cells are separated by commas, semicolons or tabs: by what follows the first name of the first row. Where commas do not separate
cells, a comma within a cell is a decimal one: "-7,5 mm".
"""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping, Sequence

from geometry.common.errors import InputError, Words, describe_choices


def parse_csv(text: str, name: str, keys: Sequence[str]) -> list[Mapping[str, object]]:
    """Return the entries of each row below the first, which names them; empty cells are left out.

    Parameters
    ----------
    text
        Of the file.
    name
        Of the file, in messages.
    keys
        Names that columns may have, in small or large letters.

    Raises
    ------
    InputError
        Columns have other names, or a row has other cells.
    """
    separators = re.search("[,;\\t]", text)
    separator = separators[0] if separators else ","
    try:
        table = [[cell.strip() for cell in row] for row in csv.reader(text.splitlines(), delimiter=separator)]
    except csv.Error as fault:
        raise InputError(name, Words(f"not CSV: {fault}"), f"columns {', '.join(keys)}") from None
    lines = [row for row in table if any(row)]
    width = max((index + 1 for row in lines for index, cell in enumerate(row) if cell), default=0)
    lines = [row[:width] for row in lines]  # without columns at the end that are empty
    names = [cell.lower() for cell in lines[0]] if lines else []
    if len(set(names)) < max(len(names), 1):
        raise InputError(name, Words("no row of names, each once"), f"a first row with names among {', '.join(keys)}")
    for column, cell in zip(names, lines[0], strict=True):
        if column not in keys:
            units = "units in the cells, as in '-7.5 mm', and " if re.search(r"[(\[]", cell) else ""
            allowed = f"{units}{describe_choices(column, keys)}"
            raise InputError(f"column {cell!r} of {name}", Words("not known"), allowed)
    for index, row in enumerate(lines[1:]):
        if len(row) != len(names):
            raise InputError(f"reading[{index}]", Words(f"{len(row)} cells"), f"{len(names)} cells as in the first row")
    if separator != ",":
        lines = [[cell.replace(",", ".") for cell in row] for row in lines]
    return [{key: cell for key, cell in zip(names, row, strict=True) if cell} for row in lines[1:]]
