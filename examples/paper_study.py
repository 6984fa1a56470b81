"""The paper's study: two tumours in a block, four positions, three loads, in the form of its Table 3 beside the printed numbers.

Usage, from a clone in which ``pip install -e .`` was run: ``python examples/paper_study.py``; some three minutes, less the
next time, as meshes are kept. ``--evaluator equivalent-inclusion`` answers in seconds, but leaves the groove out and counts it
as an error. ``--plot study.png`` draws the ratio at the positions and along the line through them.

The scene is ``paper-study.toml``, which marks each number as the paper's or as an assumption.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from paper_notes import notes
from paper_table import AREA_RATIO, POSITION_NAMES, TABLE_3, check_position

from geometry import ProbeError, Scene, read_scene
from geometry.common.files import write_whole
from geometry.common.resources import Limits
from probe_design.maps.scan import Scan, scan
from probe_design.reporting.picture_files import check_format
from probe_design.terminal.console import show_steps, write_message
from solver import Result, evaluate

SCENE = Path(__file__).with_name("paper-study.toml")
FAR = 0.030  # x of position 4, m: 25 mm from the nearer tumour, 20 mm from the block's side
KEYS = ("stress_inner", "stress_outer", "ratio", "error_estimate")
EVALUATORS = ("solid", "equivalent-inclusion", "closed-form")
LIMITS = Limits(memory=4e9, seconds=1800.0)  # of each position: the check of a design may take its time


def scenes(scene: Scene) -> dict[int, Scene]:
    """Return the scene with the probe at each of the four positions."""
    first, two = scene.inclusion
    positions = {1: (first.x + two.x) / 2, 2: two.x, 3: first.x, 4: FAR}
    return {k: scene.model_copy(update={"placement": scene.placement.model_copy(update={"x": x})}) for k, x in positions.items()}


def solved(scene: Scene, evaluator: str, accuracy: float) -> dict[int, Result]:
    """Evaluate the four positions at the scene's small load, each once: linear elasticity gives 1 N and the other loads.

    Raises
    ------
        InputError, Refusal: see ``solver.evaluate``.
    """
    results = {}
    with show_steps("the paper's study") as progress:
        for k, scene_at in scenes(scene).items():
            progress(f"position {k} of 4, {POSITION_NAMES[k]}")
            results[k] = at_one_newton(
                evaluate(scene_at, evaluator, accuracy, partial(_tell_line, progress, k), limits=LIMITS), scene_at
            )
    return results


def at_one_newton(result: Result, scene: Scene) -> Result:
    """Return a result at the scene's force as what linear elasticity makes of it at 1 N."""
    at_load = {key: getattr(result, key) for key in ("stress_inner", "stress_outer", "charge_inner", "charge_outer")}
    force = scene.load.force or 1.0
    return replace(result, **{key: None if value is None else value / force for key, value in at_load.items()})


def _tell_line(progress: Callable[[str], None], k: int, line: str) -> None:
    progress(f"position {k} of 4: {line}")


def loaded(result: Result, load: float) -> tuple[float | None, ...]:
    """Return stress 1, stress 2 (Pa, compression positive), ratio and its bound at a load, of a result at 1 N."""
    stresses = (None if stress is None else load * stress for stress in (result.stress_inner, result.stress_outer))
    return (*stresses, result.ratio, result.error_estimate)


def study_table(results: dict[int, Result], title: str) -> Table:
    """Return Table 3, printed and ours side by side."""
    table = Table(title=title, title_justify="left")
    for heading in ("position", "stress 1\nprinted", "stress 2\nprinted", "ratio\nprinted"):
        table.add_column(heading, justify="left" if heading == "position" else "right", no_wrap=True)
    for heading in ("stress 1\nours, kPa", "stress 2\nours, kPa", "ratio\nours", "error\nbound"):
        table.add_column(heading, justify="right", no_wrap=True)
    for k, rows in TABLE_3.items():
        table.add_row(f"{k}, {POSITION_NAMES[k]}")
        for row in rows:
            inner, two, ratio, bound = loaded(results[k], row.load)
            printed = (f"{row.stress_1:g}", f"{row.stress_2:g}", f"{row.ratio:.7g}")
            table.add_row(f"  {row.load:g} N", *printed, _text(inner, 1e-3), _text(two, 1e-3), _text(ratio), _percent(bound))
        table.add_section()
    return table


def _text(value: float | None, scale: float = 1.0) -> str:
    return "-" if value is None else f"{value * scale:.4g}"


def _percent(value: float | None) -> str:
    return "-" if value is None else f"{100 * value:.2g} %"


def check_table(results: dict[int, Result]) -> Table:
    """Return what can be checked of the printed numbers alone; areas beside those of our probe."""
    table = Table(title="The printed numbers, checked", title_justify="left")
    headings = ("position", "ratio constant\nover loads within", "ratio column\nright within", "sign of\nstress 1 / stress 2")
    for heading in (*headings, "A1 that balances\n1 N, printed", "A1 that balances\n1 N, ours, mm2"):
        table.add_column(heading, justify="right")
    for k, rows in TABLE_3.items():
        row, ours = check_position(rows), results[k]
        total = AREA_RATIO * (ours.stress_inner or 0.0) + (ours.stress_outer or 0.0)
        sign = "+" if row.signed > 0 else "-, printed as +"
        table.add_row(
            str(k),
            f"{100 * row.spread:.3f} %",
            f"{row.arithmetic:.0e}",
            sign,
            f"{row.area:.4f}",
            _text(1e6 / total if total else None),
        )
    return table


