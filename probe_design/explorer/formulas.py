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
from geometry.processes.child import END, Child, Died, Failure

PROGRAM = Path(__file__).with_name("formulas_program.py")
ORDER = ("outputs", "map", "limits", "curves")  # of all pages' requests; see ``formulas_program``


class FormulasEnded(ProbeError):  # noqa: N818
    """The process has ended; the next request starts another."""


class Formulas:
    """One process, which loads the formulas while this one goes on; a context manager that ends it."""

    def __init__(self) -> None:
        self._child: Child | None = None
        self._thread = ThreadPoolExecutor(1, "formulas")  # of its own: readings and checks wait in the common ones
        self._queue: list[tuple[int, int, tuple[str, tuple[object, ...]], asyncio.Future[Any]]] = []
        self._number, self._task = count(), None
        self._start()

    _task: asyncio.Task[None] | None

    async def compute(self, name: str, *arguments: object) -> Any:
        """Return a function's result, see ``formulas_program``; requests of one name are answered in their order.

        Raises
        ------
        FormulasEnded
            The process has ended.
        ProbeError
            The design is refused.
        """
        future = asyncio.get_running_loop().create_future()
        heappush(self._queue, (ORDER.index(name), next(self._number), (name, arguments), future))
        if self._task is None or self._task.done():
            self._task = asyncio.get_running_loop().create_task(self._work())
        return await future

    def close(self) -> None:
        """End the process."""
        if self._child is not None:
            self._child.close()
        self._thread.shutdown(wait=False)

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
        """Return the response to a request. Raises ``ProbeError``."""
        try:
            if self._child is None:
                self._start()
            assert self._child is not None
            if self._is_loading:
                self._receive(self._child)
                self._is_loading = False
            self._child.send(request)
            return self._receive(self._child)
        except Died as fault:
            if self._child is not None:
                self._child.close()
            self._child = None
            raise FormulasEnded(f"the process of the formulas ended: {fault}; another one goes on") from None
        except Failure as fault:
            raise ProbeError(str(fault)) from None

    @staticmethod
    def _receive(child: Child) -> Any:
        """Return the one part of a response."""
        part = child.receive()
        end = child.receive()
        assert end is END
        return part
