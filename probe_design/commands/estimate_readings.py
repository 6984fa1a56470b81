"""Convert the files of `estimate --reading` to readings: calibration, positions and noise."""

from __future__ import annotations

import math
import os
from dataclasses import replace
from pathlib import Path

from geometry.common.errors import InputError, Words
from geometry.common.json_types import JsonObject
from geometry.scenes.quantities import POSITION_QUANTITY
from geometry.scenes.scene import Scene
from geometry.scenes.scene_tables import Load
from hw.files.columns import ColumnMap
from hw.reader import Reader
from hw.signal.fingerprint import Fingerprint
from probe_design.built_probe.field_readings import (
    FieldReading,
    build_reading_without_prediction,
    check_different,
    compute_spreads,
    find_common_bonds,
    parse_field_reading,
    read_result,
)
from probe_design.built_probe.film_forces import measure_samples
from probe_design.built_probe.load_plausibility import check_expected, compute_expected_load
from probe_design.built_probe.probe_identity import check_serials, clean_serial, read_board_serial
from probe_design.built_probe.reference_charges import scale_bonds
from probe_design.commands.hardware_sources import HardwareSetup, get_reading_limits
from probe_design.data.noise import MIN_NOISE
from probe_design.estimation.measurements import Reading, build_single_reading, read_force

PLACE_KEYS = ("x", "y", "blank", "force")
READING_FORM = "a file and, behind commas, its place: 'run.probe, x=-8 mm, y=0 mm, blank=true'"
LOAD_EXCESS_FACTOR = 1.05  # times the scene's load: a reading under a larger load is evaluated at its own load


def collect_field_readings(
    setup: HardwareSetup, texts: tuple[str, ...], columns: ColumnMap, rate: float | None, any_probe: bool
) -> tuple[Scene, tuple[Reading, ...], list[str]]:
    """Read all files of readings; return the scene, the readings and warnings.

    If a measured load is clearly above the scene's, the returned scene has the largest measured load.

    Parameters
    ----------
    setup
        Scene, bench and calibration.
    texts
        One for each reading, of the form ``READING_FORM``; the file is a recording, a file of another program, or the output of
        `read --json`.
    columns
        Of recordings by other programs.
    rate
        Samples per second of recordings without times, Hz.
    any_probe
        Whether the readings may be of different probes.

    Raises
    ------
    InputError
        A file or place is not allowed, or a reading is of another probe, or given twice.
    HardwareError
        No ratio can be computed from a recording.
    """
    measured, places, warnings = collect_measured(setup, texts, columns, rate, any_probe)
    triples = zip(measured, compute_spreads(measured), places, strict=True)
    readings = tuple(_build_reading(setup.scene, reading, spread, place) for reading, spread, place in triples)
    scene = scale_bonds(setup.scene, find_common_bonds(measured))
    return _apply_largest_load(scene, measured, warnings), readings, warnings


def collect_measured(
    setup: HardwareSetup, texts: tuple[str, ...], columns: ColumnMap, rate: float | None, any_probe: bool
) -> tuple[list[FieldReading], list[dict[str, str]], list[str]]:
    """Read all files of readings; return what was measured, the texts of the places by their keys, and warnings.

    For the arguments and exceptions see ``collect_field_readings``.
    """
    file_places = [_split_reading_text(text) for text in texts]
    for path, _ in file_places:
        if not os.path.isfile(path):
            raise InputError("reading", str(path), f"a file that is there; {READING_FORM}")
    measured, warnings, serials = [], [], dict[str, str | None]()
    for path, place in file_places:
        entry = read_result(path)
        stated = None if "force" not in place else read_force("force", place["force"], setup.scene)
        if entry is None:
            entry = _read_recording(path, setup, columns, rate, stated)
            serials |= setup.collect_serials({})  # that of the calibration, if there is one
        serials[str(path)] = clean_serial(entry.get("serial"))
        reading = parse_field_reading(entry, path.name, setup.scene)
        measured.append(reading if stated is None else replace(reading, load=stated))
        expected = measured[-1].load or compute_expected_load(setup.scene)
        if expected is not None:  # the load of a recording is checked while reading it; the load in a JSON file is checked here
            check_expected(abs(measured[-1].force), 0.0, expected, expected, f"{path.name} shows")
        warnings += [f"{path.name}: {text}" for text in entry.get("warnings", []) if isinstance(text, str)]
    check_different(
        "reading", [(str(path), reading.fingerprint) for (path, _), reading in zip(file_places, measured, strict=True)]
    )
    warnings += check_serials(serials, any_probe)
    return measured, [place for _, place in file_places], warnings


