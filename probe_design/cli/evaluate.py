"""The commands `evaluate`, `plan`, `curve` and `tolerances`, which take one scene."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from probe_design.cli.arguments import (
    FILE_NAME,
    completed,
    fraction,
    frequency_option,
    limiting,
    linear_option,
    loads_option,
    modulus,
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
    help=f"Model to use: {EVALUATORS}.",
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
    """Compute the film stresses, their ratio and its sensitivity to the tumour's modulus.

    \b
    published             the paper's equations as printed: an equivalent modulus, no stresses
    closed-form           formulas, milliseconds, 1 to 30 %: spheres anywhere
    equivalent-inclusion  finite elements and scattering, 0.3 to 5 s, 1e-2 to 1e-3: tumours anywhere
    axisymmetric          finite elements, 0.1 to 10 s, 1e-2 to 1e-4: one sphere on the probe's axis
    contact               finite elements at finite strain, walls in contact, 2 to 20 s, 5e-3 to 2e-2:
                          one sphere on the probe's axis, loads of a hand
    solid                 3D finite elements, 10 to 100 s, 1e-2 to 3e-3: groove, edges, tilt, tumours
                          of any shape, from STL and STEP files too
    auto                  chosen by plan: the cheapest of the last four that can model the scene
                          and reaches --accuracy; refuses where none does

    All but contact are exact for small loads. Beyond linear_limit_load a named evaluator warns; auto uses contact if that can
    model the scene, and refuses if not. With --linear, error_estimate counts the possible effect of finite strain instead.
    """  # noqa: D301
    from geometry.scenes.scene_file import read_scene
    from probe_design.terminal.console import result_table, saying

    relative = fraction("accuracy", accuracy)
    with saying(f"evaluating {scene}") as tell:
        if vtu is not None or picture is not None:
            from probe_design.solid_output.evaluate_with_files import evaluated
            from solver.answers import with_phase

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
    """Compute how ratio and log-sensitivity depend on the inclusion's Young's modulus.

    With one sphere on the probe's axis all moduli follow exactly from one factorisation, so that a thousand take as long as ten.
    With tumours elsewhere each modulus takes some 10 to 100 ms.
    """
    from geometry.scenes.scene_file import read_scene
    from probe_design.maps.curve_plot import plot
    from probe_design.terminal.console import curve_table, saying
    from solver import curve as run

    read = read_scene(scene)
    check_picture(picture)
    with saying(f"curve of {scene}") as tell:
        answer = run(read, _moduli(low, high, points), fraction("accuracy", accuracy), tell, linear=linear)
    if picture is not None:
        body = read.inclusion[read.target or 0]
        plot(answer, picture, body.youngs_modulus, read.tissue.material_at(body.depth).youngs_modulus)
    present(answer, curve_table, as_json, picture)


def _moduli(low: str, high: str, points: int) -> Any:
    """Return logarithmically spaced moduli that contain ``low`` and ``high`` exactly, Pa, shape (points,)."""
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
    """Report which model of SCENE reaches --accuracy at the lowest cost, which features it neglects, and the reasons.

    evaluate without --evaluator does the same: where it refuses, so does plan (exit code 2). Every feature that may be neglected
    is listed with its effect on the ratio, on the stresses and on the stiffness. Nonlinear effects are bounded at the scene's
    load, and the largest load for which auto uses a linear evaluator is printed. The evaluator has been run and reaches the
    accuracy; solid is not run where its accuracy is certain without.
    """
    from geometry.scenes.scene_file import read_scene
    from probe_design.terminal.console import plan_lines, plan_table, working
    from solver import plan as run

    with working(f"planning {scene}"):
        decided = run(read_scene(scene), fraction("accuracy", accuracy), loads=loads)
    present(decided, plan_table, as_json, lines=plan_lines)
    if decided.refusal is not None:
        raise decided.refusal


@click.command()
@click.argument("scene", type=FILE_NAME)
@click.option("--ratio", default="0.01", show_default=True, help="Allowed relative standard deviation of the ratio.")
@click.option("--tolerance", multiple=True, help='A standard deviation: "probe.gap = 10 um", 5 % of a modulus or gain.')
@click.option("--material", multiple=True, help="Material of a block, inner=dragon-skin-30: sets the sd of its modulus.")
@click.option("--bench", type=FILE_NAME, help="TOML file whose [workshop] and [channels] replace the built-in ones.")
@click.option("--samples", default=1024, show_default=True, type=int, help="Samples for the Sobol indices: a power of 2.")
@click.option("--plot", "picture", type=FILE_NAME, help="Draw the budget to this .png, .svg or .pdf file.")
@limiting
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def tolerances(
    scene: Path, ratio: str, tolerance: tuple[str, ...], material: tuple[str, ...], bench: Path | None, samples: int,
    picture: Path | None, as_json: bool,
) -> None:  # fmt: skip
    """Compute how manufacturing tolerances of SCENE's probe change its ratio, and which tolerances --ratio requires.

    Radii and heights have the tolerances of casting or machining, moduli those of the catalogue for a named material, gains 5 %;
    or those of --bench, --tolerance and --material. To first order by exact derivatives, and by samples of the closed form.
    """
    from geometry.scenes.scene_file import read_scene
    from probe_design.built_probe.bench import read_bench
    from probe_design.terminal.console import working
    from probe_design.terminal.tolerance_table import tolerance_lines, tolerance_table
    from probe_design.tolerances.budget import tolerances as run
    from probe_design.tolerances.plot import plot

    read, allowed = read_scene(scene), fraction("ratio", ratio)
    check_picture(picture)
    given, materials = (dict(_named(kind, text) for text in texts) for kind, texts in
                        (("tolerance", tolerance), ("material", material)))  # fmt: skip
    with working(f"tolerances of {scene}"):
        shop = None if bench is None else read_bench(bench)
        found = run(read, allowed, bench=shop, materials=materials, given=given, samples=samples)
    if picture is not None:
        plot(found, picture)
    present(found, tolerance_table, as_json, picture, tolerance_lines)


def _named(kind: str, text: str) -> tuple[str, str]:
    """Split a text such as "probe.gap = 10 um" into key and value."""
    from geometry.common.errors import InputError

    name, equals, value = (part.strip() for part in text.partition("="))
    if not equals:
        raise InputError(kind, text, {"tolerance": "'probe.gap = 10 um'", "material": "'inner=dragon-skin-30'"}[kind])
    return name, value
