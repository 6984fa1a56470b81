"""The verbs `evaluate`, `plan` and `curve`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from probe_design.cli.arguments import (
    FILE_NAME,
    completed,
    frequency_option,
    limiting,
    linear_option,
    loads_option,
    modulus,
    number,
)
from probe_design.cli.output import check_picture, present

EVALUATORS = "auto, published, closed-form, equivalent-inclusion, axisymmetric, contact, solid"


@click.command()
@click.argument("scene", type=FILE_NAME)
@click.option(
    "--evaluator",
    default="auto",
    show_default=True,
    shell_complete=completed(*EVALUATORS.split(", ")),
    help=f"Level of fidelity: {EVALUATORS}.",
)
@click.option("--accuracy", default="0.01", show_default=True, help="Relative error that ratio, stresses and stiffness may have.")
@linear_option
@loads_option
@frequency_option
@click.option("--vtu", type=FILE_NAME, help="With solid: write mesh, displacements and stresses for ParaView.")
@click.option("--plot", "picture", type=FILE_NAME, help="With solid: draw mesh and stresses to this .png file.")
@limiting
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def evaluate(
    scene: Path, evaluator: str, accuracy: str, linear: bool, loads: bool, frequency: float | None, vtu: Path | None,
    picture: Path | None, as_json: bool,
) -> None:  # fmt: skip
    """Say what both films feel, and how well their ratio tells E_object.

    \b
    published             the paper's equations as printed: an equivalent modulus, no stresses
    closed-form           formulas, milliseconds, 1 to 30 %: spheres anywhere
    equivalent-inclusion  finite elements and scattering, 0.3 to 5 s, 1e-2 to 1e-3: tumours anywhere
    axisymmetric          finite elements, 0.1 to 10 s, 1e-2 to 1e-4: one sphere on the probe's axis
    contact               finite elements at finite strain, walls in contact, 2 to 20 s, 5e-3 to 2e-2:
                          one sphere on the probe's axis, loads that a hand makes
    solid                 3D finite elements, 10 to 100 s, 1e-2 to 3e-3: groove, edges, tilt, tumours
                          of any shape, from STL and STEP files too
    auto                  what plan says: the cheapest of the last four that takes the scene and
                          reaches --accuracy; refuses rather than answer worse

    All but contact are exact for small loads. Beyond linear_limit_load an evaluator that is named warns; auto has contact answer
    if it can, refuses if not, or with --linear counts in error_estimate what finite strain may change.
    """  # noqa: D301
    from geometry.scenes.scene_file import read_scene
    from probe_design.terminal.console import result_table, saying

    relative = number("accuracy", accuracy)
    with saying(f"evaluating {scene}") as tell:
        if vtu is not None or picture is not None:
            from probe_design.solid_output.evaluate_with_files import evaluated
            from solver.levels import with_phase

            read = read_scene(scene)
            result = evaluated(read, evaluator, relative, vtu=vtu, picture=picture, tell=tell)
            result = result if frequency is None else with_phase(result, read, relative, frequency)
        else:
            from solver import evaluate as run

            result = run(read_scene(scene), evaluator, relative, tell, linear=linear, loads=loads, frequency=frequency)
    present(result, result_table, as_json)


@click.command()
@click.argument("scene", type=FILE_NAME)
@click.option("--from", "low", default="1 kPa", show_default=True, help="Smallest Young's modulus of the inclusion.")
@click.option("--to", "high", default="1 MPa", show_default=True, help="Largest Young's modulus of the inclusion.")
@click.option(
    "--points", default=50, show_default=True, type=click.IntRange(2, 100_000), help="Moduli, evenly on a logarithmic scale."
)
@click.option("--accuracy", default="0.01", show_default=True, help="Relative error that the ratio may have at every modulus.")
@linear_option
@click.option("--plot", "picture", type=FILE_NAME, help="Draw the curve to this .png, .svg or .pdf file.")
@limiting
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def curve(
    scene: Path, low: str, high: str, points: int, accuracy: str, linear: bool, picture: Path | None, as_json: bool
) -> None:
    """Say how ratio and log-sensitivity depend on the inclusion's Young's modulus.

    With one sphere on the probe's axis all moduli follow exactly from one factorisation, so that a thousand cost as much as
    ten; with tumours elsewhere each modulus costs some 10 to 100 ms.
    """
    from geometry.scenes.scene_file import read_scene
    from probe_design.maps.curve_plot import plot
    from probe_design.terminal.console import curve_table, saying
    from solver import curve as run

    read = read_scene(scene)
    check_picture(picture)
    with saying(f"curve of {scene}") as tell:
        answer = run(read, _moduli(low, high, points), number("accuracy", accuracy), tell, linear=linear)
    if picture is not None:
        body = read.inclusion[read.target or 0]
        plot(answer, picture, body.youngs_modulus, read.tissue.material_at(body.depth).youngs_modulus)
    present(answer, curve_table, as_json, picture)


def _moduli(low: str, high: str, points: int) -> Any:
    """Moduli from ``low`` to ``high``, both met exactly."""
    import numpy as np

    from geometry.common.errors import InputError

    first, last = modulus("from", low), modulus("to", high)
    if not first < last:
        raise InputError("to", high, f"a modulus above from = {low!r}")
    moduli = np.geomspace(first, last, points)
    moduli[0], moduli[-1] = first, last
    return moduli


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
