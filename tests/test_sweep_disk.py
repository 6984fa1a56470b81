"""Full disks: one line, exit code 1, an intact store; with room again the sweep goes on."""

from __future__ import annotations

import shlex
import shutil
import sqlite3
import subprocess
from pathlib import Path

import pytest
from sweeps import ROOT, command, run, stored, toml

from probe_design import sweep


@pytest.mark.parametrize("room", [30_000, 100_000])
def test_files_that_may_not_grow(room: int, whole: Path, tmp_path: Path) -> None:
    """Beyond ``room`` bytes: the designs do not fit, or the rows do not."""
    import resource  # not on Windows

    ended = run(
        toml(tmp_path), "-o", tmp_path / "out", preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (room, room))
    )
    check_kept(ended, tmp_path / "out", whole)


@pytest.mark.parametrize("size", [32, 90])
def test_a_file_system_without_room(size: int, whole: Path, tmp_path: Path) -> None:
    """A real one, of ``size`` kB: the index of the store's log does not fit, or the rows do not."""
    disk = tmp_path / "disk"
    disk.mkdir()
    mount = f"mount -t tmpfs -o size={size}k none {disk}"
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
