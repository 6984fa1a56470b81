"""Sweeps for tests: small ones, as commands, and what they stored."""

from __future__ import annotations

import json
import sqlite3
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from probe_design.sweeps.rows import ROW_COLUMNS
from probe_design.sweeps.store import open_for_reading
from tests.support.paths import ROOT, SCENE

GAP = {"from": "0.05 mm", "to": "0.2 mm"}
DEPTH = {"from": "6 mm", "to": "12 mm"}

VARIABLE = {"name": "probe.gap", "unit": "m", "shown": "mm", "values": [1e-4, 2e-4], "log": False}


def make_table(designs: int) -> dict[str, Any]:
    """The request of a sweep of one variable, as its store records it."""
    return {
        "names": ["probe.gap"], "variables": [VARIABLE], "designs": designs, "digest": "ab", "sample": {"kind": "grid"},
        "constraints": [], "evaluator": "closed-form", "accuracy": 0.01, "version": "1", "base": {},
    }  # fmt: skip


def grid(gaps: int, depths: int) -> dict[str, Any]:
    variables = {"probe.gap": GAP | {"points": gaps}, "inclusion.depth": DEPTH | {"points": depths}}
    return {"scene": str(SCENE), "evaluator": "closed-form", "variables": variables}


def toml(folder: Path, text: str = "", n: int = 300) -> Path:
    """A sweep file of ``n`` cheap designs."""
    path = folder / "sweep.toml"
    path.write_text(
        f'scene = {json.dumps(str(SCENE))}\nevaluator = "closed-form"\n{text}\n[sample]\n'
        f'kind = "latin-hypercube"\nn = {n}\nseed = 3\n'
        '[variables."probe.gap"]\nfrom = "0.05 mm"\nto = "0.2 mm"\nscale = "log"\n'
        '[variables."inclusion[0].depth"]\nfrom = "3.5 mm"\nto = "12 mm"\n'  # the tumour's radius is 4 mm: some are refused
    )
    return path


def command(*arguments: str | Path) -> list[str]:
    return [sys.executable, "-W", "error", "-m", "probe_design", "sweep", *map(str, arguments)]


def run(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command(*arguments), capture_output=True, text=True, stdin=subprocess.DEVNULL, cwd=ROOT, timeout=100)


def stored(folder: Path) -> list[tuple[Any, ...]]:
    """Every column of every row but the times."""
    with open_for_reading(folder) as store:
        return [
            (number, inputs, key, *(row[name] for name in ROW_COLUMNS if name != "seconds"))
            for number, inputs, key, row in store.iterate_rows()
        ]


def count(folder: Path) -> int:
    if not (folder / "sweep.sqlite").exists():
        return 0
    connection = sqlite3.connect(folder / "sweep.sqlite", timeout=30)
    try:
        return int(connection.execute("SELECT count(*) FROM results").fetchone()[0])
    except sqlite3.OperationalError:  # no tables yet
        return 0
    finally:
        connection.close()


def wait_for_rows(folder: Path, wanted: int, process: subprocess.Popen[Any]) -> None:
    while count(folder) < wanted and process.poll() is None:
        time.sleep(0.01)
