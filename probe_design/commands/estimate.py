"""The command `estimate`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated

from pydantic import Field

from geometry.common.errors import InputError, Words
from geometry.scenes.scene import Scene
from geometry.scenes.scene_file import load_scene
from probe_design.commands.fields import AnyProbe, Fraction, LimitedRequest, Linear, Noise, SceneSource
from probe_design.commands.output import present, split_assignments
from probe_design.commands.request import Option, use_request
from probe_design.data.noise import DEFAULT_NOISE
from probe_design.terminal.console import show_spinner

if TYPE_CHECKING:
    from probe_design.estimation.estimate_result import Estimate
    from probe_design.estimation.measurements import Reading

NO_NUISANCES: Mapping[str, object] = MappingProxyType({})
Measured = Annotated[str | float | None, Field(description="a number above 0")]  # checked together with the readings of files
FILE_OPTIONS = ("ratio", "readings_file", "noise", "stiffness", "stiffness_noise")  # stated by the files of --reading themselves


class EstimateRequest(LimitedRequest):
    """Estimate E_object, diameter or depth of SCENE's target, or a layer of its tissue, from readings, with its 95 % interval.

    All other numbers of the scene are taken as known, except those with a relative standard deviation by --nuisance. Where the
    unknown is not identifiable, the reason is given, together with depth and strength D^3 (c-1) / (1 + beta (c-1)),
    c = E_object/E_tissue, which may still be identifiable. The exit code is 0 then, too.

    At loads beyond linear elasticity, contact predicts the readings, in half a minute or more. Readings at several loads state
    each its force; the ratio of one place changes with the load.

    \b
    probe-design estimate scene.toml --ratio 0.62 --noise 0.05
    probe-design estimate scene.toml --ratio 0.62 --noise 0.01 --stiffness 80 --unknown diameter
    probe-design estimate scene.toml --ratio 0.62 --noise 0.01 --nuisance "inclusion.diameter = 20 %" --next
    probe-design estimate scene.toml --readings scan.csv --nuisance "tissue.layer[0].thickness = 20 %"
    probe-design estimate scene.toml --calibration probe.toml --reading over.probe "beside.probe, x=30 mm, blank=true"

    Where SCENE reads charges ([reading] observable, by default that of films with bonds), every ratio is charge_ratio: inner over
    outer film charge, each over its block's end area. Otherwise it is stress_inner / stress_outer. The result says which.

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

    scene: SceneSource
    other_files: Annotated[tuple[str, ...], Option("Further files of --reading.", is_argument=True, metavar="")] = ()
    ratio: Annotated[
        Measured, Option("Measured ratio at the scene's placement: of charges per area or of stresses, see below.")
    ] = None
    noise: Noise = DEFAULT_NOISE
    stiffness: Annotated[Measured, Option("Measured force on the base per indentation, together with --ratio, N/m.")] = None
    stiffness_noise: Annotated[Measured, Option("Relative standard deviation of a stiffness.", left_out="that of the ratio")] = (
        None
    )
    readings_file: Annotated[Path | None, Option("In place of --ratio: a .toml or .csv file, see below.", "--readings")] = None
    reading: Annotated[
        tuple[str, ...],
        Option("In place of --ratio: recordings or output of read --json, each with its place: 'run.probe, x=-8 mm'."),
    ] = ()
    calibration: Annotated[Path | None, Option("With --reading: calibration file, written by calibrate.")] = None
    bench: Annotated[Path | None, Option("With --reading: TOML file of load and amplifier.")] = None
    column: Annotated[tuple[str, ...], Option("Of recordings by other programs: 'inner=CH1 mV'; see read --help.")] = ()
    rate: Annotated[str | None, Option("Of recordings without times: samples per second, '10 kHz'.")] = None
    unknown: Annotated[
        str,
        Option("youngs_modulus, diameter or depth of the target, or a number of the tissue, tissue.layer[0].thickness."),
    ] = "youngs_modulus"
    nuisance: Annotated[
        tuple[str, ...],
        Option('An uncertain number, "tissue.layer[0].thickness = 20 %" (sd); may be repeated.'),
    ] = ()
    advise: Annotated[bool, Option("Report which further reading would narrow the interval most, and to what.", "--next")] = False
    accuracy: Annotated[
        Fraction | None,
        Option("Relative error that the model's ratio may have.", left_out="1/4 of --noise, at most 0.01"),
    ] = None
    linear: Linear = False
    any_probe: AnyProbe = False

    def run(self) -> None:
        """Estimate from a ratio, from a file of readings, or from recordings."""
        from hw.files.columns import ColumnMap, read_rate
        from probe_design.commands.estimate_readings import collect_field_readings, join_reading_texts
        from probe_design.commands.hardware_sources import HardwareSetup
        from probe_design.estimation.estimate import estimate as run
        from probe_design.terminal.estimate_table import build_estimate_table, list_advice, write_sentence

        scene = load_scene(self.scene)
        nuisances = split_assignments(
            "nuisance", self.nuisance, "a number of the scene and its relative standard deviation, 'probe.gap = 20 %'"
        )
        notes: list[str] = []
        if texts := join_reading_texts(self.reading, self.other_files):
            for key in FILE_OPTIONS:
                if key in self.model_fields_set:
                    value = str(getattr(self, key))
                    raise InputError(
                        key.removesuffix("_file").replace("_", "-"), value, "nothing beside --reading, whose files have it"
                    )
            assert isinstance(self.scene, Path)  # on the command line a scene is always a file's name
            setup = HardwareSetup.from_files(self.scene, self.bench, self.calibration)
            columns, rate = ColumnMap.from_texts(self.column), None if self.rate is None else read_rate(self.rate)
            scene, readings, notes = collect_field_readings(setup, texts, columns, rate, self.any_probe)
        else:
            readings = self._read_readings(scene)
        with show_spinner(f"estimating {self.unknown} of {self.scene}"):
            result = self.call(run, scene=scene, readings=readings, nuisances=nuisances)
        result = replace(result, warnings=(*notes, *result.warnings))
        present(
            result, build_estimate_table, self.as_json, lines=lambda estimate: [write_sentence(estimate), *list_advice(estimate)]
        )

    def _read_readings(self, scene: Scene) -> tuple[Reading, ...]:
        """Return the readings that --ratio or --readings gives; exactly one of both is allowed."""
        if (self.ratio is None) == (self.readings_file is None):
            problem = Words("missing") if self.ratio is None else Words(f"{self.ratio} beside --readings")
            raise InputError("ratio", problem, "exactly one of --ratio, --readings and --reading")
        if self.readings_file is not None and self.stiffness is not None:
            raise InputError("stiffness", self.stiffness, "nothing beside --readings, whose file has a column for it")
        return _collect_readings(scene, self.ratio, self.readings_file, self.noise, self.stiffness, self.stiffness_noise)


