"""Run a program on requests in a separate Python process, which can be killed at any time; its crash is an exception here.

A program is a file with a function ``run`` from a request to its result, or to an iterator over the parts of it; see
``child_main.py``. Temporary files of the child are in a folder of its own, which is removed, so that no files are left behind.
"""

from __future__ import annotations

import math
import os
import pickle
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Self

SOURCE_ROOT = Path(__file__).parents[2]  # contains the packages, which a child may import
CHILD_MAIN = Path(__file__).with_name("child_main.py")
END = object()  # received after the last part of a result
_ALARM_EXIT_CODE = -int(getattr(signal, "SIGALRM", 0)) or None
_WAIT_FOR_END_S = 5.0  # s for a process that closed its pipe to end by itself, and so with an exit code of its own
# read by libraries when they are loaded
_ENVIRONMENT = {f"{library}_NUM_THREADS": "1" for library in ("OMP", "OPENBLAS", "MKL", "NUMEXPR", "VECLIB")} | {
    "PYTHONWARNINGS": "ignore"
}
_WORKER_ENVIRONMENT = {"MKL_CBWR": "AUTO,STRICT"}  # without it MKL's last bits depend on the alignment of arrays


class Failure(Exception):  # noqa: N818 - what the process says, not yet an error of the toolkit
    """There is no result; the text gives the reason."""


class Died(Failure):
    """The process ended before its result, with an exit code and, where it was kept, a last line of standard error."""

    def __init__(self, exit_code: int, last_line: str) -> None:
        # negative codes are signals; others are hexadecimal, as Windows states them
        names = {-known: known.name for known in signal.Signals}
        how = (
            f"was ended by {names.get(exit_code, f'signal {-exit_code}')}" if exit_code < 0 else f"ended with code {exit_code:#x}"
        )
        super().__init__(f"its process {how}{last_line and f': {last_line}'}")
        self.exit_code, self.last_line = exit_code, last_line


class TooLong(Failure):
    """The process was ended, as it took longer than the limit."""


