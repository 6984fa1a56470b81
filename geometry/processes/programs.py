"""Return one result of a program in a child process, from one thread or several."""

from __future__ import annotations

import contextvars
import signal
import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from types import TracebackType
from typing import Any, ParamSpec, TypeVar

from geometry.processes.child import Child, Died, TooLong

_INTERRUPT_EXIT_CODES = (-int(signal.SIGINT), 128 + int(signal.SIGINT), 0xC000013A)  # what a process ends with after Ctrl-C
P = ParamSpec("P")
R = TypeVar("R")


class ChildThreads(ThreadPoolExecutor):
    """Threads that run programs in child processes; an exception in the block kills these, and those started later.

    Threads cannot be interrupted: without this Ctrl-C would wait until their programs are done.

    Examples
    --------
    >>> with ChildThreads(2) as threads:  # doctest: +SKIP
    ...     results = [threads.submit(run_program, *request) for request in requests]
    """

    def __init__(self, count: int) -> None:
        super().__init__(count)
        self._children: list[Child] = []
        self._is_ended, self._lock = False, threading.Lock()

    def submit(self, function: Callable[P, R], /, *arguments: P.args, **options: P.kwargs) -> Future[R]:
        """Call a function in a thread, and return its future; programs that it runs are killed with this block."""
        context = contextvars.copy_context()  # limits and clock of the caller, too, hold in the thread
        context.run(_CURRENT_THREADS.set, self)
        return super().submit(lambda: context.run(function, *arguments, **options))

    def add(self, child: Child) -> None:
        """Add a running program, which is killed at once where the block was left."""
        with self._lock:
            self._children.append(child)
            if self._is_ended:
                child.kill()

    def remove(self, child: Child) -> None:
        """Forget a program that has ended."""
        with self._lock:
            self._children.remove(child)

    def __exit__(self, kind: type[BaseException] | None, fault: BaseException | None, trace: TracebackType | None) -> None:
        if kind is not None:
            with self._lock:
                self._is_ended = True
                for child in self._children:
                    child.kill()
        super().__exit__(kind, fault, trace)


_CURRENT_THREADS: contextvars.ContextVar[ChildThreads | None] = contextvars.ContextVar("threads", default=None)


def run_program(program: Path, request: object, seconds: float, memory: float | None = None) -> Any:
    """Return the result of a program for one request; safe in several threads at a time.

    Parameters
    ----------
    program : Path
        Its file; see ``Child``.
    request : object
        What its function ``run`` is given.
    seconds : float
        After which it is ended.
    memory : float or None
        Bytes that it may hold, where the system can see to that (Linux).

    Returns
    -------
    object
        What ``run`` returns.

    Raises
    ------
    TooLong
        It took longer than ``seconds``.
    Failure
        The program fails, or its process ends early.
    KeyboardInterrupt
        Ctrl-C, here or in the child, which is gone by then.
    """
    if seconds <= 0:
        raise TooLong("no time is left for it")
    threads = _CURRENT_THREADS.get()
    with Child(program, seconds=seconds, memory=memory) as child:
        if threads is not None:
            threads.add(child)
        try:
            with child.limit_time(seconds):
                child.send(request)
                return child.receive()
        except Died as fault:
            if fault.exit_code in _INTERRUPT_EXIT_CODES:
                raise KeyboardInterrupt from None
            raise
        finally:
            if threads is not None:
                threads.remove(child)
