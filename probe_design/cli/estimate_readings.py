"""From files of readings to what an estimate takes: calibration, positions and noise in one chain."""

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
MORE = 1.05  # times the scene's load: what is pressed harder is judged at its own load


@dataclass(frozen=True)
class Sources:
    """How recordings are read: what the verb `read` is told by the same options."""

    bench: Path | None = None
    calibration: Path | None = None
    columns: tuple[str, ...] = ()
    rate: str | None = None
    any_probe: bool = False


def field_readings(scene: Path, texts: tuple[str, ...], sources: Sources) -> tuple[Scene, tuple[Reading, ...], list[str]]:
    """Return the scene, under the load that was read where that is larger, the readings over it and warnings.

    Args:
        scene: file of the scene.
        texts: of each reading, FORM; the file is a recording, a file of another program, or what `read --json` has printed.
        sources: how recordings are read.

    Raises:
        InputError: a file or place is not what it should be, or a reading is of another probe, or given twice.
        HardwareError: a recording from which no ratio can be told.
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
        if expected is not None:  # a recording's is checked as it is read, what was printed before is not
            check_expected(abs(found[-1].force), 0.0, expected, expected, f"{path.name} shows")
        warnings += [f"{path.name}: {text}" for text in told.get("warnings", []) if isinstance(text, str)]
    check_different("reading", [(str(path), one.fingerprint) for (path, _), one in zip(split, found, strict=True)])
    warnings += check_serials(boards, sources.any_probe)
    pairs = zip(found, spreads(found), split, strict=True)
    readings = tuple(_reading(setting.scene, one, spread, place) for one, spread, (_, place) in pairs)
    return _loaded(setting.scene, found, warnings), readings, warnings


def _split(text: str) -> tuple[Path, dict[str, str]]:
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
    """Refuse what is no file."""
    for path in paths:
        if not os.path.isfile(path):
            raise InputError("reading", str(path), f"a file that is there; {FORM}")


def _recorded(path: Path, setting: HardwareSetup, sources: Sources) -> dict[str, Any]:
    """The JSON object of `read` for a recording, its prediction left out."""
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
    """One press: at the place that is given, else at the one that the reading tells, else at the scene's."""
    x, y = found.placement or (scene.placement.x, scene.placement.y)
    x, y = (position(key, place[key]) if key in place else own for key, own in (("x", x), ("y", y)))
    there = scene.model_copy(update={"placement": scene.placement.model_copy(update={"x": x, "y": y})})
    (one,) = one_reading(there, found.ratio, max(spread, LEAST))
    blank = {"true": True, "false": False}.get(place.get("blank", "false").lower())
    if blank is None:
        raise InputError("blank", place["blank"], "true or false")
    return replace(one, blank=blank)


def _loaded(scene: Scene, found: list[FieldReading], warnings: list[str]) -> Scene:
    largest = max(abs(one.force) for one in found)
    force = scene.load.force
    if force is None or not math.isfinite(largest) or largest <= MORE * force:
        return scene
    warnings.append(f"load read: {largest:.4g} N, more than the scene's {force:.4g} N: taken in its place")
    return scene.model_copy(update={"load": Load(force=largest)})


def checked_texts(texts: tuple[str, ...], more: tuple[str, ...]) -> tuple[str, ...]:
    """Return all readings that the command line names; what stands behind the last --reading belongs to it.

    Raises:
        InputError: files without --reading.
    """
    if more and not texts:
        raise InputError("scene", Words(f"{len(more) + 1} files"), "one scene; --reading before the files of readings")
    return (*texts, *more)
