"""Evaluate batches on a Dask cluster, whose workers may die; a sweep that lost its scheduler is started again and goes on."""

from __future__ import annotations

import asyncio
import logging
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import count
from queue import Empty, SimpleQueue
from typing import Any, Generic

from geometry.common.errors import InputError, import_extra
from geometry.common.resources import Limits
from geometry.processes.dask_task import evaluate_batch
from geometry.processes.executor import ExecutorError, Item, Job, Outcome, Row

CONNECTION_TIMEOUT_S = 5.0  # seconds for a connection, and for each request before there is a client
CLIENT_TIMEOUT_S = 20.0  # seconds in all to create a client, whatever runs at the address
POLL_INTERVAL_S = 0.05  # seconds between looks at the futures
FETCH_TIMEOUT_S = 5.0  # seconds to fetch rows from a worker, which may hang
COUNT_TIMEOUT_S = 2.0  # seconds for the scheduler to return the number of workers
BATCHES_PER_WORKER = 2  # batches queued for each worker, so that none waits for the next
MAX_DASK_FAULTS = 4  # errors of Dask with one batch, other than the death of a worker, before the sweep ends
SILENCE_INTERVAL_S = 60.0  # seconds without a finished batch between reports of it
_NOISY_LOGGERS = ("distributed", "distributed.client", "tornado.application", "asyncio")  # loggers that report lost connections
_DASK_ERRORS = (OSError, RuntimeError, ValueError, TimeoutError)  # raised by a client whose scheduler is gone or hangs


