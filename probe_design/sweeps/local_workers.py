"""Workers on this computer: processes, and a thread here that waits for each.

Where a process has ended another is started: what dies or takes too long takes only itself along.
"""

from __future__ import annotations

import json
import os
import queue
import signal
import subprocess
import sys
import threading
from bisect import bisect
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, replace
from itertools import accumulate
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import IO, Any

from geometry.common.resources import Limits
from probe_design.sweeps.keys import Value
from probe_design.sweeps.rows import Job, Row
from probe_design.sweeps.workers import Batch, FinishedBatch, Outcome

# libraries read these when they are loaded; MKL's bits depend on where arrays lie unless it is told otherwise
_ENVIRONMENT = {f"{one}_NUM_THREADS": "1" for one in ("OMP", "OPENBLAS", "MKL", "NUMEXPR", "VECLIB")} | {
    "MKL_CBWR": "AUTO,STRICT"
}
GRACE = 5.0  # seconds that a worker has to say by itself that its time is over, and what it was doing
STARTS = 3  # attempts, each with a process that ends before it asks for work


class LocalCrew:
    """Worker processes."""

    def __init__(self, job: Job, workers: int, limits: Limits, errors: Path) -> None:
        """Make a crew; processes are started when they are needed.

        Args:
            job: what all designs share.
            workers: how many processes.
            limits: of each design.
            errors: file for what libraries write to standard error.
        """
        self._path, self._errors = errors, errors.open("ab")
        self._answers: queue.SimpleQueue[tuple[WorkerProcess, FinishedBatch]] = queue.SimpleQueue()
        self._threads: list[threading.Thread] = []
        self._idle = [WorkerProcess(job, limits, self._errors) for _ in range(workers)]
        self._all = tuple(self._idle)

    def free(self) -> int:
        """Return how many workers have nothing to do."""
        return len(self._idle)

    def size(self) -> int:
        """Return how many workers there are."""
        return len(self._all)

    def give(self, batch: Batch) -> None:
        """Hand a batch to a free worker."""
        worker = self._idle.pop()
        thread = threading.Thread(target=lambda: self._answers.put((worker, self._answer(worker, batch))), daemon=True)
        self._threads = [one for one in self._threads if one.is_alive()] + [thread]
        thread.start()

    def take(self, seconds: float) -> list[FinishedBatch]:
        """Wait for answers, at most that long."""
        finished: list[FinishedBatch] = []
        try:
            while True:
                worker, answer = self._answers.get(timeout=0 if finished else seconds)
                self._idle.append(worker)
                finished.append(answer)
        except queue.Empty:
            return finished

    def close(self) -> None:
        """Stop all processes."""
        for worker in self._all:
            worker.close()
        for thread in self._threads:
            thread.join()
        for worker in self._all:
            worker.stop()
        self._errors.close()

    def _answer(self, worker: WorkerProcess, batch: Batch) -> FinishedBatch:
        try:
            outcome = worker.answer([task.values for task in batch])
        except Exception as fault:  # a thread that ends without an answer is waited for in vain
            outcome = Outcome(refused=f"{type(fault).__name__}: {fault}")
        if outcome.refused:
            outcome = replace(outcome, refused=f"{outcome.refused}; {self._path} may tell why")
        return FinishedBatch(batch, outcome)


