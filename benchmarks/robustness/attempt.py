"""Run one robustness test: the command, how it ended, and which part of that is a failure.

The program is asked in a forked child of a process that has imported it, which saves its start, in a folder that is removed
afterwards. What it prints is taken where the operating system has it, so that what libraries in C say is there too.
"""

from __future__ import annotations

import json
import os
import resource
import signal
import sys
import time
import traceback
from collections.abc import Iterator
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path

from probe_design.commands.main import main

NEEDED_MODULES = (
    "h5py", "hw.reader", "matplotlib.figure", "probe_design.design_search.tumour_study", "probe_design.doctor.self_test",
    "probe_design.estimation.estimate", "probe_design.maps.scan", "probe_design.probe_check.check", "probe_design.sweeps.run",
    "probe_design.terminal.console", "probe_design.tolerancing.budget", "solver.closed_form.evaluator",
    "solver.contact.evaluator", "solver.equivalent_inclusion.evaluator", "solver.planning.plan",
)  # fmt: skip
EXPECTED_CODES = (0, 2, 130)  # answered, refused, interrupted
TOO_LITTLE_DATA_CODE = (
    1  # of some commands: data that are whole and say too little, such as a part of a cycle, or an answer that is no
)
SAYING_NO = ("read", "estimate", "calibrate", "check", "doctor", "rerun", "optimize")
ANSWER_SECONDS = 20.0  # s that an answer may take, --time
STARTUP_SECONDS = 40.0  # s that are no answer's: reading, planning and drawing, on a machine that is busy


@dataclass(frozen=True)
class Attempt:
    """What is asked.

    Attributes
    ----------
    words
        Of the command line, after the program's name.
    said
        What was damaged, for the list of failures.
    seconds
        After which it counts as a hang.
    held
        Limits of the process by their names in ``resource``, such as RLIMIT_DATA, bytes.
    """

    words: tuple[str, ...]
    said: str = ""
    seconds: float = ANSWER_SECONDS + STARTUP_SECONDS
    held: dict[str, int] = field(default_factory=dict)


@dataclass(frozen=True)
class Ended:
    """How the program ended: its exit code, or None where it did not end in time, less than 0 for a signal; what it printed."""

    code: int | None
    output: str
    errors: str
    seconds: float


def prepare() -> None:
    """Import what most attempts need; nothing is computed, so that no library has begun threads that a fork would lose."""
    for name in NEEDED_MODULES:
        import_module(name)


def run_attempt(attempt: Attempt, folder: Path) -> Ended:
    """Ask the program in a folder, whose files ``output`` and ``errors`` take what it prints."""
    start = time.perf_counter()
    sys.stdout.flush()
    child = os.fork()
    if child == 0:
        _run(attempt, folder)
    code = _wait_for_child(child, start + attempt.seconds)
    output, errors = ((folder / name).read_text(encoding="utf-8", errors="replace") for name in ("output", "errors"))
    return Ended(code, output, errors, time.perf_counter() - start)


def _wait_for_child(child: int, end: float) -> int | None:
    """Return the exit code of a child, which is ended with all its children if it does not end in time."""
    while time.perf_counter() < end:
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.005)
    os.killpg(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return None


def _run(attempt: Attempt, folder: Path) -> None:
    """Be the program: the child never returns."""
    code = 99
    try:
        os.setsid()
        os.chdir(folder)
        nothing = os.open(os.devnull, os.O_RDONLY)
        for name, number in (("output", 1), ("errors", 2)):
            os.dup2(os.open(name, os.O_WRONLY | os.O_CREAT), number)
        os.dup2(nothing, 0)
        for name, size in attempt.held.items():
            resource.setrlimit(getattr(resource, name), (size, size))
        sys.argv = ["probe-design", *attempt.words]
        main()
    except SystemExit as end:
        code = int(end.code or 0)
    except BaseException:  # what passes the program's last line of defence is a failure that its traceback tells
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


def failures(attempt: Attempt, ended: Ended) -> Iterator[str]:
    """Name all that went wrong; nothing where the program returned a result or refused as it should."""
    if ended.code is None:
        yield "hang"
    elif ended.code < 0:
        yield "signal"
    elif ended.code not in EXPECTED_CODES and not (ended.code == TOO_LITTLE_DATA_CODE and attempt.words[0] in SAYING_NO):
        yield "exit code"
    if "Traceback" in ended.errors or "stack backtrace" in ended.errors:
        yield "traceback"
    if "a defect of the program" in ended.errors:
        yield "defect"
    lines = ended.errors.splitlines()
    if any(not line.startswith("probe-design: ") for line in lines) or (ended.code == 2 and not lines):
        yield "stray lines"
    if "--json" in attempt.words and not _whole(ended):
        yield "JSON"


def _whole(ended: Ended) -> bool:
    """Whether an output is one JSON object without NaN or infinity, and everything else prints none."""
    if ended.code != 0 and not (ended.code == TOO_LITTLE_DATA_CODE and ended.output):
        return not ended.output
    try:
        return isinstance(json.loads(ended.output, parse_constant=_refuse_import), dict)
    except ValueError:
        return False


def _refuse_import(name: str) -> None:
    raise ValueError(name)
