"""Evaluate batches on a Dask cluster. Workers may die, and the scheduler may restart."""

from __future__ import annotations

import asyncio
import logging
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import count
from queue import Empty, SimpleQueue
from time import monotonic
from typing import Any, Generic

from geometry.common.errors import InputError, import_extra
from geometry.common.resources import Limits
from geometry.processes.dask_task import evaluate_batch
from geometry.processes.executor import ExecutorError, Item, Job, Outcome, Row

MAX_SCHEDULER_ABSENCE_S = 600.0  # seconds to wait for a lost scheduler to return
CONNECTION_TIMEOUT_S = 5.0  # seconds for a connection, and for each request before there is a client
CLIENT_TIMEOUT_S = 20.0  # seconds in all to create a client, whatever runs at the address
POLL_INTERVAL_S = 0.05  # seconds between looks at the futures
FETCH_TIMEOUT_S = 5.0  # seconds to fetch rows from a worker, which may hang
COUNT_TIMEOUT_S = 2.0  # seconds for the scheduler to return the number of workers
BATCHES_PER_WORKER = 2  # batches queued for each worker, so that none waits for the next
MAX_DASK_FAULTS = 4  # errors of Dask with one batch, other than the death of a worker, before the sweep ends
SLOW_BATCH_FACTOR, MIN_SLOW_BATCH_S = 5.0, 5.0  # times the usual duration, and seconds: slower batches are duplicated
_DASK_ERRORS = (OSError, RuntimeError, ValueError, TimeoutError)  # raised by a client whose scheduler is gone or hangs
_NOISY_LOGGERS = ("distributed", "distributed.client", "tornado.application", "asyncio")  # loggers that report lost connections
SILENCE_INTERVAL_S = 60.0  # seconds without a response between reports of it


