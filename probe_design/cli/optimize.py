"""The command `optimize`: search a better probe for the tumours of a design file or for the tumour of a scene."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from probe_design.cli.arguments import (
    FILE_NAME,
    add_limit_options,
    add_noise_option,
    complete_words,
    force_option,
    read_length,
    read_noise,
)
from probe_design.cli.output import print_json, report_assumed_sizes

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from geometry.scenes.scene import Scene
    from probe_design.populations.design_file import Design

DEFAULT_STARTS = 8  # local searches for a scene


@click.command()
@click.argument("scene", metavar="[SCENE | DESIGN]", type=FILE_NAME, required=False)
@click.option("-o", "--output", type=FILE_NAME, help="Folder for the design, STEP files and report.")
@click.option("--template", is_flag=True, help="Print a design file with every key, its default and its meaning, and exit.")
@click.option(
    "--pareto",
    multiple=True,
    type=click.Choice(["outer_radius", "force", "positions"]),
    help="With a DESIGN file: compute how the objective improves as this limit grows; may be repeated.",
)
@click.option("--outer-radius", help="Limit of the probe's outer radius, such as '8 mm'.  [default: 1.4 times the start's]")
@click.option("--starts", type=click.IntRange(1, 100), help="Local searches for a SCENE.  [default: 8]")
@click.option(
    "--evaluator",
    shell_complete=complete_words("axisymmetric", "equivalent-inclusion"),
    help="Verifies and refines: axisymmetric or equivalent-inclusion.  [default: chosen by the scene]",
)
@add_noise_option
@force_option
@add_limit_options
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def optimize(
    scene: Path | None, output: Path | None, template: bool, pareto: tuple[str, ...], outer_radius: str | None,
    starts: int | None, evaluator: str | None, noise: str | None, force: bool, as_json: bool,
) -> None:  # fmt: skip
    """Find a better probe for a DESIGN file's tumours or for a SCENE's tumour, verify it by finite elements, and export it.

    A DESIGN file (--template prints one) describes the tumours and their tissue, the readings and their noise, the limits, and
    the design variables: dimensions, moduli, materials that can be bought. The probe that detects most of
    them, or resolves most, is searched by formulas, refined and verified by finite elements on tumours that were not used in
    the search. Without a file, a built-in design file is used, which starts at the paper's probe. Every result states the
    probability of detection by the ratio alone, by the stiffness alone and by both. A gain counts if it is above twice its error.
    If there is none, the initial design is exported, and the exit code is 1.

    For a SCENE the standard deviation of ln E_object of its one tumour is improved. The search varies inner radius, A2/A1,
    gap, height and both moduli by formulas; the ten best designs are verified by finite elements, the best three of them
    refined with exact derivatives. A gain counts if it is above what the errors of both designs can cause.

    \b
    Limits for a SCENE, each extended to the initial design if that lies outside:
      outer radius   --outer-radius, and 0.95 of the tissue's radius or half its breadth
      inner radius   0.5 mm or more, and 0.55 groove widths
      wall           0.5 mm or more, of the outer block
      A2/A1          0.05 to 20
      gap            0.1 mm to 0.5 mm
      height         1 mm to 20 mm, and 1.25 groove depths
      moduli         10 kPa to 1 MPa, of each block
    SCENE's load is an upper limit. In the search each design has the largest load that is within this limit, changes the ratio by
    at most 1 % through finite strain, and is at most 1/20 of the force that closes the gap. Where SCENE's load is above that,
    contact evaluates the initial design and the candidates under the best load up to it (one tumour on the axis), with an open
    gap and up to half an outer radius deep. The table lists the active limits, the limit of the force, and the effect of more
    load.
    """  # noqa: D301
    from probe_design.design_search.design_source import read_design_source
    from probe_design.populations.design_file import Design

    if template:
        from probe_design.design_search.template import build_design_template

        click.echo(build_design_template(), nl=False)
        return
    if output is None:
        raise click.UsageError("Missing option '-o' / '--output'.")
    start = read_design_source(scene)
    scene_options = {"outer-radius": outer_radius, "starts": starts, "evaluator": evaluator, "noise": noise}
    if isinstance(start, Design):
        _refuse_options(scene_options, "none for a design file, whose tables say it")
        _check_output(output, _compute_question_digest(start), force)
        _optimize_population(start, output, _compute_question_digest(start), force=force, pareto=pareto, as_json=as_json)
        return
    _refuse_options({"pareto": ", ".join(pareto) or None}, "none for a scene: fronts are a design file's")
    max_radius = None if outer_radius is None else read_length("outer-radius", outer_radius)
    _optimize_scene(
        start,
        output,
        max_radius=max_radius,
        starts=starts or DEFAULT_STARTS,
        evaluator=evaluator,
        noise=read_noise(noise),
        force=force,
        as_json=as_json,
    )


def _refuse_options(options: Mapping[str, object], allowed: str) -> None:
    """Refuse options that do not apply to this kind of file."""
    from geometry.common.errors import InputError

    for key, value in options.items():
        if value is not None:
            raise InputError(key, value, allowed)


def _check_output(output: Path, question_digest: str, force: bool) -> None:
    """Check the output folder and CAD before the search rather than after it."""
    from geometry.cad.parts_record import check_same_question
    from geometry.cad.solids import load_cadquery
    from geometry.common.files import check_writable

    check_writable(output)
    if not force:
        check_same_question(output, question_digest)
    load_cadquery()


def _optimize_population(
    design: Design, output: Path, question_digest: str, *, force: bool, pareto: tuple[str, ...], as_json: bool
) -> None:
    """Search, verify, write and report; exit code 1 where no gain counts."""
    from functools import partial

    from probe_design.design_report.report import compute_maps, write_all
    from probe_design.design_report.table import build_table
    from probe_design.design_search.optimize import optimize
    from probe_design.design_search.pareto import compute_front
    from probe_design.terminal.console import show_stages, show_table, write_message

    with show_stages() as progress:
        optimum = optimize(design, progress)
        maps = compute_maps(optimum)
        fronts = tuple(compute_front(design, quantity, partial(progress, f"front: {quantity}")) for quantity in pareto)
        files = write_all(optimum, output, progress, maps, fronts, force=force, asking=question_digest)
    if as_json:
        import json

        record: Mapping[str, object] = json.loads((output / "optimize.json").read_text(encoding="utf-8"))
        print_json(dict(record))
    else:
        show_table(build_table(optimum, maps))
        write_message(f"search: {optimum.how}")
        write_message(f"error of the detection: {optimum.best.judgement.error_note}")
        _report_files(output, files)
    _conclude(optimum.verdict, optimum.status, optimum.warnings)


def _optimize_scene(
    start: Scene,
    output: Path,
    *,
    max_radius: float | None,
    starts: int,
    evaluator: str | None,
    noise: float,
    force: bool,
    as_json: bool,
) -> None:
    from probe_design.optimisation.comparison import build_comparison_table
    from probe_design.optimisation.optimize import optimize as run
    from probe_design.optimisation.report import build_summary, write_all
    from probe_design.terminal.console import show_stages, show_table, warn
    from probe_design.workshop.package import list_missing_films

    question_digest = _compute_question_digest(start)
    _check_output(output, question_digest, force)
    with show_stages() as progress:
        optimum = run(start, progress, outer_radius=max_radius, starts=starts, judge=evaluator, noise=noise)
        files = write_all(optimum, output, progress, force=force, question=question_digest)
    if as_json:
        print_json(build_summary(optimum, files))
    else:
        show_table(build_comparison_table(optimum))
        report_assumed_sizes(optimum.best.scene.probe)
        warn(list_missing_films(optimum.best.scene.probe))
        _report_files(output, files)
    _conclude(optimum.verdict, optimum.status, optimum.remarks)


def _report_files(output: Path, files: Sequence[Path]) -> None:
    """Report the files written, and the command that exports them for the workshop."""
    from probe_design.reporting.workshop_command import build_export_command
    from probe_design.terminal.console import write_message

    write_message(f"wrote {len(files)} files to {output}; begin with {output / 'report.html'}")
    write_message(f"for the workshop: {build_export_command(output)}")


def _conclude(verdict: str, status: str, warnings: Iterable[str]) -> None:
    """Report warnings and verdict; exit code 1 where there is no gain."""
    from probe_design.terminal.console import warn, write_message

    warn(warnings)
    write_message(verdict)
    if status == "no-gain":
        raise SystemExit(1)


def _compute_question_digest(start: Scene | Design) -> str:
    """Return a digest of the scene or design, and of every option that the result depends on."""
    from importlib.metadata import version

    from geometry.provenance.digest import compute_digest

    ignored_names = ("scene", "output", "force", "as_json", "template", "pareto")
    parameters = click.get_current_context().params.items()
    options = {key: str(value) for key, value in parameters if key not in ignored_names and value is not None}
    tables = start.model_dump(mode="json", exclude_none=True)
    return compute_digest({"asked": tables, "version": version("probe-design"), **options})
