"""Workers of this computer: what one item does costs no other."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from geometry.common.resources import Limits
from geometry.processes.executor import Outcome
from geometry.processes.local_executor import LocalExecutor
from tests.support.jobs import ActJob

POSIX = pytest.mark.skipif(os.name == "nt", reason="signals end processes on POSIX systems only")
Workers = LocalExecutor[str, str]


@pytest.fixture
def executor(tmp_path: Path) -> Iterator[Workers]:
    executor: Workers = LocalExecutor(ActJob(), 1, Limits(seconds=2.0), tmp_path / "log")
    yield executor
    executor.close()


def evaluate(executor: Workers, *items: str) -> Outcome[str]:
    number = executor.submit(items)
    assert executor.count_free() == 0
    ((answered, outcome),) = executor.collect(60.0)
    assert (answered, executor.count_free()) == (number, 1)
    return outcome


@POSIX
def test_a_crash_keeps_the_rows_before_it_and_names_the_signal(executor: Workers) -> None:
    outcome = evaluate(executor, "a", "crash", "b")
    assert (outcome.rows, outcome.unfinished) == (("A",), 1)
    assert outcome.failure.startswith("its process was ended by SIGSEGV: ")
    assert evaluate(executor, "b").rows == ("B",)  # by a new process


def test_a_quiet_exit_is_a_failure_with_its_code(executor: Workers) -> None:
    assert evaluate(executor, "leave").failure.startswith("its process ended with code 0x0: ")


def test_an_item_without_an_end_is_late_and_no_other(executor: Workers) -> None:
    outcome = evaluate(executor, "a", "wait", "b")
    assert (outcome.rows, outcome.unfinished, outcome.is_late) == (("A",), 1, True)
    assert evaluate(executor, "b").rows == ("B",)


def test_noise_past_python_is_no_row(executor: Workers) -> None:
    assert evaluate(executor, "print", "a") == Outcome(("PRINT", "A"))


def test_a_worker_that_cannot_do_the_job_refuses_all_in_one_line(tmp_path: Path) -> None:
    executor: Workers = LocalExecutor(ActJob(refuses=True), 1, Limits(), tmp_path / "log")
    assert evaluate(executor, "a") == Outcome(refusal=f"another version; see {tmp_path / 'log'}")
    executor.close()


def test_closing_ends_what_runs(tmp_path: Path) -> None:
    executor: Workers = LocalExecutor(ActJob(), 1, Limits(seconds=900.0), tmp_path / "log")
    executor.submit(["wait"])
    assert executor.collect(0.5) == []
    executor.close()  # waits for the process's end
    ((_, outcome),) = executor.collect(0.0)
    assert outcome.rows == ()
