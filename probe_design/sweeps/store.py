"""The store of a sweep: one SQLite file from which no crash removes a committed row.

SQLite is part of Python, writes one file and documents its guarantees: with a write-ahead log and ``synchronous = FULL`` a commit
returns when the log is on the disk (fsync), so that ``kill -9`` and power loss lose only what was not committed; a commit on a
full disk is rolled back whole (https://www.sqlite.org/wal.html, https://www.sqlite.org/atomiccommit.html). Module ``integrity``
detects damage of the file.
"""

from __future__ import annotations

import json
import os
import shutil
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from geometry.common.errors import InputError, ProbeError, Words
from geometry.common.files import written_whole
from geometry.common.resources import Limits
from probe_design.sweeps import integrity
from probe_design.sweeps.integrity import insertion, sealed, sealed_result
from probe_design.sweeps.keys import Value
from probe_design.sweeps.rows import COLUMNS, Row

NAME, LOCK, DAMAGED = "sweep.sqlite", "sweep.lock", "sweep.sqlite.damaged"
_DAMAGE = ("SQLITE_CORRUPT", "SQLITE_NOTADB", "SQLITE_ERROR")  # the last: of a table that is damaged
_NO_ROOM = ("SQLITE_FULL", "SQLITE_IOERR_SHMSIZE")


class StoreError(ProbeError):
    """The store could not be read or written; rows committed before are kept."""


