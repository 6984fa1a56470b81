"""The rows of a sweep on disk: one SQLite file in which a committed row stays, whatever happens next.

SQLite, for it is part of Python, one file, and says what it promises: with a write-ahead log and ``synchronous = FULL`` a commit
returns when the log is on the disk (fsync), so that ``kill -9`` and power loss cost what was not committed and nothing else; a
commit that finds the disk full is rolled back whole (https://www.sqlite.org/wal.html, https://www.sqlite.org/atomiccommit.html).
"""

from __future__ import annotations

import json
import os
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, TypeAdapter
from pydantic_core import from_json

from geometry.common.errors import InputError, ProbeError, Words
from probe_design.sweeps.keys import Value
from probe_design.sweeps.rows import COLUMNS, OUTPUTS, Row

NAME, LOCK, FORMAT = "sweep.sqlite", "sweep.lock", 2
_NO_ROOM = ("SQLITE_FULL", "SQLITE_IOERR_SHMSIZE")
Design = tuple[int, tuple[Value, ...]]
_REAL = (*OUTPUTS, "seconds")
_COLUMNS = ", ".join(f"{one} {'REAL' if one in _REAL else 'TEXT'}" for one in COLUMNS)
_TABLES = f"""
CREATE TABLE IF NOT EXISTS about (name TEXT PRIMARY KEY, value TEXT NOT NULL) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS designs (number INTEGER PRIMARY KEY, inputs TEXT NOT NULL, key BLOB NOT NULL);
CREATE TABLE IF NOT EXISTS results (key BLOB PRIMARY KEY, {_COLUMNS},
 CHECK (status IN ('ok', 'refused', 'failed'))) WITHOUT ROWID;
"""


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


class StoreError(ProbeError):
    """The store could not be read or written; what was committed before is kept."""


class Store:
    """The store of one folder; of rows that are written, none is ever changed, and none goes unless it is asked for anew."""

    def __init__(self, folder: Path, connection: sqlite3.Connection) -> None:
        self.folder, self._connection = folder, connection

    def about(self) -> dict[str, Any]:
        """Return what the sweep was asked; empty before it began. Raises ``InputError`` where it is damaged."""
        texts = self._all("SELECT name, value FROM about")
        with _intact(self.folder):
            told = {name: from_json(value) for name, value in texts}
            return _About.model_validate(told).model_dump() if told else {}

    def begin(self, about: Mapping[str, Any], designs: Sequence[tuple[int, tuple[Value, ...], bytes]]) -> None:
        """Note which designs the sweep has, in place of those of another sweep in this folder; its rows stay."""
        with self._written() as connection:
            connection.execute("DELETE FROM about")
            connection.execute("DELETE FROM designs")
            connection.executemany("INSERT INTO about VALUES (?, ?)", [(k, json.dumps(v)) for k, v in about.items()])
            rows = ((number, json.dumps(values), key) for number, values, key in designs)
            connection.executemany("INSERT INTO designs VALUES (?, ?, ?)", rows)

    def missing(self) -> list[tuple[int, tuple[Value, ...], bytes]]:
        """Return of the designs without a row how many are the same, their values and their key."""
        query = (
            "SELECT count(*), inputs, key FROM designs WHERE NOT EXISTS"
            " (SELECT 1 FROM results WHERE results.key = designs.key) GROUP BY key ORDER BY min(number)"
        )
        found = self._all(query)
        with _intact(self.folder):
            return [(count, _INPUTS.validate_json(inputs), key) for count, inputs, key in found]

    def add(self, rows: Sequence[tuple[bytes, Row]]) -> int:
        """Commit rows; one whose key is there already is left as it is. Returns how many were new."""
        before = self._connection.total_changes
        with self._written() as connection:
            places = ", ".join("?" * (1 + len(COLUMNS)))
            values = [(key, *(row[name] for name in COLUMNS)) for key, row in rows]
            connection.executemany(f"INSERT OR IGNORE INTO results VALUES ({places})", values)
        return self._connection.total_changes - before

    def forget(self, status: str) -> int:
        """Take away the rows of this sweep's designs with a status, so that they are missing again; returns how many."""
        with self._written() as connection:
            query = "DELETE FROM results WHERE status = ? AND key IN (SELECT key FROM designs)"
            return connection.execute(query, (status,)).rowcount

    def counts(self) -> dict[str, int]:
        """Return how many designs have a row, by its status."""
        query = "SELECT status, count(*) FROM designs JOIN results USING (key) GROUP BY status"
        return {"ok": 0, "refused": 0, "failed": 0} | dict(self._all(query))

    def rows(self) -> Iterator[tuple[int, tuple[Value, ...], bytes, Row]]:
        """Yield number, values, key and row of every design that has one, by number. Raises ``InputError`` for damaged values."""
        columns = ", ".join(COLUMNS)
        query = f"SELECT number, inputs, key, {columns} FROM designs JOIN results USING (key) ORDER BY number"
        for number, inputs, key, *values in self._connection.execute(query):
            with _intact(self.folder):
                checked = _INPUTS.validate_json(inputs)
            yield number, checked, key, dict(zip(COLUMNS, values, strict=True))

    def _all(self, query: str) -> list[Any]:
        with _store_errors(self.folder):
            return self._connection.execute(query).fetchall()

    @contextmanager
    def _written(self) -> Iterator[sqlite3.Connection]:
        with _store_errors(self.folder):
            try:
                self._connection.execute("BEGIN IMMEDIATE")
                yield self._connection
                self._connection.execute("COMMIT")
            except BaseException:
                if self._connection.in_transaction:
                    self._connection.execute("ROLLBACK")
                raise


