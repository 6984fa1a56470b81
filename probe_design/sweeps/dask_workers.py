"""Worker pool on a Dask cluster. Workers evaluate, only this process writes. Workers may die and the scheduler may restart."""

from __future__ import annotations

import asyncio
import logging
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from queue import Empty, SimpleQueue
from typing import Any

from geometry.common.errors import InputError
from geometry.common.resources import Limits
from probe_design.sweeps.dask_task import answered
from probe_design.sweeps.progress import Silence
from probe_design.sweeps.results import extra
from probe_design.sweeps.rows import Job
from probe_design.sweeps.workers import Batch, CrewError, FinishedBatch, Outcome

PATIENCE = 600.0  # seconds to wait for a lost scheduler to return
TRY = 5.0  # seconds for a connection, and for each request before there is a client
CONNECT = 20.0  # seconds in all to create a client, whatever runs at the address
POLL = 0.05  # seconds between looks at the futures
FETCH = 5.0  # seconds to fetch rows from a worker, which may hang
ASK = 2.0  # seconds for the scheduler to return the number of workers
AHEAD = 2  # batches queued for each worker, so that none waits for the next
FAULTS = 4  # errors of Dask with one batch, other than the death of a worker, before the sweep ends
SLOW, LEAST = 5.0, 5.0  # times the usual duration, and seconds: slower batches are duplicated
_LOUD = ("distributed", "distributed.client", "tornado.application", "asyncio")  # loggers that report lost connections


@dataclass
class _Out:
    """A batch that the cluster works on, as one or more futures."""

    batch: Batch
    since: float
    futures: list[Any] = field(default_factory=list)
    faults: int = 0