def plot(results: dict[int, Result], scene: Scene, line: Scan, path: Path) -> None:
    """Draw the ratio at the four positions, and along the line through them by ``equivalent-inclusion``, with error bars."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 5.0), dpi=130, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    for body in scene.inclusion:
        half = (body.diameter or 0.0) / 2
        axes.axvspan(1e3 * (body.x - half), 1e3 * (body.x + half), color="#a33b2e", alpha=0.12, linewidth=0)
    quick = {"label": f"{line.evaluator}, without the groove, with its error bounds", "color": "tab:blue", "linewidth": 0.8}
    _bars(axes, line.position, line.ratio, line.error_estimate, fmt=".-", **quick)
    positions = [scene_at.placement.x for scene_at in scenes(scene).values()]
    ratios, bounds = [scene_at.ratio for scene_at in results.values()], [scene_at.error_estimate for scene_at in results.values()]
    _bars(axes, positions, ratios, bounds, label=f"{results[1].evaluator}, the four positions", color="black", fmt="o", zorder=3)
    axes.set(xlabel="x of the probe, mm (shaded: the tumours)", ylabel="stress 1 / stress 2")
    axes.grid(alpha=0.3)
    axes.legend()
    with write_whole(path) as draft:
        figure.savefig(draft, format=path.suffix[1:].lower())


def _bars(axes: Any, positions: Sequence[float], ratios: Sequence[Any], bounds: Sequence[Any], **style: Any) -> None:
    x, ratio, bound = (np.array(values, dtype=float) for values in (positions, ratios, bounds))
    axes.errorbar(1e3 * x, ratio, np.abs(ratio) * np.minimum(bound, 1.0), capsize=3, elinewidth=0.8, **style)


def report(results: dict[int, Result], scene: Scene) -> dict[str, Any]:
    """Return the JSON object of ``--json``."""
    places = scenes(scene)
    rows = {k: [asdict(row) for row in rows] for k, rows in TABLE_3.items()}
    ours = {k: [dict(zip(KEYS, loaded(results[k], row.load), strict=True)) for row in TABLE_3[k]] for k in results}
    positions = [
        {"position": k, "place": POSITION_NAMES[k], "x": places[k].placement.x, "printed": rows[k], "ours": ours[k],
         "check": asdict(check_position(TABLE_3[k])), "result": results[k].as_dict()}
        for k in results
    ]  # fmt: skip
    return {"positions": positions, "notes": list(notes(results))}


def arguments(given: Sequence[str] | None) -> argparse.Namespace:
    """Return the command line's options."""
    parser = argparse.ArgumentParser(description="The paper's Table 3 beside ours.")
    parser.add_argument("--evaluator", choices=EVALUATORS, default="solid", help="default: solid")
    parser.add_argument("--accuracy", type=float, default=0.01, help="relative, of ratio and stresses; default: 0.01")
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output in place of tables")
    parser.add_argument("--plot", type=Path, metavar="FILE", help="draw the ratio at the positions (.png, .svg, .pdf)")
    return parser.parse_args(given)


def main(given: Sequence[str] | None = None) -> int:
    """Run the study; returns the exit code."""
    arguments_given = arguments(given)
    try:
        _run(arguments_given)
    except (ProbeError, OSError) as fault:
        write_message(str(fault))
        return fault.exit_code if isinstance(fault, ProbeError) else 1
    return 0


def _run(options: argparse.Namespace) -> None:
    if options.plot is not None:
        check_format(options.plot)
    scene = read_scene(SCENE)
    results = solved(scene, options.evaluator, options.accuracy)
    if options.plot is not None:
        line = scan(scene, "x", np.linspace(-0.035, 0.035, 29), accuracy=options.accuracy)
        plot(results, scene, line, options.plot)
    if options.json:
        print(json.dumps(report(results, scene)))
        return
    _print(results, scene, options)


def _print(results: dict[int, Result], scene: Scene, options: argparse.Namespace) -> None:
    console = Console(width=None if sys.stdout.isatty() else 120)
    seconds = sum(result.seconds for result in results.values())
    console.print(study_table(results, f"Table 3 of the paper beside {options.evaluator}, four positions in {seconds:.3g} s"))
    console.print("printed: tension positive, no unit given; ours: compression positive, force on the film over the end area\n")
    console.print(check_table(results))
    for line in notes(results):
        console.print(f"- {line}", highlight=False)
    for line in dict.fromkeys(note for result in results.values() for note in result.warnings if note.kind != "linear"):
        console.print(f"- {options.evaluator}: {line}", highlight=False)


if __name__ == "__main__":
    sys.exit(main())