class SilenceMonitor:
    """Report once a minute that something has not responded for some time."""

    def __init__(self, log: Callable[[str], None]) -> None:
        self._log = log
        self.reset()

    def reset(self) -> None:
        """Restart the clock after a response."""
        self._start_time, self._report_count = monotonic(), 0

    def report(self, text: str, remedy: str, min_silence: float = 0.0) -> None:
        """Log ``text`` with the silent time and a remedy, once a minute and not before ``min_silence`` seconds."""
        seconds = monotonic() - self._start_time
        if seconds >= max((self._report_count + 1) * SILENCE_INTERVAL_S, min_silence):
            self._report_count = int(seconds // SILENCE_INTERVAL_S)
            self._log(f"{text} for {seconds:.0f} s; {remedy}, or wait")


@dataclass
class _SubmittedBatch(Generic[Item]):
    """A batch that the cluster works on, as one or more futures."""

    number: int
    items: Sequence[Item]
    submit_time: float
    futures: list[Any] = field(default_factory=list)
    faults: int = 0


class DaskExecutor(Generic[Item, Row]):
    """The workers of a Dask scheduler; see ``executor.Executor``."""

    def __init__(self, job: Job[Item, Row], address: str, limits: Limits, log: Callable[[str], None]) -> None:
        """Connect to a scheduler.

        Parameters
        ----------
        job : Job
            What is done with all items.
        address : str
            Of the scheduler.
        limits : Limits
            Time and memory of each item.
        log : callable
            Called with a line when the scheduler is lost and when it returns.

        Raises
        ------
        InputError
            There is no scheduler at the address.
        MissingLibrary
            Dask is not installed.
        """
        self._distributed, self._job, self._limits, self._address = import_extra("distributed"), job, limits, address
        self._log = log
        self._log_levels = {name: logging.getLogger(name).level for name in _NOISY_LOGGERS}
        self._set_log_levels(dict.fromkeys(_NOISY_LOGGERS, logging.CRITICAL + 1))  # lost connections are handled here
        self._numbers = count()
        self._submitted: list[_SubmittedBatch[Item]] = []
        self._usual_seconds: float | None = None
        self._count_time, self._worker_count = -1.0, 1
        self._scheduler_silence, self._worker_silence = SilenceMonitor(log), SilenceMonitor(log)
        try:
            _check_address(address)
            self._client: Any = self._connect_client()
        except Exception as fault:  # Dask may raise anything, even MemoryError for a bad message length
            self._set_log_levels(self._log_levels)
            reason = " ".join(str(fault).split())[:120] or "no response in time"
            raise InputError("scheduler", address, f"the address of a Dask scheduler, tcp://host:8786 ({reason})") from None

    def count_workers(self) -> int:
        """Return how many batches the cluster can evaluate at once now: its threads, at least 1.

        The scheduler is asked at most once a second, else the last number is returned.
        """
        if time.monotonic() - self._count_time > 1.0:
            try:
                threads = self._client.sync(self._client.scheduler.ncores, workers=None, callback_timeout=COUNT_TIMEOUT_S)
            except _DASK_ERRORS:
                self._report_scheduler("has not responded", "start it again")
            else:
                self._worker_count = max(1, sum(threads.values()))
                if threads:
                    self._scheduler_silence.reset()
                else:
                    self._report_scheduler("has had no worker", "start one")
            self._count_time = time.monotonic()
        return self._worker_count

    def count_free(self) -> int:
        """Return how many more batches can be submitted now; 0 or less for none."""
        return BATCHES_PER_WORKER * self.count_workers() - len(self._submitted)

    def submit(self, items: Sequence[Item]) -> int:
        """Submit a batch to the scheduler."""
        submitted = _SubmittedBatch(next(self._numbers), items, time.monotonic())
        self._submitted.append(submitted)
        self._start_attempt(submitted)
        return submitted.number

    def collect(self, seconds: float) -> list[tuple[int, Outcome[Row]]]:
        """Wait at most ``seconds`` for finished batches; reconnect to a lost scheduler."""
        deadline = time.monotonic() + seconds
        while True:
            if self._client.status != "running":
                self._reconnect()
            self.count_workers()  # reports a scheduler that hangs
            outcomes = [(submitted.number, self._poll_batch(submitted)) for submitted in list(self._submitted)]
            finished = [(number, outcome) for number, outcome in outcomes if outcome is not None]
            if finished or not self._submitted:
                self._worker_silence.reset()
            self._report_workers()
            if finished or time.monotonic() >= deadline:
                return finished
            self._duplicate_slow_batches()
            time.sleep(POLL_INTERVAL_S)

    def _report_scheduler(self, text: str, remedy: str) -> None:
        """Report what the scheduler has (not) done, ``text``, and a remedy; silent workers are then not reported as well."""
        self._scheduler_silence.report(f"the Dask scheduler {self._address} {text}", remedy)
        self._worker_silence.reset()

    def _report_workers(self) -> None:
        """Report that no batch has finished for longer than expected."""
        max_silence = self._limits.seconds if self._usual_seconds is None else SLOW_BATCH_FACTOR * self._usual_seconds
        self._worker_silence.report("no Dask worker has responded", "see to them", min_silence=max_silence)

    def close(self) -> None:
        """Disconnect from the cluster; running batches are cancelled."""
        self._disconnect()
        self._set_log_levels(self._log_levels)

    def _start_attempt(self, submitted: _SubmittedBatch[Item]) -> None:
        """Start one more attempt at a batch; a lost scheduler is noticed later, in ``collect``."""
        with suppress(*_DASK_ERRORS):
            submitted.futures.append(self._client.submit(evaluate_batch, self._job, self._limits, submitted.items, pure=False))

    def _poll_batch(self, submitted: _SubmittedBatch[Item]) -> Outcome[Row] | None:
        """Return the outcome of a batch if one of its futures has it; start it again if all of them were lost."""
        for future in list(submitted.futures):
            if future.status not in ("finished", "error", "cancelled", "lost"):
                continue
            if (outcome := self._read_outcome(submitted, future)) is not None:
                self._finish_batch(submitted)
                return outcome
            submitted.futures.remove(future)  # its worker died before the rows were fetched, or Dask failed
            # if that was the last attempt, the next one starts below, and its time counts from now
            submitted.submit_time = submitted.submit_time if submitted.futures else time.monotonic()
        if not submitted.futures:
            self._start_attempt(submitted)
        return None

    def _read_outcome(self, submitted: _SubmittedBatch[Item], future: Any) -> Outcome[Row] | None:
        """Return the outcome of a future that has ended, or None if the batch is to be tried again."""
        fault = None  # also of a future that was cancelled or lost together with the scheduler
        with suppress(Exception):  # whatever goes wrong on the way: the batch is computed again
            if future.status == "finished":
                outcome: Outcome[Row] = future.result(timeout=FETCH_TIMEOUT_S)
                return outcome
            if future.status == "error":
                fault = future.exception(timeout=FETCH_TIMEOUT_S)
        if isinstance(fault, self._distributed.scheduler.KilledWorker):
            return Outcome(unfinished=len(submitted.items), failure="the Dask workers that held it died")
        submitted.faults += fault is not None
        if submitted.faults < MAX_DASK_FAULTS:
            return None
        reason = " ".join(f"{type(fault).__name__}: {fault}".split())[:300]
        return Outcome(refusal=f"Dask workers cannot run this program, of this version ({reason})")

    def _finish_batch(self, submitted: _SubmittedBatch[Item]) -> None:
        """Release the futures of a batch and update the usual duration of batches, a moving average."""
        self._submitted.remove(submitted)
        seconds = time.monotonic() - submitted.submit_time
        self._usual_seconds = seconds if self._usual_seconds is None else 0.8 * self._usual_seconds + 0.2 * seconds
        for future in submitted.futures:
            future.release()  # Dask stops futures without references

    def _duplicate_slow_batches(self) -> None:
        """Give batches that take far too long to a second worker, when workers are idle."""
        if self._usual_seconds is None or self.count_free() <= 0:
            return
        for submitted in self._submitted:
            if len(submitted.futures) == 1 and time.monotonic() - submitted.submit_time > max(
                SLOW_BATCH_FACTOR * self._usual_seconds, MIN_SLOW_BATCH_S
            ):
                self._log(f"a batch of {len(submitted.items)} designs takes long and is given to another worker too")
                self._start_attempt(submitted)

    def _reconnect(self) -> None:
        """Reconnect to the scheduler and submit all unfinished batches again."""
        self._log("the Dask scheduler is gone")
        self._disconnect()
        deadline = time.monotonic() + MAX_SCHEDULER_ABSENCE_S
        while True:
            try:
                self._client = self._connect_client()
                break
            except Exception:  # any, as in __init__
                if time.monotonic() > deadline:
                    reason = f"{self._address}: no scheduler for {MAX_SCHEDULER_ABSENCE_S:g} s; all rows are kept, start again"
                    raise ExecutorError(reason) from None
                self._report_scheduler("has been gone", "start it again")
                time.sleep(1.0)
        self._log("a Dask scheduler is there again")
        self._scheduler_silence.reset()
        for submitted in self._submitted:
            submitted.futures, submitted.submit_time = [], time.monotonic()
            self._start_attempt(submitted)

    def _set_log_levels(self, levels: dict[str, int]) -> None:
        """Set the levels of loggers, by name."""
        for name, level in levels.items():
            logging.getLogger(name).setLevel(level)

    def _connect_client(self) -> Any:
        """Return a client. Raises whatever Dask raises where there is no scheduler, ``TimeoutError`` without a response."""
        # in a thread that can be abandoned, as Dask may hang
        responses: SimpleQueue[Any] = SimpleQueue()

        def connect() -> None:
            try:
                asyncio.run(asyncio.wait_for(_check_scheduler(self._address), 2 * CONNECTION_TIMEOUT_S))
                responses.put(self._distributed.Client(self._address, timeout=CONNECTION_TIMEOUT_S, set_as_default=False))
            except Exception as fault:
                responses.put(fault)

        threading.Thread(target=connect, daemon=True).start()
        try:
            client_or_fault = responses.get(timeout=CLIENT_TIMEOUT_S)
        except Empty:
            raise TimeoutError(f"no response within {CLIENT_TIMEOUT_S:g} s") from None
        if isinstance(client_or_fault, Exception):
            raise client_or_fault
        return client_or_fault

    def _disconnect(self) -> None:
        """Release all futures and close the client."""
        for submitted in self._submitted:
            for future in submitted.futures:
                future.release()
        with suppress(*_DASK_ERRORS):
            self._client.close(timeout=5)


def _check_address(address: str) -> None:
    """Raise ``ValueError`` for a malformed address at once: Dask needs half a minute, and prints a traceback."""
    addressing, backends = import_extra("distributed.comm.addressing"), import_extra("distributed.comm.registry").backends
    scheme, place = addressing.parse_address(address)
    if scheme not in backends:
        raise ValueError(f"{scheme} is none of {', '.join(sorted(backends))}")
    if scheme in ("tcp", "tls"):
        addressing.parse_host_port(place)


async def _check_scheduler(address: str) -> None:
    """Check that a Dask scheduler runs at an address: Dask's own client would wait for ever, and leaves threads behind."""
    async with import_extra("distributed.core").rpc(address, timeout=CONNECTION_TIMEOUT_S) as remote:
        try:
            identity = await remote.identity()
        except (OSError, TypeError, ImportError):  # no connection, or no such protocol
            raise
        except Exception:  # another protocol: a wrong message length may raise anything
            raise ConnectionError("what responds there is no Dask scheduler") from None
    if identity.get("type") != "Scheduler":
        raise ConnectionError(f"what responds there is a Dask {identity.get('type')}")
