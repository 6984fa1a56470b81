"""``probe-design plan``."""

from __future__ import annotations

from pathlib import Path

import click

from probe_design.cli.arguments import FILE_NAME, limiting, loads_option, number
from probe_design.cli.output import present


@click.command()
@click.argument("scene", type=FILE_NAME)
@click.option("--accuracy", default="0.01", show_default=True, help="Relative error that ratio, stresses and stiffness may have.")
@loads_option
@limiting
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def plan(scene: Path, accuracy: str, loads: bool, as_json: bool) -> None:
    """Say which model of SCENE meets --accuracy at the least cost, what it leaves out, and why.

    This is what evaluate and curve do without --evaluator. Every feature that could be left out is listed with what it changes
    of the ratio, of the stresses and of the stiffness; what is not linear is bounded at the scene's load, and the
    largest load that auto answers linearly is told.
    """
    from geometry.scenes.scene_file import read_scene
    from probe_design.terminal.console import plan_lines, plan_table, working
    from solver import plan as run

    with working(f"planning {scene}"):
        decided = run(read_scene(scene), number("accuracy", accuracy), loads=loads)
    present(decided, plan_table, as_json, lines=plan_lines)
