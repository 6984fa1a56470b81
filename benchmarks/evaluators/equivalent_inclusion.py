"""Measure the evaluator ``equivalent-inclusion``: true errors, validity of its bounds, seconds. Needs no other code.

Usage: ``python -m benchmarks.evaluators.equivalent_inclusion``, about twenty minutes on a quiet core; ``--part`` (may be
repeated) restricts it:

- references: against the scenes of ``tests/reference`` (``--folder``, may be repeated; ``--single`` prints each scene);
- audit: error bounds on random scenes with one tumour on the axis (``--scenes`` of each ``--seed``), against ``axisymmetric``;
- layers: the same on tissue of one to three layers with the tumour inside one of them;
- near: the same with the tumour all but touching an interface of layers, the bottom or the side of the tissue;
- speed: seconds for the probe, for tumours to first order, for tumours with reflections (medians of ``--repeats``);
- map: 50 x 50 depths and diameters against ``axisymmetric`` point by point.

Everything runs on one thread. ``--accuracy`` is that of audit and map.

Duration: twenty minutes.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

from rich.console import Console

from benchmarks.evaluators.inclusion_audit import audit
from benchmarks.evaluators.inclusion_references import FOLDERS, references
from benchmarks.evaluators.inclusion_speed import one_map, speed
from benchmarks.tables import MeasuredTable

ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
PARTS = ("references", "audit", "layers", "near", "speed", "map")


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--part", action="append", choices=PARTS, help="only this part")
    parser.add_argument("--folder", action="append", choices=FOLDERS, help="of references (axisymmetric, solid, off-axis)")
    parser.add_argument("--single", action="store_true", help="print every scene of references too")
    parser.add_argument("--scenes", type=int, default=100, help="random scenes of each seed (100)")
    parser.add_argument("--seed", type=int, action="append", help="of random scenes (1 and 2)")
    parser.add_argument("--worst", type=int, default=5, help="random scenes to print of each tier (5)")
    parser.add_argument("--accuracy", type=float, default=0.003, help="of audit and map (0.003)")
    parser.add_argument("--repeats", type=int, default=5, help="of timed runs (5)")
    parser.add_argument("--points", type=int, default=50, help="of the map along each side (50)")
    parser.add_argument("--sample", type=int, default=20, help="of the map's points, answered by axisymmetric (20)")
    parser.add_argument("--json", type=Path, help="write the raw values to this file, times in seconds")
    return parser.parse_args()


def measure(chosen: argparse.Namespace, progress: Callable[[str], None]) -> Iterator[MeasuredTable]:
    """Yield the tables as they are ready."""
    folders, seeds = chosen.folder or FOLDERS[:3], chosen.seed or [1, 2]
    parts: dict[str, Callable[[], Iterator[MeasuredTable]]] = {
        "references": lambda: references(folders, chosen.single, progress),
        "audit": lambda: audit(seeds, chosen.scenes, chosen.accuracy, chosen.worst, progress=progress),
        "layers": lambda: audit(seeds, chosen.scenes, chosen.accuracy, chosen.worst, progress=progress, kind="random layered"),
        "near": lambda: audit(seeds, chosen.scenes, chosen.accuracy, chosen.worst, progress=progress, kind="all but touching"),
        "speed": lambda: speed(chosen.repeats, progress),
        "map": lambda: one_map(chosen.points, chosen.sample, chosen.accuracy, progress),
    }
    for part in chosen.part or PARTS:
        yield from parts[part]()


def main() -> None:
    """Run the chosen parts, print their tables, write the file."""
    chosen, console, progress = arguments(), Console(width=165), Console(stderr=True)
    tables = []
    with progress.status("starting") as status:
        for table in measure(chosen, lambda line: status.update(line)):
            table.print(console)
            tables.append(table.as_json())
            if chosen.json is not None:
                chosen.json.write_text(json.dumps(tables, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    if any(os.environ.get(key) != value for key, value in ONE_THREAD.items()):  # they count when libraries are loaded
        os.execve(
            sys.executable,
            [sys.executable, "-m", "benchmarks.evaluators.equivalent_inclusion", *sys.argv[1:]],
            os.environ | ONE_THREAD,
        )
    main()
