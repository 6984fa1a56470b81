"""The bench that all tabs of the server share: one worker process that reads the probe, and what it has reported last."""

from __future__ import annotations

import asyncio
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from geometry.processes.child import END, Child, Died, Failure
from probe_design.explorer.bench_settings import BenchSettings, DiscardRequest, PressRequest

WORKER_PROGRAM = Path(__file__).with_name("bench_program.py")
STOP_PATIENCE_S = 5.0  # s after which a reading that does not stop is ended with its process
Listener = Callable[[str, Any], None]


class Bench:
    """Presses of the probe, one at a time, for any number of listening tabs.

    Parameters
    ----------
    settings
        What was named at the start.

    Attributes
    ----------
    state
        Readings, map and next place, as ``Measuring.describe`` returns them; None before the worker has started.
    numbers
        Of the last reading, or None.
    status
        What is going on, or how it ended.
    """

    def __init__(self, settings: BenchSettings) -> None:
        self._temporary = tempfile.TemporaryDirectory(prefix="probe-design-", ignore_cleanup_errors=True)
        self.settings = settings
        self.folder = settings.folder or Path(self._temporary.name, "recordings")
        self._stop_file = Path(self._temporary.name, "stop")
        self._child: Child | None = None
        self._listeners: list[Listener] = []
        self._task: asyncio.Task[None] | None = None
        self.state: dict[str, Any] | None = None
        self.numbers: dict[str, Any] | None = None
        self.status = ""

    @property
    def is_busy(self) -> bool:
        """Whether the worker works."""
        return self._task is not None and not self._task.done()

    def listen(self, listener: Listener) -> Callable[[], None]:
        """Call a function with all messages from now on; return a function that ends this."""
        self._listeners.append(listener)
        return lambda: self._listeners.remove(listener)

    def start(self) -> None:
        """Start the worker, unless it runs."""
        if self._child is None and not self.is_busy:
            self._task = asyncio.get_running_loop().create_task(self._work(None))

    def request(self, request: PressRequest | DiscardRequest) -> bool:
        """Start a reading, or discard the last one; False while the worker works."""
        if self.is_busy:
            return False
        self._stop_file.unlink(missing_ok=True)
        self._publish("numbers", None)  # those of the last reading say nothing about this one
        if isinstance(request, PressRequest):
            self._publish("progress", "reading")
            request = replace(request, stop_file=self._stop_file)
        self._task = asyncio.get_running_loop().create_task(self._work(request))
        return True

    async def stop(self) -> None:
        """End the reading; a worker that does not stop is killed."""
        task = self._task
        if task is None or task.done():
            return
        self._stop_file.touch()
        done, _ = await asyncio.wait([task], timeout=STOP_PATIENCE_S)
        if not done and self._child is not None:
            self._child.kill()

    def close(self) -> None:
        """End the worker, and remove the temporary folder."""
        self._end_worker()
        self._temporary.cleanup()

    def _end_worker(self) -> None:
        """End the worker, if there is one; the next press starts another."""
        if self._child is not None:
            self._child.close()
        self._child = None

    async def _work(self, request: PressRequest | DiscardRequest | None) -> None:
        """Start the worker where none runs, and carry out a request."""
        try:
            if self._child is not None and not self._child.is_alive:  # it ended between two readings: the folder holds them
                self._end_worker()
            if self._child is None:
                self._child = Child(WORKER_PROGRAM, is_worker=True)
                await self._ask(replace(self.settings, folder=self.folder))
            if request is not None and self.state is not None:
                await self._ask(request)
        except Failure as fault:
            self._end_worker()
            how = "ended" if isinstance(fault, Died) else "failed"
            self._publish("refused", f"the worker {how}: {fault}; recordings are kept; press again")
        if self.state is None:  # the settings were refused: ask again for the next press
            self._end_worker()
        self._publish("idle", None)

    async def _ask(self, request: object) -> None:
        """Send a request, and publish the messages that answer it."""
        assert self._child is not None
        self._child.send(request)
        while (message := await asyncio.to_thread(self._child.receive)) is not END:
            self._publish(*message)

    def _publish(self, kind: str, content: Any) -> None:
        """Remember the last message of a kind, and pass it on."""
        if kind in ("progress", "refused"):
            self.status = str(content)
        elif kind == "numbers":
            self.numbers = content
        elif kind == "result":
            self.status = ""
            if content is not None:
                self.state = content
        for listener in tuple(self._listeners):
            listener(kind, content)
