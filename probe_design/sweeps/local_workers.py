"""Worker pool on this computer: processes, and one thread here that waits for each.

A process that has ended is replaced by a new one, so that a crash or a time limit costs only the design that caused it.
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
from geometry.scenes.keys import Value
from probe_design.sweeps.rows import Job, Row
from probe_design.sweeps.workers import Batch, FinishedBatch, Outcome

# read by libraries when they are loaded; without MKL_CBWR, MKL's last bits depend on the alignment of arrays
_WORKER_ENVIRONMENT = {f"{library}_NUM_THREADS": "1" for library in ("OMP", "OPENBLAS", "MKL", "NUMEXPR", "VECLIB")} | {
    "MKL_CBWR": "AUTO,STRICT"
}
GRACE_PERIOD_S = 5.0  # seconds for a worker to report by itself that its time is over
MAX_STARTS = 3  # attempts to start a process


class LocalPool:
    """A pool of worker processes; see ``workers.WorkerPool``."""

    def __init__(self, job: Job, workers: int, limits: Limits, errors: Path) -> None:
        """Create the pool; processes are started when they are needed.

        Args:
            job: settings shared by all designs.
            workers: number of processes.
            limits: time and memory of each design.
            errors: file for the standard error of the processes.
        """
        self._path, self._errors = errors, errors.open("ab")
        self._finished: queue.SimpleQueue[tuple[WorkerProcess, FinishedBatch]] = queue.SimpleQueue()
        self._threads: list[threading.Thread] = []
        self._idle = [WorkerProcess(job, limits, self._errors) for _ in range(workers)]
        self._workers = tuple(self._idle)

    def count_free(self) -> int:
        """Return the number of idle workers."""
        return len(self._idle)

    def count_workers(self) -> int:
        """Return the number of workers."""
        return len(self._workers)

    def submit(self, batch: Batch) -> None:
        """Give a batch to an idle worker."""
        worker = self._idle.pop()
        thread = threading.Thread(target=lambda: self._finished.put((worker, self._evaluate_batch(worker, batch))), daemon=True)
        self._threads = [old_thread for old_thread in self._threads if old_thread.is_alive()] + [thread]
        thread.start()

    def collect(self, seconds: float) -> list[FinishedBatch]:
        """Wait at most ``seconds`` for finished batches."""
        finished: list[FinishedBatch] = []
        try:
            while True:
                worker, answer = self._finished.get(timeout=0 if finished else seconds)
                self._idle.append(worker)
                finished.append(answer)
        except queue.Empty:
            return finished

    def close(self) -> None:
        """Stop all processes."""
        for worker in self._workers:
            worker.close()
        for thread in self._threads:
            thread.join()
        for worker in self._workers:
            worker.stop()
        self._errors.close()

    def _evaluate_batch(self, worker: WorkerProcess, batch: Batch) -> FinishedBatch:
        """Evaluate a batch in a worker; an unexpected error becomes an outcome too."""
        try:
            outcome = worker.evaluate([task.values for task in batch])
        except Exception as fault:  # without an outcome the pool would wait for ever
            outcome = Outcome(refusal=f"{type(fault).__name__}: {fault}")
        if outcome.refusal:
            outcome = replace(outcome, refusal=f"{outcome.refusal}; see {self._path}")
        return FinishedBatch(batch, outcome)


class WorkerProcess:
    """A process that runs ``worker_main``; started when it is needed, and again after it has ended."""

    def __init__(self, job: Job, limits: Limits, errors: IO[bytes] | None = None) -> None:
        """Store the settings; the process is started later.

        Args:
            job: settings shared by all designs.
            limits: time and memory of each design.
            errors: file for the standard error of the process; by default that of this process.
        """
        self._request, self._count_parts = json.dumps([asdict(job), asdict(limits)]), job.count_parts
        self._seconds, self._errors = limits.seconds, errors
        self._process: subprocess.Popen[bytes] | None = None
        self._folder: TemporaryDirectory[str] | None = None  # for its temporary files, which a killed process does not remove
        self._is_late = self._is_closed = False

    def evaluate(self, designs: Sequence[tuple[Value, ...]]) -> Outcome:
        """Evaluate designs in the process; waits for their rows."""
        if self._process is None and not any(self._start() for _ in range(MAX_STARTS)):
            return Outcome(refusal="no worker process starts")
        if self._is_closed:
            return Outcome()
        rows: list[Row] = []
        ends, expected = [*accumulate(self._count_parts(designs))], 0
        try:
            self._send(json.dumps(designs))
            while len(rows) < len(designs):
                end = ends[bisect(ends, len(rows))]
                is_whole_part = len(rows) in (0, *ends)  # else the designs of this part are evaluated one by one
                expected = end - len(rows) if is_whole_part else 1
                reply = json.loads(self._read_line(expected))
                if "refused" in reply:
                    return Outcome(refusal=reply["refused"])
                rows += reply["rows"]
                if reply["enough"] or self._process is None:
                    break
        except (OSError, ValueError):  # a broken pipe, half a line
            was_late, self._is_late = self._is_late, False
            return Outcome(tuple(rows), expected, self._clean_up(), was_late)
        return Outcome(tuple(rows))

    def kill(self) -> None:
        """Kill the process; a thread that waits for it goes on."""
        if (process := self._process) is not None:
            _kill_group(process)

    def stop(self) -> None:
        """Kill the process and clean up; call ``close`` and join waiting threads first."""
        self.kill()
        self._clean_up()

    def close(self) -> None:
        """Kill the process and accept no more work."""
        self._is_closed = True
        self.kill()

    def _read_line(self, count: int) -> bytes:
        """Read the next line, that of ``count`` designs; kill the process if it exceeds its time limit without noticing."""
        stream = _get_stream(self._process, "stdout")
        watch = threading.Timer(count * self._seconds + min(GRACE_PERIOD_S, self._seconds), self._stop_late)
        watch.start()
        try:
            line = bytes(stream.readline())
        finally:
            watch.cancel()
            watch.join()
        if line and self._is_late:  # a line came at the last moment: the process is gone, but no design is to blame
            self._is_late = False
            self._clean_up()
        return line

    def _stop_late(self) -> None:
        """Kill the process after its time limit."""
        self._is_late = True
        self.kill()

    def _start(self) -> bool:
        """Start a process; return whether it became ready for work."""
        try:
            self._folder = TemporaryDirectory(prefix="sweep-", ignore_cleanup_errors=True)
            self._process = _start_process(self._errors, self._folder.name)
            self._send(self._request)
            ready = bool(_get_stream(self._process, "stdout").readline())
        except OSError:
            ready = False
        if not ready:
            self._clean_up()
        return ready

    def _send(self, line: str) -> None:
        stream = _get_stream(self._process, "stdin")
        stream.write(line.encode() + b"\n")
        stream.flush()

    def _clean_up(self) -> str:
        """Release the ended process and return how it ended."""
        process, self._process = self._process, None
        if process is None:
            return "the worker process was not running"
        try:
            code = process.wait(5)  # the row reports the exit code of the process itself, not of our kill
        except subprocess.TimeoutExpired:
            _kill_group(process)
            code = process.wait()
        for name in ("stdin", "stdout"):
            with suppress(OSError):
                _get_stream(process, name).close()
        if self._folder is not None:
            self._folder.cleanup()
        killed = f"was killed by signal {-code}" if code < 0 else f"ended with exit code {code}"
        return f"the worker process {killed}: out of memory, a crash of a library, or ended from outside"


def _start_process(errors: IO[bytes] | None, temporary: str) -> subprocess.Popen[bytes]:
    """Start a worker process with one thread for linear algebra and its own folder for temporary files."""
    root = str(Path(__file__).parents[2])
    path = os.pathsep.join(filter(None, (root, os.environ.get("PYTHONPATH"))))
    return subprocess.Popen(
        [sys.executable, "-m", "probe_design.sweeps.worker_main"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=errors,
        env=os.environ | _WORKER_ENVIRONMENT | {"PYTHONPATH": path} | dict.fromkeys(("TMPDIR", "TEMP", "TMP"), temporary),
        start_new_session=True,
    )


def _kill_group(process: subprocess.Popen[bytes]) -> None:
    """Kill a process and its child processes (meshers); on Windows the process only."""
    if sys.platform == "win32":
        process.kill()
    else:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)


def _get_stream(process: subprocess.Popen[bytes] | None, name: str) -> IO[Any]:
    """Return a stream of a process; raise ``OSError`` if there is none."""
    stream: IO[Any] | None = getattr(process, name, None)
    if stream is None:
        raise OSError("no process")
    return stream
