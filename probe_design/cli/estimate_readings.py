"""Convert the files of `estimate --reading` to readings: calibration, positions and noise."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from geometry.common.errors import InputError, Words
from geometry.scenes.scene import Load, Scene
from hw.foreign.columns import ColumnMap
from hw.foreign.units import read_rate
from hw.reader import Reader
from hw.signal.fingerprint import Fingerprint
from probe_design.built_probe.field_readings import (
    FieldReading,
    check_different,
    field_reading,
    placement_of,
    read_result,
    spreads,
    without_prediction,
)
from probe_design.built_probe.film_forces import reading as measured
from probe_design.built_probe.load_checks import check_expected, expected_load
from probe_design.built_probe.probe_identity import board_serial, check_serials, clean_serial
from probe_design.cli.arguments import position
from probe_design.cli.hardware_sources import HardwareSetup, read_limits
from probe_design.data.noise import LEAST
from probe_design.estimation.readings import Reading, one_reading

KEYS = ("x", "y", "blank")
FORM = "a file and, behind commas, its place: 'run.probe, x=-8 mm, y=0 mm, blank=true'"
MORE = 1.05  # times the scene's load: a reading under a larger load is evaluated at its own load


@dataclass(frozen=True)
class Sources:
    """Options for recordings, with the same meaning as for the command `read`."""

    bench: Path | None = None
    calibration: Path | None = None
    columns: tuple[str, ...] = ()
    rate: str | None = None
    any_probe: bool = False


def field_readings(scene: Path, texts: tuple[str, ...], sources: Sources) -> tuple[Scene, tuple[Reading, ...], list[str]]:
    """Return the scene, the readings and warnings; the scene's load is raised to the largest measured load.

    Args:
        scene: file of the scene.
        texts: one for each reading, of the form ``READING_FORM``; the file is a recording, a file of another program, or the
            output of `read --json`.
        options: for recordings.

    Raises:
        InputError: a file or place is not allowed, or a reading is of another probe, or given twice.
        HardwareError: no ratio can be computed from a recording.
    """
    setting = HardwareSetup.of(scene, sources.bench, sources.calibration)
    split = [_split(text) for text in texts]
    _check_there([path for path, _ in split])
    found, warnings, boards = [], [], dict[str, str | None]()
    for path, _ in split:
        told = read_result(path)
        if told is None:
            told = _recorded(path, setting, sources)
            boards |= setting.boards({})
        boards[str(path)] = clean_serial(told.get("serial"))
        found.append(field_reading(told, path.name, setting.scene))
        expected = expected_load(setting.scene)
        if expected is not None:  # the load of a recording is checked while reading it; the load in a JSON file is checked here
            check_expected(abs(found[-1].force), 0.0, expected, expected, f"{path.name} shows")
        warnings += [f"{path.name}: {text}" for text in told.get("warnings", []) if isinstance(text, str)]
    check_different("reading", [(str(path), one.fingerprint) for (path, _), one in zip(split, found, strict=True)])
    warnings += check_serials(boards, sources.any_probe)
    pairs = zip(found, spreads(found), split, strict=True)
    readings = tuple(_reading(setting.scene, one, spread, place) for one, spread, (_, place) in pairs)
    return _loaded(setting.scene, found, warnings), readings, warnings


def _split(text: str) -> tuple[Path, dict[str, str]]:
    """Return the file and the place entries of a text of the form ``READING_FORM``."""
    if os.path.exists(text):
        return Path(text), {}
    name, *places = text.split(",")
    entries = {}
    for place in places:
        key, equals, value = (part.strip() for part in place.partition("="))
        if key not in KEYS or not equals:
            raise InputError("reading", text, FORM)
        entries[key] = value
    return Path(name.strip()), entries


def _check_there(paths: list[Path]) -> None:
    """Refuse names of files that do not exist."""
    for path in paths:
        if not os.path.isfile(path):
            raise InputError("reading", str(path), f"a file that is there; {FORM}")


def _recorded(path: Path, setting: HardwareSetup, sources: Sources) -> dict[str, Any]:
    """Return the JSON object of `read` for a recording, without the prediction."""
    gains = None if setting.calibration is None else setting.calibration.gains().warmed(setting.bench.channels.warming)
    at = None if setting.calibration is None else setting.calibration.frequency
    rate = None if sources.rate is None else read_rate(sources.rate)
    with Reader.open(f"replay:{path}", rate, ColumnMap.of(sources.columns), read_limits()) as reader:
        samples = reader.collect()
    origin = setting.origin | {"placement": placement_of(samples.source), "serial": board_serial(samples.source)}
    measurement = measured(samples, setting.bench, at)
    return without_prediction(
        measurement, setting.scene, setting.bench, gains, origin=origin, fingerprint=Fingerprint.from_samples(samples)
    )


def _reading(scene: Scene, found: FieldReading, spread: float, place: dict[str, str]) -> Reading:
    """Return one reading, at its given place, else at the place stored in its file, else at the scene's."""
    x, y = found.placement or (scene.placement.x, scene.placement.y)
    x, y = (position(key, place[key]) if key in place else own for key, own in (("x", x), ("y", y)))
    there = scene.model_copy(update={"placement": scene.placement.model_copy(update={"x": x, "y": y})})
    (one,) = one_reading(there, found.ratio, max(spread, LEAST))
    blank = {"true": True, "false": False}.get(place.get("blank", "false").lower())
    if blank is None:
        raise InputError("blank", place["blank"], "true or false")
    return replace(one, blank=blank)


def _loaded(scene: Scene, found: list[FieldReading], warnings: list[str]) -> Scene:
    """Return the scene under the largest measured load, if that is clearly above the scene's load; add a warning then."""
    largest = max(abs(one.force) for one in found)
    force = scene.load.force
    if force is None or not math.isfinite(largest) or largest <= MORE * force:
        return scene
    warnings.append(f"the measured load {largest:.4g} N is above the scene's {force:.4g} N and replaces it")
    return scene.model_copy(update={"load": Load(force=largest)})


def checked_texts(texts: tuple[str, ...], more: tuple[str, ...]) -> tuple[str, ...]:
    """Return the texts of all --reading options, and of the files that follow the last one.

    Raises:
        InputError: files without --reading.
    """
    if more and not texts:
        raise InputError("scene", Words(f"{len(more) + 1} files"), "one scene; --reading before the files of readings")
    return (*texts, *more)
