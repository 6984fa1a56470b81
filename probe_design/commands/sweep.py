"""The commands `sweep`, which evaluates thousands of designs, and `tradeoff`, which measures time and error of each evaluator."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from pydantic import Field

from geometry.common.errors import InputError, MissingLibrary
from geometry.common.files import check_writable
from geometry.common.percent import format_percent
from geometry.scenes.scene_file import load_scene, read_scene
from probe_design.commands.fields import LimitedRequest, Linear, Memory, Time, replace_limits
from probe_design.commands.optimize import Stages, ignore_stage
from probe_design.commands.output import print_json, print_result
from probe_design.commands.request import Option, Request, use_request
from probe_design.terminal.console import show_stages, show_sweep, warn, write_message

if TYPE_CHECKING:
    from geometry.scenes.scene import Scene
    from probe_design.tradeoffs.rows import Row
    from probe_design.tradeoffs.study import Tradeoff


class SweepRequest(Request):
    """Evaluate every design of SWEEP, a TOML file of variables, and store each row as soon as it is computed.

    After any interruption the same command continues where it ended; no row is computed twice. A design that is refused or fails
    is stored too, with the reason. A design that a limit stopped is evaluated again under a larger limit.
    """

    sweep: Annotated[Path, Option("File of a sweep.", is_argument=True)]
    output: Annotated[Path, Option("Folder for store, log and results.", "-o/--output")]
    scheduler: Annotated[str | None, Option("Dask scheduler to run on, such as tcp://host:8786.", metavar="ADDRESS")] = None
    workers: Annotated[
        int | None, Field(ge=1, le=1024), Option("Processes on this computer.", left_out="one for each processor")
    ] = None
    time: Annotated[Time | None, Option("Time limit of a design.", left_out="the file's time_limit, or 120 s")] = None
    memory: Annotated[Memory | None, Option("Memory limit of a design.", left_out="the file's memory_limit, or 2 GB")] = None
    retry_failed: Annotated[bool, Option("Evaluate designs again that failed.")] = False

    def run(self) -> None:
        """Evaluate the designs that have no row yet, and write the tables."""
        from probe_design.sweeps.file import read_sweep
        from probe_design.sweeps.run import sweep

        parsed_sweep = read_sweep(self.sweep)
        parsed_sweep = replace(parsed_sweep, limits=replace_limits(parsed_sweep.limits, self.time, self.memory))
        check_writable(self.output)
        with show_sweep() as progress:
            result = self.call(sweep, specification=parsed_sweep, progress=progress, notice=write_message)
        files = _write_files(self.output)
        if self.as_json:
            print_json(result.as_dict() | {"files": [str(file) for file in files]})
            return
        print(
            f"{result.designs} designs: {result.ok} ok, {result.refused} refused, {result.failed} failed; {result.answered} "
            "evaluated now"
        )
        write_message(f"wrote {', '.join(file.name for file in files)} to {self.output}")


def _write_files(folder: Path) -> list[Path]:
    """Write CSV, and Parquet and a summary page if the libraries for them are installed; return the files."""
    from probe_design.sweeps.results import write_csv, write_parquet
    from probe_design.sweeps.summary_page import write_page

    files = [write_csv(folder, folder / "results.csv")]
    for write, name in ((write_parquet, "results.parquet"), (write_page, "summary.html")):
        try:
            files.append(write(folder, folder / name))
        except MissingLibrary as missing:
            write_message(f"without {name}: {missing}")
    return files


class TradeoffRequest(LimitedRequest):
    """Measure the cost of accuracy on your scenes: time, stated error and true error of every evaluator and setting.

    True errors are differences from the most accurate result of all evaluators that converge, which has a stated error, too.
    Beyond linear elasticity, contact is compared at several accuracies. Allow half a minute per scene, more there. Without
    SCENE, five built-in scenes are used: the paper's probe without its groove, and
    another probe over a tumour on its axis, off its axis, shallow and soft.

    \b
    probe-design tradeoff -o out
    probe-design tradeoff mine.toml other.toml -o out --json
    """  # noqa: D301

    scenes: Annotated[tuple[Path, ...], Option("Files of scenes.", is_argument=True, metavar="[SCENE]...")] = ()
    output: Annotated[Path, Option("Folder for table, plot and JSON file.", "-o/--output")]
    solid: Annotated[bool, Option("Run the three-dimensional evaluator too: minutes for each scene.")] = False
    linear: Linear = False

    def run(self) -> None:
        """Measure time and errors, write the files, and print the tables."""
        from probe_design.tradeoffs.report import build_choice_table, build_summary_table, write_files
        from probe_design.tradeoffs.study import measure_tradeoff

        named_scenes = _read_scenes(self.scenes)
        check_writable(self.output)  # checked before the computation rather than after it
        with show_stages() as progress:
            study = measure_tradeoff(named_scenes, self.solid, progress, linear=self.linear)
        files = write_files(study, self.output)
        names = [str(file) for file in files]
        tables = (build_summary_table, build_choice_table)
        print_result(lambda: study.as_dict() | {"files": names}, lambda: [build(study) for build in tables], self.as_json)
        if not self.as_json:
            write_message(f"wrote {', '.join(file.name for file in files)} to {self.output}")
        for row in study.uncertain_references:
            remedy = "" if self.solid else "; --solid runs the three-dimensional evaluator"
            error = format_percent(row.stated_error or 0.0)
            write_message(f"{row.scene}: even the most accurate result states an error of {error}{remedy}")
        warn((*study.warnings, *(_describe_broken_row(row) for row in study.understated_rows)))


@use_request(TradeoffRequest, checks=False)
def tradeoff(
    scenes: Mapping[str, Scene] | Sequence[Path | str] = (), *, solid: bool = False, linear: bool = False,
    progress: Stages | None = None,
) -> Tradeoff:  # fmt: skip
    """Measure time, stated error and true error of every evaluator on your scenes.

    Parameters
    ----------
    scenes : mapping of str to Scene, or sequence of file names; default: five built-in scenes
        Scenes by name.
    progress : callable, optional
        Called with a scene's name, the number of settings done and their total.

    Returns
    -------
    Tradeoff
        ``to_frame()`` has a row for each scene and setting.

    Raises
    ------
    Refusal
        No evaluator takes any of the scenes under their loads.
    """
    from probe_design.tradeoffs.study import measure_tradeoff

    TradeoffRequest.build({"output": Path("none"), "solid": solid, "linear": linear})  # which checks these
    if isinstance(scenes, Mapping):
        named = {str(name): load_scene(scene) for name, scene in scenes.items()}
    elif isinstance(scenes, tuple | list) and all(isinstance(scene, Path | str) for scene in scenes):
        named = _read_scenes([Path(scene) for scene in scenes])
    else:
        raise InputError("scenes", scenes, "a mapping from names to scenes, or a list of the names of scene files")
    return measure_tradeoff(named, solid, progress or ignore_stage, linear=linear)


def _describe_broken_row(row: Row) -> str:
    """Return a warning about an evaluator whose true error is above its stated error, in one row of the table."""
    stated, true = (format_percent(error or 0.0) for error in (row.stated_error, row.true_error_least))
    reason = f"states an error of {stated}, which is {true} at least: a defect of the program"
    return f"{row.scene}: {row.setting} {reason}"


def _read_scenes(paths: Sequence[Path]) -> dict[str, Scene]:
    """Read scenes; return them by the names of their files, or by their paths where two files have the same name."""
    from probe_design.data.builtin import read_typical_scenes

    if not paths:
        return read_typical_scenes()
    stems = [path.stem for path in paths]
    return {path.stem if stems.count(path.stem) == 1 else str(path): read_scene(path) for path in paths}
