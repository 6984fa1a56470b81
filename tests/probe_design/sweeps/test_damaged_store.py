"""A store that is damaged, in SQLite's own pages or in what they hold: readers refuse it in one line, its sweep mends it."""

from __future__ import annotations

import random
import shutil
import sqlite3
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from geometry import InputError
from geometry.processes.executor import Outcome
from probe_design import sweep
from probe_design.sweeps.progress import Progress
from probe_design.sweeps.results import iterate_rows, read_request
from probe_design.sweeps.rows import Job, build_row_without_result
from probe_design.sweeps.store import DAMAGED_FILE, STORE_FILE, StoreError, open_for_writing
from tests.support.slow import slow_unless
from tests.support.sweeps import grid, make_table, run, stored, toml


@pytest.fixture
def store(tmp_path: Path) -> Path:
    designs = [(k, (1e-4 * k,), k.to_bytes(8)) for k in range(40)]
    with open_for_writing(tmp_path) as open_store:
        open_store.begin(make_table(40), designs)
        open_store.add([(key, build_row_without_result("failed", "SolveError", "a reason", 0.1)) for _, _, key in designs])
    return tmp_path


def read(folder: Path) -> int:
    return len(read_request(folder)) + len(list(iterate_rows(folder)))


def test_what_is_whole_is_read(store: Path) -> None:
    assert read_request(store) == make_table(40)
    assert [row["probe.gap"] for row in iterate_rows(store)] == [1e-4 * k for k in range(40)]


@pytest.mark.parametrize(
    "query",
    [
        "UPDATE request SET content = '['",
        "UPDATE request SET content = '5'",
        "DELETE FROM request",
        "UPDATE request SET content = '[[[' || content",
        "UPDATE request SET content = CAST(x'ff' AS TEXT)",
        "UPDATE designs SET inputs = '{}' WHERE number = 7",
        "UPDATE designs SET inputs = '[null]' WHERE number = 7",
        "UPDATE designs SET inputs = x'ff' WHERE number = 7",
        "UPDATE designs SET inputs = printf('%.*c', 5000, '[') WHERE number = 7",
    ],
)
def test_texts_that_no_sweep_has_written(store: Path, query: str) -> None:
    connection = sqlite3.connect(store / STORE_FILE)
    with connection:
        connection.execute(query)
    connection.close()
    with pytest.raises(InputError, match=r"^folder = .*: allowed: a folder whose sweep\.sqlite is whole \(.*\); move it away"):
        read(store)


def test_flipped_and_missing_bytes(store: Path) -> None:
    content, random = (store / STORE_FILE).read_bytes(), np.random.default_rng(0)
    refused = []
    for k in range(150):
        damaged = np.frombuffer(content[: random.integers(1, len(content)) if k % 5 == 0 else None], np.uint8).copy()
        damaged[random.integers(len(damaged), size=30)] ^= np.uint8(random.integers(1, 256))
        (store / STORE_FILE).write_bytes(damaged.tobytes())
        try:
            read(store)
        except (InputError, StoreError) as fault:
            refused.append(str(fault))
    assert len(refused) > 20
    assert not any("\n" in line for line in refused)


def changed(folder: Path, *queries: str) -> None:
    """Change rows behind the program's back, as a flipped bit would: every page stays what SQLite expects."""
    connection = sqlite3.connect(folder / STORE_FILE)
    with connection:
        for query in queries:
            connection.execute(query)
    connection.close()


@pytest.mark.parametrize(
    "query",
    slow_unless(
        lambda query: "ratio" in query,
        [
            "UPDATE results SET ratio = ratio * (1 + 1e-15) WHERE ratio > 0",
            "UPDATE results SET status = 'refused' WHERE status = 'ok'",
            "UPDATE results SET key = x'00' WHERE key = (SELECT min(key) FROM results)",
            "UPDATE designs SET inputs = '[0.0002, 0.0061]' WHERE number = 1",
            "UPDATE designs SET key = x'00' WHERE number = 1",
            "DELETE FROM designs WHERE number = 1",
            "UPDATE request SET content = replace(content, '0.01', '0.02')",
        ],
    ),
)
def test_what_was_changed_is_answered_again_and_that_is_said(query: str, swept: Path, tmp_path: Path) -> None:
    shutil.copytree(swept, tmp_path, dirs_exist_ok=True)
    changed(tmp_path, query)
    with pytest.raises(InputError, match=r"folder = .* is whole \(.*\); move it away"):
        read(tmp_path)
    messages: list[str] = []
    sweep(grid(2, 2), tmp_path, workers=1, notice=messages.append)
    assert stored(tmp_path) == stored(swept)
    assert [line.startswith("sweep.sqlite was damaged (") for line in messages] == [True]
    assert messages[0] in (tmp_path / "sweep.log").read_text()
    assert (tmp_path / DAMAGED_FILE).exists()


@pytest.fixture(scope="module")
def swept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("swept")
    sweep(grid(2, 2), folder, workers=1)
    return folder


