import threading
from contextvars import copy_context

import pytest

from geometry.common import resources as module
from geometry.common.errors import InputError, Refusal
from geometry.common.resources import (
    LimitReached,
    Limits,
    check_memory,
    check_time,
    find_seconds_left,
    get_limits,
    start_clock,
    use_limits,
)


@pytest.fixture
def clock(monkeypatch):
    """A clock that shows the times that it was given."""
    now = [1000.0]
    monkeypatch.setattr(module.time, "monotonic", lambda: now[0])
    return now


def test_what_passes_the_memory_is_refused_with_what_it_takes_and_the_option():
    check_memory("factors", 1.7e9)
    with pytest.raises(LimitReached, match=r"memory = 2 GB: allowed: 5\.4 GB or more.*for factors \(--memory"):
        check_memory("factors", 5.15e9)
    with use_limits(Limits(memory=6e9)):
        check_memory("factors", 5.15e9)


def test_what_is_said_to_be_allowed_is_more_than_what_was_refused():
    """2.02 GB of a limit of 2 GB read "allowed: 2 GB or more"."""
    with pytest.raises(LimitReached, match=r"memory = 2 GB: allowed: 2\.1 GB or more"):
        check_memory("factors", 1.77e9)
    assert Limits() == Limits(2e9, 120.0)


def test_the_clock_of_an_answer_runs_from_its_question(clock):
    check_time("solving", 1e9)  # no clock is running
    with use_limits(Limits()), start_clock():
        clock[0] += 100
        check_time("solving", 19)
        with start_clock():  # a part of the same answer
            assert find_seconds_left() == 20
        with pytest.raises(LimitReached, match=r"time = 120 s.*solving takes 21 s more after 100 s \(--time"):
            check_time("solving", 21)
        clock[0] += 20
        with pytest.raises(LimitReached, match="solving after 120 s"):
            check_time("solving")
    assert find_seconds_left() == float("inf")


def test_none_leaves_the_limits_as_they_are():
    with use_limits(Limits(seconds=7.0)), use_limits(None):
        assert get_limits().seconds == 7


def test_other_types_are_refused():
    with pytest.raises(InputError, match="limits = true: allowed: Limits"), use_limits(True):
        pass


def test_a_thread_is_given_them_with_its_context():
    seen = []
    with use_limits(Limits(seconds=7.0)), start_clock():
        for run in (copy_context().run, lambda work: work()):
            thread = threading.Thread(target=run, args=(lambda: seen.append((get_limits().seconds, find_seconds_left() < 8)),))
            thread.start()
            thread.join()
    assert seen == [(7.0, True), (120.0, False)]


def test_a_limit_is_a_refusal_that_is_no_other():
    assert issubclass(LimitReached, Refusal)
    assert LimitReached.exit_code == 2
