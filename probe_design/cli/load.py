"""The command `load`."""

from __future__ import annotations

from pathlib import Path

import click

from probe_design.cli.arguments import FILE_NAME, add_limit_options, read_fraction
from probe_design.cli.output import check_picture, present


@click.command()
@click.argument("scene", type=FILE_NAME)
@click.option("--to", "max_load", required=True, help='Largest load: a force, "0.3 N", or an indentation, "2 mm".')
@click.option("--points", default=20, show_default=True, type=click.IntRange(1, 1000), help="Loads, evenly spaced above 0.")
@click.option("--accuracy", default="0.01", show_default=True, help="Relative error that ratio, stresses and stiffness may have.")
@click.option("--plot", "picture", type=FILE_NAME, help="Draw ratio, log-sensitivity and walls to this .png, .svg or .pdf file.")
@add_limit_options
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def load(scene: Path, max_load: str, points: int, accuracy: str, picture: Path | None, as_json: bool) -> None:
    """Compute ratio, log-sensitivity and the gap between the blocks under rising loads.

    Finite strain and contact are modelled (evaluator contact): tissue folds onto the blocks' walls, and the gap closes. The
    command also reports the load at which the gap closes, the load up to which linear theory holds within --accuracy, and the
    range of loads in which the ratio is constant within --accuracy. The log-sensitivity is taken at constant force. Where no
    further step converges, the curve ends early, with a warning.
    """
    from geometry.scenes.scene_file import read_scene
    from probe_design.reporting.curve_figures import draw_load_curve
    from probe_design.reporting.picture_files import save_figure
    from probe_design.terminal.console import show_steps
    from probe_design.terminal.load_table import build_load_table, list_load_lines
    from solver.evaluation import load as run

    force, indentation = _read_load(max_load)
    parsed_scene = read_scene(scene)
    check_picture(picture)
    with show_steps(f"pressing {scene}") as tell:
        result = run(
            parsed_scene,
            force=force,
            indentation=indentation,
            points=points,
            accuracy=read_fraction("accuracy", accuracy),
            tell=tell,
        )
    if picture is not None:
        save_figure(draw_load_curve(result), picture)
    present(result, build_load_table, as_json, picture, list_load_lines)


def _read_load(text: str) -> tuple[float | None, float | None]:
    """Return (force, None) or (None, indentation) of a text, in N and m."""
    from typing import get_args

    from geometry.common.errors import InputError
    from geometry.scenes.scene import Force, Indentation

    for k, kind in enumerate((Force, Indentation)):
        try:
            value = float(get_args(kind)[1].read("to", text))
        except InputError:
            continue
        if value > 0:
            return (value, None) if k == 0 else (None, value)
    raise InputError("to", text, "a force such as '0.3 N', or an indentation such as '2 mm', above 0")
