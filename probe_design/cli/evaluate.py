"""The commands `evaluate`, `plan`, `curve` and `tolerances`, which take one scene."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from probe_design.cli.arguments import (
    FILE_NAME,
    add_limit_options,
    complete_words,
    frequency_option,
    linear_option,
    loads_option,
    read_fraction,
    read_modulus,
)
from probe_design.cli.output import check_picture, present

EVALUATOR_NAMES = "auto, published, closed-form, equivalent-inclusion, axisymmetric, contact, solid"


@click.command()
@click.argument("scene", type=FILE_NAME)
@click.option(
    "--evaluator",
    default="auto",
    show_default=True,
    shell_complete=complete_words(*EVALUATOR_NAMES.split(", ")),
    help=f"Model to use: {EVALUATOR_NAMES}.",
)
@click.option("--accuracy", default="0.01", show_default=True, help="Relative error that ratio, stresses and stiffness may have.")
@linear_option
@loads_option
@frequency_option
@click.option("--vtu", type=FILE_NAME, help="With solid: write mesh, displacements and stresses for ParaView.")
@click.option("--plot", "picture", type=FILE_NAME, help="With solid: draw mesh and stresses to this .png file.")
@add_limit_options
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
    from probe_design.terminal.console import build_result_table, show_steps

    relative_accuracy = read_fraction("accuracy", accuracy)
    with show_steps(f"evaluating {scene}") as tell:
        if vtu is not None or picture is not None:
            from probe_design.solid_output.evaluate_with_files import evaluate_with_files
            from solver.evaluation import add_phase

            parsed_scene = read_scene(scene)
            result = evaluate_with_files(parsed_scene, evaluator, relative_accuracy, vtu=vtu, picture=picture, tell=tell)
            result = result if frequency is None else add_phase(result, parsed_scene, relative_accuracy, frequency)
        else:
            from solver import evaluate as run

            result = run(read_scene(scene), evaluator, relative_accuracy, tell, linear=linear, loads=loads, frequency=frequency)
    present(result, build_result_table, as_json)


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
@add_limit_options
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def curve(
    scene: Path, low: str, high: str, points: int, accuracy: str, linear: bool, picture: Path | None, as_json: bool
) -> None:
    """Compute how ratio and log-sensitivity depend on the inclusion's Young's modulus.

    With one sphere on the probe's axis all moduli follow exactly from one factorisation, so that a thousand take as long as ten.
    With tumours elsewhere each modulus takes some 10 to 100 ms.
    """
    from geometry.scenes.scene_file import read_scene
    from probe_design.reporting.curve_figures import draw_curve
    from probe_design.reporting.picture_files import save_figure
    from probe_design.terminal.console import build_curve_table, show_steps
    from solver import curve as run

    parsed_scene = read_scene(scene)
    check_picture(picture)
    with show_steps(f"curve of {scene}") as tell:
        result = run(parsed_scene, _space_moduli(low, high, points), read_fraction("accuracy", accuracy), tell, linear=linear)
    if picture is not None:
        body = parsed_scene.inclusion[parsed_scene.target or 0]
        tissue = parsed_scene.tissue.find_material(body.depth)
        save_figure(draw_curve(result, body.youngs_modulus, tissue.youngs_modulus), picture)
    present(result, build_curve_table, as_json, picture)


def _space_moduli(low: str, high: str, points: int) -> Any:
    """Return logarithmically spaced moduli that contain ``low`` and ``high`` exactly, Pa, shape (points,)."""
    import numpy as np

    from geometry.common.errors import InputError

    first, last = read_modulus("from", low), read_modulus("to", high)
    if not first < last:
        raise InputError("to", high, f"a modulus above from = {low!r}")
    moduli = np.geomspace(first, last, points)
    moduli[0], moduli[-1] = first, last
    return moduli


@click.command()
@click.argument("scene", type=FILE_NAME)
@click.option("--accuracy", default="0.01", show_default=True, help="Relative error that ratio, stresses and stiffness may have.")
@loads_option
@add_limit_options
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def plan(scene: Path, accuracy: str, loads: bool, as_json: bool) -> None:
    """Report which model of SCENE reaches --accuracy at the lowest cost, which features it neglects, and the reasons.

    evaluate without --evaluator does the same: where it refuses, so does plan (exit code 2). Every feature that may be neglected
    is listed with its effect on the ratio, on the stresses and on the stiffness. Nonlinear effects are bounded at the scene's
    load, and the largest load for which auto uses a linear evaluator is printed. The evaluator has been run and reaches the
    accuracy; solid is not run where its accuracy is certain without.
    """
    from geometry.scenes.scene_file import read_scene
    from probe_design.terminal.console import build_plan_table, list_plan_lines, show_spinner
    from solver import plan as run

    with show_spinner(f"planning {scene}"):
        result = run(read_scene(scene), read_fraction("accuracy", accuracy), loads=loads)
    present(result, build_plan_table, as_json, lines=list_plan_lines)
    if result.refusal is not None:
        raise result.refusal


@click.command()
@click.argument("scene", type=FILE_NAME)
@click.option("--ratio", default="0.01", show_default=True, help="Allowed relative standard deviation of the ratio.")
@click.option("--tolerance", multiple=True, help='A standard deviation: "probe.gap = 10 um", 5 % of a modulus or gain.')
@click.option("--material", multiple=True, help="Material of a block, inner=dragon-skin-30: sets the sd of its modulus.")
@click.option("--bench", type=FILE_NAME, help="TOML file whose [workshop] and [channels] replace the built-in ones.")
@click.option("--samples", default=1024, show_default=True, type=int, help="Samples for the Sobol indices: a power of 2.")
@click.option("--plot", "picture", type=FILE_NAME, help="Draw the budget to this .png, .svg or .pdf file.")
@add_limit_options
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
    from probe_design.terminal.console import show_spinner
    from probe_design.terminal.tolerance_table import build_tolerance_table, write_tolerance_lines
    from probe_design.tolerances.budget import tolerances as run
    from probe_design.tolerances.plot import plot_budget

    parsed_scene, allowed_sd = read_scene(scene), read_fraction("ratio", ratio)
    check_picture(picture)
    stated_sds, materials = (dict(_split_assignment(kind, text) for text in texts) for kind, texts in
                        (("tolerance", tolerance), ("material", material)))  # fmt: skip
    with show_spinner(f"tolerances of {scene}"):
        bench_data = None if bench is None else read_bench(bench)
        budget = run(parsed_scene, allowed_sd, bench=bench_data, materials=materials, given=stated_sds, samples=samples)
    if picture is not None:
        plot_budget(budget, picture)
    present(budget, build_tolerance_table, as_json, picture, write_tolerance_lines)


def _split_assignment(kind: str, text: str) -> tuple[str, str]:
    """Split a text such as "probe.gap = 10 um" into key and value."""
    from geometry.common.errors import InputError

    name, equals, value = (part.strip() for part in text.partition("="))
    if not equals:
        raise InputError(kind, text, {"tolerance": "'probe.gap = 10 um'", "material": "'inner=dragon-skin-30'"}[kind])
    return name, value