class InProcessCrew:
    """An executor in this process, which starts at once."""

    def __init__(self, job: Job, *_: object) -> None:
        self._job, self._given, self._number = job, list[Any](), 0

    def count_free(self) -> int:
        return 1 - len(self._given)

    def count_workers(self) -> int:
        return 1

    def submit(self, designs: Any) -> int:
        self._given.append(designs)
        self._number += 1
        return self._number

    def collect(self, _: float) -> list[tuple[int, Outcome[Any]]]:
        (designs,), self._given = self._given, []
        row_list = [row for rows in self._job.evaluate_parts(designs) for row in rows]
        return [(self._number, Outcome(tuple(row_list)))]

    def close(self) -> None:
        self._given.clear()


def flipped(content: bytearray, chance: random.Random) -> None:
    content[chance.randrange(len(content))] ^= 1 << chance.randrange(8)


def cut(content: bytearray, chance: random.Random) -> None:
    del content[chance.choice((0, -2048, chance.randrange(len(content)))) :]


def zeroed(content: bytearray, chance: random.Random) -> None:
    position = chance.randrange(len(content) // 512) * 512
    content[position : position + 512] = bytes(512)


@pytest.mark.slow
@pytest.mark.parametrize(("damage", "tries"), [(flipped, 80), (cut, 25), (zeroed, 25)])
def test_the_table_is_right_or_the_store_refused(
    damage: Callable[[bytearray, random.Random], None], tries: int, whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a sweep of 300 designs: bits anywhere in the file, its end, a sector."""
    monkeypatch.setattr("probe_design.sweeps.run.LocalExecutor", InProcessCrew)
    path, known, chance = toml(tmp_path), stored(whole), random.Random(25)
    outcomes = [report_after(damage, path, whole, tmp_path / str(k), known, chance) for k in range(tries)]
    assert set(outcomes) <= {"the same", "mended", "refused"}
    assert len(set(outcomes)) > 1


def report_after(
    damage: Callable[[bytearray, random.Random], None], path: Path, whole: Path, folder: Path, known: list[object],
    chance: random.Random,
) -> str:  # fmt: skip
    """What becomes of a damaged store that is read, swept and read again."""
    folder.mkdir()
    content = bytearray((whole / STORE_FILE).read_bytes())
    damage(content, chance)
    (folder / STORE_FILE).write_bytes(content)
    unnoticed, messages = refusal(lambda: check(folder, known)) == "", []
    refused = refusal(lambda: sweep(path, folder, workers=1, notice=messages.append))
    if refused:
        assert "\n" not in refused
        return "refused"
    check(folder, known)
    assert bool(messages) != unnoticed
    shutil.rmtree(folder)
    return "mended" if messages else "the same"


def check(folder: Path, known: list[object]) -> None:
    assert stored(folder) == known


def refusal(call: Callable[[], object]) -> str:
    try:
        call()
    except InputError as fault:
        return str(fault)
    return ""


def test_the_write_ahead_file_holds_rows_up_to_the_first_flipped_bit(tmp_path: Path) -> None:
    """As a killed sweep leaves it: of ten commits the first ones are there, and no row is another."""
    designs = [(k, (1e-4 * k,), k.to_bytes(8)) for k in range(10)]
    with open_for_writing(tmp_path) as running:
        running.begin(make_table(10), designs)
        for _, _, key in designs:
            running.add([(key, build_row_without_result("failed", "SolveError", f"of {key!r}", 0.1))])
        main, log, known = (tmp_path / STORE_FILE).read_bytes(), (tmp_path / f"{STORE_FILE}-wal").read_bytes(), stored(tmp_path)
    chance, counts = random.Random(5), []
    for _ in range(30):
        content = bytearray(log)
        flipped(content, chance)
        (tmp_path / STORE_FILE).write_bytes(main)
        (tmp_path / f"{STORE_FILE}-wal").write_bytes(content)
        with open_for_writing(tmp_path) as store:
            counts.append(store.count_rows()["failed"])
        if counts[-1]:
            assert stored(tmp_path) == known[: counts[-1]]
    assert len(known) == 10
    assert len(set(counts)) > 5


@pytest.mark.slow
def test_the_terminal_says_what_was_mended(swept: Path, tmp_path: Path) -> None:
    path = toml(tmp_path, n=2)
    sweep(path, tmp_path / "out", workers=1)
    changed(tmp_path / "out", "UPDATE results SET stiffness = 1.0")
    ended = run(path, "-o", tmp_path / "out")
    assert ended.returncode == 0, ended.stderr
    assert "probe-design: sweep.sqlite was damaged (a row of results is not what was written)" in ended.stderr
    assert "2 evaluated now" in ended.stdout


@pytest.mark.parametrize("gone", slow_unless("moved".__eq__, ["moved", "deleted", "replaced"]))
def test_a_folder_that_goes_ends_the_sweep(gone: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("probe_design.sweeps.batches.BATCH_TIME_S", 1e-9)  # each design is a batch
    folder, elsewhere, gone_with = tmp_path / "out", tmp_path / "elsewhere", []

    def go(state: Progress) -> None:
        assert not gone_with  # nothing is reported after
        if state.done:
            gone_with.append(state.done)
            folder.rename(elsewhere)
            if gone == "deleted":
                shutil.rmtree(elsewhere)
            if gone == "replaced":
                shutil.copytree(elsewhere, folder)

    with pytest.raises(StoreError, match=r"sweep\.sqlite: moved or deleted during the sweep"):
        sweep(grid(10, 10), folder, workers=1, progress=go)
    assert gone_with < [100]
    if gone == "moved":
        assert [len(list(iterate_rows(elsewhere)))] == gone_with