class Store:
    """The open store of one folder. Written rows are never changed, and only deleted to be evaluated again.

    Attributes:
        folder: of the store.
        repair_note: what was damaged and how it was repaired, one line; empty if nothing was.
    """

    def __init__(self, folder: Path, connection: sqlite3.Connection, mended: str = "") -> None:
        self.folder, self._connection, self.mended = folder, connection, mended
        self._place = _place(folder)

    def about(self) -> dict[str, Any]:
        """Return the request of the sweep; empty before it began. Raises ``InputError`` if it is damaged."""
        rows = self._all("SELECT * FROM about")
        with _intact(self.folder):
            return integrity.about(rows)

    def begin(self, about: Mapping[str, Any], designs: Sequence[tuple[int, tuple[Value, ...], bytes]]) -> None:
        """Store the request and designs of a sweep, replacing those of an earlier sweep in this folder; result rows stay."""
        with self._written() as connection:
            connection.execute("DELETE FROM about")
            connection.execute("DELETE FROM designs")
            connection.executemany(insertion("about"), [sealed(name, json.dumps(value)) for name, value in about.items()])
            rows = (sealed(number, json.dumps(values), key) for number, values, key in designs)
            connection.executemany(insertion("designs"), rows)

    def missing(self) -> list[tuple[int, tuple[Value, ...], bytes]]:
        """Return count (of identical designs), values and key of the designs without a row."""
        query = (
            "SELECT count(*), inputs, key FROM designs WHERE NOT EXISTS"
            " (SELECT 1 FROM results WHERE results.key = designs.key) GROUP BY key ORDER BY min(number)"
        )
        found = self._all(query)
        with _intact(self.folder):
            return [(count, integrity.inputs(text), key) for count, text, key in found]

    def add(self, rows: Sequence[tuple[bytes, Row]]) -> int:
        """Commit rows and return how many were new; a row whose key exists already is not replaced."""
        before = self._connection.total_changes
        with self._written() as connection:
            connection.executemany(insertion("results"), [sealed_result(key, row) for key, row in rows])
        return self._connection.total_changes - before

    def forget(self, status: str) -> int:
        """Delete the rows of this sweep's designs with a status, so that they are evaluated again; return how many."""
        with self._written() as connection:
            query = "DELETE FROM results WHERE status = ? AND key IN (SELECT key FROM designs)"
            return connection.execute(query, (status,)).rowcount

    def forget_limited(self, limits: Limits) -> int:
        """Delete rows of this sweep that a now larger limit stopped, see ``rows.LIMIT_COLUMNS``; return how many."""
        with self._written() as connection:
            query = "DELETE FROM results WHERE (time_limit < ? OR memory_limit < ?) AND key IN (SELECT key FROM designs)"
            return connection.execute(query, (limits.seconds, limits.memory)).rowcount

    def check_place(self) -> None:
        """Check that the file is still where it was opened: rows written to a deleted file would be lost.

        Raises:
            StoreError: the file is gone, or another one is in its place.
        """
        if _place(self.folder) != self._place:
            raise StoreError(f"{self.folder / NAME}: moved or deleted during the sweep, and with it the rows committed before")

    def counts(self) -> dict[str, int]:
        """Return the number of designs with a row, by status."""
        query = "SELECT status, count(*) FROM designs JOIN results USING (key) GROUP BY status"
        return {"ok": 0, "refused": 0, "failed": 0} | dict(self._all(query))

    def rows(self) -> Iterator[tuple[int, tuple[Value, ...], bytes, Row]]:
        """Yield number, values, key and row of every design with a row, by number. Raises ``InputError`` if damaged."""
        with _store_errors(self.folder), _intact(self.folder):
            fault = integrity.fault_of_whole(self._connection)
            for row in self._connection.execute("SELECT * FROM results WHERE key NOT IN (SELECT key FROM designs)"):
                integrity.opened(row)  # a row with a damaged key belongs to no design: check it too
        if fault:
            raise _damaged(self.folder, fault)
        width = len(integrity.TABLES["designs"]) + 1
        query = "SELECT designs.*, results.* FROM designs LEFT JOIN results ON results.key = designs.key ORDER BY number"
        for found in self._connection.execute(query):
            with _intact(self.folder):
                number, text, key = integrity.opened(found[:width])
                values = integrity.inputs(text)
                answer = integrity.opened(found[width:])[1:] if found[width] is not None else ()
            if answer:
                yield number, values, key, dict(zip(COLUMNS, answer, strict=True))

    def _all(self, query: str) -> list[Any]:
        with _store_errors(self.folder):
            return self._connection.execute(query).fetchall()

    @contextmanager
    def _written(self) -> Iterator[sqlite3.Connection]:
        """Open a transaction that is committed at the end, or rolled back on any exception."""
        self.check_place()
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
    """Open the store of a folder for writing; create both if needed; lock out other writers.

    A damaged store is kept under another name and replaced by one with its sound rows.

    Raises:
        InputError: another process is writing, the store has another format, or its schema is damaged.
        StoreError: the store cannot be read or written.
        OSError: the folder cannot be created.
    """
    folder.mkdir(parents=True, exist_ok=True)
    existed = (folder / NAME).exists()
    with _alone(folder), _store_errors(folder):
        connection = sqlite3.connect(folder / NAME, isolation_level=None, timeout=30)
        try:
            for pragma in ("journal_mode = WAL", "synchronous = FULL", "fullfsync = 1", "checkpoint_fullfsync = 1"):
                connection.execute(f"PRAGMA {pragma}")
            mended = _mended(folder, connection) if _check_format(folder, connection) else _made(connection, existed)
            _flush(folder)
            yield Store(folder, connection, mended)
        finally:
            connection.close()


@contextmanager
def reading(folder: Path) -> Iterator[Store]:
    """Open the store of a folder for reading, also while a sweep writes.

    Raises:
        InputError: there is no store, or it has another format.
        StoreError: the store cannot be read.
    """
    if not (folder / NAME).is_file():
        raise InputError("folder", str(folder), "a folder that a sweep was written to")
    with _store_errors(folder):
        connection = sqlite3.connect(folder / NAME, isolation_level=None, timeout=30)
        try:
            connection.execute("PRAGMA query_only = 1")
            connection.execute("BEGIN")  # all reads see the same state
            if not _check_format(folder, connection):
                raise InputError("folder", str(folder), "a folder of a sweep that has begun")
            yield Store(folder, connection)
        finally:
            connection.close()


@contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """Lock a folder until the process ends, also by ``kill -9``: SQLite's own lock on a second file."""
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
    """Turn an error of reading damaged data into ``InputError``."""
    try:
        yield
    except (ValueError, TypeError):
        raise _damaged(folder, "it holds what no sweep has written") from None


def _damaged(folder: Path, why: object) -> InputError:
    return InputError("folder", str(folder), f"a folder whose {NAME} is whole ({why}); move it away to begin anew")


@contextmanager
def _store_errors(folder: Path) -> Iterator[None]:
    """Turn errors of SQLite into ``InputError`` for damage, ``StoreError`` otherwise."""
    try:
        yield
    except UnicodeDecodeError as fault:  # raised by an error message of SQLite about damaged tables
        raise _damaged(folder, fault.reason) from None
    except sqlite3.Error as fault:
        if _is_damage(fault):
            raise _damaged(folder, fault) from None
        safe = "; all rows committed before are kept" if isinstance(fault, sqlite3.OperationalError) else ""
        remedy = "; free space and start again" if fault.sqlite_errorname in _NO_ROOM else ""
        raise StoreError(f"{folder / NAME}: {fault}{safe}{remedy}") from None


def _check_format(folder: Path, connection: sqlite3.Connection) -> int:
    """Return the format of a store, 0 if it has no tables yet.

    Raises:
        InputError: another program wrote the file, or its schema is damaged.
    """
    version = int(connection.execute("PRAGMA user_version").fetchone()[0])
    if version not in (0, integrity.FORMAT):
        raise InputError("folder", str(folder), f"a folder whose store is of format {integrity.FORMAT}, not {Words(version)}")
    if fault := integrity.fault_of_schema(connection, version):
        raise _damaged(folder, fault)
    return version


def _made(connection: sqlite3.Connection, existed: bool) -> str:
    """Create the tables of a store; return a note if an empty file existed."""
    connection.executescript(integrity.CREATE)
    return f"{NAME} was empty: all designs are evaluated" if existed else ""


def _mended(folder: Path, connection: sqlite3.Connection) -> str:
    """Replace a damaged store by its sound rows and return a note; return an empty text if it is undamaged."""
    fault = _fault(connection)
    if not fault:
        return ""
    connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    with written_whole(folder / DAMAGED) as draft:
        shutil.copyfile(folder / NAME, draft)
    count = integrity.saved(connection)
    if again := _fault(connection):
        raise _damaged(folder, again)
    return f"{NAME} was damaged ({fault}) and is now {DAMAGED}: {count} whole rows are kept, the others are evaluated again"


def _fault(connection: sqlite3.Connection) -> str:
    """Return what is damaged in a store whose schema is right; an empty text if nothing is."""
    try:
        return integrity.fault_of_whole(connection) or integrity.fault_of_rows(connection)
    except (sqlite3.Error, UnicodeDecodeError, ValueError, TypeError) as fault:
        if isinstance(fault, sqlite3.Error) and not _is_damage(fault):
            raise
        return " ".join(str(fault).split())


def _is_damage(fault: sqlite3.Error) -> bool:
    """Return whether an error means a damaged file; Python's own decoding errors have no SQLite name and count as damage."""
    return getattr(fault, "sqlite_errorname", "SQLITE_CORRUPT").startswith(_DAMAGE)


def _place(folder: Path) -> tuple[int, int] | None:
    """Return device and inode of the store's file; None if there is none."""
    try:
        found = (folder / NAME).stat()
    except OSError:
        return None
    return found.st_dev, found.st_ino


def _flush(folder: Path) -> None:
    """Sync the folder to disk, so that the file's name survives a power loss too."""
    if os.name != "nt":  # Windows cannot open folders
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
