"""Workers of a Dask cluster: they answer, this process alone writes; workers may die, the scheduler may start anew."""

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

PATIENCE = 600.0  # seconds to wait for a scheduler that is gone
TRY = 5.0  # seconds for a connection, and for each question before there is a client
CONNECT = 20.0  # seconds for a client in all, whatever answers at the address, or does not
POLL = 0.05
FETCH = 5.0  # seconds for rows to come from the worker that has them; it may stand still
ASK = 2.0  # seconds that the scheduler has to say how many workers there are
AHEAD = 2  # batches for each worker, so that none waits for the next
FAULTS = 4  # of Dask's workers with one batch that are no death, as of those without this program, before the sweep ends
SLOW, LEAST = 5.0, 5.0  # a batch that takes that many times the usual, and seconds, is given to another worker too at the end
_LOUD = ("distributed", "distributed.client", "tornado.application", "asyncio")  # loggers that tell of connections lost


@dataclass
class _Out:
    """A batch that is out, as one or more futures."""

    batch: Batch
    since: float
    futures: list[Any] = field(default_factory=list)
    faults: int = 0


class DaskCrew:
    """The workers of a scheduler."""

    def __init__(self, job: Job, address: str, limits: Limits, log: Callable[[str], None]) -> None:
        """Connect.

        Args:
            job: what all designs share.
            address: of the scheduler.
            limits: of each design.
            log: called with a line when the scheduler goes and comes back.

        Raises:
            InputError: there is no scheduler at the address.
            MissingLibrary: Dask is not installed.
        """
        self._distributed, self._job, self._limits, self._address = extra("distributed"), job, limits, address
        self._log = log
        self._levels = {name: logging.getLogger(name).level for name in _LOUD}
        self._hush(dict.fromkeys(_LOUD, logging.CRITICAL + 1))  # a connection that is lost is no news here, nor a traceback
        self._out: list[_Out] = []
        self._usual: float | None = None
        self._counted, self._workers = -1.0, 1
        self._scheduler, self._answers = Silence(log), Silence(log)
        try:
            _check_address(address)
            self._client: Any = self._connected()
        except Exception as fault:  # Dask raises what it likes, up to a MemoryError for what is no length of a message
            self._hush(self._levels)
            reason = " ".join(str(fault).split())[:120] or "no answer in time"
            raise InputError("scheduler", address, f"the address of a Dask scheduler, tcp://host:8786 ({reason})") from None

    def size(self) -> int:
        """Return how many batches the cluster can work on now; workers come and go."""
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
        """Return how many more batches the cluster may be given."""
        return AHEAD * self.size() - len(self._out)

    def give(self, batch: Batch) -> None:
        """Hand a batch to the scheduler."""
        out = _Out(batch, time.monotonic())
        self._out.append(out)
        self._submit(out)

    def take(self, seconds: float) -> list[FinishedBatch]:
        """Wait for answers, at most that long; reconnect to a scheduler that has gone."""
        until = time.monotonic() + seconds
        while True:
            if self._client.status != "running":
                self._again()
            self.size()  # one that stands still is told of
            finished = [answer for out in list(self._out) if (answer := self._answer(out)) is not None]
            if finished or not self._out:
                self._answers.heard()
            self._missed()
            if finished or time.monotonic() >= until:
                return finished
            self._hurry()
            time.sleep(POLL)

    def _waits(self, text: str, remedy: str) -> None:
        """Say what is wrong with the scheduler; that nothing else is heard either is no news then."""
        self._scheduler.tell(f"the Dask scheduler {self._address} {text}", remedy)
        self._answers.heard()

    def _missed(self) -> None:
        """Say that no worker answers, where they take longer than they should."""
        enough = self._limits.seconds if self._usual is None else SLOW * self._usual
        self._answers.tell("no Dask worker has answered", "see to them", after=enough)

    def close(self) -> None:
        """Leave the cluster; what it works on is cancelled."""
        self._leave()
        self._hush(self._levels)

    def _submit(self, out: _Out) -> None:
        """Start a batch once more; a scheduler that has gone is noticed when answers are awaited."""
        try:
            designs = tuple(task.values for task in out.batch)
            out.futures.append(self._client.submit(answered, self._job, self._limits, designs, pure=False))
        except (OSError, RuntimeError, ValueError):
            return

    def _answer(self, out: _Out) -> FinishedBatch | None:
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
            out.futures.remove(future)  # its worker went before the answer was fetched, or something of Dask's own
            if not out.futures:
                out.since = time.monotonic()
                self._submit(out)
        if not out.futures:
            self._submit(out)
        return None

    def _failed(self, out: _Out, future: Any) -> Outcome | None:
        """What a future without answer says of its batch; None where that is to be tried again."""
        if future.status != "error":  # cancelled or lost, with its scheduler
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
        try:
            outcome: Outcome = future.result(timeout=FETCH)
            return outcome
        except Exception:  # whatever happened to it on its way, it is computed again
            return None

    def _fault(self, future: Any) -> BaseException | None:
        try:
            fault: BaseException | None = future.exception(timeout=5)
            return fault
        except Exception:
            return None

    def _done(self, out: _Out) -> None:
        self._out.remove(out)
        took = time.monotonic() - out.since
        self._usual = took if self._usual is None else 0.8 * self._usual + 0.2 * took
        for future in out.futures:
            future.release()  # Dask stops what nobody wants any more

    def _hurry(self) -> None:
        """Give batches that take far too long to another worker too, when workers have nothing else to do."""
        if self._usual is None or self.free() <= 0:
            return
        for out in self._out:
            if len(out.futures) == 1 and time.monotonic() - out.since > max(SLOW * self._usual, LEAST):
                self._log(f"a batch of {len(out.batch)} designs takes long and is given to another worker too")
                self._submit(out)

    def _again(self) -> None:
        """Connect anew and hand out everything that was out."""
        self._log("the Dask scheduler is gone")
        self._leave()
        until = time.monotonic() + PATIENCE
        while True:
            try:
                self._client = self._connected()
                break
            except Exception:  # as in the beginning
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
        """Return a client. Raises whatever Dask does where there is no scheduler, ``TimeoutError`` where nothing is said."""
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
        for out in self._out:
            for future in out.futures:
                future.release()
        try:
            self._client.close(timeout=5)
        except (OSError, RuntimeError, ValueError, TimeoutError):
            return


def _check_address(address: str) -> None:
    """Raise ``ValueError`` for an address of which Dask would say so with a traceback, after half a minute."""
    addressing, backends = extra("distributed.comm.addressing"), extra("distributed.comm.registry").backends
    scheme, place = addressing.parse_address(address)
    if scheme not in backends:
        raise ValueError(f"{scheme} is none of {', '.join(sorted(backends))}")
    if scheme in ("tcp", "tls"):
        addressing.parse_host_port(place)


async def _greet(address: str) -> None:
    """Ask who is there: Dask's own client waits for ever for an answer, and leaves much behind where there is none."""
    async with extra("distributed.core").rpc(address, timeout=TRY) as remote:
        try:
            identity = await remote.identity()
        except (OSError, TypeError, ImportError):  # there is no connection, or no such kind of one
            raise
        except Exception:  # whatever comes of what it takes for the length of a message
            raise ConnectionError("what answers there is no Dask scheduler") from None
    if identity.get("type") != "Scheduler":
        raise ConnectionError(f"what answers there is a Dask {identity.get('type')}")
