"""Time ``solid``, NGSolve and CalculiX on the same scenes at the same true error in three dimensions, in one run.

Usage: ``apt-get install calculix-ccx``, ``pip install -e '.[bench]'``, then ``python -m benchmarks.peers.solid``. ``--skip``
leaves out a code; ``--peers PYTHON`` runs both peers by another interpreter (one with ngsolve, whose netgen makes CalculiX's
meshes too), ``--ours PYTHON`` likewise. Each run is a process of its own, on ``--threads`` (1); seconds are medians of
``--repeats`` runs, by the clock and of the processor, without the interpreter's start and imports. Peak memory is that of the
process and of those it starts. True values: ``tests/reference/solid``, else the folder ``SOLID_REFERENCE`` names.

The peers' settings are the cheapest ones that reach the error and keep it when refined (``solid_settings.py``), the ratio
alone, without an error estimate. Ours is given the accuracy and returns its own error estimate; its meshing is
the difference between a run with an empty cache of meshes and runs with that cache filled.

Duration: half an hour.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

from rich.console import Console

from benchmarks.peers.measured_solid import ACCURACIES, SCENES, read_expected, scene_file
from benchmarks.tables import MeasuredTable
from geometry import read_scene

PEERS_FOLDER = Path(__file__).resolve().parent
SETTINGS = PEERS_FOLDER / "solid_settings.json"
ALL_SUFFIX = " all"  # marks settings that reach the error in both stresses, and so in the stiffness, too
PEERS = {"ngsolve": "benchmarks.peers.ngsolve_solid", "calculix": "benchmarks.peers.calculix_solid"}
TITLES = {"ours": "ours", "ngsolve": "NGSolve", "calculix": "CalculiX"}
CODES = ("ours", "ngsolve", "calculix", "ngsolve" + ALL_SUFFIX, "calculix" + ALL_SUFFIX)
LIBRARIES = "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS", "RAYON_NUM_THREADS"
OURS = """
import json, resource, sys, time
from geometry import read_scene
from solver.evaluators import evaluator
def processor():
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(usage.ru_utime + usage.ru_stime for usage in used)
level, scene = evaluator("solid"), read_scene(sys.argv[1])
start = time.perf_counter(), processor()
result = level.evaluate(scene, float(sys.argv[2]))
wall, process = time.perf_counter() - start[0], processor() - start[1]
print(json.dumps({"ratio": result.ratio, "stiffness": result.stiffness, "estimate": result.error_estimate, "wall": wall,
                  "process": process, "warnings": result.warnings}))
"""
COLUMNS = (
    "scene",
    "code",
    "order",
    "unknowns, count",
    "true error, error",
    "of stresses, error",
    "mesh, s",
    "solve, s",
    "all, s",
    "all, processor, s",
    "peak, MB",
    "over ours, times",
    "of processor, times",
)


@dataclass(frozen=True)
class Run:
    """What one process printed, and the most memory it held, MB."""

    output: dict[str, Any]
    peak: float


class FailedError(RuntimeError):
    """A process ended badly; the text is the end of what it wrote."""


def run(command: Sequence[str], threads: int, cache: str | None = None) -> Run:
    """Run a process; its last line is JSON."""
    environment = os.environ | dict.fromkeys(LIBRARIES, str(threads)) | {"PYTHONPATH": str(PEERS_FOLDER.parents[1])}
    if cache is not None:
        environment["PROBE_DESIGN_CACHE"] = cache
    with tempfile.TemporaryFile() as stdout, tempfile.TemporaryFile() as err:
        child = subprocess.Popen(command, stdout=stdout, stderr=err, env=environment)
        _, status, used = os.wait4(child.pid, 0)
        child.returncode = os.waitstatus_to_exitcode(status)
        for file in (stdout, err):
            file.seek(0)
        text, trouble = stdout.read().decode(), err.read().decode()
    if child.returncode:
        raise FailedError((trouble.strip() or f"exit {child.returncode}").splitlines()[-1][-200:])
    return Run(json.loads(text.strip().splitlines()[-1]), used.ru_maxrss / 1024)


def ours(name: str, accuracy: float, chosen: argparse.Namespace) -> dict[str, Any]:
    """Run ours with an empty cache and with a filled one."""
    command = [chosen.ours, "-c", OURS, str(scene_file(name)), str(accuracy)]
    cold, warm = list[Run](), list[Run]()
    for _ in range(chosen.repeats):
        with tempfile.TemporaryDirectory() as cache:
            cold.append(run(command, chosen.threads, cache))
            warm.append(run(command, chosen.threads, cache))
    first = {key: median(process_run.output[key] for process_run in cold) for key in ("wall", "process")}
    later = median(process_run.output["wall"] for process_run in warm)
    return cold[0].output | {
        "mesh": max(first["wall"] - later, 0.0),
        "solve": later,
        "all": first["wall"],
        "process": first["process"],
        "peak": max(process_run.peak for process_run in cold),
        "unit": 1.0,
    }


def read_setting(code: str, name: str, accuracy: float) -> dict[str, Any] | None:
    """Return a peer's setting, or None."""
    peer, _, kind = code.partition(" ")
    scenes = json.loads(SETTINGS.read_text(encoding="utf-8"))[peer]
    setting: dict[str, Any] | None = scenes.get(name, {}).get(f"{accuracy:g} {kind}".strip())
    return setting