def _split_reading_text(text: str) -> tuple[Path, dict[str, str]]:
    """Return the file and, by their keys, the texts of the place in a text of the form ``READING_FORM``."""
    if os.path.exists(text):  # a file's name may contain commas
        return Path(text), {}
    name, *places = text.split(",")
    entries = {}
    for place in places:
        key, equals, value = (part.strip() for part in place.partition("="))
        if key not in PLACE_KEYS or not equals:
            raise InputError("reading", text, READING_FORM)
        entries[key] = value
    return Path(name.strip()), entries


def _read_recording(path: Path, setup: HardwareSetup, columns: ColumnMap, rate: float | None, load: float | None) -> JsonObject:
    """Return the JSON object of `read` for a recording, without the prediction.

    Parameters
    ----------
    path
        Of the recording, or of a file of another program.
    setup
        Scene, bench and calibration.
    columns, rate
        Of a file of another program, as for ``collect_field_readings``.
    load
        Force that was to be pressed, N; None: as the recording states, else the scene's.
    """
    with Reader.open(f"replay:{path}", rate, columns, get_reading_limits()) as reader:
        samples = reader.collect()
    origin = setup.origin | {"placement": samples.source.get("placement"), "serial": read_board_serial(samples.source)}
    measurement = measure_samples(samples, setup.bench, setup.calibrated_at)
    if load is None and samples.source.get("load") is not None:  # as `survey` records it
        load = read_force(f"{path.name}: load", f"{samples.source['load']} N", setup.scene)
    scene = setup.scene if load is None else setup.scene.model_copy(update={"load": Load(force=load)})
    contents = build_reading_without_prediction(
        measurement, scene, setup.bench, setup.gains, origin=origin, fingerprint=Fingerprint.from_samples(samples)
    )
    return contents | {"blank": samples.source.get("blank") is True, "load": load}


def _build_reading(scene: Scene, measured: FieldReading, spread: float, place: dict[str, str]) -> Reading:
    """Return one reading at its place: that of the command line, else that stored in its file, else the scene's.

    Parameters
    ----------
    scene
        For its placement.
    measured
        The reading as measured.
    spread
        Its relative standard deviation.
    place
        The place on the command line: texts by keys of ``PLACE_KEYS``.
    """
    x, y = measured.placement or (scene.placement.x, scene.placement.y)
    x, y = (POSITION_QUANTITY.read(key, place[key]) if key in place else default for key, default in (("x", x), ("y", y)))
    placed_scene = scene.model_copy(update={"placement": scene.placement.model_copy(update={"x": x, "y": y})})
    (reading,) = build_single_reading(placed_scene, measured.ratio, max(spread, MIN_NOISE))
    blank = {"true": True, "false": False}.get(place.get("blank", str(measured.blank)).lower())
    if blank is None:
        raise InputError("blank", place["blank"], "true or false")
    return replace(reading, blank=blank, force=measured.load)


def _apply_largest_load(scene: Scene, measured: list[FieldReading], warnings: list[str]) -> Scene:
    """Return the scene under the largest measured load if that is clearly above the scene's, else the scene unchanged.

    A line is appended to ``warnings`` if the load is replaced.
    """
    largest_force = max((abs(reading.force) for reading in measured if reading.load is None), default=0.0)
    force = scene.load.force
    if force is None or not math.isfinite(largest_force) or largest_force <= LOAD_EXCESS_FACTOR * force:
        return scene
    warnings.append(f"the measured load {largest_force:.4g} N is above the scene's {force:.4g} N and replaces it")
    return scene.model_copy(update={"load": Load(force=largest_force)})


def join_reading_texts(texts: tuple[str, ...], other_files: tuple[str, ...]) -> tuple[str, ...]:
    """Return the texts of all readings on a command line: the values of --reading, then the names of further files.

    A value of --reading has the form ``READING_FORM``: the name of a file and, after commas, where on the tissue it was read.

    Raises
    ------
    InputError
        There are further files but no --reading, so that they look like a second scene.
    """
    if other_files and not texts:
        # the file of the scene is counted, too
        raise InputError("scene", Words(f"{len(other_files) + 1} files"), "one scene; --reading before the files of readings")
    return (*texts, *other_files)
