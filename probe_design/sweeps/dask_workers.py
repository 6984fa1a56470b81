"""Workers of a Dask cluster: they answer, this process alone writes; workers may die, the scheduler may start anew."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from geometry.common.errors import InputError
from geometry.common.resources import Limits
from probe_design.sweeps.dask_task import answered
from probe_design.sweeps.results import extra
from probe_design.sweeps.rows import Job
from probe_design.sweeps.workers import Batch, CrewError, FinishedBatch, Outcome

PATIENCE = 600.0  # seconds to wait for a scheduler that is gone
CONNECT = 5.0  # seconds to try
POLL = 0.05
FETCH = 5.0  # seconds for rows to come from the worker that has them; it may stand still
ASK = 2.0  # seconds that the scheduler has to say how many workers there are
SILENT = 60.0  # seconds without an answer of the scheduler after which that is told, and told again
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
        self._heard, self._told = time.monotonic(), 0
        try:
            self._check_address()
            self._client: Any = self._connected()
        except (OSError, ValueError, TypeError) as fault:
            self._hush(self._levels)
            reason = " ".join(str(fault).split())[:120]
            raise InputError("scheduler", address, f"the address of a Dask scheduler, tcp://host:8786 ({reason})") from None

    def size(self) -> int:
        """Return how many batches the cluster can work on now; workers come and go."""
        if time.monotonic() - self._counted > 1.0:
            try:
                threads = self._client.sync(self._client.scheduler.ncores, workers=None, callback_timeout=ASK)
            except (OSError, RuntimeError, ValueError, TimeoutError):
                self._unheard()
            else:
                self._workers = max(1, sum(threads.values()))
                self._heard, self._told = time.monotonic(), 0
            self._counted = time.monotonic()
        return self._workers

    def _unheard(self) -> None:
        """Say that the scheduler stands still, once a minute: it may go on, or somebody has to see to it."""
        silent = time.monotonic() - self._heard
        if silent >= (self._told + 1) * SILENT:
            self._told = int(silent // SILENT)
            self._log(f"the Dask scheduler {self._address} has not answered for {silent:.0f} s; start it again, or wait")

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
            if finished or time.monotonic() >= until:
                return finished
            self._hurry()
            time.sleep(POLL)

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
            except (OSError, ValueError):
                if time.monotonic() > until:
                    reason = f"{self._address}: no scheduler for {PATIENCE:g} s; all rows are kept, start again"
                    raise CrewError(reason) from None
                time.sleep(1.0)
        self._log("a Dask scheduler is there again")
        self._heard, self._told = time.monotonic(), 0
        for out in self._out:
            out.futures, out.since = [], time.monotonic()
            self._submit(out)

    def _hush(self, levels: dict[str, int]) -> None:
        for name, level in levels.items():
            logging.getLogger(name).setLevel(level)

    def _check_address(self) -> None:
        """Raise ``ValueError`` for an address of which Dask would say so with a traceback, after half a minute."""
        addressing, backends = extra("distributed.comm.addressing"), extra("distributed.comm.registry").backends
        scheme, place = addressing.parse_address(self._address)
        if scheme not in backends:
            raise ValueError(f"{scheme} is none of {', '.join(sorted(backends))}")
        if scheme in ("tcp", "tls"):
            addressing.parse_host_port(place)

    def _connected(self) -> Any:
        return self._distributed.Client(self._address, timeout=CONNECT, set_as_default=False)

    def _leave(self) -> None:
        for out in self._out:
            for future in out.futures:
                future.release()
        try:
            self._client.close(timeout=5)
        except (OSError, RuntimeError, ValueError, TimeoutError):
            return
