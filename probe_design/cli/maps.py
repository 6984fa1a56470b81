"""The commands `scan` and `detectability`: many readings of one probe as curves and maps."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

from probe_design.cli.arguments import (
    FILE_NAME,
    add_limit_options,
    add_noise_option,
    linear_option,
    read_fraction,
    read_length,
    read_noise,
    read_number,
    read_position,
)
from probe_design.cli.output import check_picture, present
from probe_design.data.noise import MAX_RESOLVED_LOG_SD

CommandT = TypeVar("CommandT", bound=Callable[..., Any])
SCENE_ARGUMENT = click.argument("scene", type=FILE_NAME)
JSON_OPTION = click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")


def make_picture_option(subject: str) -> Callable[[CommandT], CommandT]:
    """Return the option --plot, with a help text that names the subject of the picture."""
    text = f"Draw {subject} to this .png, .svg or .pdf file."
    return click.option("--plot", "picture", type=FILE_NAME, help=text)


@click.command()
@SCENE_ARGUMENT
@click.option("--along", default="x", show_default=True, type=click.Choice(["x", "y"]), help="Axis that the probe moves along.")
@click.option("--from", "low", default="-20 mm", show_default=True, help="First position of the probe's axis.")
@click.option("--to", "high", default="20 mm", show_default=True, help="Last position of the probe's axis.")
@click.option("--points", default=41, show_default=True, type=click.IntRange(2, 10_000), help="Positions, evenly spaced.")
@click.option("--at", help="Coordinate of the line along the other axis.  [default: the scene's placement]")
@click.option("--accuracy", default="0.01", show_default=True, help="Relative error that ratio, stresses and stiffness may have.")
@linear_option
@make_picture_option("the scan above a section of the tissue")
@add_limit_options
@JSON_OPTION
def scan(
    scene: Path, along: str, low: str, high: str, points: int, at: str | None, accuracy: str, linear: bool, picture: Path | None,
    as_json: bool,
) -> None:  # fmt: skip
    """Compute readings of the probe along a line over the tissue.

    The probe is lifted, moved and pressed again; tumours and tissue stay where SCENE has them, and SCENE's own
    placement along the line does not matter. Positions are in SCENE's frame, whose origin is the tissue's middle.
    Any number of spheres, anywhere; without one the line is flat.

    \b
    probe-design scan scene.toml --along x --from "-20 mm" --to "20 mm" --plot scan.png
    probe-design scan scene.toml --along y --at "5 mm" --points 81 --json
    """  # noqa: D301
    import numpy as np

    from geometry.common.errors import InputError
    from geometry.scenes.scene_file import read_scene
    from probe_design.maps.scan import scan as run
    from probe_design.reporting.picture_files import save_figure
    from probe_design.reporting.scan_figure import draw_scan
    from probe_design.terminal.console import build_scan_table, show_count

    parsed_scene = read_scene(scene)
    check_picture(picture)
    first, last = read_position("from", low), read_position("to", high)
    if not first < last:
        raise InputError("to", high, f"a position above from = {low!r}")
    line_offset = None if at is None else read_position("at", at)
    with show_count(f"scan of {scene}") as progress:
        positions = np.linspace(first, last, points)
        result = run(
            parsed_scene,
            along,
            positions,
            line_offset,
            accuracy=read_fraction("accuracy", accuracy),
            linear=linear,
            progress=progress,
        )
    if picture is not None:
        save_figure(draw_scan(result, parsed_scene), picture)
    present(result, build_scan_table, as_json, picture)


@click.command()
@SCENE_ARGUMENT
@add_noise_option
@click.option(
    "--seen",
    default="3",
    show_default=True,
    help="Change of the ratio, in multiples of the noise, from which a tumour is detected.",
)
@click.option(
    "--resolved",
    default=f"{MAX_RESOLVED_LOG_SD:g}",
    show_default=True,
    help="Standard deviation of ln E_object up to which it is resolved.",
)
@click.option("--depth-from", help="Smallest depth of a centre.  [default: 1/50 of the largest]")
@click.option("--depth-to", help="Largest depth of a centre.  [default: 4 outer radii or what the scene's tumour needs]")
@click.option("--diameter-from", help="Smallest diameter.  [default: 1/50 of the largest]")
@click.option("--diameter-to", help="Largest diameter.  [default: 2.5 outer radii or what the scene's tumour needs]")
@click.option("--points", default=50, show_default=True, type=click.IntRange(2, 300), help="Depths, and as many diameters.")
@click.option("--accuracy", help="Relative error that the ratio may have.  [default: --noise, between 0.0005 and 0.01]")
@linear_option
@make_picture_option("both maps")
@add_limit_options
@JSON_OPTION
def detectability(
    scene: Path, noise: str | None, seen: str, resolved: str, depth_from: str | None, depth_to: str | None,
    diameter_from: str | None, diameter_to: str | None, points: int, accuracy: str | None, linear: bool, picture: Path | None,
    as_json: bool,
) -> None:  # fmt: skip
    """Map which tumours the probe detects, and which it resolves in stiffness, over depth and diameter.

    SCENE's target inclusion is replaced by spheres of its material at its lateral offset; all else stays. For each sphere the
    maps show the change of the ratio, and the standard deviation of ln E_object from one reading of the ratio,
    noise / |log_sensitivity|, all other numbers of the scene being known, size and depth included.

    Detected: the ratio changes by 3 times the noise or more. A threshold at half of that misses 1 of 15 tumours, and reports a
    tumour at 1 of 15 healthy places (6.7 %; 3.29 times the noise gives 5 %, Currie 1968). The ratio without tumour is taken as
    known: where it is a baseline reading with noise too, give 1.41 times the noise.

    Resolved: a standard deviation of ln E_object up to 0.5, a factor of 1.65 either way.

    \b
    probe-design detectability scene.toml --noise 0.01 --plot map.png
    probe-design detectability scene.toml --noise 0.002 --depth-to "30 mm" --diameter-to "12 mm" --json
    """  # noqa: D301
    from geometry.scenes.scene_file import read_scene
    from probe_design.maps.detectability import detectability as run
    from probe_design.maps.sphere_effects import Thresholds
    from probe_design.maps.target_grid import choose_sizes
    from probe_design.reporting.detectability_figure import draw_detectability
    from probe_design.reporting.picture_files import save_figure
    from probe_design.terminal.console import build_threshold_table, show_count

    parsed_scene = read_scene(scene)
    check_picture(picture)
    ends = {"depth_from": depth_from, "depth_to": depth_to, "diameter_from": diameter_from, "diameter_to": diameter_to}
    sizes = {key: None if text is None else read_length(key.replace("_", "-"), text) for key, text in ends.items()}
    positive = "a number above 0"
    thresholds = Thresholds(read_noise(noise), read_number("seen", seen, positive), read_number("resolved", resolved, positive))
    depths, diameters = choose_sizes(parsed_scene, points, **sizes)
    relative_accuracy = None if accuracy is None else read_fraction("accuracy", accuracy)
    with show_count(f"detectability of {scene}") as progress:
        result = run(parsed_scene, depths, diameters, thresholds, accuracy=relative_accuracy, linear=linear, progress=progress)
    if picture is not None:
        save_figure(draw_detectability(result, parsed_scene), picture)
    present(result, build_threshold_table, as_json, picture)
