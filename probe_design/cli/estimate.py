"""The command `estimate`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from probe_design.cli.arguments import (
    FILE_NAME,
    add_limit_options,
    add_noise_option,
    any_probe_option,
    linear_option,
    read_fraction,
)
from probe_design.cli.output import present
from probe_design.data.noise import DEFAULT_NOISE

if TYPE_CHECKING:
    from geometry.scenes.scene import Scene
    from probe_design.estimation.measurements import Reading


@click.command()
@click.argument("scene", type=FILE_NAME)
@click.argument("other_files", nargs=-1, metavar="")
@click.option("--ratio", help="Measured stress_inner / stress_outer at the scene's placement.")
@add_noise_option
@click.option("--stiffness", help="Measured force on the base per indentation, together with --ratio, N/m.")
@click.option("--stiffness-noise", help="Relative standard deviation of a stiffness.  [default: that of the ratio]")
@click.option("--readings", "file", type=FILE_NAME, help="In place of --ratio: a .toml or .csv file, see below.")
@click.option(
    "--reading",
    "reading",
    multiple=True,
    help="In place of --ratio: recordings or output of read --json, each with its place: 'run.probe, x=-8 mm'.",
)
@click.option("--calibration", type=FILE_NAME, help="With --reading: calibration file, written by calibrate.")
@click.option("--bench", type=FILE_NAME, help="With --reading: TOML file of load and amplifier.")
@click.option("--column", multiple=True, help="Of recordings by other programs: 'inner=CH1 mV'; see read --help.")
@click.option("--rate", help="Of recordings without times: samples per second, '10 kHz'.")
@click.option(
    "--unknown",
    default="youngs_modulus",
    show_default=True,
    help="youngs_modulus, diameter or depth of the target, or a number of the tissue, tissue.layer[0].thickness.",
)
@click.option(
    "--nuisance", "nuisance", multiple=True, help='An uncertain number, "tissue.layer[0].thickness = 20 %" (sd); may be repeated.'
)
@click.option("--next", "advise", is_flag=True, help="Report which further reading would narrow the interval most, and to what.")
@click.option("--accuracy", help="Relative error that the model's ratio may have.  [default: 1/4 of --noise, at most 0.01]")
@linear_option
@any_probe_option
@add_limit_options
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def estimate(
    scene: Path, ratio: str | None, noise: str | None, stiffness: str | None, stiffness_noise: str | None, file: Path | None,
    unknown: str, nuisance: tuple[str, ...], accuracy: str | None, linear: bool, as_json: bool, reading: tuple[str, ...],
    other_files: tuple[str, ...], calibration: Path | None, bench: Path | None, column: tuple[str, ...], rate: str | None,
    advise: bool,
    any_probe: bool,
) -> None:  # fmt: skip
    """Estimate E_object, diameter or depth of SCENE's target, or a layer of its tissue, from readings, with its 95 % interval.

    All other numbers of the scene are taken as known, except those with a relative standard deviation by --nuisance. Where the
    unknown is not identifiable, the reason is given, together with depth and strength D^3 (c-1) / (1 + beta (c-1)),
    c = E_object/E_tissue, which may still be identifiable. The exit code is 0 then, too.

    At loads beyond linear elasticity, contact predicts the readings on the axis of one tumour, in half a minute or more.

    \b
    probe-design estimate scene.toml --ratio 0.62 --noise 0.05
    probe-design estimate scene.toml --ratio 0.62 --noise 0.01 --stiffness 80 --unknown diameter
    probe-design estimate scene.toml --ratio 0.62 --noise 0.01 --nuisance "inclusion.diameter = 20 %" --next
    probe-design estimate scene.toml --readings scan.csv --nuisance "tissue.layer[0].thickness = 20 %"
    probe-design estimate scene.toml --calibration probe.toml --reading over.probe "beside.h5, x=30 mm, blank=true"

    A recording states its own noise. The error of a calibration does not average out over the readings that share it. The place
    of a reading is the one given after the file's name, else the one stored in the file, else the scene's.

    \b
    scan.csv holds one press a line (or scan.toml, tables [[reading]] with these keys):
    x,     y,    ratio, noise, stiffness, stiffness_noise, blank
    -8 mm, 0 mm, 0.55,  0.05,  79 N/m,    0.02,            false
    0 mm,  0 mm, 0.62,  0.05,  81 N/m,    0.02,            false
    30 mm, 0 mm, 0.51,  0.05,  78 N/m,    0.02,            true
    x and y are the probe's axis in the scene's frame. blank is true for a reading over tumour-free tissue: the uncertainty of the
    tissue affects that reading too, and so weighs less. Every column but ratio may be left out. ratio_phase and ratio_phase_sd,
    angles such as 1.8 deg, are the ratio's phase as read reports it; they are used where the scene has loss factors.
    """  # noqa: D301
    from dataclasses import replace

    from geometry.scenes.scene_file import read_scene
    from probe_design.cli.estimate_readings import RecordingOptions, collect_field_readings, join_reading_texts
    from probe_design.estimation.estimate import estimate as run
    from probe_design.terminal.console import show_spinner
    from probe_design.terminal.estimate_table import build_estimate_table, list_advice, write_sentence

    parsed_scene = read_scene(scene)
    nuisances = dict(_split_nuisance(text) for text in nuisance)
    notes: list[str] = []
    if texts := join_reading_texts(reading, other_files):
        _refuse_options(
            {"ratio": ratio, "readings": file, "noise": noise, "stiffness": stiffness, "stiffness-noise": stiffness_noise}
        )
        parsed_scene, readings, notes = collect_field_readings(
            scene, texts, RecordingOptions(bench, calibration, column, rate, any_probe)
        )
    else:
        readings = _read_readings(
            parsed_scene, file, ratio=ratio, noise=noise, stiffness=stiffness, stiffness_noise=stiffness_noise
        )
    relative_accuracy = None if accuracy is None else read_fraction("accuracy", accuracy)
    with show_spinner(f"estimating {unknown} of {scene}"):
        result = run(parsed_scene, readings, unknown, relative_accuracy, linear=linear, nuisances=nuisances, advise=advise)
    result = replace(result, warnings=(*notes, *result.warnings))
    present(result, build_estimate_table, as_json, lines=lambda estimate: [write_sentence(estimate), *list_advice(estimate)])


def _split_nuisance(text: str) -> tuple[str, str]:
    """Split a text such as "tissue.layer[0].thickness = 20 %" into key and value."""
    from geometry.common.errors import InputError

    name, equals, value = (part.strip() for part in text.partition("="))
    if not equals:
        raise InputError("nuisance", text, "a number of the scene and its relative standard deviation, 'probe.gap = 20 %'")
    return name, value


def _refuse_options(options: dict[str, object]) -> None:
    """Refuse options whose values the files of --reading state themselves."""
    from geometry.common.errors import InputError

    for key, value in options.items():
        if value is not None:
            raise InputError(key, str(value), "nothing beside --reading, whose files have it")


def _read_readings(
    scene: Scene, file: Path | None, *, ratio: str | None, noise: str | None, stiffness: str | None, stiffness_noise: str | None
) -> tuple[Reading, ...]:
    """Return the readings of --ratio or --readings."""
    from geometry.common.errors import InputError, Words
    from probe_design.estimation.measurements import build_single_reading, read_readings

    if (ratio is None) == (file is None):
        problem = Words("missing") if ratio is None else Words(f"{ratio} beside --readings")
        raise InputError("ratio", problem, "exactly one of --ratio, --readings and --reading")
    if file is None:
        return build_single_reading(scene, ratio, DEFAULT_NOISE if noise is None else noise, stiffness, stiffness_noise)
    if stiffness is not None:
        raise InputError("stiffness", stiffness, "nothing beside --readings, whose file has a column for it")
    return read_readings(file, scene, DEFAULT_NOISE if noise is None else noise, stiffness_noise)
