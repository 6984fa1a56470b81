"""The verbs `optimize` and `export`."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from probe_design.cli.arguments import FILE_NAME, completed, length, limiting, noise_of, noise_option, number
from probe_design.cli.output import print_json

if TYPE_CHECKING:
    from geometry.cad.export import Writer
    from geometry.scenes.probe import Probe
    from geometry.scenes.scene import Scene
    from geometry.workshop.package import Casting
    from probe_design.workshop.package import Exported

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
        files = write_all(optimum, output, progress, force=force, question=asked)
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
@click.option("-o", "--output", type=FILE_NAME, required=True, help="Folder for the files.")
@click.option("--step", help='Round radii, gap and heights to what is machined, "0.1 mm", and say what it costs.')
@click.option("--tolerance", default="0.01", show_default=True, help="Of the ratio, relative sd: what the tolerances may make.")
@click.option("--shrinkage", help="Linear, of the elastomer while it cures, for the moulds.  [default: 0.001]")
@click.option("--draft", help='Of the moulds\' walls, at most.  [default: "0.5 deg"]')
@FORCE
@click.option("--fixture", is_flag=True, help="Besides pin, ring and sleeve to calibrate with, and a page to print.")
@click.option("--bench", type=FILE_NAME, help="TOML file of load, amplifier and references, for that page.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def export(
    scene: Path, output: Path, step: str | None, tolerance: str, shrinkage: str | None, draft: str | None, force: bool,
    fixture: bool, bench: Path | None, as_json: bool,
) -> None:  # fmt: skip
    """Write what a workshop needs of SCENE's probe; docs/workshop.md tells each file.

    STEP files (AP242, millimetres) of parts, assembly and the moulds' halves, each read back and measured; a dimensioned drawing
    of each as DXF and PDF; film patterns with electrodes, leads and tabs as DXF; bill of materials, tolerances, assembly order.

    What SCENE leaves open and a part needs, such as the base's thickness, is assumed and marked; parts.json tells it too, and
    whose parts they are: a folder that holds another design is refused.

    With --fixture also pin.step, ring.step and sleeve.step, which press on one block alone, centred to 0.05 mm, and
    calibration.pdf, one page: the references of the bench in their order, loads, expected signals, commands.
    """
    from geometry.scenes.scene_file import read_scene
    from probe_design.terminal.console import saying

    drawn = read_scene(scene)
    size = None if step is None else length("step", step)
    allowed, casting = number("tolerance", tolerance), _casting(shrinkage, draft)
    with saying("export") as tell:
        from probe_design.workshop.package import export as write

        beside = partial(_to_calibrate, fixture, bench, scene.name)
        told = write(drawn, output, step=size, force=force, tolerance=allowed, casting=casting, beside=beside, tell=tell)
    if as_json:
        print_json(told.as_dict())
        return
    _tell(told, output)


def _casting(shrinkage: str | None, draft: str | None) -> Casting:
    from geometry.scenes.units import Quantity
    from geometry.scenes.units import number as plain
    from geometry.workshop.mould_sizes import DRAFT, MOST_DRAFT, SHRINKAGE
    from geometry.workshop.package import Casting

    share = SHRINKAGE if shrinkage is None else plain("shrinkage", shrinkage, "a number such as 0.001, of every length")
    angle = DRAFT if draft is None else Quantity("angle", "rad", "deg", 0.0, MOST_DRAFT).read("draft", draft)
    return Casting(share, angle)


def _to_calibrate(fixture: bool, bench: Path | None, name: str, scene: Scene) -> dict[str, Writer]:
    """What writes the fixture and the page, if they are asked for."""
    if not fixture:
        return {}
    from probe_design.built_probe.bench import builtin_bench, read_bench
    from probe_design.built_probe.protocol_page import writers

    return writers(scene, builtin_bench() if bench is None else read_bench(bench), name)


def _tell(told: Exported, output: Path) -> None:
    from probe_design.terminal.console import message, warn
    from probe_design.terminal.rounding_lines import rounding_lines

    _tell_assumed(told.scene.probe)
    for line in [] if told.rounding is None else rounding_lines(told.rounding):
        message(line)
    warn(told.remarks)
    message(f"wrote {', '.join(file.name for file in told.files)} to {output}")


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
