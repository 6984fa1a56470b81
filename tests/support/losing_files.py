"""A file system for SQLite that notes every write and sync, and what is left of its files when power is lost.

What was synced is on the disk. Of what was written since, each sector is there or not, by chance and in any order, and so are
changes of a file's length; files that were removed may be back until their folder is synced.
"""

from __future__ import annotations

import random
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import apsw

SECTOR = 512


@dataclass(frozen=True)
class Event:
    """``kind`` write, truncate, sync or delete of a file, folder: that its names were synced; or a note of the test's own."""

    kind: str
    name: str = ""
    offset: int = 0
    data: bytes = b""


class Recorder(apsw.VFS):
    """The usual file system, with a record."""

    def __init__(self) -> None:
        self.events: list[Event] = []
        super().__init__("recorder", "")

    def xOpen(self, name: Any, flags: list[int]) -> Any:  # noqa: N802
        return _File(self.events, name, flags)

    def xDelete(self, name: str, sync: bool) -> None:  # noqa: N802
        super().xDelete(name, sync)
        self.events.append(Event("delete", Path(name).name))
        if sync:
            self.events.append(Event("folder"))


class _File(apsw.VFSFile):
    def __init__(self, events: list[Event], name: Any, flags: list[int]) -> None:
        super().__init__("", name, flags)
        self._events, self._name = events, Path(name.filename() if isinstance(name, apsw.URIFilename) else name or "").name

    def xWrite(self, data: bytes, offset: int) -> None:  # noqa: N802
        super().xWrite(data, offset)
        self._events.append(Event("write", self._name, offset, bytes(data)))

    def xTruncate(self, size: int) -> None:  # noqa: N802
        super().xTruncate(size)
        self._events.append(Event("truncate", self._name, size))

    def xSync(self, flags: int) -> None:  # noqa: N802
        super().xSync(flags)
        self._events.append(Event("sync", self._name))


class Connection:
    """As much of ``sqlite3.Connection`` as a store needs, by APSW on a recorder."""

    def __init__(self, path: Path, replaced: dict[str, str]) -> None:
        self._connection, self._replaced = apsw.Connection(str(path), vfs="recorder"), replaced

    def execute(self, query: str, values: Any = ()) -> Any:
        return self._connection.execute(self._replaced.get(query, query), values)

    def executemany(self, query: str, values: Any) -> Any:
        return self._connection.executemany(query, values)

    def executescript(self, query: str) -> None:
        self._connection.execute(query)

    @property
    def total_changes(self) -> int:
        return self._connection.total_changes()

    @property
    def in_transaction(self) -> bool:
        return self._connection.in_transaction

    def close(self) -> None:
        self._connection.close()


def left(events: list[Event], folder: Path, chance: random.Random) -> None:
    """Write to ``folder`` what is left of the files when power is lost after these events."""
    for name in {event.name for event in events if event.kind == "write"}:
        synced = {"delete": 0, "write": 0, "truncate": 0}
        for k, event in enumerate(events):
            if event.kind == "folder":
                synced["delete"] = k
            elif (event.kind, event.name) == ("sync", name):
                synced["write"] = synced["truncate"] = k
        content: bytearray | None = None
        for k, event in enumerate(events):
            if event.name == name and event.kind in synced:
                content = _damage_content(content, event, k < synced[event.kind], chance)
        if content is not None:
            (folder / name).write_bytes(content)


def _damage_content(content: bytearray | None, event: Event, synced: bool, chance: random.Random) -> bytearray | None:
    if event.kind == "delete":
        return None if synced or chance.random() < 0.5 else content
    if event.kind == "truncate" and content is not None and (synced or chance.random() < 0.5):
        return content[: event.offset] + bytes(max(0, event.offset - len(content)))
    if event.kind == "truncate":
        return content
    content = bytearray() if content is None else content
    size = len(event.data) if synced else SECTOR
    for low in range(0, len(event.data), size):
        if synced or chance.random() < 0.5:
            part, offset = event.data[low : low + size], event.offset + low
            content += bytes(max(0, offset - len(content)))
            content[offset : offset + len(part)] = part
    return content
