"""Measure the cost of a sweep beside a bare loop.

    python -m benchmarks.evaluators.sweep [--scale 1]

First table: rows per second of each evaluator in a bare loop (the same designs, after a first one; ``closed-form``
on arrays of 128), and of a sweep with 1 and 2 workers, start of the processes counted; overhead: what a row of the one-worker
sweep takes beyond its own ``seconds``, by the clock, after the first rows are there; of which in the process that hands out and
writes: its processor time a row, with one worker. Second table: 1e5 closed-form designs swept with 2 workers, size of the store,
time to start again when all rows are there. ``--scale 0.1`` asks for a tenth of the designs.

Duration: minutes.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from probe_design import sweep
from probe_design.sweeps.file import sweep_from_dict
from probe_design.sweeps.progress import Progress
from probe_design.sweeps.results import iterate_rows
from probe_design.sweeps.rows import Job

SCENE = Path(__file__).parents[2] / "examples" / "scene.toml"
COUNTS = {"closed-form": 20_000, "equivalent-inclusion": 60, "axisymmetric": 150}


def build_sweep_document(evaluator: str, n: int) -> dict[str, Any]:
    """Return a sample of new probes over new tumours."""
    variables = {
        "probe.gap": {"from": "0.05 mm", "to": "0.2 mm", "scale": "log"},
        "probe.outer.youngs_modulus": {"from": "20 kPa", "to": "1 MPa", "scale": "log"},
        "inclusion.depth": {"from": "6 mm", "to": "12 mm"},
    }
    return {"scene": SCENE, "evaluator": evaluator, "sample": {"kind": "sobol", "n": n, "seed": 1}, "variables": variables}


def bare(evaluator: str, n: int) -> float:
    """Rows a second of a loop without a store."""
    checked = sweep_from_dict(build_sweep_document(evaluator, n))
    job, designs = Job.from_sweep(checked), [values for _, values in checked.list_designs()]
    list(job.evaluate_parts(designs[:1]))
    begin = time.perf_counter()
    list(job.evaluate_parts(designs))
    return n / (time.perf_counter() - begin)


def measure_sweep(evaluator: str, n: int, workers: int) -> tuple[float, float, float]:
    """Rows a second of a sweep; seconds a row beyond the results themselves, by the clock and of this process."""
    states: list[tuple[float, float, int, float]] = []  # clock, processor time, rows, their seconds
    with tempfile.TemporaryDirectory() as folder:

        def note_progress(state: Progress) -> None:
            if state.done and (not states or state.done == n):
                states.append(
                    (time.perf_counter(), time.process_time(), state.done, sum(row["seconds"] for row in iterate_rows(folder)))
                )

        summary = sweep(build_sweep_document(evaluator, n), folder, workers=workers, progress=note_progress)
    (begin, idle, begun, first_answered_s), (end, used, _, last_answered_s) = states[0], states[-1]
    return (
        n / summary.seconds,
        (workers * (end - begin) - (last_answered_s - first_answered_s)) / (n - begun),
        (used - idle) / (n - begun),
    )


def speed(scale: float) -> Table:
    """Return the first table."""
    table = Table(title="rows per second")
    for heading in ("evaluator", "rows", "bare loop", "1 worker", "2 workers", "overhead a row, ms", "of this process, ms"):
        table.add_column(heading, justify="left" if heading == "evaluator" else "right")
    for evaluator, count in COUNTS.items():
        n = max(8, int(count * scale))
        single, double = measure_sweep(evaluator, n, 1), measure_sweep(evaluator, n, 2)
        rates = (f"{rate:.3g}" for rate in (bare(evaluator, n), single[0], double[0]))
        table.add_row(evaluator, str(n), *rates, *(f"{1e3 * cost:.2g}" for cost in single[1:]))
    return table


def store(scale: float) -> Table:
    """Return the second table."""
    n = max(100, int(100_000 * scale))
    with tempfile.TemporaryDirectory() as folder:
        first = sweep(build_sweep_document("closed-form", n), folder, workers=2)
        size = sum(file.stat().st_size for file in Path(folder).glob("sweep.sqlite*"))
        repeated = sweep(build_sweep_document("closed-form", n), folder, workers=2)
    table = Table(title=f"{n} closed-form designs, 2 workers")
    for heading in ("ok", "refused", "failed", "s", "rows/s", "store, MB per 1e6 rows", "starting again, s", "rows repeated"):
        table.add_column(heading, justify="right")
    cells = (
        first.ok,
        first.refused,
        first.failed,
        first.seconds,
        n / first.seconds,
        size / n,
        repeated.seconds,
        repeated.answered,
    )
    table.add_row(*(f"{cell:.4g}" if isinstance(cell, float) else str(cell) for cell in cells))
    return table


def main() -> None:
    arguments = argparse.ArgumentParser()
    arguments.add_argument("--scale", type=float, default=1.0)
    scale = arguments.parse_args().scale
    console = Console(width=120)
    console.print(speed(scale))
    console.print(store(scale))


if __name__ == "__main__":
    main()
