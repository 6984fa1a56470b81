"""The verbs `optimize` and `export`."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from probe_design.cli.arguments import FILE_NAME, completed, length, limiting, noise_of, noise_option
from probe_design.cli.output import print_json

if TYPE_CHECKING:
    from collections.abc import Callable

    from geometry.scenes.probe import Probe
    from geometry.scenes.scene import Scene


FORCE = click.option("--force", is_flag=True, help="Replace parts of another design that the folder holds.")


@click.command()
@click.argument("scene", type=FILE_NAME, required=False)
@click.option("-o", "--output", type=FILE_NAME, required=True, help="Folder for the design, STEP files and report.")
@click.option("--outer-radius", help="Limit of the probe's outer radius, such as '8 mm'.  [default: 1.4 times the start's]")
@click.option("--starts", default=8, show_default=True, type=click.IntRange(1, 100), help="Local searches.")
@click.option(
    "--evaluator",
    shell_complete=completed("axisymmetric", "equivalent-inclusion"),
    help="Who judges and polishes: axisymmetric or equivalent-inclusion.  [default: what the scene asks for]",
)
@noise_option
@FORCE
@limiting
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def optimize(
    scene: Path | None, output: Path, outer_radius: str | None, starts: int, evaluator: str | None, noise: str | None,
    force: bool, as_json: bool,
) -> None:  # fmt: skip
    """Find a probe that tells E_object better than SCENE's, prove it by finite elements, export it.

    Without SCENE the built-in one is improved: the paper's materials, gap, groove and films on a
    cylinder of tissue with one 8 mm tumour. The search varies inner radius, A2/A1, gap, height and
    both moduli by formulas; the ten best designs are judged by finite elements, the best three
    of them polished with exact derivatives. A gain counts where it is beyond what the errors of start and design can
    feign. Exit code 1 if none does.

    \b
    Limits, each as far as the start lies if that is beyond it:
      outer radius   --outer-radius, and 0.95 of the tissue's radius or half its breadth
      inner radius   0.5 mm or more, and 0.55 groove widths
      wall           0.5 mm or more, of the outer block
      A2/A1          0.05 to 20
      gap            0.1 mm to 0.5 mm
      height         1 mm to 20 mm, and 1.25 groove depths
      moduli         10 kPa to 1 MPa, of each block
    The force is the least of what SCENE's load gives on the design, the force at which finite strain changes the ratio
    by 1 %, and 1/25 of the force that closes the gap. The table says which limits are active and what sets the force.
    """  # noqa: D301
    from geometry.cad.record import check_asked
    from geometry.cad.solids import cadquery
    from geometry.common.files import check_writable
    from geometry.scenes.scene_file import read_scene
    from probe_design.data.builtin import builtin_scene
    from probe_design.optimisation.comparison import levels_table
    from probe_design.optimisation.optimize import optimize as run
    from probe_design.optimisation.report import summary, write_all
    from probe_design.terminal.console import message, show, stages, warn

    start = builtin_scene() if scene is None else read_scene(scene)
    limit = None if outer_radius is None else length("outer-radius", outer_radius)
    relative = noise_of(noise)
    check_writable(output)  # what would fail after the search fails before it
    asked = _question(start)
    if not force:
        check_asked(output, asked)
    cadquery()
    with stages() as progress:
        optimum = run(start, progress, outer_radius=limit, starts=starts, judge=evaluator, noise=relative)
        files = write_all(optimum, output, progress, force=force, asked=asked)
    if as_json:
        print_json(summary(optimum, files))
    else:
        show(levels_table(optimum))
        _tell_assumed(optimum.best.scene.probe)
        message(f"wrote {len(files)} files to {output}; begin with {output / 'report.html'}")
    warn(optimum.remarks)
    message(optimum.verdict)
    if optimum.status == "no-gain":
        raise SystemExit(1)


@click.command()
@click.argument("scene", type=FILE_NAME)
@click.option("-o", "--output", type=FILE_NAME, required=True, help="Folder for the STEP files.")
@FORCE
@click.option("--fixture", is_flag=True, help="Besides pin, ring and sleeve to calibrate with, and a page to print.")
@click.option("--bench", type=FILE_NAME, help="TOML file of load, amplifier and references, for that page.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def export(scene: Path, output: Path, force: bool, fixture: bool, bench: Path | None, as_json: bool) -> None:
    """Write SCENE's probe as STEP files in millimetres, each read back and measured, and a drawing.

    What SCENE leaves open and a part needs, such as the base's thickness, is assumed and marked; parts.json tells it too, and
    whose parts they are: a folder that holds another design is refused.

    With --fixture also pin.step, ring.step and sleeve.step, which press on one block alone, centred to 0.05 mm, and
    calibration.pdf, one page: the references of the bench in their order, loads, expected signals, commands.
    """
    from geometry.common.files import check_writable
    from geometry.scenes.base_sizes import assumed_sizes
    from geometry.scenes.probe import mm
    from geometry.scenes.scene_file import read_scene
    from probe_design.terminal.console import message, working

    with working("building the solids"):
        from geometry.cad.drawing import draw
        from geometry.cad.export import export as write

        drawn = read_scene(scene)
        probe, edge = drawn.probe, drawn.contact.edge_radius
        check_writable(output)
        beside = _to_calibrate(drawn, bench, scene.name) if fixture else {}
        drawing = partial(draw, probe, edge_radius=edge)
        files = write(probe, output, force, beside={"drawing.png": drawing, **beside}, edge_radius=edge)
    assumed = {key: str(mm(size)) for key, size in assumed_sizes(probe).items()}
    if as_json:
        print_json({"files": [str(file) for file in files], "assumed": assumed})
        return
    _tell_assumed(probe)
    message(f"wrote {', '.join(file.name for file in files)} to {output}")


def _to_calibrate(scene: Scene, bench: Path | None, name: str) -> dict[str, Callable[[Path], object]]:
    """What writes the fixture and the page."""
    from probe_design.built_probe.bench import builtin_bench, read_bench
    from probe_design.built_probe.protocol_page import writers

    return writers(scene, builtin_bench() if bench is None else read_bench(bench), name)


def _tell_assumed(probe: Probe) -> None:
    """Say of which sizes a workshop should know that nobody has given them."""
    from geometry.scenes.base_sizes import assumed_sizes
    from geometry.scenes.probe import mm
    from probe_design.terminal.console import message

    for key, size in assumed_sizes(probe).items():
        message(f"assumed: {key} = {mm(size)}, which the scene does not give")
    if probe.film is None:
        message("no films: the scene has no [probe.film]; the base lies on the blocks")


def _question(start: Scene) -> str:
    """What an optimisation is asked: the scene, and every option that its answer depends on."""
    from importlib.metadata import version

    from geometry.provenance.digest import digest
    from geometry.scenes.scene_file import scene_to_dict

    others = ("scene", "output", "force", "as_json")
    options = {key: str(value) for key, value in click.get_current_context().params.items() if key not in others}
    return digest({"scene": scene_to_dict(start), "version": version("probe-design"), **options})
