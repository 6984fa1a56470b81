import os
import sys
import time

import numpy as np
import pytest

from geometry.processes.child import Failure, TooLong
from geometry.processes.programs import ChildThreads, run_program

POSIX = pytest.mark.skipif(os.name == "nt", reason="signals end processes on POSIX systems only")


@pytest.fixture
def program(tmp_path):
    """Write a program whose function ``run`` has the given body."""

    def written(body):
        path = tmp_path / "program.py"
        path.write_text(f"import os, signal, time\nimport numpy as np\ndef run(arrays):\n    {body}\n")
        return path

    return written


def test_arrays_go_there_and_back(program):
    sent = {"points": np.arange(6.0).reshape(2, 3), "name": np.array("tumour.stl")}
    received = run_program(program("print('noise'); return {'twice': 2 * arrays['points'], 'name': arrays['name']}"), sent, 60)
    assert np.array_equal(received["twice"], 2 * sent["points"])
    assert received["name"].item() == "tumour.stl"


def test_what_it_raises_is_told_in_one_line(program):
    with pytest.raises(Failure, match=r"^no such shape$"):
        run_program(program("raise LookupError('no such\\nshape')"), {}, 60)


def test_a_result_that_cannot_be_sent_is_a_failure(program):
    with pytest.raises(Failure, match="pickle"):
        run_program(program("return lambda: 0"), {}, 60)


def test_a_quiet_exit_is_a_failure(program):
    with pytest.raises(Failure, match="ended with code 0x0"):
        run_program(program("os._exit(0)"), {}, 60)


def test_noise_past_python_is_no_answer(program):
    assert run_program(program("os.write(1, b'noise'); return 36"), {}, 60) == 36


@POSIX
@pytest.mark.parametrize("signal", ["SIGSEGV", "SIGABRT"])
def test_its_death_is_a_failure(program, signal):
    with pytest.raises(Failure, match=f"ended by {signal}"):
        run_program(program(f"os.kill(os.getpid(), signal.{signal})"), {}, 60)


def test_one_without_an_end_is_ended(program):
    with pytest.raises(TooLong, match=r"longer than 0\.5 s"):
        run_program(program("time.sleep(1000)"), {}, 0.5)


def test_programs_of_threads_end_with_the_block_that_an_exception_leaves(program, tmp_path):
    """Those that run, and those that a thread would begin after them."""
    begun = tmp_path / "begun"
    path = program(f"open({str(begun)!r}, 'w').close(); time.sleep(1000)")

    def twice():
        faults = []
        for _ in range(2):
            try:
                run_program(path, {}, 900)
            except Failure as fault:
                faults.append(str(fault))
        return faults

    def interrupted():
        nonlocal running
        with ChildThreads(1) as threads:
            running = threads.submit(twice)
            while not begun.exists():
                time.sleep(0.01)
            raise KeyboardInterrupt

    running = None
    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert len(running.result()) == 2


def test_without_time_it_is_not_begun():
    with pytest.raises(TooLong, match="no time is left"):
        run_program(None, {}, 0.0)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="only Linux limits what a process holds")
def test_it_is_given_no_more_memory_than_it_may_hold(program):
    body = "return {'size': np.array(len(np.ones(125_000_000)))}"
    assert run_program(program(body), {}, 60, 4e9)["size"] == 125_000_000
    with pytest.raises(Failure, match="more memory than it may have"):
        run_program(program(body), {}, 60, 0.9e9)
