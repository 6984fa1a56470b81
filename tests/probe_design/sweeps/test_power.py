"""Power loss: whatever of the unsynced writes is lost, the store is intact and has every row that was committed."""

from __future__ import annotations

import os
import random
import sqlite3
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from probe_design.sweeps import store as sweep_store
from probe_design.sweeps.rows import ROW_COLUMNS, Row, build_row_without_result
from probe_design.sweeps.store import STORE_FILE, open_for_writing
from tests.support.losing_files import Connection, Event, Recorder, left
from tests.support.sweeps import make_table

BATCHES, IN_EACH = 40, 10
CUTS = 60


def row(number: int) -> Row:
    """Rows as large as those with a long plan: the log is copied into the file several times."""
    return build_row_without_result("ok", "", "", float(number)) | {"plan": f"{number} " * 9000}


@pytest.fixture(scope="module")
def recorder() -> Recorder:
    return Recorder()


def recorded(folder: Path, recorder: Recorder, monkeypatch: pytest.MonkeyPatch, replaced: dict[str, str]) -> list[Event]:
    """All that a store wrote; after each commit a note of how many rows there are."""
    connect = sqlite3.connect

    def opened(path: Path, **options: Any) -> Any:
        return Connection(path, replaced) if Path(path).name == STORE_FILE else connect(path, **options)

    def synced(handle: int) -> None:
        recorder.events.append(Event("folder"))

    recorder.events.clear()
    monkeypatch.setattr(os, "fsync", synced)
    monkeypatch.setattr(sweep_store.sqlite3, "connect", opened)
    with open_for_writing(folder) as store:
        recorder.events.append(Event("open"))
        store.begin(
            make_table(BATCHES * IN_EACH), [(k, (float(k),), bytes([k // 256, k % 256])) for k in range(BATCHES * IN_EACH)]
        )
        recorder.events.append(Event("begun"))
        for batch in range(BATCHES):
            numbers = range(batch * IN_EACH, (batch + 1) * IN_EACH)
            store.add([(bytes([k // 256, k % 256]), row(k)) for k in numbers])
            recorder.events.append(Event("kept", offset=numbers.stop))
    monkeypatch.undo()
    return list(recorder.events)


def lost(events: list[Event], folder: Path, seed: int) -> tuple[int, int]:
    """Lose power at a random moment, start again; returns how many rows were committed and how many are there."""
    chance = random.Random(seed)
    opened = next(k for k, event in enumerate(events) if event.kind == "open")
    happened = events[: chance.randrange(opened, len(events)) + 1]
    folder.mkdir()
    left(happened, folder, chance)
    kept = max((event.offset for event in happened if event.kind == "kept"), default=0)
    with open_for_writing(folder) as store:
        (intact,) = store._connection.execute("PRAGMA integrity_check").fetchone()
        assert intact == "ok"
        rows = {number: held for number, _, _, held in store.iterate_rows()}
        assert all(held == {name: row(number)[name] for name in ROW_COLUMNS} for number, held in rows.items())
        assert sorted(rows) == list(range(len(rows)))  # whole batches, in order
        assert len(rows) % IN_EACH == 0
    return kept, len(rows)


@pytest.mark.slow
def test_committed_rows_outlive_power(tmp_path: Path, recorder: Recorder, monkeypatch: pytest.MonkeyPatch) -> None:
    events = recorded(tmp_path / "whole", recorder, monkeypatch, {})
    copied = [k for k, event in enumerate(events) if (event.kind, event.name) == ("write", STORE_FILE)]
    assert sum(b - a > 20 for a, b in pairwise(copied)) > 2  # the log was copied into the file several times
    for seed in range(CUTS):
        kept, stored = lost(events, tmp_path / str(seed), seed)
        assert kept <= stored <= kept + IN_EACH


@pytest.mark.slow
def test_without_syncs_rows_would_be_lost(tmp_path: Path, recorder: Recorder, monkeypatch: pytest.MonkeyPatch) -> None:
    """The simulation loses what is not synced: with ``synchronous = NORMAL`` commits do not wait for the disk."""
    weak = {"PRAGMA synchronous = FULL": "PRAGMA synchronous = NORMAL"}
    events = recorded(tmp_path / "whole", recorder, monkeypatch, weak)
    short = [kept - stored for kept, stored in (lost(events, tmp_path / str(seed), seed) for seed in range(20))]
    assert max(short) > IN_EACH
