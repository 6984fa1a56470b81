"""Whether a store is what sweeps have written, and what can be saved of one that is not.

SQLite checks how its pages hang together, not what stands in them: a row with a flipped bit is read as any other. So each row of
each table ends with a checksum over all that stands before it: CRC-32, which misses no single bit and no run of up to 32 of them
(Peterson & Brown, Proc. IRE 49 (1961) 228-235). Readers check the rows that they hand out, a writer the whole store as it begins.
"""

from __future__ import annotations

import sqlite3
import zlib
from collections.abc import Iterable, Iterator
from contextlib import closing, suppress
from typing import Any

from pydantic import BaseModel, ConfigDict, TypeAdapter
from pydantic_core import from_json

from probe_design.sweeps.keys import Value
from probe_design.sweeps.rows import COLUMNS, REAL, Row

FORMAT = 3
TABLES = {
    "about": ("name TEXT PRIMARY KEY", "value TEXT"),
    "designs": ("number INTEGER PRIMARY KEY", "inputs TEXT", "key BLOB"),
    "results": ("key BLOB PRIMARY KEY", *(f"{one} {'REAL' if one in REAL else 'TEXT'}" for one in COLUMNS)),
}
_SCHEMA = [f"CREATE TABLE {name} ({', '.join(columns)}, checksum INTEGER) WITHOUT ROWID" for name, columns in TABLES.items()]
CREATE = f"BEGIN; {'; '.join(_SCHEMA)}; PRAGMA user_version = {FORMAT}; COMMIT;"
Stored = tuple[Any, ...]


class _Variable(BaseModel):
    """One variable of a sweep, as a store has it."""

    model_config = ConfigDict(strict=True, extra="allow")

    name: str
    unit: str
    shown: str
    values: list[float | str | bool]
    log: bool


class _About(BaseModel):
    """What readers of a store rely on; more may stand there."""

    model_config = ConfigDict(strict=True, extra="allow")

    names: list[str]
    variables: list[_Variable]
    sample: dict[str, Any]
    constraints: list[str]
    evaluator: str
    accuracy: float
    version: str
    designs: int
    digest: str


_INPUTS: TypeAdapter[tuple[Value, ...]] = TypeAdapter(tuple[Value, ...])


def insertion(table: str) -> str:
    """Return the statement that adds sealed rows; one whose key is there already is left as it is."""
    return f"INSERT OR IGNORE INTO {table} VALUES ({', '.join('?' * (len(TABLES[table]) + 1))})"


def sealed(*values: Any) -> Stored:
    """Return the values of a row, as SQLite will give them back, with their checksum at the end."""
    return (*values, zlib.crc32(ascii(values).encode()))


def sealed_result(key: bytes, row: Row) -> Stored:
    """Return a result as a sealed row; SQLite gives floats back in columns of numbers, and no -0.0."""
    numbers = {name: float(row[name]) + 0.0 for name in REAL if row[name] is not None}
    return sealed(key, *(numbers.get(name, row[name]) for name in COLUMNS))


def is_sound(row: Stored) -> bool:
    """Whether a row is one that ``sealed`` has made."""
    return row == sealed(*row[:-1])


def opened(row: Stored) -> Stored:
    """Return the values of a row. Raises ``ValueError`` where they are not what was written."""
    if not is_sound(row):
        raise ValueError("a row is not what was written")
    return row[:-1]


def about(rows: Iterable[Stored]) -> dict[str, Any]:
    """Return what a sweep was asked from the rows that say so; empty without any. Raises ``ValueError`` where it cannot be."""
    told = {name: from_json(value) for name, value in map(opened, rows)}
    return _About.model_validate(told).model_dump() if told else {}


def inputs(text: str) -> tuple[Value, ...]:
    """Return the values of a design's variables. Raises ``ValueError`` where there are none."""
    return _INPUTS.validate_json(text)


def fault_of_schema(connection: sqlite3.Connection, version: int) -> str:
    """Say that tables are not as they were made, in a store of some format; nothing if they are."""
    found = [text for (text,) in connection.execute("SELECT sql FROM sqlite_master ORDER BY name")]
    return "" if found == (_SCHEMA if version else []) else "its tables are others"


def fault_of_whole(connection: sqlite3.Connection) -> str:
    """Say what is wrong with pages, what the sweep was asked, or how many designs there are; nothing if nothing is.

    Raises:
        sqlite3.Error: it is too much for SQLite.
        ValueError: what the sweep was asked is not what was written.
    """
    text = " ".join(connection.execute("PRAGMA integrity_check(1)").fetchone()[0].split())
    if text != "ok":
        return text.removeprefix("*** in database main *** ")
    wanted = about(connection.execute("SELECT * FROM about")).get("designs", 0)
    (count,) = connection.execute("SELECT count(*) FROM designs").fetchone()
    return "" if count == wanted else f"{count} of {wanted} designs are there"


def fault_of_rows(connection: sqlite3.Connection) -> str:
    """Say in which table a row is not what was written; nothing if all are. Raises ``sqlite3.Error`` where one cannot be read."""
    for name in TABLES:
        if not all(map(is_sound, connection.execute(f"SELECT * FROM {name}"))):
            return f"a row of {name} is not what was written"
    return ""


def saved(connection: sqlite3.Connection) -> int:
    """Write in place of a damaged store, in one commit, those of its results that are whole; return how many.

    What the sweep was asked is left out: whoever goes on with it knows.

    Raises:
        sqlite3.Error: it cannot be written.
    """
    connection.text_factory = lambda raw: raw.decode(errors="surrogateescape")  # what is no text is no reason to stop reading
    with closing(sqlite3.connect("", isolation_level=None)) as whole:  # a temporary file
        whole.executescript(CREATE)
        whole.execute("BEGIN")
        for order in ("ASC", "DESC"):
            whole.executemany(insertion("results"), (row for row in _readable(connection, order) if is_sound(row)))
        whole.execute("COMMIT")
        connection.text_factory = str
        whole.backup(connection)
        (count,) = whole.execute("SELECT count(*) FROM results").fetchone()
    return int(count)


def _readable(connection: sqlite3.Connection, order: str) -> Iterator[Stored]:
    """Results from one end, up to a page that cannot be read."""
    with suppress(sqlite3.Error):
        yield from connection.execute(f"SELECT * FROM results ORDER BY key {order}")