@dataclass
class _SubmittedBatch(Generic[Item]):
    """A batch that the cluster works on, its future, and how often Dask failed with it."""

    items: Sequence[Item]
    future: Any
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
            Called with a line when the cluster does not respond.

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
        self._submitted: dict[int, _SubmittedBatch[Item]] = {}
        self._count_time, self._worker_count = -1.0, 1
        self._last_time, self._reports = time.monotonic(), 0  # of the last finished batch, and how often silence was reported
        try:
            _check_address(address)
            self._client: Any = self._connect_client()
        except Exception as fault:  # Dask may raise anything, even MemoryError for a bad message length
            self._set_log_levels(self._log_levels)
            reason = " ".join(str(fault).split())[:120] or "no answer in time"
            raise InputError("scheduler", address, f"the address of a Dask scheduler, tcp://host:8786 ({reason})") from None

    def count_workers(self) -> int:
        """Return how many batches the cluster can evaluate at once now; asked at most once a second."""
        if time.monotonic() - self._count_time > 1.0:
            with suppress(*_DASK_ERRORS):
                threads = self._client.sync(self._client.scheduler.ncores, workers=None, callback_timeout=COUNT_TIMEOUT_S)
                self._worker_count = max(1, sum(threads.values()))
            self._count_time = time.monotonic()
        return self._worker_count

    def count_free(self) -> int:
        """Return how many more batches can be submitted."""
        return BATCHES_PER_WORKER * self.count_workers() - len(self._submitted)

    def submit(self, items: Sequence[Item]) -> int:
        """Submit a batch to the scheduler."""
        number = next(self._numbers)
        self._submitted[number] = _SubmittedBatch(items, self._start(items))
        return number

    def collect(self, seconds: float) -> list[tuple[int, Outcome[Row]]]:
        """Wait at most ``seconds`` for finished batches.

        Raises
        ------
        ExecutorError
            The scheduler is lost.
        """
        deadline = time.monotonic() + seconds
        while True:
            if self._client.status != "running":
                raise self._build_loss_error()
            outcomes = {number: self._find_outcome(submitted) for number, submitted in self._submitted.items()}
            finished = [(number, outcome) for number, outcome in outcomes.items() if outcome is not None]
            for number, _ in finished:
                self._submitted.pop(number).future.release()
            self._report_silence(has_news=bool(finished) or not self._submitted)
            if finished or time.monotonic() >= deadline:
                return finished
            time.sleep(POLL_INTERVAL_S)

    def close(self) -> None:
        """Disconnect from the cluster; running batches are cancelled."""
        for submitted in self._submitted.values():
            submitted.future.release()
        with suppress(*_DASK_ERRORS):
            self._client.close(timeout=5)
        self._set_log_levels(self._log_levels)

    def _start(self, items: Sequence[Item]) -> Any:
        """Return the future of a batch. Raises ``ExecutorError``."""
        try:
            return self._client.submit(evaluate_batch, self._job, self._limits, items, pure=False)
        except _DASK_ERRORS:
            raise self._build_loss_error() from None

    def _build_loss_error(self) -> ExecutorError:
        return ExecutorError(f"{self._address}: the Dask scheduler is gone; all rows are kept, start again")

    def _find_outcome(self, submitted: _SubmittedBatch[Item]) -> Outcome[Row] | None:
        """Return the outcome of a batch, or None if it is not finished; start it again if its worker or Dask failed."""
        status = submitted.future.status
        if status == "finished":
            with suppress(Exception):  # whatever goes wrong on the way: the batch is computed again
                outcome: Outcome[Row] = submitted.future.result(timeout=FETCH_TIMEOUT_S)
                return outcome
        elif status == "error":
            if (failed := self._read_failure(submitted)) is not None:
                return failed
        elif status not in ("cancelled", "lost"):
            return None
        submitted.future = self._start(submitted.items)
        return None

    def _read_failure(self, submitted: _SubmittedBatch[Item]) -> Outcome[Row] | None:
        """Return the outcome of a batch whose future failed, or None if it is to be tried again."""
        fault = None
        with suppress(Exception):  # of fetching the exception
            fault = submitted.future.exception(timeout=FETCH_TIMEOUT_S)
        if isinstance(fault, self._distributed.scheduler.KilledWorker):
            return Outcome(unfinished=len(submitted.items), failure="the Dask workers that held it died")
        submitted.faults += fault is not None
        if submitted.faults < MAX_DASK_FAULTS:
            return None
        reason = " ".join(f"{type(fault).__name__}: {fault}".split())[:300]
        return Outcome(refusal=f"Dask workers cannot run this program, of this version ({reason})")

    def _report_silence(self, has_news: bool) -> None:
        """Report once a minute that no batch has finished."""
        now = time.monotonic()
        if has_news:
            self._last_time, self._reports = now, 0
        elif now - self._last_time >= (self._reports + 1) * SILENCE_INTERVAL_S:
            self._reports = int((now - self._last_time) // SILENCE_INTERVAL_S)
            silence = f"nothing has come from the Dask cluster {self._address} for {now - self._last_time:.0f} s"
            self._log(f"{silence}; see to its scheduler and workers, or wait")

    def _set_log_levels(self, levels: dict[str, int]) -> None:
        for name, level in levels.items():
            logging.getLogger(name).setLevel(level)

    def _connect_client(self) -> Any:
        """Return a client. Raises whatever Dask raises where there is no scheduler, ``TimeoutError`` without a response."""
        answers: SimpleQueue[Any] = SimpleQueue()

        def connect() -> None:
            try:
                asyncio.run(asyncio.wait_for(_check_scheduler(self._address), 2 * CONNECTION_TIMEOUT_S))
                answers.put(self._distributed.Client(self._address, timeout=CONNECTION_TIMEOUT_S, set_as_default=False))
            except Exception as fault:
                answers.put(fault)

        threading.Thread(target=connect, daemon=True).start()
        try:
            client_or_fault = answers.get(timeout=CLIENT_TIMEOUT_S)
        except Empty:
            raise TimeoutError(f"no answer within {CLIENT_TIMEOUT_S:g} s") from None
        if isinstance(client_or_fault, Exception):
            raise client_or_fault
        return client_or_fault


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
            raise ConnectionError("what answers there is no Dask scheduler") from None
    if identity.get("type") != "Scheduler":
        raise ConnectionError(f"what answers there is a Dask {identity.get('type')}")