def peer(code: str, name: str, setting: dict[str, Any], chosen: argparse.Namespace) -> dict[str, Any]:
    """Run a peer."""
    command = [chosen.peers, "-m", PEERS[code], str(scene_file(name)), json.dumps(setting)]
    runs = [run(command, chosen.threads) for _ in range(chosen.repeats)]
    mesh = median(process_run.output["wall"]["mesh"] for process_run in runs)
    whole = median(sum(process_run.output["wall"].values()) for process_run in runs)
    return runs[0].output | {
        "order": setting["order"],
        "mesh": mesh,
        "solve": median(sum(process_run.output["wall"].values()) - process_run.output["wall"]["mesh"] for process_run in runs),
        "all": whole,
        "process": median(sum(process_run.output["process"].values()) for process_run in runs),
        "peak": max(process_run.peak for process_run in runs),
        "unit": 1e-3,  # m over the peers' unit of length
    }


def worst(name: str, ratio: float, stiffness: float) -> float:
    """Return the larger relative error of both stresses at the scene's indentation."""
    true, area = read_expected(name), read_scene(scene_file(name)).probe
    part = ratio * area.inner_area / area.outer_area
    whole = true["ratio"] * area.inner_area / area.outer_area
    relative = stiffness / true["stiffness_n_per_m"] * (1 + whole) / (1 + part)
    return max(abs(relative - 1), abs(relative * part / whole - 1))


def measure(accuracy: float, chosen: argparse.Namespace, progress: Callable[[str], None]) -> MeasuredTable:
    """Return the table of one accuracy."""
    table = MeasuredTable(f"one evaluation at {accuracy * 100:g} %, threads: {chosen.threads}", COLUMNS)
    for name in chosen.scene or SCENES:
        true, mine = read_expected(name), None
        for code in CODES:
            which, setting = code.removesuffix(ALL_SUFFIX), None if code == "ours" else read_setting(code, name, accuracy)
            if which in (chosen.skip or ()) or (code.endswith(ALL_SUFFIX) and setting is None):
                continue
            title = TITLES[which] + (", stresses too" if code.endswith(ALL_SUFFIX) else "")
            progress(f"{title} on {name} at {accuracy:g}")
            try:
                outcome = ours(name, accuracy, chosen) if code == "ours" else peer(which, name, setting or {}, chosen)
            except (FailedError, OSError) as fault:
                table.note(f"{title} on {name}: not measured: {fault}")
                continue
            mine = outcome if code == "ours" else mine
            error = abs(outcome["ratio"] / true["ratio"] - 1)
            table.add(
                name,
                title,
                outcome.get("order"),
                outcome.get("unknowns"),
                error,
                worst(name, outcome["ratio"], outcome["stiffness"] * outcome["unit"]),
                *(outcome[key] for key in ("mesh", "solve", "all", "process")),
                round(outcome["peak"]),
                *(None if mine is None or code == "ours" else outcome[key] / mine[key] for key in ("all", "process")),
            )
            if error > accuracy:
                table.note(f"{title} on {name} misses the accuracy: with another release, run solid_settings.py again")
    table.note("ours: error estimate and log-sensitivity included, mesh = empty cache less filled cache; solve = cache filled")
    table.note("peers: cheapest settings found with the true value known, the ratio alone, no error estimate; half models;")
    table.note("what both films' errors have in common cancels in it; stresses too: both are as exact as asked, as ours promises")
    table.note("CalculiX: solve includes writing and reading its input file; over ours: the whole time over ours, cache empty")
    return table


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--skip", action="append", choices=tuple(TITLES), help="leave this code out")
    parser.add_argument("--scene", action="append", choices=SCENES, help="only this scene")
    parser.add_argument("--accuracy", action="append", type=float, choices=ACCURACIES, help="only this accuracy")
    parser.add_argument("--repeats", type=int, default=3, help="of each run (3)")
    parser.add_argument("--threads", type=int, default=1, help="of each process: ours and NGSolve's task manager (1)")
    parser.add_argument("--ours", default=sys.executable, help="the interpreter that runs ours (this one)")
    parser.add_argument("--peers", default=sys.executable, help="the interpreter that has ngsolve (this one)")
    parser.add_argument("--json", type=Path, help="write the raw values to this file, times in seconds")
    return parser.parse_args()


def main() -> None:
    chosen, console, progress = arguments(), Console(width=165), Console(stderr=True)
    skip = set(chosen.skip or ())
    if shutil.which("ccx") is None and "calculix" not in skip:
        console.print("CalculiX skipped: `apt-get install calculix-ccx` on Debian and Ubuntu")
        chosen.skip = [*skip, "calculix"]
    tables = []
    with progress.status("starting") as status:
        for accuracy in chosen.accuracy or ACCURACIES:
            table = measure(accuracy, chosen, lambda line: status.update(line))
            table.print(console)
            tables.append(table.as_json())
    if chosen.json is not None:
        chosen.json.write_text(json.dumps({"tables": tables}, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
