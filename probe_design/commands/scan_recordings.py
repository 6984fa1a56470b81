"""Convert raw recordings to the readings of a scan: each with its place, its own noise, and the gain common to all."""

from __future__ import annotations

from pathlib import Path

from geometry.common.errors import InputError
from geometry.scenes.scene import Scene
from hw.files.columns import ColumnMap
from probe_design.built_probe.field_readings import FieldReading
from probe_design.commands.estimate_readings import collect_measured
from probe_design.commands.hardware_sources import HardwareSetup
from probe_design.estimation.measurements import Reading
from probe_design.populations.design_file import Design
from probe_design.populations.tables import NoiseModel
from probe_design.surveys.record import build_press_reading


def use_calibration(design: Design, calibration: Path | None) -> Design:
    """Return the design with the gain of a calibration file in place of its own, if one is given."""
    if calibration is None:
        return design
    noise = design.noise.model_copy(update={"calibration": str(calibration.absolute())})
    return design.model_copy(update={"noise": noise})


def read_scan_recordings(
    setup: HardwareSetup, design: Design, texts: tuple[str, ...], *, columns: ColumnMap, rate: float | None, any_probe: bool
) -> tuple[tuple[Reading, ...], list[str]]:
    """Return the readings of recordings, and warnings.

    Errors of the calibration are common to the readings: they belong to the gain of the design file's noise.

    Parameters
    ----------
    setup
        Scene, bench and calibration.
    design
        For the noise of a press beside that of the electronics.
    texts
        A file each and, behind commas, its place, as `estimate --reading` takes them.
    columns, rate
        Of recordings by other programs.
    any_probe
        Whether the readings may be of different probes.

    Raises
    ------
    InputError
        A file or place is not allowed, or a recording states no place and none is given.
    HardwareError
        No ratio can be computed from a recording.
    """
    measured, places, warnings = collect_measured(setup, texts, columns, rate, any_probe)
    readings = tuple(
        _build_reading(setup.scene, part, design.noise, place, text)
        for part, place, text in zip(measured, places, texts, strict=True)
    )
    return readings, _join_warnings(warnings)


def _join_warnings(warnings: list[str]) -> list[str]:
    """Return warnings that several recordings share once, with the number of recordings."""
    names = {text: [line.partition(": ")[0] for line in warnings if line.partition(": ")[2] == text] for text in
             dict.fromkeys(line.partition(": ")[2] for line in warnings)}  # fmt: skip
    return [f"{files[0] if len(files) == 1 else f'{len(files)} recordings'}: {text}" for text, files in names.items()]


def _build_reading(scene: Scene, measured: FieldReading, noise: NoiseModel, place: dict[str, str], text: str) -> Reading:
    """Return one reading at its place: that of the command line, else that stored in its file."""
    if measured.placement is None and not {"x", "y"} <= place.keys():
        raise InputError("reading", text, "a recording that states its place, or a text with it: 'run.probe, x=-8 mm, y=0 mm'")
    return build_press_reading(scene, measured, noise, place)
