"""The process that computes the formulas for all pages: numbers of a page come before curves of another one."""

from __future__ import annotations

import asyncio
from concurrent.futures import ThreadPoolExecutor
from heapq import heappop, heappush
from itertools import count
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from geometry.common.errors import ProbeError
from geometry.processes.child import END, Child, Died, Failure, TooLong

PROGRAM = Path(__file__).with_name("formulas_program.py")
MAX_SECONDS = 30.0  # s of a response, which takes tens of milliseconds
ORDER = ("outputs", "map", "limits", "curves", "closure")  # of all pages' requests; see ``formulas_program``


class Formulas:
    """One process, which loads the formulas while this one goes on; a context manager that ends it.

    Attributes
    ----------
    accidents
        How processes have ended so far; another one has gone on.
    """

    def __init__(self) -> None:
        self._child: Child | None = None
        self.accidents: list[str] = []
        self._thread = ThreadPoolExecutor(1, "formulas")  # of its own: readings and checks wait in the common ones
        self._queue: list[tuple[int, int, tuple[str, tuple[object, ...]], asyncio.Future[Any]]] = []
        self._number, self._task = count(), None
        self._start()

    _task: asyncio.Task[None] | None

    async def compute(self, name: str, *arguments: object) -> Any:
        """Return a function's result, see ``formulas_program``; requests of one name are answered in their order.

        Raises
        ------
        ProbeError
            The design is refused, or has ended two processes.
        """
        future = asyncio.get_running_loop().create_future()
        heappush(self._queue, (ORDER.index(name), next(self._number), (name, arguments), future))
        if self._task is None or self._task.done():
            self._task = asyncio.get_running_loop().create_task(self._work())
        return await future

    def close(self) -> None:
        """End process and thread."""
        self.close_process()
        self._thread.shutdown(wait=False)

    def close_process(self) -> None:
        """End the process."""
        if self._child is not None:
            self._child.close()
        self._child = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, fault: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    async def _work(self) -> None:
        """Answer requests until there are none."""
        while self._queue:
            *_, request, future = heappop(self._queue)
            if future.done():  # its page was left
                continue
            try:
                result = await asyncio.get_running_loop().run_in_executor(self._thread, self._ask, request)
            except ProbeError as fault:
                if not future.done():
                    future.set_exception(fault)
            else:
                if not future.done():
                    future.set_result(result)

    def _start(self) -> None:
        """Start the process, which loads the formulas at once. Raises ``Failure`` where none can be started."""
        self._child = Child(PROGRAM, is_worker=True)
        self._child.send(("load", ()))
        self._is_loading = True

    def _ask(self, request: tuple[str, tuple[object, ...]]) -> Any:
        """Return the response to a request, from another process where one ends. Raises ``ProbeError``."""
        for attempt in range(2):
            try:
                return self._ask_once(request)
            except (Died, TooLong) as fault:
                self.close_process()
                self.accidents = [*self.accidents, f"the process of the formulas ended: {fault}"]
                if attempt:
                    raise ProbeError(f"{self.accidents[-1]}; change the design") from None
            except Failure as fault:
                raise ProbeError(str(fault)) from None
        raise AssertionError

    def _ask_once(self, request: tuple[str, tuple[object, ...]]) -> Any:
        """Return the response to a request. Raises ``Failure``."""
        if self._child is None:
            self._start()
        assert self._child is not None
        with self._child.limit_time(MAX_SECONDS):
            if self._is_loading:
                self._is_loading = False
                self._receive(self._child)
            self._child.send(request)
            return self._receive(self._child)

    @staticmethod
    def _receive(child: Child) -> Any:
        """Return the one part of a response."""
        part = child.receive()
        end = child.receive()
        assert end is END
        return part
