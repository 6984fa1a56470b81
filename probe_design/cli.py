"""The command line: arguments in, one table or one JSON object out, one line for every refusal."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

import click

from probe_design.arguments import length, modulus, number, print_json
from probe_design.cli_estimate import estimate
from probe_design.cli_hardware import calibrate, check, read
from probe_design.cli_maps import detectability, scan
from probe_design.cli_plan import plan
from probe_design.cli_sweep import sweep
from probe_design.cli_tradeoff import tradeoff

HARDWARE = ("read", "calibrate", "check")
VERBS = ("evaluate", "plan", "curve", "scan", "detectability", "estimate", "optimize", "export", "tradeoff", "sweep", *HARDWARE)
EVALUATORS = "auto, published, closed-form, equivalent-inclusion, axisymmetric, solid"
CONTEXT = {"help_option_names": ["-h", "--help"], "max_content_width": 100}


class Verbs(click.Group):
    """The verbs; one that does not exist is refused with those that do."""

    def resolve_command(self, ctx: click.Context, args: list[str]) -> Any:
        """Look a verb up."""
        verb = args[0]
        if verb in VERBS:
            return super().resolve_command(ctx, args)
        raise click.UsageError(f"verb = {verb!r}: allowed: {', '.join(VERBS)}")


@click.group(cls=Verbs, context_settings=CONTEXT)
@click.version_option(package_name="probe-design")
def cli() -> None:
    """Design, check and export tactile palpation probes.

    A scene file (TOML) says which probe is pressed on which tissue; README shows one.
    """


@cli.command()
@click.argument("scene", type=click.Path(path_type=Path))
@click.option("--evaluator", default="auto", show_default=True, help=f"Level of fidelity: {EVALUATORS}.")
@click.option("--accuracy", default="0.01", show_default=True, help="Relative error that ratio, stresses and stiffness may have.")
@click.option("--vtu", type=click.Path(path_type=Path), help="With solid: write mesh, displacements and stresses for ParaView.")
@click.option("--plot", "picture", type=click.Path(path_type=Path), help="With solid: draw mesh and stresses to this .png file.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def evaluate(scene: Path, evaluator: str, accuracy: str, vtu: Path | None, picture: Path | None, as_json: bool) -> None:
    """Say what both films feel, and how well their ratio tells E_object.

    \b
    published             the paper's equations as printed: an equivalent modulus, no stresses
    closed-form           formulas, milliseconds, 1 to 30 %: spheres anywhere
    equivalent-inclusion  finite elements and scattering, 0.3 to 5 s, 1e-2 to 1e-3: tumours anywhere
    axisymmetric          finite elements, 0.1 to 10 s, 1e-2 to 1e-4: one sphere on the probe's axis
    solid                 3D finite elements, 10 to 100 s, 1e-2 to 3e-3: groove, edges, tilt, tumours
                          of any shape, from STL and STEP files too
    auto                  what plan says: the cheapest of the last three that takes the scene and
                          reaches --accuracy; refuses rather than answer worse
    """  # noqa: D301
    from geometry.scene_file import read_scene
    from probe_design.console import message, result_table, saying, show

    asked = number("accuracy", accuracy)
    with saying(f"evaluating {scene}") as tell:
        if vtu is not None or picture is not None:
            from probe_design.solid_files import evaluated

            result = evaluated(read_scene(scene), evaluator, asked, vtu, picture, tell)
        else:
            from solver import evaluate as run

            result = run(read_scene(scene), evaluator, asked, tell)
    if as_json:
        print_json(result.as_dict())
        return
    show(result_table(result))
    for warning in result.warnings:
        message(f"warning: {warning}")


@cli.command()
@click.argument("scene", type=click.Path(path_type=Path))
@click.option("--from", "low", default="1 kPa", show_default=True, help="Smallest Young's modulus of the inclusion.")
@click.option("--to", "high", default="1 MPa", show_default=True, help="Largest Young's modulus of the inclusion.")
@click.option(
    "--points", default=50, show_default=True, type=click.IntRange(2, 100_000), help="Moduli, evenly on a logarithmic scale."
)
@click.option("--accuracy", default="0.01", show_default=True, help="Relative error that the ratio may have at every modulus.")
@click.option("--plot", "picture", type=click.Path(path_type=Path), help="Draw the curve to this .png, .svg or .pdf file.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def curve(scene: Path, low: str, high: str, points: int, accuracy: str, picture: Path | None, as_json: bool) -> None:
    """Say how ratio and log-sensitivity depend on the inclusion's Young's modulus.

    With one sphere on the probe's axis all moduli follow exactly from one factorisation, so that a thousand cost as much as
    ten; with tumours elsewhere each modulus costs some 10 to 100 ms.
    """
    from geometry.files import check_writable
    from geometry.scene_file import read_scene
    from probe_design.console import curve_table, message, saying, show
    from probe_design.curve_plot import check_format, plot
    from solver import curve as run

    found = read_scene(scene)
    if picture is not None:
        check_format(picture)  # what would fail after the work fails before it
        check_writable(picture.parent)
    with saying(f"curve of {scene}") as tell:
        told = run(found, _moduli(low, high, points), number("accuracy", accuracy), tell)
    if picture is not None:
        plot(told, picture, found.inclusion[found.target or 0].youngs_modulus, found.tissue.youngs_modulus)
    if as_json:
        print_json(told.as_dict())
        return
    show(curve_table(told))
    for warning in told.warnings:
        message(f"warning: {warning}")
    if picture is not None:
        message(f"wrote {picture}")


@cli.command()
@click.argument("scene", type=click.Path(path_type=Path), required=False)
@click.option(
    "-o", "--output", type=click.Path(path_type=Path), required=True, help="Folder for the design, STEP files and report."
)
@click.option("--outer-radius", help="Limit of the probe's outer radius, such as '8 mm'.  [default: 1.4 times the start's]")
@click.option("--starts", default=8, show_default=True, type=click.IntRange(1, 100), help="Local searches.")
@click.option(
    "--evaluator", help="Who judges and polishes: axisymmetric or equivalent-inclusion.  [default: what the scene asks for]"
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def optimize(
    scene: Path | None, output: Path, outer_radius: str | None, starts: int, evaluator: str | None, as_json: bool
) -> None:
    """Find a probe that tells E_object better than SCENE's, prove it by finite elements, export it.

    Without SCENE the built-in one is improved: the paper's materials, gap, groove and films on a
    cylinder of tissue with one 8 mm tumour. The search varies inner radius, A2/A1, gap, height and
    both moduli by formulas; the ten best designs are judged by finite elements, the best three
    of them polished with exact derivatives. Exit code 1 if the judge sees no gain.
    """
    from geometry.files import check_writable
    from geometry.scene_file import read_scene
    from geometry.solids import cadquery
    from probe_design.builtin import builtin_scene
    from probe_design.console import message, show, stages
    from probe_design.optimize import optimize as run
    from probe_design.report import levels_table, summary, write_all

    start = builtin_scene() if scene is None else read_scene(scene)
    limit = None if outer_radius is None else length("outer-radius", outer_radius)
    check_writable(output)  # what would fail after the search fails before it
    cadquery()
    with stages() as progress:
        optimum = run(start, progress, limit, starts, evaluator)
        files = write_all(optimum, output, progress)
    if as_json:
        print_json(summary(optimum, files))
    else:
        show(levels_table(optimum))
        message(f"wrote {len(files)} files to {output}; begin with {output / 'report.html'}")
    if optimum.status == "no-gain":
        message(f"no gain: {optimum.baseline.judged.evaluator} sees no design that beats the start")
        raise SystemExit(1)


@cli.command()
@click.argument("scene", type=click.Path(path_type=Path))
@click.option("-o", "--output", type=click.Path(path_type=Path), required=True, help="Folder for the STEP files.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def export(scene: Path, output: Path, as_json: bool) -> None:
    """Write SCENE's probe as STEP files in millimetres, each read back and measured, and a drawing."""
    from geometry.scene_file import read_scene
    from probe_design.console import message, working

    with working("building the solids"):
        from geometry.drawing import draw
        from geometry.step import export as write

        probe = read_scene(scene).probe
        files = [*write(probe, output), draw(probe, output / "drawing.png")]
    if as_json:
        print_json({"files": [str(file) for file in files]})
    else:
        message(f"wrote {', '.join(file.name for file in files)} to {output}")


