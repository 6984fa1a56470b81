"""Libraries for child processes under the faults that ``geometry/processes`` stands: which fault costs more than its own task.

pip install pebble loky; python -m benchmarks.robustness.executors        prints the table of docs/evidence/executors.md

Duration: three minutes.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from importlib import import_module, metadata
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from benchmarks.robustness.executor_tasks import ENDLESS_S, FAULTS, SquareJob, limit_memory, square
from geometry.common.resources import Limits
from geometry.processes.local_executor import LocalExecutor

ROOT = Path(__file__).parents[2]
TIME_LIMIT_S, PATIENCE_S = 3.0, 12.0  # s: of a task where the library knows one; of a trial
WORKERS, TASKS = 2, 6  # of which the second one is at fault
Outcomes = list[str]  # "36" of a task that is done, else the reason
MARK = "outcomes:"
LIBRARIES = ("geometry.processes", "pebble", "loky", "concurrent.futures")


def run_ours(faults: list[str]) -> Outcomes:
    """Run tasks in ``geometry.processes``, each a batch."""
    with tempfile.TemporaryDirectory() as folder:
        executor = LocalExecutor[str, object](
            SquareJob("memory" in faults), WORKERS, Limits(seconds=TIME_LIMIT_S), Path(folder, "log")
        )
        outcomes, waiting, running = [""] * len(faults), [*range(len(faults))], dict[int, int]()
        try:
            while waiting or running:
                while waiting and executor.count_free():
                    k = waiting.pop(0)
                    running[executor.submit([faults[k]])] = k
                for number, outcome in executor.collect(1.0):
                    text = outcome.failure or outcome.refusal or ("too long" if outcome.is_late else "")
                    outcomes[running.pop(number)] = text or str(outcome.rows[0])
        finally:
            executor.close()
        return outcomes


def run_futures(library: str, faults: list[str]) -> Outcomes:
    """Run tasks in a library's pool."""
    options: dict[str, Any] = {"initializer": limit_memory} if "memory" in faults else {}
    pool: Any
    if library == "pebble":
        pool = import_module("pebble").ProcessPool(WORKERS, context=get_context("spawn"), **options)
        futures = [pool.schedule(square, (fault,), timeout=TIME_LIMIT_S) for fault in faults]
    else:
        if library == "loky":
            pool = import_module("loky").ProcessPoolExecutor(WORKERS, **options)
        else:
            pool = import_module("concurrent.futures").ProcessPoolExecutor(WORKERS, get_context("spawn"), **options)
        futures = [pool.submit(square, fault) for fault in faults]
    outcomes = []
    for future in futures:
        try:
            outcomes.append(str(future.result(PATIENCE_S)))
        except Exception as fault:
            outcomes.append(f"{type(fault).__name__} {fault} {getattr(fault, 'exitcode', '')}")
    if library == "pebble":
        pool.stop()
    else:
        pool.shutdown(wait=False)
    return outcomes


def try_fault(library: str, name: str) -> None:
    """Print the outcomes of tasks of which one is at fault, as JSON in one line, and end whatever still runs."""
    faults = ["", name, *[""] * (TASKS - 2)]
    outcomes = run_ours(faults) if library == "geometry.processes" else run_futures(library, faults)
    print(MARK, json.dumps(outcomes), flush=True)
    os._exit(0)


def run_faulty_task(library: str, name: str) -> str:
    """Return what a fault cost besides its own task."""
    words = [sys.executable, "-m", "benchmarks.robustness.executors", library, name]
    begin = time.monotonic()
    with tempfile.TemporaryFile("w+") as output:
        process = subprocess.Popen(words, stdout=output, stderr=subprocess.DEVNULL, cwd=ROOT, start_new_session=True)
        with suppress(subprocess.TimeoutExpired):
            process.wait(2 * PATIENCE_S)
        seconds = time.monotonic() - begin
        is_left = name == "endless" and _is_running()
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        output.seek(0)
        printed, _, outcome_text = output.read().partition(MARK)
    if not outcome_text:
        return f"no end in {2 * PATIENCE_S:g} s"
    outcomes = json.loads(outcome_text)
    lost = sum(outcome != "36" for k, outcome in enumerate(outcomes) if k != 1)
    is_named = any(word in outcomes[1] for word in FAULTS[name].reason.split("|"))
    faults = [f"{lost} of {TASKS - 1} other tasks lost"] * (lost > 0)
    faults += ["no reason given"] * (not is_named)
    faults += ["printed into the program's output"] * ("noise" in printed)
    faults += ["its process goes on"] * is_left
    return f"{'; '.join(faults) or 'passes'} ({seconds:.1f} s)"


def _is_running() -> bool:
    """Return whether the process that the endless task started still runs, and end it."""
    found = subprocess.run(["pgrep", "-f", f"time.sleep\\({ENDLESS_S}\\)"], capture_output=True, text=True, check=False)
    for number in found.stdout.split():
        os.kill(int(number), signal.SIGKILL)
    return bool(found.stdout)


def judge_script(library: str) -> str:
    """Return whether a script without ``if __name__ == "__main__"`` runs, as users write them."""
    call = "run_ours([''])" if library == "geometry.processes" else f"run_futures({library!r}, [''])"
    with tempfile.TemporaryDirectory() as folder:
        script = Path(folder, "script.py")
        script.write_text(f"from benchmarks.robustness.executors import *; print(MARK, {call}, flush=True)")
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])}
        words = [sys.executable, str(script)]
        try:
            ended = subprocess.run(words, capture_output=True, text=True, timeout=PATIENCE_S, env=environment, check=False)
        except subprocess.TimeoutExpired:
            return f"no end in {PATIENCE_S:g} s"
    return "passes" if f"{MARK} ['36']" in ended.stdout and "Traceback" not in ended.stderr else "an error"


def main() -> None:
    """Print the table."""
    packages = {"pebble", "loky"}
    heads = [f"{library} {metadata.version(library)}" if library in packages else library for library in LIBRARIES]
    print("|", " | ".join(["one of six tasks", *heads]), "|", flush=True)
    for name in FAULTS:
        print("|", " | ".join([name, *(run_faulty_task(library, name) for library in LIBRARIES)]), "|", flush=True)
    print("|", " | ".join(["a script without a main guard", *map(judge_script, LIBRARIES)]), "|")


if __name__ == "__main__":
    try_fault(*sys.argv[1:]) if len(sys.argv) > 1 else main()
