"""Serve the pages of `explore`, and open them in a real Chromium."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from tests.support.browser import NAMES
from tests.support.paths import ROOT

PATIENCE_MS = 60_000  # for a busy machine

LEFT_OUT = "probe-design: a message of a page is left out"  # of malformed messages


@contextmanager
def serve_pages(*words: str, prefix: Sequence[str] = ()) -> Iterator[tuple[str, int]]:
    """Yield the address that the command prints first, and its process; afterwards Ctrl-C ends it cleanly."""
    command = [*prefix, sys.executable, "-m", "probe_design", "explore", *words, "--no-browser"]
    pipes: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True, "start_new_session": True}
    with subprocess.Popen(command, cwd=ROOT, env={**os.environ, "PYTHONPATH": str(ROOT)}, **pipes) as server:
        assert server.stdout is not None
        try:
            yield server.stdout.readline().strip(), server.pid
        finally:
            os.killpg(server.pid, signal.SIGINT)
            _, errors = server.communicate(timeout=60)
    assert server.returncode == 0
    assert [line for line in errors.splitlines() if not line.startswith(LEFT_OUT)] == []


@contextmanager
def open_browser() -> Iterator[Any]:
    """Yield headless Chromium; skip without it."""
    sync_api = pytest.importorskip("playwright.sync_api")
    program = next((path for name in NAMES if (path := shutil.which(name))), None)
    if program is None:
        pytest.skip("no Chromium")
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=["--no-sandbox"])
        yield browser
        browser.close()


def kill_worker(server: int) -> None:
    """Kill the worker processes of a server, and wait until they have ended (Linux)."""
    children = Path(f"/proc/{server}/task/{server}/children").read_text().split()
    assert children
    for process in map(int, children):
        os.kill(process, signal.SIGKILL)
        status = Path(f"/proc/{process}/status")
        while status.exists() and "(zombie)" not in status.read_text():
            time.sleep(0.01)
