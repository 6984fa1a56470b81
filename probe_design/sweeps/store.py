"""The store of a sweep: one SQLite file from which no crash removes a committed row.

SQLite is part of Python, writes one file and documents its guarantees: with a write-ahead log and ``synchronous = FULL`` a commit
returns when the log is on the disk (fsync), so that ``kill -9`` and power loss lose only what was not committed; a commit on a
full disk is rolled back whole (https://www.sqlite.org/wal.html, https://www.sqlite.org/atomiccommit.html). Module ``integrity``
detects damage of the file.
"""

from __future__ import annotations

import json
import shutil
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from geometry.common.errors import InputError, ProbeError, Words
from geometry.common.files import flush_to_disk, write_whole
from geometry.common.json_types import JsonObject
from geometry.common.resources import Limits
from geometry.scenes.keys import Value
from probe_design.sweeps import integrity
from probe_design.sweeps.integrity import build_insertion, seal_result, seal_row
from probe_design.sweeps.rows import ROW_COLUMNS, Row

STORE_FILE, LOCK_FILE, DAMAGED_FILE = "sweep.sqlite", "sweep.lock", "sweep.sqlite.damaged"
_DAMAGE_ERRORS = ("SQLITE_CORRUPT", "SQLITE_NOTADB", "SQLITE_ERROR")  # the last: of a table that is damaged
_NO_SPACE_ERRORS = ("SQLITE_FULL", "SQLITE_IOERR_SHMSIZE")


class StoreError(ProbeError):
    """The store could not be read or written; rows committed before are kept."""


class Store:
    """The open store of one folder. Written rows are never changed, and only deleted to be evaluated again.

    Attributes
    ----------
    folder
        Of the store.
    repair_note
        What was damaged and how it was repaired, one line; empty if nothing was.
    """

    def __init__(self, folder: Path, connection: sqlite3.Connection, repair_note: str = "") -> None:
        """Keep an open connection; use ``open_for_writing`` or ``open_for_reading`` to make a store."""
        self.folder, self._connection, self.repair_note = folder, connection, repair_note
        self._file_identity = _identify_file(folder)

    def read_request(self) -> JsonObject:
        """Return the request of the sweep; empty before it began. Raises ``InputError`` if it is damaged."""
        rows = self._fetch_all("SELECT * FROM request")
        if not rows and self._fetch_all("SELECT 1 FROM designs LIMIT 1"):
            raise _build_damage_error(self.folder, "its request is missing")
        with _refuse_damage(self.folder):
            return integrity.read_request(rows)

    def begin(self, request: Mapping[str, object], designs: Sequence[tuple[int, tuple[Value, ...], bytes]]) -> None:
        """Store the request and designs of a sweep, replacing those of an earlier sweep in this folder; result rows stay.

        A design is its number, its values of the variables, and the key of its row.
        """
        with self._open_transaction() as connection:
            connection.execute("DELETE FROM request")
            connection.execute("DELETE FROM designs")
            connection.execute(build_insertion("request"), seal_row(json.dumps(request)))
            rows = (seal_row(number, json.dumps(values), key) for number, values, key in designs)
            connection.executemany(build_insertion("designs"), rows)

    def find_missing(self) -> list[tuple[int, tuple[Value, ...], bytes]]:
        """Return count (of identical designs), values and key of the designs without a row."""
        query = (
            "SELECT count(*), inputs, key FROM designs WHERE NOT EXISTS"
            " (SELECT 1 FROM results WHERE results.key = designs.key) GROUP BY key ORDER BY min(number)"
        )
        records = self._fetch_all(query)
        with _refuse_damage(self.folder):
            return [(count, tuple(json.loads(text)), key) for count, text, key in records]

    def add(self, rows: Sequence[tuple[bytes, Row]]) -> int:
        """Commit rows and return how many were new; a row whose key exists already is not replaced."""
        old_changes = self._connection.total_changes
        with self._open_transaction() as connection:
            connection.executemany(build_insertion("results"), [seal_result(key, row) for key, row in rows])
        return self._connection.total_changes - old_changes

    def forget(self, status: str) -> int:
        """Delete the rows of this sweep's designs with a status, so that they are evaluated again; return how many."""
        with self._open_transaction() as connection:
            query = "DELETE FROM results WHERE status = ? AND key IN (SELECT key FROM designs)"
            return connection.execute(query, (status,)).rowcount

    def delete_limited_rows(self, limits: Limits) -> int:
        """Delete rows of this sweep that a now larger limit stopped, see ``rows.LIMIT_UNITS``; return how many."""
        with self._open_transaction() as connection:
            query = "DELETE FROM results WHERE (time_limit < ? OR memory_limit < ?) AND key IN (SELECT key FROM designs)"
            return connection.execute(query, (limits.seconds, limits.memory)).rowcount

    def check_file(self) -> None:
        """Check that the file is still where it was opened: rows written to a deleted file would be lost.

        Raises
        ------
        StoreError
            The file is gone, or another one is in its place.
        """
        if _identify_file(self.folder) != self._file_identity:
            raise StoreError(
                f"{self.folder / STORE_FILE}: moved or deleted during the sweep, and with it the rows committed before"
            )

    def count_rows(self) -> dict[str, int]:
        """Return the number of designs with a row, by status."""
        query = "SELECT status, count(*) FROM designs JOIN results USING (key) GROUP BY status"
        return {"ok": 0, "refused": 0, "failed": 0} | dict(self._fetch_all(query))

    def iterate_rows(self) -> Iterator[tuple[int, tuple[Value, ...], bytes, Row]]:
        """Yield number, values, key and row of every design with a row, by number. Raises ``InputError`` if damaged."""
        with _convert_errors(self.folder), _refuse_damage(self.folder):
            fault = integrity.find_store_fault(self._connection)
            for row in self._connection.execute("SELECT * FROM results WHERE key NOT IN (SELECT key FROM designs)"):
                integrity.open_row(row)  # a row with a damaged key belongs to no design: check it too
        if fault:
            raise _build_damage_error(self.folder, fault)
        width = len(integrity.TABLE_COLUMNS["designs"]) + 1  # columns of a design with its checksum; its result follows
        query = "SELECT designs.*, results.* FROM designs LEFT JOIN results ON results.key = designs.key ORDER BY number"
        for record in self._connection.execute(query):
            with _refuse_damage(self.folder):
                number, text, key = integrity.open_row(record[:width])
                values = tuple(json.loads(text))
                columns = integrity.open_row(record[width:])[1:] if record[width] is not None else ()
            if columns:
                yield number, values, key, dict(zip(ROW_COLUMNS, columns, strict=True))

    def _fetch_all(self, query: str) -> list[Any]:
        """Return all rows of a query."""
        with _convert_errors(self.folder):
            return self._connection.execute(query).fetchall()

    @contextmanager
    def _open_transaction(self) -> Iterator[sqlite3.Connection]:
        """Open a transaction that is committed at the end, or rolled back on any exception."""
        self.check_file()
        with _convert_errors(self.folder):
            try:
                self._connection.execute("BEGIN IMMEDIATE")
                yield self._connection
                self._connection.execute("COMMIT")
            except BaseException:
                if self._connection.in_transaction:
                    self._connection.execute("ROLLBACK")
                raise


