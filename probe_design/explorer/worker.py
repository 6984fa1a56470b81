"""Run one long piece of work of a page in a worker process, which the page can cancel."""

from __future__ import annotations

import asyncio
import os
from collections.abc import AsyncIterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from geometry.processes.child import END, Child, Died, Failure

WORKER_PROGRAM = Path(__file__).with_name("worker_program.py")
MAX_WORKERS = max(2, (os.cpu_count() or 1) - 1)  # of all pages at once; each needs a processor and some 200 MB
POLL_S = 0.1  # s


class Worker:
    """At most one process at a time, and ``MAX_WORKERS`` of all pages, for which others wait."""

    _places = asyncio.Semaphore(MAX_WORKERS)

    def __init__(self) -> None:
        self._child: Child | None = None
        self._is_busy = self._is_cancelled = False

    def cancel(self) -> None:
        """End the process, if one works, or the waiting for it."""
        self._is_cancelled = True
        if self._child is not None:
            self._child.kill()

    async def work(self, kind: str, subject: object, option: object) -> AsyncIterator[tuple[str, Any]]:
        """Yield the messages of ``worker_program.run``; a process that ends early, or is cancelled, counts as a refusal."""
        if self._is_busy:
            yield "refused", "another piece of work is going on: wait, or cancel it"
            return
        self._is_busy, self._is_cancelled = True, False
        try:
            if self._places.locked():
                yield "progress", "waiting for the work of other pages"
            while self._places.locked() and not self._is_cancelled:
                await asyncio.sleep(POLL_S)
            if self._is_cancelled:
                yield "refused", "cancelled"
                return
            async with self._places:
                async for message in self._run((kind, subject, option)):
                    yield message
        finally:
            self._is_busy = False

    async def _run(self, request: object) -> AsyncIterator[tuple[str, Any]]:
        """Yield the messages of a process."""
        with ThreadPoolExecutor(1) as thread:  # of its own, as it waits for as long as the work takes
            try:
                self._child = child = Child(WORKER_PROGRAM, is_worker=True)
                child.send(request)
                loop = asyncio.get_running_loop()
                while (message := await loop.run_in_executor(thread, child.receive)) is not END:
                    yield message
            except Died as fault:
                yield "refused", "cancelled" if self._is_cancelled else f"the worker ended: {fault}; try again"
            except Failure as fault:
                yield "refused", f"the worker failed: {fault}"
            finally:
                if self._child is not None:
                    self._child.close()
                    self._child = None