class DaskCrew:
    """The worker pool of a Dask scheduler; see ``workers.WorkerPool``."""

    def __init__(self, job: Job, address: str, limits: Limits, log: Callable[[str], None]) -> None:
        """Connect to a scheduler.

        Args:
            job: settings shared by all designs.
            address: of the scheduler.
            limits: time and memory of each design.
            log: called with a line when the scheduler is lost and when it returns.

        Raises:
            InputError: there is no scheduler at the address.
            MissingLibrary: Dask is not installed.
        """
        self._distributed, self._job, self._limits, self._address = extra("distributed"), job, limits, address
        self._log = log
        self._levels = {name: logging.getLogger(name).level for name in _LOUD}
        self._hush(dict.fromkeys(_LOUD, logging.CRITICAL + 1))  # lost connections are handled here
        self._out: list[_Out] = []
        self._usual: float | None = None
        self._counted, self._workers = -1.0, 1
        self._scheduler, self._answers = Silence(log), Silence(log)
        try:
            _check_address(address)
            self._client: Any = self._connected()
        except Exception as fault:  # Dask may raise anything, even MemoryError for a bad message length
            self._hush(self._levels)
            reason = " ".join(str(fault).split())[:120] or "no answer in time"
            raise InputError("scheduler", address, f"the address of a Dask scheduler, tcp://host:8786 ({reason})") from None

    def size(self) -> int:
        """Return how many batches the cluster can evaluate at once now; asked at most once a second."""
        if time.monotonic() - self._counted > 1.0:
            try:
                threads = self._client.sync(self._client.scheduler.ncores, workers=None, callback_timeout=ASK)
            except (OSError, RuntimeError, ValueError, TimeoutError):
                self._waits("has not answered", "start it again")
            else:
                self._workers = max(1, sum(threads.values()))
                if threads:
                    self._scheduler.heard()
                else:
                    self._waits("has had no worker", "start one")
            self._counted = time.monotonic()
        return self._workers

    def free(self) -> int:
        """Return how many more batches can be submitted."""
        return AHEAD * self.size() - len(self._out)

    def give(self, batch: Batch) -> None:
        """Submit a batch to the scheduler."""
        out = _Out(batch, time.monotonic())
        self._out.append(out)
        self._submit(out)

    def take(self, seconds: float) -> list[FinishedBatch]:
        """Wait at most ``seconds`` for finished batches; reconnect to a lost scheduler."""
        until = time.monotonic() + seconds
        while True:
            if self._client.status != "running":
                self._again()
            self.size()  # reports a scheduler that hangs
            finished = [answer for out in list(self._out) if (answer := self._answer(out)) is not None]
            if finished or not self._out:
                self._answers.heard()
            self._missed()
            if finished or time.monotonic() >= until:
                return finished
            self._hurry()
            time.sleep(POLL)

    def _waits(self, text: str, remedy: str) -> None:
        """Report a problem of the scheduler; silent workers are then not reported as well."""
        self._scheduler.tell(f"the Dask scheduler {self._address} {text}", remedy)
        self._answers.heard()

    def _missed(self) -> None:
        """Report that no batch has finished for longer than expected."""
        enough = self._limits.seconds if self._usual is None else SLOW * self._usual
        self._answers.tell("no Dask worker has answered", "see to them", after=enough)

    def close(self) -> None:
        """Disconnect from the cluster; running batches are cancelled."""
        self._leave()
        self._hush(self._levels)

    def _submit(self, out: _Out) -> None:
        """Start one more attempt at a batch; a lost scheduler is noticed later, in ``collect``."""
        try:
            designs = tuple(task.values for task in out.batch)
            out.futures.append(self._client.submit(answered, self._job, self._limits, designs, pure=False))
        except (OSError, RuntimeError, ValueError):
            return

    def _answer(self, out: _Out) -> FinishedBatch | None:
        """Return a batch if one of its futures is finished; start it again if they were lost."""
        for future in list(out.futures):
            if future.status == "finished":
                outcome = self._fetched(future)
            elif future.status in ("error", "cancelled", "lost"):
                outcome = self._failed(out, future)
            else:
                continue
            if outcome is not None:
                self._done(out)
                return FinishedBatch(out.batch, outcome)
            out.futures.remove(future)  # its worker died before the rows were fetched, or Dask failed
            if not out.futures:
                out.since = time.monotonic()
                self._submit(out)
        if not out.futures:
            self._submit(out)
        return None

    def _failed(self, out: _Out, future: Any) -> Outcome | None:
        """Return the outcome of a failed future, or None if the batch is to be tried again."""
        if future.status != "error":  # cancelled or lost together with the scheduler
            return None
        fault = self._fault(future)
        if isinstance(fault, self._distributed.scheduler.KilledWorker):
            return Outcome(held=len(out.batch), ended="the Dask workers that held it died")
        out.faults += fault is not None
        if out.faults < FAULTS:
            return None
        reason = " ".join(f"{type(fault).__name__}: {fault}".split())[:300]
        return Outcome(refused=f"Dask workers cannot run this program, of this version ({reason})")

    def _fetched(self, future: Any) -> Outcome | None:
        """Fetch the outcome of a finished future, or return None."""
        try:
            outcome: Outcome = future.result(timeout=FETCH)
            return outcome
        except Exception:  # whatever went wrong on the way: the batch is computed again
            return None

    def _fault(self, future: Any) -> BaseException | None:
        """Fetch the exception of a failed future, or return None."""
        try:
            fault: BaseException | None = future.exception(timeout=5)
            return fault
        except Exception:
            return None

    def _done(self, out: _Out) -> None:
        """Release the futures of a batch and update the usual duration."""
        self._out.remove(out)
        took = time.monotonic() - out.since
        self._usual = took if self._usual is None else 0.8 * self._usual + 0.2 * took
        for future in out.futures:
            future.release()  # Dask stops futures that nobody holds

    def _hurry(self) -> None:
        """Give batches that take far too long to a second worker, when workers are idle."""
        if self._usual is None or self.free() <= 0:
            return
        for out in self._out:
            if len(out.futures) == 1 and time.monotonic() - out.since > max(SLOW * self._usual, LEAST):
                self._log(f"a batch of {len(out.batch)} designs takes long and is given to another worker too")
                self._submit(out)

    def _again(self) -> None:
        """Reconnect to the scheduler and submit all unfinished batches again."""
        self._log("the Dask scheduler is gone")
        self._leave()
        until = time.monotonic() + PATIENCE
        while True:
            try:
                self._client = self._connected()
                break
            except Exception:  # any, as in __init__
                if time.monotonic() > until:
                    reason = f"{self._address}: no scheduler for {PATIENCE:g} s; all rows are kept, start again"
                    raise CrewError(reason) from None
                self._waits("has been gone", "start it again")
                time.sleep(1.0)
        self._log("a Dask scheduler is there again")
        self._scheduler.heard()
        for out in self._out:
            out.futures, out.since = [], time.monotonic()
            self._submit(out)

    def _hush(self, levels: dict[str, int]) -> None:
        for name, level in levels.items():
            logging.getLogger(name).setLevel(level)

    def _connected(self) -> Any:
        """Return a client. Raises whatever Dask raises where there is no scheduler, ``TimeoutError`` without a response."""
        done: SimpleQueue[Any] = SimpleQueue()

        def connect() -> None:
            try:
                asyncio.run(asyncio.wait_for(_greet(self._address), 2 * TRY))
                done.put(self._distributed.Client(self._address, timeout=TRY, set_as_default=False))
            except Exception as fault:
                done.put(fault)

        threading.Thread(target=connect, daemon=True).start()
        try:
            found = done.get(timeout=CONNECT)
        except Empty:
            raise TimeoutError(f"no answer within {CONNECT:g} s") from None
        if isinstance(found, Exception):
            raise found
        return found

    def _leave(self) -> None:
        """Release all futures and close the client."""
        for out in self._out:
            for future in out.futures:
                future.release()
        try:
            self._client.close(timeout=5)
        except (OSError, RuntimeError, ValueError, TimeoutError):
            return


def _check_address(address: str) -> None:
    """Raise ``ValueError`` for a malformed address at once: Dask needs half a minute, and prints a traceback."""
    addressing, backends = extra("distributed.comm.addressing"), extra("distributed.comm.registry").backends
    scheme, place = addressing.parse_address(address)
    if scheme not in backends:
        raise ValueError(f"{scheme} is none of {', '.join(sorted(backends))}")
    if scheme in ("tcp", "tls"):
        addressing.parse_host_port(place)


async def _greet(address: str) -> None:
    """Check that a Dask scheduler runs at an address: Dask's own client would wait for ever, and leaves threads behind."""
    async with extra("distributed.core").rpc(address, timeout=TRY) as remote:
        try:
            identity = await remote.identity()
        except (OSError, TypeError, ImportError):  # no connection, or no such protocol
            raise
        except Exception:  # another protocol: a wrong message length may raise anything
            raise ConnectionError("what answers there is no Dask scheduler") from None
    if identity.get("type") != "Scheduler":
        raise ConnectionError(f"what answers there is a Dask {identity.get('type')}")