class WorkerProcess:
    """A process of ``worker_main``, started when it is needed and again when it has ended."""

    def __init__(self, job: Job, limits: Limits, errors: IO[bytes] | None = None) -> None:
        """Note what it is for.

        Args:
            job: what all designs share.
            limits: of each design.
            errors: file for what libraries write to standard error; without it, where this process writes its own.
        """
        self._job, self._parts = json.dumps([asdict(job), asdict(limits)]), job.parts
        self._seconds, self._errors = limits.seconds, errors
        self._process: subprocess.Popen[bytes] | None = None
        self._folder: TemporaryDirectory[str] | None = None  # for its temporary files: what is killed removes none
        self._late = self._closed = False

    def answer(self, designs: Sequence[tuple[Value, ...]]) -> Outcome:
        """Have designs answered; waits for it."""
        if self._process is None and not any(self._begun() for _ in range(STARTS)):
            return Outcome(refused="no worker process starts")
        if self._closed:
            return Outcome()
        rows: list[Row] = []
        ends, expected = [*accumulate(self._parts(designs))], 0
        try:
            self._send(json.dumps(designs))
            while len(rows) < len(designs):
                end = ends[bisect(ends, len(rows))]
                whole = len(rows) in (0, *ends)  # else the rest of a part is answered one by one
                expected = end - len(rows) if whole else 1
                reply = json.loads(self._line(expected))
                if "refused" in reply:
                    return Outcome(refused=reply["refused"])
                rows += reply["rows"]
                if reply["enough"] or self._process is None:
                    break
        except (OSError, ValueError):  # a broken pipe, half a line
            late, self._late = self._late, False
            return Outcome(tuple(rows), expected, self._ended(), late)
        return Outcome(tuple(rows))

    def kill(self) -> None:
        """End it; whoever waits for it goes on."""
        if (process := self._process) is not None:
            _kill(process)

    def stop(self) -> None:
        """End it for good; before, ``close`` and whoever waits."""
        self.kill()
        self._ended()

    def close(self) -> None:
        """Start no work any more."""
        self._closed = True
        self.kill()

    def _line(self, count: int) -> bytes:
        """The next line, that of ``count`` designs; a process that does not itself notice that it takes too long is ended."""
        stream = _stream(self._process, "stdout")
        watch = threading.Timer(count * self._seconds + min(GRACE, self._seconds), self._overdue)
        watch.start()
        try:
            line = bytes(stream.readline())
        finally:
            watch.cancel()
            watch.join()
        if line and self._late:  # answered at the last moment: the process is gone, and no design is to blame
            self._late = False
            self._ended()
        return line

    def _overdue(self) -> None:
        self._late = True
        self.kill()

    def _begun(self) -> bool:
        """Start a process; say whether it came as far as to ask for work."""
        try:
            self._folder = TemporaryDirectory(prefix="sweep-", ignore_cleanup_errors=True)
            self._process = _started(self._errors, self._folder.name)
            self._send(self._job)
            ready = bool(_stream(self._process, "stdout").readline())
        except OSError:
            ready = False
        if not ready:
            self._ended()
        return ready

    def _send(self, line: str) -> None:
        stream = _stream(self._process, "stdin")
        stream.write(line.encode() + b"\n")
        stream.flush()

    def _ended(self) -> str:
        """Clear the process away and say how it ended."""
        process, self._process = self._process, None
        if process is None:
            return "the worker process could not be asked"
        try:
            code = process.wait(5)  # its own end, not ours, is what the row tells
        except subprocess.TimeoutExpired:
            _kill(process)
            code = process.wait()
        for name in ("stdin", "stdout"):
            with suppress(OSError):
                _stream(process, name).close()
        if self._folder is not None:
            self._folder.cleanup()
        killed = f"was killed by signal {-code}" if code < 0 else f"ended with exit code {code}"
        return f"the worker process {killed}: out of memory, a crash of a library, or ended from outside"


def _started(errors: IO[bytes] | None, temporary: str) -> subprocess.Popen[bytes]:
    root = str(Path(__file__).parents[2])
    path = os.pathsep.join(filter(None, (root, os.environ.get("PYTHONPATH"))))
    return subprocess.Popen(
        [sys.executable, "-m", "probe_design.sweeps.worker_main"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=errors,
        env=os.environ | _ENVIRONMENT | {"PYTHONPATH": path} | dict.fromkeys(("TMPDIR", "TEMP", "TMP"), temporary),
        start_new_session=True,
    )


def _kill(process: subprocess.Popen[bytes]) -> None:
    """End a process, and with it those that mesh for it, where the system knows groups of processes."""
    if sys.platform == "win32":
        process.kill()
    else:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)


def _stream(process: subprocess.Popen[bytes] | None, name: str) -> IO[Any]:
    stream: IO[Any] | None = getattr(process, name, None)
    if stream is None:
        raise OSError("no process")
    return stream
