"""The command `export`: write the files that a workshop needs to build a scene's probe."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from probe_design.cli.arguments import FILE_NAME, force_option, fraction, length
from probe_design.cli.output import print_json, tell_assumed

if TYPE_CHECKING:
    from geometry.cad.export import Writer
    from geometry.scenes.scene import Scene
    from geometry.workshop.package import Casting
    from probe_design.workshop.package import Exported


@click.command()
@click.argument("scene", type=FILE_NAME)
@click.option("-o", "--output", type=FILE_NAME, required=True, help="Folder for the files.")
@click.option("--step", help='Round radii, gap and heights to multiples of this, "0.1 mm", and report the effect.')
@click.option("--tolerance", default="0.01", show_default=True, help="Relative sd of the ratio that the tolerances may cause.")
@click.option("--shrinkage", help="Linear shrinkage of the elastomer while it cures, for the moulds.  [default: 0.001]")
@click.option("--draft", help='Maximum draft angle of the moulds\' walls.  [default: "0.5 deg"]')
@force_option
@click.option("--fixture", is_flag=True, help="Write also pin, ring and sleeve for the calibration, and a page to print.")
@click.option("--bench", type=FILE_NAME, help="TOML file of load, amplifier and references, for that page.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def export(
    scene: Path, output: Path, step: str | None, tolerance: str, shrinkage: str | None, draft: str | None, force: bool,
    fixture: bool, bench: Path | None, as_json: bool,
) -> None:  # fmt: skip
    """Write the files that a workshop needs to build SCENE's probe; docs/guides/workshop.md describes each file.

    STEP files (AP242, millimetres) of parts, assembly and the moulds' halves, each read back and measured; a dimensioned drawing
    of each as DXF and PDF; film patterns with electrodes, leads and tabs as DXF; bill of materials, tolerances, assembly order.

    A size that a part needs and SCENE does not give, such as the base's thickness, is assumed and marked, also in parts.json.
    parts.json identifies the design, and a folder that holds another design is refused.

    With --fixture also pin.step, ring.step and sleeve.step, which press on one block alone, centred to 0.05 mm, and
    calibration.pdf, one page with the references of the bench in their order, loads, expected signals and commands.
    """
    from geometry.scenes.scene_file import read_scene
    from probe_design.terminal.console import saying

    drawn = read_scene(scene)
    size = None if step is None else length("step", step)
    allowed, casting = fraction("tolerance", tolerance), _casting(shrinkage, draft)
    with saying("export") as tell:
        from probe_design.workshop.package import export as write

        beside = partial(_to_calibrate, fixture, bench, scene.name)
        told = write(drawn, output, step=size, force=force, tolerance=allowed, casting=casting, beside=beside, tell=tell)
    if as_json:
        print_json(told.as_dict())
        return
    _tell(told, output)


def _casting(shrinkage: str | None, draft: str | None) -> Casting:
    """Return shrinkage and draft angle as numbers, or their defaults."""
    from geometry.scenes.units import Quantity
    from geometry.scenes.units import number as plain
    from geometry.workshop.mould_sizes import DRAFT, MOST_DRAFT, SHRINKAGE
    from geometry.workshop.package import Casting

    share = SHRINKAGE if shrinkage is None else plain("shrinkage", shrinkage, "a number such as 0.001, of every length")
    angle = DRAFT if draft is None else Quantity("angle", "rad", "deg", 0.0, MOST_DRAFT).read("draft", draft)
    return Casting(share, angle)


def _to_calibrate(fixture: bool, bench: Path | None, name: str, scene: Scene) -> dict[str, Writer]:
    """Return the writers of the fixture and of the calibration page, if --fixture is given."""
    if not fixture:
        return {}
    from probe_design.built_probe.bench import builtin_bench, read_bench
    from probe_design.measuring.protocol_page import writers

    return writers(scene, builtin_bench() if bench is None else read_bench(bench), name)


def _tell(told: Exported, output: Path) -> None:
    """Report assumed sizes, the effect of rounding, warnings and the files written."""
    from probe_design.terminal.console import message, warn
    from probe_design.terminal.rounding_lines import rounding_lines

    tell_assumed(told.scene.probe)
    for line in [] if told.rounding is None else rounding_lines(told.rounding):
        message(line)
    warn(told.remarks)
    message(f"wrote {', '.join(file.name for file in told.files)} to {output}")
