"""The rows of a sweep on disk: one SQLite file in which a committed row stays, whatever happens next.

SQLite, for it is part of Python, one file, and says what it promises: with a write-ahead log and ``synchronous = FULL`` a commit
returns when the log is on the disk (fsync), so that ``kill -9`` and power loss cost what was not committed and nothing else; a
commit that finds the disk full is rolled back whole (https://www.sqlite.org/wal.html, https://www.sqlite.org/atomiccommit.html).
Whether the file is still what was written ``integrity`` tells.
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
_DAMAGE = ("SQLITE_CORRUPT", "SQLITE_NOTADB", "SQLITE_ERROR")  # the last of a file of an unknown format: our queries are right
_NO_ROOM = ("SQLITE_FULL", "SQLITE_IOERR_SHMSIZE")


class StoreError(ProbeError):
    """The store could not be read or written; what was committed before is kept."""


class Store:
    """The store of one folder; of rows that are written, none is ever changed, and none goes unless it is asked for anew.

    Attributes:
        folder: where it is.
        mended: what was wrong with it and what became of that, a line; empty where nothing was.
    """

    def __init__(self, folder: Path, connection: sqlite3.Connection, mended: str = "") -> None:
        self.folder, self._connection, self.mended = folder, connection, mended
        self._place = _place(folder)

    def about(self) -> dict[str, Any]:
        """Return what the sweep was asked; empty before it began. Raises ``InputError`` where it is damaged."""
        rows = self._all("SELECT * FROM about")
        with _intact(self.folder):
            return integrity.about(rows)

    def begin(self, about: Mapping[str, Any], designs: Sequence[tuple[int, tuple[Value, ...], bytes]]) -> None:
        """Note which designs the sweep has, in place of those of another sweep in this folder; its rows stay."""
        with self._written() as connection:
            connection.execute("DELETE FROM about")
            connection.execute("DELETE FROM designs")
            connection.executemany(insertion("about"), [sealed(name, json.dumps(value)) for name, value in about.items()])
            rows = (sealed(number, json.dumps(values), key) for number, values, key in designs)
            connection.executemany(insertion("designs"), rows)

    def missing(self) -> list[tuple[int, tuple[Value, ...], bytes]]:
        """Return of the designs without a row how many are the same, their values and their key."""
        query = (
            "SELECT count(*), inputs, key FROM designs WHERE NOT EXISTS"
            " (SELECT 1 FROM results WHERE results.key = designs.key) GROUP BY key ORDER BY min(number)"
        )
        found = self._all(query)
        with _intact(self.folder):
            return [(count, integrity.inputs(text), key) for count, text, key in found]

    def add(self, rows: Sequence[tuple[bytes, Row]]) -> int:
        """Commit rows; one whose key is there already is left as it is. Returns how many were new."""
        before = self._connection.total_changes
        with self._written() as connection:
            connection.executemany(insertion("results"), [sealed_result(key, row) for key, row in rows])
        return self._connection.total_changes - before

    def forget(self, status: str) -> int:
        """Take away the rows of this sweep's designs with a status, so that they are missing again; returns how many."""
        with self._written() as connection:
            query = "DELETE FROM results WHERE status = ? AND key IN (SELECT key FROM designs)"
            return connection.execute(query, (status,)).rowcount

    def forget_limited(self, limits: Limits) -> int:
        """Take away the rows of this sweep's designs that name a limit which is larger now, see ``rows.LIMITS``; how many."""
        with self._written() as connection:
            query = "DELETE FROM results WHERE (time_limit < ? OR memory_limit < ?) AND key IN (SELECT key FROM designs)"
            return connection.execute(query, (limits.seconds, limits.memory)).rowcount

    def check_place(self) -> None:
        """Make sure that the file is where it was opened: what is written to one that is gone is lost.

        Raises:
            StoreError: it is gone, or another one is there.
        """
        if _place(self.folder) != self._place:
            raise StoreError(f"{self.folder / NAME}: moved or deleted during the sweep, and with it the rows committed before")

    def counts(self) -> dict[str, int]:
        """Return how many designs have a row, by its status."""
        query = "SELECT status, count(*) FROM designs JOIN results USING (key) GROUP BY status"
        return {"ok": 0, "refused": 0, "failed": 0} | dict(self._all(query))

    def rows(self) -> Iterator[tuple[int, tuple[Value, ...], bytes, Row]]:
        """Yield number, values, key and row of every design that has one, by number. Raises ``InputError`` if damaged."""
        with _store_errors(self.folder), _intact(self.folder):
            fault = integrity.fault_of_whole(self._connection)
            for row in self._connection.execute("SELECT * FROM results WHERE key NOT IN (SELECT key FROM designs)"):
                integrity.opened(row)  # one whose key is damaged is no design's
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
    """Open the store of a folder for writing, making both if needed; no other process can meanwhile.

    One that is damaged is written anew from its rows that are whole, and kept under another name.

    Raises:
        InputError: another process is writing, or the store is of another format, or damaged where its tables are named.
        StoreError: the store cannot be read or written.
        OSError: the folder cannot be made.
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
        InputError: there is none, or one of another format.
        StoreError: it cannot be read.
    """
    if not (folder / NAME).is_file():
        raise InputError("folder", str(folder), "a folder that a sweep was written to")
    with _store_errors(folder):
        connection = sqlite3.connect(folder / NAME, isolation_level=None, timeout=30)
        try:
            connection.execute("PRAGMA query_only = 1")
            connection.execute("BEGIN")  # all that is read is of one moment
            if not _check_format(folder, connection):
                raise InputError("folder", str(folder), "a folder of a sweep that has begun")
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
        if _is_damage(fault):
            raise _damaged(folder, fault) from None
        safe = "; all rows committed before are kept" if isinstance(fault, sqlite3.OperationalError) else ""
        remedy = "; free space and start again" if fault.sqlite_errorname in _NO_ROOM else ""
        raise StoreError(f"{folder / NAME}: {fault}{safe}{remedy}") from None


