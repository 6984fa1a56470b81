"""The program ends with one line and 128 + the signal's number, whatever a signal lands in; and does without standard streams."""

from __future__ import annotations

import os
import shlex
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.interrupted import left, moments
from tests.support.paths import SCENE

pytestmark = pytest.mark.skipif(os.name == "nt", reason="signals and streams of POSIX systems")
LINE = "probe-design: interrupted; nothing half-written is left\n"
HEAD = """
import atexit, os, signal, sys, threading, time
{before}
from probe_design import __main__
import probe_design.commands.main
class Commands:
    def main(self, **options):
        {body}
sys.modules['probe_design.commands.main'].cli = Commands()
__main__.main()
"""
SWALLOWED = "try:\n    signal.raise_signal(signal.SIGINT)\nexcept KeyboardInterrupt:\n    "
FALLEN = "class Handle:\n    def __del__(self):\n        signal.raise_signal(signal.SIGINT)\nHandle()\n"


def program(body: str, setup: str = "") -> tuple[int, str]:
    """Exit code and standard error of the program whose command is some lines of Python."""
    text = HEAD.format(body=body.replace("\n", "\n        "), before=setup)
    ended = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, timeout=100, check=False)
    assert ended.stdout == ""
    return ended.returncode, ended.stderr


@pytest.mark.parametrize(("name", "word"), [("SIGINT", "interrupted"), ("SIGTERM", "terminated"), ("SIGHUP", "hung up")])
def test_each_signal_has_its_code_and_its_word(name: str, word: str) -> None:
    number = getattr(signal, name)
    body = f"threading.Thread(target=os.kill, args=(os.getpid(), {number})).start()\nthreading.Event().wait()"
    heard = f"signal.signal({number}, signal.SIG_DFL)"  # also where the tests run under nohup
    assert program(body, heard) == (128 + number, f"probe-design: {word}; nothing half-written is left\n")


@pytest.mark.parametrize(
    "body",
    [
        SWALLOWED + "print('a warning', file=sys.stderr)\ntime.sleep(90)",
        SWALLOWED + "raise RuntimeError('a status') from None",
        FALLEN + "time.sleep(90)",
    ],
    ids=["swallowed", "another exception", "where nobody can catch it"],
)
def test_what_a_library_makes_of_it_does_not_matter(body: str) -> None:
    assert program(body) == (130, LINE)


def test_a_library_is_not_torn_out_of_its_import(tmp_path: Path) -> None:
    text = "import signal\nsignal.raise_signal(signal.SIGINT)\nopen(__file__ + '.whole', 'w').close()\n"
    (tmp_path / "library.py").write_text(text)
    assert program("import library\ntime.sleep(90)", f"sys.path.append({str(tmp_path)!r})") == (130, LINE)
    assert (tmp_path / "library.py.whole").exists()


def test_what_is_clearing_up_is_left_to_do_so(tmp_path: Path) -> None:
    clearing = f"signal.raise_signal(signal.SIGTERM)\n    time.sleep(0.3)\n    open({str(tmp_path / 'clear')!r}, 'w').close()"
    assert program(f"try:\n    signal.raise_signal(signal.SIGINT)\nfinally:\n    {clearing}") == (130, LINE)
    assert (tmp_path / "clear").exists()


def test_one_that_comes_after_the_end_changes_nothing() -> None:
    assert program("return 0", "atexit.register(signal.raise_signal, signal.SIGINT)") == (0, "")


def test_one_before_anybody_listens() -> None:
    finder = "class Finder:\n    def find_spec(self, name, *_):\n        if name[-10:] == 'interrupts': raise KeyboardInterrupt\n"
    text = finder + "import sys\nsys.meta_path.insert(0, Finder())\nfrom probe_design.__main__ import main\nmain()\n"
    ended = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, timeout=100, check=False)
    assert (ended.returncode, ended.stderr) == (130, LINE)


def test_what_nohup_ignores_is_ignored() -> None:
    ignored = "signal.signal(signal.SIGHUP, signal.SIG_IGN)"
    assert program("signal.raise_signal(signal.SIGHUP)\nreturn 0", ignored) == (0, "")


@pytest.mark.slow
@pytest.mark.timeout(1200)
@pytest.mark.parametrize(
    "words",
    [
        ["evaluate", str(SCENE), "--json"],
        ["curve", str(SCENE), "--points", "5", "--plot", "OUT/curve.png"],
        ["export", str(SCENE), "-o", "OUT"],
        ["read", str(SCENE), "--virtual", "--seconds", "3"],
        ["sweep", str(SCENE.parent / "sweep.toml"), "--workers", "1", "-o", "OUT"],
    ],
    ids=lambda words: words[0],
)
def test_signals_at_any_moment(words: list[str]) -> None:
    """More of them, and more commands, in ``benchmarks/evaluators/interrupts.py``."""
    whole = left(words)
    for delay, number in moments(whole.seconds, 2, seed=3):
        assert left(words, delay, number).wrong(number, whole) == "", (delay, number)


def ended(words: str, redirections: str) -> subprocess.CompletedProcess[str]:
    command = f"exec {shlex.quote(sys.executable)} -m probe_design {words} {redirections}"
    return subprocess.run(["sh", "-c", command], capture_output=True, text=True, timeout=100, check=False)


def test_without_standard_error_a_refusal_goes_nowhere() -> None:
    output = ended("evaluate absent.toml", "2>&-")
    assert (output.returncode, output.stdout) == (2, "")


def test_without_standard_output_there_is_no_answer() -> None:
    output = ended(f"evaluate {shlex.quote(str(SCENE))} --evaluator published --json", ">&- <&-")
    assert (output.returncode, output.stderr) == (1, "probe-design: output: Bad file descriptor\n")