@use_request(EstimateRequest)
def estimate(
    scene: Scene | Path | str, *, ratio: float | None = None, noise: float = DEFAULT_NOISE, stiffness: float | None = None,
    stiffness_noise: float | None = None, readings: tuple[Reading, ...] | Path | str | None = None,
    unknown: str = "youngs_modulus", accuracy: float | None = None, linear: bool = False,
    nuisances: Mapping[str, object] = NO_NUISANCES,
) -> Estimate:  # fmt: skip
    """Estimate one unknown of the target or the tissue from readings, with its 95 % interval.

    All other numbers of the scene are taken as known. Give either ``ratio`` or ``readings``.

    Parameters
    ----------
    readings : tuple of Reading, or the name of a .toml or .csv file
        Several readings; see ``probe-design estimate --help``.
    nuisances : mapping
        Relative standard deviations, 0.2 or "20 %", of uncertain numbers of the scene, by their keys.

    Returns
    -------
    Estimate
        Value, interval, and the reason where the unknown is not identifiable.

    Raises
    ------
    InputError
        An unknown, reading or nuisance is not allowed.
    Refusal
        Nothing can be estimated for this kind of scene, or its load is beyond the range of the models.
    """
    from probe_design.estimation.estimate import estimate as run

    known_scene = load_scene(scene)
    if (ratio is None) == (readings is None):
        raise InputError("ratio", Words("missing" if ratio is None else "given beside readings"), "one of ratio and readings")
    measured = _collect_readings(known_scene, ratio, readings, noise, stiffness, stiffness_noise)
    return run(known_scene, measured, unknown, accuracy, linear=linear, nuisances=nuisances)


def _collect_readings(
    scene: Scene,
    ratio: str | float | None,
    readings: tuple[Reading, ...] | Path | str | None,
    *noise_and_stiffness: str | float | None,
) -> tuple[Reading, ...]:
    """Return ``readings`` if these are given, those of a file if it is a file's name, or the one reading of a ratio.

    Parameters
    ----------
    scene
        For its placement, and for the keys of a file.
    ratio
        Of one reading, or None.
    readings
        Readings, the name of their file, or None.
    noise_and_stiffness
        Noise of the ratio, stiffness and noise of the stiffness.
    """
    from probe_design.estimation.made_readings import check_readings
    from probe_design.estimation.measurements import build_single_reading, read_readings

    noise, stiffness, stiffness_noise = noise_and_stiffness
    if readings is None:
        return build_single_reading(scene, ratio, noise, stiffness, stiffness_noise)
    source = check_readings_source(readings)
    if isinstance(source, Path):
        return read_readings(source, scene, noise, stiffness_noise)
    return check_readings(source, scene)


def check_readings_source(readings: object) -> tuple[Reading, ...] | Path:
    """Return readings, or the path of their file; raise ``InputError`` for anything else."""
    from probe_design.estimation.measurements import Reading

    if isinstance(readings, Path | str):
        return Path(readings)
    if isinstance(readings, tuple | list) and all(isinstance(reading, Reading) for reading in readings):
        return tuple(readings)
    raise InputError("readings", readings, "a tuple of Reading, or the name of a .toml or .csv file")