for verb in (plan, scan, detectability, estimate, tradeoff, sweep, read, calibrate, check):
    cli.add_command(verb)


def main() -> None:
    """Run the program: 0 good, 1 failure, 2 bad input, 130 interrupted; never a traceback."""
    sys.exit(_run())


def _run() -> int:
    try:
        code = cli.main(prog_name="probe-design", standalone_mode=False)
        return code if isinstance(code, int) else 0
    except click.exceptions.NoArgsIsHelpError as help_page:
        click.echo(help_page.format_message())
        return 0
    except click.ClickException as refused:
        return _fail(refused.format_message(), 2)
    except (KeyboardInterrupt, click.Abort):
        return _fail("interrupted; nothing half-written is left", 130)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # or Python complains again on the way out
        return 1
    except OSError as fault:
        return _fail(f"{fault.filename or 'output'}: {fault.strerror or fault}", 1)
    except MemoryError:
        return _fail("out of memory: ask for less with a larger --accuracy", 1)
    except Exception as fault:  # the toolkit's own errors, and the last line of defence of "never a traceback"
        return _explained(fault)


def _explained(fault: Exception) -> int:
    from geometry.errors import ProbeError  # costs 0.2 s, which --help need not pay
    from hw.errors import HardwareError

    if isinstance(fault, ProbeError | HardwareError):
        return _fail(str(fault), fault.exit_code)
    if os.environ.get("PROBE_DESIGN_DEBUG"):
        raise fault
    return _fail(f"a defect of the program: {type(fault).__name__}: {str(fault)[:200]}; PROBE_DESIGN_DEBUG=1 shows where", 1)


def _fail(text: str, code: int) -> int:
    print("probe-design:", *text.split(), file=sys.stderr)
    return code


def _moduli(low: str, high: str, points: int) -> Any:
    """Moduli from ``low`` to ``high``, both met exactly."""
    import numpy as np

    from geometry.errors import InputError

    first, last = modulus("from", low), modulus("to", high)
    if not first < last:
        raise InputError("to", high, f"a modulus above from = {low!r}")
    moduli = np.geomspace(first, last, points)
    moduli[0], moduli[-1] = first, last
    return moduli