@contextmanager
def open_for_writing(folder: Path) -> Iterator[Store]:
    """Open the store of a folder for writing; create both if needed; lock out other writers.

    A damaged store is kept under another name and replaced by one with its sound rows.

    Raises
    ------
    InputError
        Another process is writing, the store has another format, or its schema is damaged.
    StoreError
        The store cannot be read or written.
    OSError
        The folder cannot be created.
    """
    folder.mkdir(parents=True, exist_ok=True)
    existed = (folder / STORE_FILE).exists()
    with _lock_folder(folder), _convert_errors(folder):
        connection = sqlite3.connect(folder / STORE_FILE, isolation_level=None, timeout=30)
        try:
            for pragma in ("journal_mode = WAL", "synchronous = FULL", "fullfsync = 1", "checkpoint_fullfsync = 1"):
                connection.execute(f"PRAGMA {pragma}")
            repair_note = (
                _repair(folder, connection) if _check_format(folder, connection) else _create_tables(connection, existed)
            )
            flush_to_disk(folder)
            yield Store(folder, connection, repair_note)
        finally:
            connection.close()


@contextmanager
def open_for_reading(folder: Path) -> Iterator[Store]:
    """Open the store of a folder for reading, also while a sweep writes.

    Raises
    ------
    InputError
        There is no store, or it has another format.
    StoreError
        The store cannot be read.
    """
    if not (folder / STORE_FILE).is_file():
        raise InputError("folder", str(folder), "a folder that a sweep was written to")
    with _convert_errors(folder):
        connection = sqlite3.connect(folder / STORE_FILE, isolation_level=None, timeout=30)
        try:
            connection.execute("PRAGMA query_only = 1")
            connection.execute("BEGIN")  # all reads see the same state
            if not _check_format(folder, connection):
                raise InputError("folder", str(folder), "a folder of a sweep that has begun")
            yield Store(folder, connection)
        finally:
            connection.close()


