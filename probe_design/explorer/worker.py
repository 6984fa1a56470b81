"""Run one long piece of work of a page in a worker process, which the page can cancel."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

from geometry.processes.child import END, Child, Died, Failure

WORKER_PROGRAM = Path(__file__).with_name("worker_program.py")


class Worker:
    """At most one process at a time."""

    def __init__(self) -> None:
        self._child: Child | None = None
        self._is_cancelled = False

    @property
    def is_busy(self) -> bool:
        """Whether a process works."""
        return self._child is not None

    def cancel(self) -> None:
        """End the process, if one works."""
        if self._child is not None:
            self._is_cancelled = True
            self._child.kill()

    async def work(self, kind: str, subject: object, option: object) -> AsyncIterator[tuple[str, Any]]:
        """Yield the messages of ``worker_program.run``; a process that ends early, or is cancelled, counts as a refusal."""
        if self.is_busy:
            yield "refused", "another piece of work is going on: wait, or cancel it"
            return
        self._is_cancelled = False
        try:
            self._child = child = Child(WORKER_PROGRAM, is_worker=True)
            child.send((kind, subject, option))
            while (message := await asyncio.to_thread(child.receive)) is not END:
                yield message
        except Died as fault:
            yield "refused", "cancelled" if self._is_cancelled else f"the worker ended: {fault}; try again"
        except Failure as fault:
            yield "refused", f"the worker failed: {fault}"
        finally:
            if self._child is not None:
                self._child.close()
                self._child = None
