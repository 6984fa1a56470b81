"""The command `export`: write the files that a workshop needs to build a scene's probe."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from probe_design.cli.arguments import FILE_NAME, force_option, read_fraction, read_length
from probe_design.cli.output import print_json, report_assumed_sizes

if TYPE_CHECKING:
    from geometry.cad.export import Writer
    from geometry.scenes.scene import Scene
    from geometry.workshop.package import Casting
    from probe_design.workshop.package import ExportSummary


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
    from probe_design.terminal.console import show_steps

    parsed_scene = read_scene(scene)
    step_size = None if step is None else read_length("step", step)
    allowed_sd, casting = read_fraction("tolerance", tolerance), _read_casting(shrinkage, draft)
    with show_steps("export") as tell:
        from probe_design.workshop.package import export as write

        other_files = partial(_build_fixture_writers, fixture, bench, scene.name)
        exported = write(
            parsed_scene,
            output,
            step=step_size,
            force=force,
            tolerance=allowed_sd,
            casting=casting,
            extra_writers=other_files,
            tell=tell,
        )
    if as_json:
        print_json(exported.as_dict())
        return
    _report_export(exported, output)


def _read_casting(shrinkage: str | None, draft: str | None) -> Casting:
    """Return shrinkage and draft angle as numbers, or their defaults."""
    from geometry.scenes.units import Quantity
    from geometry.scenes.units import read_number as read_plain_number
    from geometry.workshop.mould_sizes import DEFAULT_DRAFT_RAD, DEFAULT_SHRINKAGE, MAX_DRAFT_RAD
    from geometry.workshop.package import Casting

    shrinkage_fraction = (
        DEFAULT_SHRINKAGE
        if shrinkage is None
        else read_plain_number("shrinkage", shrinkage, "a number such as 0.001, of every length")
    )
    angle = DEFAULT_DRAFT_RAD if draft is None else Quantity("angle", "rad", "deg", 0.0, MAX_DRAFT_RAD).read("draft", draft)
    return Casting(shrinkage_fraction, angle)


def _build_fixture_writers(fixture: bool, bench: Path | None, name: str, scene: Scene) -> dict[str, Writer]:
    """Return the writers of the fixture and of the calibration page, if --fixture is given."""
    if not fixture:
        return {}
    from probe_design.built_probe.bench import read_bench, read_builtin_bench
    from probe_design.measuring.protocol_page import build_writers

    return build_writers(scene, read_builtin_bench() if bench is None else read_bench(bench), name)


def _report_export(exported: ExportSummary, output: Path) -> None:
    """Report assumed sizes, the effect of rounding, warnings and the files written."""
    from probe_design.terminal.console import warn, write_message
    from probe_design.terminal.rounding_lines import write_rounding_lines

    report_assumed_sizes(exported.scene.probe)
    for line in [] if exported.rounding is None else write_rounding_lines(exported.rounding):
        write_message(line)
    warn(exported.remarks)
    write_message(f"wrote {', '.join(file.name for file in exported.files)} to {output}")
