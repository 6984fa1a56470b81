"""A store that is damaged, in SQLite's own pages or in the texts that they hold, is refused in one line."""

from __future__ import annotations

import sqlite3
from pathlib import Path

import numpy as np
import pytest

from geometry import InputError
from probe_design.sweeps.results import about, rows
from probe_design.sweeps.rows import blank
from probe_design.sweeps.store import NAME, StoreError, writing

VARIABLE = {"name": "probe.gap", "unit": "m", "shown": "mm", "values": [1e-4, 2e-4], "log": False}
ABOUT = {
    "names": ["probe.gap"], "variables": [VARIABLE], "designs": 40, "digest": "ab", "sample": {"kind": "grid"}, "constraints": [],
    "evaluator": "closed-form", "accuracy": 0.01, "version": "1", "base": {},
}  # fmt: skip


@pytest.fixture
def store(tmp_path: Path) -> Path:
    designs = [(k, (1e-4 * k,), k.to_bytes(8)) for k in range(40)]
    with writing(tmp_path) as open_store:
        open_store.begin(ABOUT, designs)
        open_store.add([(key, blank("failed", "SolveError", "a reason", 0.1)) for _, _, key in designs])
    return tmp_path


def read(folder: Path) -> int:
    return len(about(folder)) + len(list(rows(folder)))


def test_what_is_whole_is_read(store: Path) -> None:
    assert about(store) == ABOUT
    assert [row["probe.gap"] for row in rows(store)] == [1e-4 * k for k in range(40)]


@pytest.mark.parametrize(
    "query",
    [
        "UPDATE about SET value = '[' WHERE name = 'names'",
        "UPDATE about SET value = '5' WHERE name = 'names'",
        "DELETE FROM about WHERE name = 'variables'",
        "UPDATE about SET value = '[[[' || value WHERE name = 'sample'",
        "UPDATE about SET value = CAST(x'ff' AS TEXT) WHERE name = 'digest'",
        "UPDATE designs SET inputs = '{}' WHERE number = 7",
        "UPDATE designs SET inputs = '[null]' WHERE number = 7",
        "UPDATE designs SET inputs = x'ff' WHERE number = 7",
        "UPDATE designs SET inputs = printf('%.*c', 5000, '[') WHERE number = 7",
    ],
)
def test_texts_that_no_sweep_has_written(store: Path, query: str) -> None:
    connection = sqlite3.connect(store / NAME)
    with connection:
        connection.execute(query)
    connection.close()
    with pytest.raises(InputError, match=r"^folder = .*: allowed: a folder whose sweep\.sqlite is whole \(.*\); move it away"):
        read(store)


def test_flipped_and_missing_bytes(store: Path) -> None:
    content, random = (store / NAME).read_bytes(), np.random.default_rng(0)
    refused = []
    for k in range(150):
        damaged = np.frombuffer(content[: random.integers(1, len(content)) if k % 5 == 0 else None], np.uint8).copy()
        damaged[random.integers(len(damaged), size=30)] ^= np.uint8(random.integers(1, 256))
        (store / NAME).write_bytes(damaged.tobytes())
        try:
            read(store)
        except (InputError, StoreError) as fault:
            refused.append(str(fault))
    assert len(refused) > 20
    assert not any("\n" in line for line in refused)