def _check_format(folder: Path, connection: sqlite3.Connection) -> int:
    """Return the format of a store, 0 of one without tables.

    Raises:
        InputError: it is another program's, or its tables are not as they were made.
    """
    version = int(connection.execute("PRAGMA user_version").fetchone()[0])
    if version not in (0, integrity.FORMAT):
        raise InputError("folder", str(folder), f"a folder whose store is of format {integrity.FORMAT}, not {Words(version)}")
    if fault := integrity.fault_of_schema(connection, version):
        raise _damaged(folder, fault)
    return version


def _made(connection: sqlite3.Connection, existed: bool) -> str:
    """Make the tables of a store; say so where a file without any was there."""
    connection.executescript(integrity.CREATE)
    return f"{NAME} was empty: all designs are answered" if existed else ""


def _mended(folder: Path, connection: sqlite3.Connection) -> str:
    """Write what is whole of a damaged store in its place; say so, or nothing where it is whole."""
    fault = _fault(connection)
    if not fault:
        return ""
    connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    with written_whole(folder / DAMAGED) as draft:
        shutil.copyfile(folder / NAME, draft)
    count = integrity.saved(connection)
    if again := _fault(connection):
        raise _damaged(folder, again)
    return f"{NAME} was damaged ({fault}) and is now {DAMAGED}: {count} whole rows are kept, the others answered again"


def _fault(connection: sqlite3.Connection) -> str:
    """Say what is damaged in a store whose tables are as they were made; nothing if nothing is."""
    try:
        return integrity.fault_of_whole(connection) or integrity.fault_of_rows(connection)
    except (sqlite3.Error, UnicodeDecodeError, ValueError, TypeError) as fault:
        if isinstance(fault, sqlite3.Error) and not _is_damage(fault):
            raise
        return " ".join(str(fault).split())


def _is_damage(fault: sqlite3.Error) -> bool:
    """Whether SQLite found something wrong in the file; of what it cannot decode Python complains, without SQLite's name."""
    return getattr(fault, "sqlite_errorname", "SQLITE_CORRUPT").startswith(_DAMAGE)


def _place(folder: Path) -> tuple[int, int] | None:
    """Which file is the store's now; None where there is none."""
    try:
        found = (folder / NAME).stat()
    except OSError:
        return None
    return found.st_dev, found.st_ino


def _flush(folder: Path) -> None:
    """Make the file's name durable too."""
    if os.name != "nt":  # Windows opens no folders
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
