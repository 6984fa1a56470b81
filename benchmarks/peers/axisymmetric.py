"""Measure true error against time: ``axisymmetric``, NGSolve and CalculiX on the same scenes, in one run.

Usage: ``pip install -e '.[bench]'`` and ``apt-get install calculix-ccx``, then ``python -m benchmarks.peers.axisymmetric``. All
of it takes about ten minutes on a quiet core; ``--part`` and ``--scene`` (both may be repeated) restrict it. Everything
runs on one thread, or on ``--threads``, of which NGSolve's task manager uses what it can. Times are wall-clock medians of
``--repeats`` runs; of long runs (CalculiX, differences, growth), one. ``--processor`` measures
the time of the processor instead, on a machine that others use; CalculiX, a process of its own, is not in it.

True values are those of ``tests/reference/axisymmetric``: NGSolve of order up to 12 (``benchmarks/references/axisymmetric.py``).
The peers are used as their best users would, see ``ngsolve_meridian.py``, ``ngsolve_settings.py``, ``calculix_meridian.py``.

Duration: ten minutes.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import sys
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from importlib.metadata import version
from pathlib import Path
from time import process_time
from typing import Any

import ngsolve as ngs
from rich.console import Console

from benchmarks.peers import comparisons
from benchmarks.peers.measured import NAMES, PeerClock, cases
from benchmarks.tables import MeasuredTable
from geometry.provenance.block import DISTRIBUTION

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
ONE_THREAD = dict.fromkeys(THREADS, "1")
PARTS = ("evaluate", "calculix", "curve", "gradients", "factorisations", "growth")


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--part", action="append", choices=PARTS, help="only this part")
    parser.add_argument("--scene", action="append", choices=NAMES, help="only this scene")
    parser.add_argument("--repeats", type=int, default=7, help="of an evaluation (7); curves are repeated three times at most")
    parser.add_argument("--threads", type=int, default=1, help="of linear algebra and of NGSolve (1)")
    parser.add_argument("--processor", action="store_true", help="tell the processor's time, not the wall clock's")
    parser.add_argument("--points", type=int, default=50, help="moduli on a curve (50)")
    parser.add_argument("--json", type=Path, help="write the raw values to this file, times in seconds")
    return parser.parse_args()


def measure(chosen: argparse.Namespace, progress: Callable[[str], None]) -> Iterator[MeasuredTable]:
    """Yield the tables as they are ready."""
    scenes, points, fewer_repeats = cases(chosen.scene or NAMES), chosen.points, min(chosen.repeats, 3)
    parts: dict[str, Callable[[], Iterator[MeasuredTable]]] = {
        "evaluate": lambda: comparisons.evaluations(scenes, chosen.repeats, progress),
        "calculix": lambda: comparisons.calculix(scenes, progress),
        "curve": lambda: comparisons.curves(scenes, points, fewer_repeats, progress),
        "gradients": lambda: comparisons.gradients(scenes, points, fewer_repeats, progress),
        "factorisations": lambda: comparisons.factorisations(scenes, points, chosen.repeats, progress),
        "growth": lambda: comparisons.growth(scenes, progress),
    }
    for part in chosen.part or PARTS:
        yield from parts[part]()


def main() -> None:
    """Run the chosen parts, print their tables, write the file."""
    chosen, console, progress = arguments(), Console(width=165), Console(stderr=True)
    if chosen.processor:
        PeerClock.now = process_time
    ngs.SetNumThreads(chosen.threads)
    tasks = ngs.TaskManager() if chosen.threads > 1 else nullcontext()
    codes = {name: version(name) for name in (DISTRIBUTION, "ngsolve", "numpy", "scipy")} | {"python": platform.python_version()}
    document: dict[str, Any] = {"codes": codes, "tables": []}
    with progress.status("starting") as status, tasks:
        for table in measure(chosen, lambda line: status.update(line)):
            table.print(console)
            document["tables"].append(table.as_json())
            if chosen.json is not None:
                chosen.json.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    wanted = dict.fromkeys(THREADS, str(arguments().threads))
    if any(os.environ.get(key) != value for key, value in wanted.items()):  # they count when libraries are loaded
        os.execve(sys.executable, [sys.executable, "-m", "benchmarks.peers.axisymmetric", *sys.argv[1:]], os.environ | wanted)
    main()
