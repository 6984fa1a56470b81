"""The command `export`: write the files that a workshop needs to build a scene's probe."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from geometry.provenance.block import record_scene
from geometry.scenes.quantities import Length
from geometry.scenes.scene import Scene
from geometry.scenes.scene_file import load_scene
from geometry.scenes.units import Quantity
from probe_design.commands.fields import Force, Fraction, SceneSource
from probe_design.commands.output import print_json, report_assumed_sizes
from probe_design.commands.request import Number, Option, Request, use_request
from probe_design.terminal.console import show_steps, warn, write_message

if TYPE_CHECKING:
    from geometry.cad.export import Writer
    from probe_design.workshop.package import ExportSummary

Shrinkage = Annotated[float, Number("a number such as 0.001 or 0.1 %, of every length", math.isfinite, percent=True)]
Draft = Annotated[float, Quantity("angle", "rad", "deg", 0.0, math.radians(10))]


class ExportRequest(Request):
    """Write the files that a workshop needs to build SCENE's probe; docs/guides/workshop.md describes each file.

    STEP files (AP242, millimetres) of parts, assembly and the moulds' halves, each read back and measured; a dimensioned drawing
    of each as DXF and PDF; film patterns with electrodes, leads and tabs as DXF; bill of materials, tolerances, assembly order.

    A size that a part needs and SCENE does not give, such as the base's thickness, is assumed and marked, also in parts.json.
    parts.json identifies the design, and a folder that holds another design is refused.

    With --fixture also pin.step, ring.step and sleeve.step, which press on one block alone, centred to 0.05 mm, and
    calibration.pdf, one page with the references of the bench in their order, loads, expected signals and commands.
    """

    scene: SceneSource
    output: Annotated[Path | str, Option("Folder for the files.", "-o/--output")]
    step: Annotated[
        Length | None, Option('Round radii, gap and heights to multiples of this, "0.1 mm", and report the effect.')
    ] = None
    tolerance: Annotated[Fraction, Option("Relative sd of the ratio that the tolerances may cause.")] = 0.01
    shrinkage: Annotated[
        Shrinkage | None, Option("Linear shrinkage of the elastomer while it cures, for the moulds.", left_out="0.001")
    ] = None
    draft: Annotated[Draft | None, Option("Maximum draft angle of the moulds' walls.", left_out='"0.5 deg"')] = None
    force: Force = False
    fixture: Annotated[bool, Option("Write also pin, ring and sleeve for the calibration, and a page to print.")] = False
    bench: Annotated[Path | str | None, Option("TOML file of load, amplifier and references, for that page.")] = None

    def run(self) -> None:
        """Write the files, and print which ones, with the sizes assumed and the effect of rounding."""
        from probe_design.terminal.workshop_tables import write_rounding_lines

        with show_steps("export") as progress:
            exported = self.call(export, progress=progress)
        if self.as_json:
            print_json(exported.as_dict())
            return
        report_assumed_sizes(exported.scene.probe)
        for line in [] if exported.rounding is None else write_rounding_lines(exported.rounding):
            write_message(line)
        warn(exported.remarks)
        write_message(f"wrote {', '.join(file.name for file in exported.files)} to {Path(self.output)}")


@use_request(ExportRequest)
def export(
    scene: Scene | Path | str, output: Path | str, *, step: float | None = None, tolerance: float = 0.01,
    shrinkage: float | None = None, draft: float | None = None, force: bool = False,
    fixture: bool = False, bench: Path | str | None = None, progress: Callable[[str], None] | None = None,
) -> ExportSummary:  # fmt: skip
    """Write the files for the workshop: STEP, drawings, film patterns, moulds, lists (docs/guides/workshop.md).

    Parameters
    ----------
    progress : callable, optional
        Called with a line of text before each long step.

    Returns
    -------
    ExportSummary
        The scene as built, the paths of the files, and the effect of the rounding.

    Raises
    ------
    ExportError
        A part that was read back differs from its parameters; no file is left.
    InputError
        The folder holds another design, or step, tolerance, shrinkage or draft is not allowed.
    MissingLibrary
        CAD cannot be loaded.

    Examples
    --------
    >>> from probe_design import export
    >>> export("examples/scene.toml", "out/parts", step=1e-4).files  # doctest: +SKIP
    """
    from geometry.workshop.package import DEFAULT_CASTING, Casting
    from probe_design.workshop.package import export as write

    probe_scene, name = load_scene(scene), "" if isinstance(scene, Scene) else Path(scene).name
    with record_scene(probe_scene):
        return write(
            probe_scene,
            Path(output),
            step=step,
            force=force,
            tolerance=tolerance,
            casting=Casting(
                DEFAULT_CASTING.shrinkage if shrinkage is None else shrinkage, DEFAULT_CASTING.draft if draft is None else draft
            ),
            extra_writers=lambda built_scene: _build_fixture_writers(built_scene, name, bench) if fixture else {},
            progress=progress or (lambda text: None),
        )


def _build_fixture_writers(scene: Scene, name: str, bench: Path | str | None) -> dict[str, Writer]:
    """Return the writers of the fixture's parts and of the calibration page, by file name.

    Parameters
    ----------
    scene
        With the probe as built.
    name
        Of the scene's file; "" for a scene that was not read from a file.
    bench
        File of the bench; None: the built-in one.
    """
    from probe_design.built_probe.bench import read_bench, read_builtin_bench
    from probe_design.measuring.protocol_page import build_writers

    return build_writers(scene, read_builtin_bench() if bench is None else read_bench(Path(bench)), name)
