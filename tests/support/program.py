"""The program as a user runs it: in this process, which saves its start-up, or started as a command."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

import pytest

from geometry.common.cached_arrays import CACHE_VARIABLE
from probe_design.commands.main import main

Ended = subprocess.CompletedProcess[str]


def run(*arguments: str | Path, cwd: Path | None = None) -> Ended:
    """Run the program in this process, without a terminal and with every warning an error.

    Standard output and error are taken where the operating system has them, so that what libraries in C print is there too.
    """
    words = ["probe-design", *map(str, arguments)]
    with pytest.MonkeyPatch.context() as patch, warnings.catch_warnings(), _streams(patch) as (output, errors):
        warnings.simplefilter("error")
        patch.setattr(sys, "argv", words)
        patch.chdir(cwd or Path.cwd())
        before_run = _state()
        with pytest.raises(SystemExit) as ended:
            main()
        assert _state() == before_run, "the program changed the process that it ran in"
    return Ended(words, int(ended.value.code or 0), _text(output), _text(errors))


def started(*arguments: str | Path, cwd: Path | None = None) -> Ended:
    """Run the program in a process of its own, without a terminal and with every warning an error."""
    command = [sys.executable, "-W", "error", "-m", "probe_design", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, stdin=subprocess.DEVNULL, cwd=cwd, timeout=250)


INSIDE = (
    "import importlib, os, sys; from probe_design.__main__ import main; importlib.import_module(sys.argv.pop(1)); "
    "os.close(int(sys.argv.pop(1))); main()"
)


def begun(module: str, *arguments: str | Path) -> subprocess.Popen[str]:
    """Start the program in a process of its own, and wait until it has imported the module that does the work.

    However slow the machine is, what a signal then interrupts is that work.
    """
    waiting, inside = os.pipe()
    command = [sys.executable, "-c", INSIDE, module, str(inside), *map(str, arguments)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, pass_fds=[inside])
    os.close(inside)
    os.read(waiting, 1)  # returns when the other end is closed
    os.close(waiting)
    return process


def refused(*arguments: str | Path) -> str:
    """Return the one line of a refusal."""
    ended = run(*arguments)
    assert ended.returncode == 2, ended.stderr
    assert ended.stdout == ""
    assert ended.stderr.count("\n") == 1
    return ended.stderr


@contextmanager
def _streams(patch: pytest.MonkeyPatch) -> Iterator[tuple[IO[bytes], IO[bytes]]]:
    """Let files stand in for standard output and error, to be read afterwards, and nothing for standard input."""
    output, errors = tempfile.TemporaryFile(), tempfile.TemporaryFile()  # noqa: SIM115 - closed by _text
    with open(os.devnull) as nothing, _redirected(patch, 1, "stdout", output), _redirected(patch, 2, "stderr", errors):
        patch.setattr(sys, "stdin", nothing)
        yield output, errors


@contextmanager
def _redirected(patch: pytest.MonkeyPatch, number: int, name: str, file: IO[bytes]) -> Iterator[None]:
    """Point a descriptor, and the stream of its name, to a file."""
    getattr(sys, name).flush()
    kept = os.dup(number)
    os.dup2(file.fileno(), number)
    try:
        with open(number, "w", encoding="utf-8", closefd=False) as stream:
            patch.setattr(sys, name, stream)
            yield
    finally:
        os.dup2(kept, number)
        os.close(kept)


def _text(file: IO[bytes]) -> str:
    with file:
        file.seek(0)
        return file.read().decode()


def _state() -> tuple[object, ...]:
    """What a program that runs inside another has to leave as it was."""
    return Path.cwd(), signal.getsignal(signal.SIGINT), os.environ.get(CACHE_VARIABLE), sys.stdin, sys.stdout, sys.stderr
