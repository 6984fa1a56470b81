"""The verb `optimize` for a design file, and without any file: the built-in one."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from probe_design.cli.output import print_json

if TYPE_CHECKING:
    from collections.abc import Mapping

    from probe_design.populations.design_file import Design


def optimize_population(design: Design, output: Path, asked: str, *, force: bool, pareto: tuple[str, ...], as_json: bool) -> None:
    """Search, judge, write and tell; exit code 1 where no gain counts."""
    from functools import partial

    from probe_design.design_search.optimize import optimize
    from probe_design.design_search.pareto import front
    from probe_design.design_search.report import maps_of, write_all
    from probe_design.design_search.table import table
    from probe_design.terminal.console import message, show, stages, warn

    with stages() as progress:
        optimum = optimize(design, progress)
        maps = maps_of(optimum)
        fronts = tuple(front(design, one, partial(progress, f"front: {one}")) for one in pareto)
        files = write_all(optimum, output, progress, maps, fronts, force=force, asked=asked)
    if as_json:
        import json

        told: Mapping[str, object] = json.loads((output / "optimize.json").read_text(encoding="utf-8"))
        print_json(dict(told))
    else:
        show(table(optimum, maps))
        message(f"search: {optimum.how}")
        message(f"wrote {len(files)} files to {output}; begin with {output / 'report.html'}")
    warn(dict.fromkeys(optimum.best.judgement.warnings))
    message(optimum.verdict)
    if optimum.status == "no-gain":
        raise SystemExit(1)