class Child:
    """A process that runs a program with one thread; a context manager that ends it.

    Parameters
    ----------
    program : Path
        File of the program.
    seconds : float
        After which it ends by itself where the system can see to that (not Windows), even if this process is killed.
    memory : float or None
        Bytes that it may hold, where the system can see to that (Linux).
    errors : IO, int or None
        File, or its descriptor, for its standard error. None keeps the text, whose last line then ends the text of ``Died``.
    is_worker : bool
        Whether it leads a group of its own, which Ctrl-C of a terminal does not reach, and which is killed as a whole with
        the processes that it started (on Windows it alone). Else it belongs to this process's group, and works in its folder.

    Raises
    ------
    Failure
        No process can be started.
    """

    def __init__(
        self,
        program: Path,
        *,
        seconds: float = 0.0,
        memory: float | None = None,
        errors: IO[bytes] | int | None = None,
        is_worker: bool = False,
    ) -> None:
        self._is_worker, self._late_after = is_worker, ""
        self._folder = tempfile.TemporaryDirectory(prefix=f"{program.stem}-", ignore_cleanup_errors=True)
        self._errors = open(Path(self._folder.name, "stderr"), "w+b") if errors is None else None  # noqa: SIM115 - see close
        arguments = [str(program), str(math.ceil(seconds)), str(int(memory or 0))]
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-P", str(CHILD_MAIN), *arguments],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=errors or self._errors,
                env=_build_environment(self._folder.name) | (_WORKER_ENVIRONMENT if is_worker else {}),
                cwd=None if is_worker else self._folder.name,  # where libraries leave files
                start_new_session=is_worker,
                creationflags=getattr(subprocess, "CREATE_NEW_PROCESS_GROUP" if is_worker else "CREATE_NO_WINDOW", 0),
            )
        except OSError as fault:
            self._remove_files()
            raise Failure(f"no process can be started for it ({fault})") from fault

    @property
    def process_id(self) -> int:
        """The number by which the system knows it."""
        return self._process.pid

    @property
    def is_late(self) -> bool:
        """Whether it was killed at the end of a time limit."""
        return bool(self._late_after)

    @property
    def is_alive(self) -> bool:
        """Whether it can take requests."""
        return not self.is_late and self._process.poll() is None

    def send(self, request: object) -> None:
        """Send a request to the program.

        Raises
        ------
        Died
            The process has ended.
        TooLong
            It was ended at its time limit.
        """
        assert self._process.stdin is not None
        try:
            # pickled twice: the child reads the outer pickle, of bytes, whole, even where loading the inner one fails there, for
            # want of a module, say; it then reports that failure, and its input is still at the start of the next request
            pickle.dump(pickle.dumps(request, pickle.HIGHEST_PROTOCOL), self._process.stdin)
            self._process.stdin.flush()
        except OSError:
            raise self._explain_end() from None

    def receive(self) -> Any:
        """Return the next part of the result of the request, or ``END`` after the last.

        Raises
        ------
        TooLong
            It exceeded the limit of the enclosing ``limit_time``, or its own.
        Died
            It ended before.
        Failure
            The program raised an exception.
        """
        assert self._process.stdout is not None
        try:
            kind, content = pickle.load(self._process.stdout)
        except (EOFError, OSError, pickle.UnpicklingError):
            raise self._explain_end() from None
        if kind == "failure":
            raise Failure(content)
        return END if kind == "end" else content

    @contextmanager
    def limit_time(self, seconds: float) -> Iterator[None]:
        """Kill the process when the block takes longer than ``seconds``; ``send`` and ``receive`` then raise ``TooLong``."""
        watch = threading.Timer(min(seconds, threading.TIMEOUT_MAX), self._end_late, (seconds,))
        watch.daemon = True
        watch.start()
        try:
            yield
        finally:
            watch.cancel()
            watch.join()

    def kill(self) -> None:
        """Kill the process, from any thread; a thread that waits in ``receive`` gets an exception there."""
        if self._is_worker and sys.platform != "win32":
            with suppress(ProcessLookupError):
                os.killpg(self._process.pid, signal.SIGKILL)
        else:
            self._process.kill()

    def close(self) -> None:
        """Kill the process, and remove its temporary files."""
        self.kill()
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            with suppress(OSError):  # flushing what was not sent fails
                assert pipe is not None
                pipe.close()
        self._remove_files()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, fault: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    def _end_late(self, seconds: float) -> None:
        """Kill the process at the end of a time limit."""
        self._late_after = f"{seconds:.3g} s"
        self.kill()

    def _explain_end(self) -> Died | TooLong:
        """Wait for the process to end, and return the exception that describes how it ended."""
        try:
            code = self._process.wait(_WAIT_FOR_END_S)  # its own exit code, not that of a kill
        except subprocess.TimeoutExpired:
            self.kill()
            code = self._process.wait()
        if self._late_after:
            return TooLong(f"it took longer than {self._late_after}")
        if code == _ALARM_EXIT_CODE:  # its own alarm, see ``child_main.py``
            return TooLong("it took too long")
        return Died(code, self._read_last_line())

    def _read_last_line(self) -> str:
        """Return the last line of the process's standard error; empty where it was not kept."""
        if self._errors is None:
            return ""
        self._errors.seek(0)
        lines = self._errors.read().decode(errors="replace").strip().splitlines()
        return lines[-1] if lines else ""

    def _remove_files(self) -> None:
        """Close the kept standard error, and remove the folder of temporary files."""
        if self._errors is not None:
            self._errors.close()
        self._folder.cleanup()


def _build_environment(folder: str) -> dict[str, str]:
    """Return the child's environment: this process's, with one thread for each library.

    Modules are found where this process finds them; temporary files go to ``folder``.
    """
    path = os.pathsep.join([str(SOURCE_ROOT), *(os.path.abspath(entry) for entry in sys.path if entry)])
    return {**os.environ, **_ENVIRONMENT, "PYTHONPATH": path, **dict.fromkeys(("TMPDIR", "TEMP", "TMP"), folder)}
