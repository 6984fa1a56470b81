"""The command `tradeoff`: time and error of each evaluator."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from geometry.scenes.scene_file import read_scene
from probe_design.commands.fields import LimitedRequest, Linear
from probe_design.commands.output import print_json
from probe_design.commands.request import Option

if TYPE_CHECKING:
    from geometry.scenes.scene import Scene
    from probe_design.tradeoffs.rows import Row


class TradeoffRequest(LimitedRequest):
    """Measure the cost of accuracy on your scenes: time, stated error and true error of every evaluator and setting.

    True errors are differences from the most accurate result of all evaluators that converge, which has a stated error, too.
    Allow half a minute per scene. Without SCENE, five built-in scenes are used: the paper's probe without its groove, and
    another probe over a tumour on its axis, off its axis, shallow and soft.

    \b
    probe-design tradeoff -o out
    probe-design tradeoff mine.toml other.toml -o out --json
    """  # noqa: D301

    scenes: Annotated[tuple[Path, ...], Option("Files of scenes.", is_argument=True, metavar="[SCENE]...")] = ()
    output: Annotated[Path, Option("Folder for page, picture and JSON file.", "-o/--output")]
    solid: Annotated[bool, Option("Run the three-dimensional evaluator too: minutes for each scene.")] = False
    linear: Linear = False

    def run(self) -> None:
        """Measure, write the files and report."""
        from geometry.common.files import check_writable
        from probe_design.terminal.console import show_stages, show_table, warn, write_message
        from probe_design.tradeoffs.report import build_choice_table, build_summary_table, write_files
        from probe_design.tradeoffs.study import measure_tradeoff

        named_scenes = _read_scenes(self.scenes)
        check_writable(self.output)  # checked before the computation rather than after it
        with show_stages() as progress:
            study = measure_tradeoff(named_scenes, self.solid, progress, linear=self.linear)
        files = write_files(study, self.output)
        if self.as_json:
            print_json(study.as_dict() | {"files": [str(file) for file in files]})
        else:
            show_table(build_summary_table(study))
            show_table(build_choice_table(study))
            write_message(f"wrote {', '.join(file.name for file in files)} to {self.output}")
        for row in study.uncertain_references:
            remedy = "" if self.solid else "; --solid runs the three-dimensional evaluator"
            write_message(f"{row.scene}: even the most accurate result states an error of {row.stated_error:.2g}{remedy}")
        warn((*study.warnings, *(_describe_broken_row(row) for row in study.understated_rows)))


def _describe_broken_row(row: Row) -> str:
    """Return a warning about an evaluator whose true error is above its stated error."""
    reason = f"states an error of {row.stated_error:.2g}, which is {row.true_error_least:.2g} at least: a defect of the program"
    return f"{row.scene}: {row.setting} {reason}"


def _read_scenes(paths: Sequence[Path]) -> dict[str, Scene]:
    """Read scenes; return them by the names of their files, or by their paths where two files have the same name."""
    from probe_design.data.builtin import read_typical_scenes

    if not paths:
        return read_typical_scenes()
    stems = [path.stem for path in paths]
    return {path.stem if stems.count(path.stem) == 1 else str(path): read_scene(path) for path in paths}
