"""Detect damage of a store, and save the sound results of a damaged one.

SQLite checks the structure of its pages, not their content: a row with a flipped bit is read as any other. So each row ends
with a checksum of its values: CRC-32, which detects every single-bit error and every burst of up to 32 bits (Peterson & Brown,
Proc. IRE 49 (1961) 228-235). Readers check each row that they return; a writer checks the whole store when it opens it.
"""

from __future__ import annotations

import json
import sqlite3
import zlib
from collections.abc import Iterable, Iterator
from contextlib import closing, suppress
from typing import Any

from geometry.common.json_types import JsonObject
from probe_design.sweeps.rows import COLUMN_UNITS, ROW_COLUMNS, Row

STORE_FORMAT = 5  # version of the schema, in SQLite's user_version
TABLE_COLUMNS = {
    "designs": ("number INTEGER PRIMARY KEY", "inputs TEXT", "key BLOB"),
    "request": ("content TEXT PRIMARY KEY",),  # one row
    "results": (
        "key BLOB PRIMARY KEY",
        *(f"{column} {'REAL' if column in COLUMN_UNITS else 'TEXT'}" for column in ROW_COLUMNS),
    ),
}
_TABLE_STATEMENTS = [
    f"CREATE TABLE {name} ({', '.join(columns)}, checksum INTEGER) WITHOUT ROWID" for name, columns in TABLE_COLUMNS.items()
]
CREATE_STATEMENTS = f"BEGIN; {'; '.join(_TABLE_STATEMENTS)}; PRAGMA user_version = {STORE_FORMAT}; COMMIT;"
StoredRow = tuple[Any, ...]


def build_insertion(table: str) -> str:
    """Return the SQL statement that adds sealed rows; a row whose key exists already is not replaced."""
    return f"INSERT OR IGNORE INTO {table} VALUES ({', '.join('?' * (len(TABLE_COLUMNS[table]) + 1))})"


def seal_row(*values: Any) -> StoredRow:
    """Return the values of a row followed by their checksum; values must be as SQLite returns them."""
    return (*values, zlib.crc32(ascii(values).encode()))


def seal_result(key: bytes, row: Row) -> StoredRow:
    """Return a result with its design's key and a checksum; numbers are floats without -0.0, as SQLite returns them."""
    numbers = {name: float(row[name]) + 0.0 for name in COLUMN_UNITS if row[name] is not None}
    return seal_row(key, *(numbers.get(name, row[name]) for name in ROW_COLUMNS))


def is_sound(row: StoredRow) -> bool:
    """Return whether the checksum of a row is right."""
    return row == seal_row(*row[:-1])


def open_row(row: StoredRow) -> StoredRow:
    """Return the values of a row without the checksum. Raises ``ValueError`` if the checksum is wrong."""
    if not is_sound(row):
        raise ValueError("a row is not what was written")
    return row[:-1]


def read_request(rows: Iterable[StoredRow]) -> JsonObject:
    """Return the request of a sweep from the rows of table ``request``; empty without rows. Raises ``ValueError`` if damaged."""
    request: JsonObject = {}
    for (content,) in map(open_row, rows):
        request = json.loads(content)
    return request


def find_schema_fault(connection: sqlite3.Connection, version: int) -> str:
    """Describe the fault if the tables are not those of this format; return an empty text if they are.

    A ``version`` of 0 is that of a new file, which has no tables.
    """
    statements = [text for (text,) in connection.execute("SELECT sql FROM sqlite_master ORDER BY name")]
    return "" if statements == (_TABLE_STATEMENTS if version else []) else "its tables are others"


def find_store_fault(connection: sqlite3.Connection) -> str:
    """Describe damage of the pages, the request or the number of designs; return an empty text if there is none.

    Raises
    ------
    sqlite3.Error
        The damage is too much for SQLite.
    ValueError
        The stored request is damaged.
    """
    text = " ".join(connection.execute("PRAGMA integrity_check(1)").fetchone()[0].split())
    if text != "ok":
        return text.removeprefix("*** in database main *** ")
    expected = read_request(connection.execute("SELECT * FROM request")).get("designs", 0)
    (count,) = connection.execute("SELECT count(*) FROM designs").fetchone()
    return "" if count == expected else f"{count} of {expected} designs are there"


def find_row_fault(connection: sqlite3.Connection) -> str:
    """Return which table has a damaged row; an empty text if none. Raises ``sqlite3.Error`` if a row cannot be read."""
    for name in TABLE_COLUMNS:
        if not all(map(is_sound, connection.execute(f"SELECT * FROM {name}"))):
            return f"a row of {name} is not what was written"
    return ""


def save_sound_results(connection: sqlite3.Connection) -> int:
    """Replace a damaged store by one with its sound results, in one commit; return their number.

    The request is left out: the sweep that goes on writes it again.

    Raises
    ------
    sqlite3.Error
        The store cannot be written.
    """
    connection.text_factory = lambda raw: raw.decode(errors="surrogateescape")  # damaged text must not stop the reading
    with closing(sqlite3.connect("", isolation_level=None)) as repaired:  # a temporary file
        repaired.executescript(CREATE_STATEMENTS)
        repaired.execute("BEGIN")
        for order in ("ASC", "DESC"):  # from both ends, as reading stops at the first damaged page
            repaired.executemany(
                build_insertion("results"), (row for row in _iterate_readable(connection, order) if is_sound(row))
            )
        repaired.execute("COMMIT")
        connection.text_factory = str
        repaired.backup(connection)
        (count,) = repaired.execute("SELECT count(*) FROM results").fetchone()
    return int(count)


def _iterate_readable(connection: sqlite3.Connection, order: str) -> Iterator[StoredRow]:
    """Yield results from one end of the table, up to the first page that cannot be read."""
    with suppress(sqlite3.Error):
        yield from connection.execute(f"SELECT * FROM results ORDER BY key {order}")
