"""Workers on this computer: a process each, so that one that dies takes its own batch along and nothing else."""

from __future__ import annotations

import json
import os
import queue
import subprocess
import sys
import threading
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import IO, Any

from probe_design.sweep_crew import Answer, Batch
from probe_design.sweep_rows import Job

# libraries read these when they are loaded; MKL's bits depend on where arrays lie unless it is told otherwise
_ENVIRONMENT = {f"{one}_NUM_THREADS": "1" for one in ("OMP", "OPENBLAS", "MKL", "NUMEXPR", "VECLIB")} | {
    "MKL_CBWR": "AUTO,STRICT"
}


STARTS = 3  # attempts, each with a process that ends before it asks for work


class LocalCrew:
    """Processes of ``sweep_worker``, started when they are needed; a thread here waits for each."""

    def __init__(self, job: Job, workers: int, errors: Path) -> None:
        """Make a crew.

        Args:
            job: what all designs share.
            workers: how many processes.
            errors: file for what libraries write to standard error.
        """
        self.job = json.dumps(asdict(job))
        self.errors, self._errors = errors, errors.open("ab")
        self._answers: queue.SimpleQueue[tuple[_Worker, Answer]] = queue.SimpleQueue()
        self._threads: list[threading.Thread] = []
        self.closed = False
        self._idle = [_Worker(self) for _ in range(workers)]
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
        thread = threading.Thread(target=lambda: self._answers.put((worker, worker.answer(batch))), daemon=True)
        self._threads = [one for one in self._threads if one.is_alive()] + [thread]
        thread.start()

    def take(self, seconds: float) -> list[Answer]:
        """Wait for answers, at most that long."""
        found: list[Answer] = []
        try:
            while True:
                worker, answer = self._answers.get(timeout=0 if found else seconds)
                self._idle.append(worker)
                found.append(answer)
        except queue.Empty:
            return found

    def close(self) -> None:
        """Stop all processes."""
        self.closed = True  # before the kills, so that no worker is asked after its own
        for worker in self._all:
            worker.kill()
        for thread in self._threads:
            thread.join()
        for worker in self._all:
            worker.stop()
        self._errors.close()

    def start(self) -> subprocess.Popen[bytes]:
        """Start a process."""
        root = str(Path(__file__).parents[1])
        path = os.pathsep.join(filter(None, (root, os.environ.get("PYTHONPATH"))))
        return subprocess.Popen(
            [sys.executable, "-m", "probe_design.sweep_worker"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._errors,
            env=os.environ | _ENVIRONMENT | {"PYTHONPATH": path},
        )


class _Worker:
    """One process, and another when it has died."""

    def __init__(self, crew: LocalCrew) -> None:
        self._crew = crew
        self._process: subprocess.Popen[bytes] | None = None

    def answer(self, batch: Batch) -> Answer:
        if self._process is None and not any(self._begun() for _ in range(STARTS)):
            return Answer(batch, None, refused=f"no worker process starts; {self._crew.errors} may tell why")
        if self._crew.closed:
            return Answer(batch, None, "stopped")
        try:
            found = json.loads(self._asked(json.dumps([task.values for task in batch])))
        except (OSError, ValueError):  # a broken pipe, half a line
            return Answer(batch, None, self._ended())
        if "refused" in found:
            return Answer(batch, None, refused=found["refused"])
        return Answer(batch, found["rows"])

    def _asked(self, line: str) -> bytes:
        process = self._process
        if process is None:
            raise OSError("no process")
        _send(process, line)
        answer: bytes = _stream(process.stdout).readline()
        return answer

    def _begun(self) -> bool:
        """Start a process; say whether it came as far as to ask for work."""
        try:
            self._process = self._crew.start()
            _send(self._process, self._crew.job)
            ready = bool(_stream(self._process.stdout).readline())
        except OSError:
            ready = False
        if not ready:
            self._ended()
        return ready

    def kill(self) -> None:
        if (process := self._process) is not None:
            process.kill()

    def stop(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._ended()

    def _ended(self) -> str:
        """Clear a process away and say how it ended."""
        process, self._process = self._process, None
        if process is None:
            return "no worker process could be started"
        try:
            code = process.wait(5)  # its own end, not ours, is what the row tells
        except subprocess.TimeoutExpired:
            process.kill()
            code = process.wait()
        for stream in (process.stdin, process.stdout):
            with suppress(OSError):
                _stream(stream).close()
        killed = f"was killed by signal {-code}" if code < 0 else f"ended with exit code {code}"
        return f"the worker process {killed}: out of memory, a crash of a library, or ended from outside"


def _send(process: subprocess.Popen[bytes], line: str) -> None:
    stream = _stream(process.stdin)
    stream.write(line.encode() + b"\n")
    stream.flush()


def _stream(stream: IO[Any] | None) -> IO[Any]:
    if stream is None:
        raise OSError("a process without pipes")
    return stream