@contextmanager
def _lock_folder(folder: Path) -> Iterator[None]:
    """Lock a folder against other writers, by SQLite's lock on a second file, which even ``kill -9`` releases."""
    try:
        lock = sqlite3.connect(folder / LOCK_FILE, isolation_level=None, timeout=0)
    except sqlite3.Error as fault:
        raise StoreError(f"{folder / LOCK_FILE}: {fault}") from None
    try:
        try:
            lock.execute("BEGIN EXCLUSIVE")
        except sqlite3.Error as fault:
            if "locked" in str(fault):
                raise InputError("output", str(folder), "a folder that no other sweep is writing to now") from None
            raise StoreError(f"{folder / LOCK_FILE}: {fault}") from None
        yield
    finally:
        lock.close()


@contextmanager
def _refuse_damage(folder: Path) -> Iterator[None]:
    """Turn an error of reading damaged data into ``InputError``."""
    try:
        yield
    except (ValueError, TypeError):
        raise _build_damage_error(folder, "it holds what no sweep has written") from None


def _build_damage_error(folder: Path, reason: object) -> InputError:
    """Return the error for a damaged store, which has to be moved away."""
    return InputError("folder", str(folder), f"a folder whose {STORE_FILE} is whole ({reason}); move it away to begin anew")


@contextmanager
def _convert_errors(folder: Path) -> Iterator[None]:
    """Turn errors of SQLite into ``InputError`` for damage, ``StoreError`` otherwise."""
    try:
        yield
    except UnicodeDecodeError as fault:  # raised by an error message of SQLite about damaged tables
        raise _build_damage_error(folder, fault.reason) from None
    except sqlite3.Error as fault:
        if _is_damage(fault):
            raise _build_damage_error(folder, fault) from None
        safe = "; all rows committed before are kept" if isinstance(fault, sqlite3.OperationalError) else ""
        remedy = "; free space and start again" if fault.sqlite_errorname in _NO_SPACE_ERRORS else ""
        raise StoreError(f"{folder / STORE_FILE}: {fault}{safe}{remedy}") from None


def _check_format(folder: Path, connection: sqlite3.Connection) -> int:
    """Return the format of a store, 0 if it has no tables yet.

    Raises
    ------
    InputError
        Another program wrote the file, or its schema is damaged.
    """
    version = int(connection.execute("PRAGMA user_version").fetchone()[0])
    if version not in (0, integrity.STORE_FORMAT):
        raise InputError(
            "folder", str(folder), f"a folder whose store is of format {integrity.STORE_FORMAT}, not {Words(version)}"
        )
    if fault := integrity.find_schema_fault(connection, version):
        raise _build_damage_error(folder, fault)
    return version


def _create_tables(connection: sqlite3.Connection, existed: bool) -> str:
    """Create the tables of a store; return a note if an empty file existed."""
    connection.executescript(integrity.CREATE_STATEMENTS)
    return f"{STORE_FILE} was empty: all designs are evaluated" if existed else ""


def _repair(folder: Path, connection: sqlite3.Connection) -> str:
    """Replace a damaged store by its sound rows and return a note; return an empty text if it is undamaged."""
    fault = _find_fault(connection)
    if not fault:
        return ""
    connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")  # so that the copy of the file is complete
    with write_whole(folder / DAMAGED_FILE) as draft:
        shutil.copyfile(folder / STORE_FILE, draft)
    count = integrity.save_sound_results(connection)
    if remaining_fault := _find_fault(connection):
        raise _build_damage_error(folder, remaining_fault)
    return (
        f"{STORE_FILE} was damaged ({fault}) and is now {DAMAGED_FILE}: {count} whole rows are kept, the others are "
        "evaluated again"
    )


def _find_fault(connection: sqlite3.Connection) -> str:
    """Describe the damage of a store whose schema is right; return an empty text if there is none."""
    try:
        return integrity.find_store_fault(connection) or integrity.find_row_fault(connection)
    except (sqlite3.Error, UnicodeDecodeError, ValueError, TypeError) as fault:
        if isinstance(fault, sqlite3.Error) and not _is_damage(fault):
            raise
        return " ".join(str(fault).split())


def _is_damage(fault: sqlite3.Error) -> bool:
    """Return whether an error means a damaged file; Python's own decoding errors have no SQLite name and count as damage."""
    return getattr(fault, "sqlite_errorname", "SQLITE_CORRUPT").startswith(_DAMAGE_ERRORS)


def _identify_file(folder: Path) -> tuple[int, int] | None:
    """Return device and inode of the store's file; None if there is none."""
    try:
        status = (folder / STORE_FILE).stat()
    except OSError:
        return None
    return status.st_dev, status.st_ino
