"""Full disks: one line, exit code 1, an intact store; with room again the sweep goes on."""

from __future__ import annotations

import shlex
import shutil
import sqlite3
import subprocess
import sys
from pathlib import Path

import pytest

from probe_design import sweep
from tests.support.paths import ROOT
from tests.support.sweeps import command, stored, toml

LIMITED = """
import os, resource, sys  # not on Windows
resource.setrlimit(resource.RLIMIT_FSIZE, (30_000, 30_000))
os.execv(sys.argv[1], sys.argv[1:])
"""


def test_files_that_may_not_grow(whole: Path, tmp_path: Path) -> None:
    """The designs do not fit."""
    swept = [sys.executable, "-c", LIMITED, *command(toml(tmp_path), "-o", tmp_path / "out")]
    ended = subprocess.run(swept, capture_output=True, text=True, cwd=ROOT, timeout=100)
    check_kept(ended, tmp_path / "out", whole)


def test_a_file_system_without_room(whole: Path, tmp_path: Path) -> None:
    """A real one: the rows do not fit."""
    disk = tmp_path / "disk"
    disk.mkdir()
    mount = f"mount -t tmpfs -o size=90k none {disk}"
    if shutil.which("unshare") is None or subprocess.run(["unshare", "-rm", *mount.split()], capture_output=True).returncode:
        pytest.skip("this system lets nobody mount")
    swept = f"{shlex.join(command(toml(tmp_path), '-o', disk / 'out'))}; code=$?"
    script = f"{mount} && {swept}; cp -r {disk}/out {tmp_path}/out; exit $code"  # the disk goes with its namespace
    ended = subprocess.run(["unshare", "-rm", "sh", "-c", script], capture_output=True, text=True, cwd=ROOT, timeout=100)
    assert "free space and start again" in ended.stderr
    check_kept(ended, tmp_path / "out", whole)


def check_kept(ended: subprocess.CompletedProcess[str], folder: Path, whole: Path) -> None:
    assert (ended.returncode, "Traceback" in ended.stderr) == (1, False)
    assert "all rows committed before are kept" in ended.stderr.splitlines()[-1]
    connection = sqlite3.connect(folder / "sweep.sqlite")
    assert connection.execute("PRAGMA integrity_check").fetchone() == ("ok",)
    connection.close()
    sweep(toml(folder.parent), folder)
    assert stored(folder) == stored(whole)