@contextmanager
def writing(folder: Path) -> Iterator[Store]:
    """Open the store of a folder for writing, making both if needed; no other process can meanwhile.

    Raises:
        InputError: another process is writing, or the store is of another format.
        StoreError: the store cannot be read or written.
        OSError: the folder cannot be made.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with _alone(folder), _store_errors(folder):
        connection = sqlite3.connect(folder / NAME, isolation_level=None, timeout=30)
        try:
            for pragma in ("journal_mode = WAL", "synchronous = FULL", "fullfsync = 1", "checkpoint_fullfsync = 1"):
                connection.execute(f"PRAGMA {pragma}")
            if _check_format(folder, connection) == 0:
                connection.executescript(f"BEGIN; {_TABLES} PRAGMA user_version = {FORMAT}; COMMIT;")
            _flush(folder)
            yield Store(folder, connection)
        finally:
            connection.close()


@contextmanager
def reading(folder: Path) -> Iterator[Store]:
    """Open the store of a folder for reading, also while a sweep writes.

    Raises:
        InputError: there is none, or one of another format.
        StoreError: it cannot be read.
    """
    if not (folder / NAME).is_file():
        raise InputError("folder", str(folder), "a folder that a sweep was written to")
    with _store_errors(folder):
        connection = sqlite3.connect(folder / NAME, isolation_level=None, timeout=30)
        try:
            connection.execute("PRAGMA query_only = 1")
            _check_format(folder, connection)
            yield Store(folder, connection)
        finally:
            connection.close()


@contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """Hold a lock that ends with the process, also by ``kill -9``: SQLite's own, on a file beside the store."""
    try:
        lock = sqlite3.connect(folder / LOCK, isolation_level=None, timeout=0)
    except sqlite3.Error as fault:
        raise StoreError(f"{folder / LOCK}: {fault}") from None
    try:
        try:
            lock.execute("BEGIN EXCLUSIVE")
        except sqlite3.Error as fault:
            if "locked" in str(fault):
                raise InputError("output", str(folder), "a folder that no other sweep is writing to now") from None
            raise StoreError(f"{folder / LOCK}: {fault}") from None
        yield
    finally:
        lock.close()


@contextmanager
def _intact(folder: Path) -> Iterator[None]:
    """Raise ``InputError`` where what is read is not what a sweep has written."""
    try:
        yield
    except (ValueError, TypeError):
        raise _damaged(folder, "it holds what no sweep has written") from None


def _damaged(folder: Path, why: object) -> InputError:
    return InputError("folder", str(folder), f"a folder whose {NAME} is whole ({why}); move it away to begin anew")


@contextmanager
def _store_errors(folder: Path) -> Iterator[None]:
    try:
        yield
    except UnicodeDecodeError as fault:  # of what SQLite itself says of damaged tables
        raise _damaged(folder, fault.reason) from None
    except sqlite3.Error as fault:
        # of what it cannot decode as text Python itself complains, without SQLite's name of the error
        if getattr(fault, "sqlite_errorname", "SQLITE_CORRUPT").startswith(("SQLITE_CORRUPT", "SQLITE_NOTADB")):
            raise _damaged(folder, fault) from None
        safe = "; all rows committed before are kept" if isinstance(fault, sqlite3.OperationalError) else ""
        remedy = "; free space and start again" if fault.sqlite_errorname in _NO_ROOM else ""
        raise StoreError(f"{folder / NAME}: {fault}{safe}{remedy}") from None


def _check_format(folder: Path, connection: sqlite3.Connection) -> int:
    """Return the format of a store, 0 of one without tables; raise ``InputError`` for one of another program's."""
    version = int(connection.execute("PRAGMA user_version").fetchone()[0])
    if version not in (0, FORMAT):
        raise InputError("folder", str(folder), f"a folder whose store is of format {FORMAT}, not {Words(version)}")
    return version


def _flush(folder: Path) -> None:
    """Make the file's name durable too."""
    if os.name != "nt":  # Windows opens no folders
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
