"""Readings of the probe, and files of them: ratios, stiffnesses and phases, each with its noise and the place of the probe.

A readings file is TOML, one table a reading,

    [[reading]]
    x = "-10 mm"            # of the probe's axis, in the scene's frame; default: the scene's placement
    y = "0 mm"
    ratio = 0.62
    noise = 0.05            # relative, one standard deviation; default: --noise
    stiffness = "80 N/m"    # default: not measured; a bare number is in N/m
    stiffness_noise = 0.05  # default: --stiffness-noise, or the noise of the ratio
    ratio_phase = "1.8 deg" # of the ratio, as `read` prints it; default: not measured; a bare number is in rad
    ratio_phase_sd = "0.1 deg"  # its standard deviation
    blank = true            # baseline reading, over tumour-free tissue; default: false
    force = "0.3 N"         # on the probe, the peak of this press; default: the scene's load

or CSV with the same keys in any order: the first row names them, and an empty cell stands for the default; see ``csv_rows``. A
scan for `locate` states every place, and may have

    x_sd = "0.5 mm"         # standard deviation of the probe's place along x; default: pose of the design file's [noise]
    y_sd = "0.5 mm"         # likewise along y
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from geometry.common.arrays import Bools, Floats, Ints
from geometry.common.errors import InputError, Words, describe_choices
from geometry.common.text_files import parse_tables, read_text
from geometry.scenes.fit_check import check_bodies_fit
from geometry.scenes.probe import format_mm
from geometry.scenes.scene import Scene
from geometry.scenes.units import Quantity, read_number
from probe_design.data.noise import read_noise
from probe_design.estimation.csv_rows import parse_csv

READING_KEYS = ("x", "y", "ratio", "noise", "stiffness", "stiffness_noise", "ratio_phase", "ratio_phase_sd", "blank", "force")
SCAN_KEYS = (*READING_KEYS, "x_sd", "y_sd")  # of scans, whose places are uncertain
# of ``Measurements``, shape (k,) each
DATUM_KEYS = "place", "is_stiffness", "is_phase", "is_blank", "value", "sign", "noise", "force"
MAX_READINGS = 1000
MAX_FILE_BYTES = 200_000  # bytes
POSITION_QUANTITY = Quantity("position", "m", "mm", -10.0, 10.0)
ALLOWED_RATIO = "a number above 0: inner over outer film stress, or charge per area, both of one sign"
SI_QUANTITIES = {  # entries that may be numbers without unit
    "stiffness": Quantity("stiffness", "N/m", "N/m", 1e-9, 1e15),
    "ratio_phase": Quantity("phase", "rad", "deg", -1.5, 1.5),
    "ratio_phase_sd": Quantity("phase", "rad", "deg", 1e-7, 1.5),
}
SCAN_QUANTITIES = {
    "x_sd": Quantity("length", "m", "mm", 0.0, 0.1),
    "y_sd": Quantity("length", "m", "mm", 0.0, 0.1),
}
FORCE_QUANTITY = Quantity("force", "N", "mN", 1e-9, 1e9)
NoiseAtForce = Callable[[float | None], tuple[float, float]]  # relative, of ratio and stiffness, at a force in N


@dataclass(frozen=True)
class Reading:
    """One press of the probe.

    Attributes
    ----------
    x, y
        Position of its axis, m.
    ratio
        ``ratio``, or ``charge_ratio`` where the scene reads charges, see ``solver.results.result.Result``; above 0.
    noise
        Relative, one standard deviation.
    stiffness
        Force on the base per indentation, N/m, or None.
    stiffness_noise
        Relative, one standard deviation.
    blank
        Whether there is no tumour under the probe.
    ratio_phase
        Phase by which the inner film leads the outer one, rad; a negative ratio counts as phase 0. None if not measured.
    ratio_phase_sd
        Its standard deviation, rad.
    x_sd, y_sd
        Standard deviations of the position, m; None if not stated.
    force
        On the probe, N; None for the scene's load.
    """

    x: float
    y: float
    ratio: float
    noise: float
    stiffness: float | None = None
    stiffness_noise: float | None = None
    blank: bool = False
    ratio_phase: float | None = None
    ratio_phase_sd: float | None = None
    x_sd: float | None = None
    y_sd: float | None = None
    force: float | None = None


@dataclass(frozen=True)
class Measurements:
    """All measured data as k independent normal numbers; ratios and stiffnesses as logarithms.

    Attributes
    ----------
    places
        Distinct places of the probe's axis, m, shape (p, 2).
    place
        Index into ``places``, shape (k,).
    is_stiffness
        Whether a datum is a stiffness, shape (k,).
    is_phase
        Whether a datum is a ratio's phase, shape (k,); a datum that is neither is a ratio.
    is_blank
        Whether a datum is of a baseline reading, over tumour-free tissue, shape (k,).
    value
        Ln |ratio| or ln stiffness, or a phase in rad, shape (k,).
    sign
        +1 or -1 for a ratio, +1 for a stiffness, 0 for a phase, shape (k,); 0 also for a ratio of unknown sign.
    noise
        Standard deviations, shape (k,).
    force
        Force on the probe, N, shape (k,); NaN where it is the scene's load.
    """

    places: Floats
    place: Ints
    is_stiffness: Bools
    is_phase: Bools
    is_blank: Bools
    value: Floats
    sign: Floats
    noise: Floats
    force: Floats

    @classmethod
    def from_readings(cls, readings: tuple[Reading, ...]) -> Measurements:
        """Return the data of readings: all ratios, then stiffnesses, then phases."""
        rows = [(reading, "ratio", np.log(abs(reading.ratio)), np.sign(reading.ratio), reading.noise) for reading in readings]
        for reading in readings:
            if reading.stiffness is not None:
                noise = reading.stiffness_noise or reading.noise
                rows.append((reading, "stiffness", np.log(reading.stiffness), 1.0, noise))
        for reading in readings:
            if reading.ratio_phase is not None:
                rows.append((reading, "phase", reading.ratio_phase, 0.0, reading.ratio_phase_sd or 0.0))
        # the reading of each datum, its kind, value, sign and noise
        pressed_readings, kinds, values, signs, noises = zip(*rows, strict=True)
        places = list(dict.fromkeys((reading.x, reading.y) for reading in readings))
        return cls(
            places=np.array(places, dtype=float),
            place=np.array([places.index((reading.x, reading.y)) for reading in pressed_readings]),
            is_stiffness=np.array(kinds) == "stiffness",
            is_phase=np.array(kinds) == "phase",
            is_blank=np.array([reading.blank for reading in pressed_readings]),
            value=np.array(values, dtype=float),
            sign=np.array(signs, dtype=float),
            noise=np.array(noises, dtype=float),
            force=np.array([np.nan if reading.force is None else reading.force for reading in pressed_readings]),
        )

    def select(self, mask: Bools) -> Measurements:
        """Return the data that a mask of shape (k,) selects."""
        return replace(self, **{key: getattr(self, key)[mask] for key in DATUM_KEYS})

    def join(self, new_data: Measurements) -> Measurements:
        """Return these data followed by new ones; the sign of the new ratios counts as unknown."""
        places = list(dict.fromkeys(map(tuple, [*self.places.tolist(), *new_data.places.tolist()])))
        place = [places.index(tuple(part.places[k].tolist())) for part in (self, new_data) for k in part.place]
        arrays = {key: np.concatenate([getattr(self, key), getattr(new_data, key)]) for key in DATUM_KEYS}
        arrays |= {"place": np.array(place), "sign": np.concatenate([self.sign, np.zeros_like(new_data.sign)])}
        return Measurements(places=np.array(places), **arrays)

    @property
    def is_ratio(self) -> Bools:
        """Whether a datum is a ratio, shape (k,)."""
        return np.asarray(~self.is_stiffness & ~self.is_phase)

    @property
    def first_ratio(self) -> int:
        """Index of the first ratio that is not of a baseline reading."""
        return int(np.argmax(self.is_ratio & ~self.is_blank))


def build_single_reading(
    scene: Scene, ratio: Any, noise: Any, stiffness: Any = None, stiffness_noise: Any = None
) -> tuple[Reading, ...]:
    """Return one reading at the scene's placement, as a tuple; values may be numbers or texts with units.

    ``noise`` and ``stiffness_noise`` are relative standard deviations.

    Raises
    ------
    InputError
        A value is not allowed.
    """
    row = {"ratio": ratio, "noise": noise, "stiffness": stiffness, "stiffness_noise": stiffness_noise}
    return (check_reading("", row, scene, None, None),)


def read_readings(
    path: Path, scene: Scene, noise: Any = None, stiffness_noise: Any = None, *, is_scan: bool = False
) -> tuple[Reading, ...]:
    """Return the readings of a file in the format of this module's docstring.

    Parameters
    ----------
    path
        Ends in .toml or .csv.
    scene
        The scene of the readings.
    noise
        Relative standard deviation of ratios for which the file states none; of a scan, see ``build_scan_reading``.
    stiffness_noise
        Relative standard deviation of stiffnesses for which the file states none; not of a scan.
    is_scan
        Whether every reading has to state its place, and may have the further keys of scans.

    Raises
    ------
    InputError
        The file cannot be read, or an entry is not allowed.
    """
    if path.suffix.lower() not in (".toml", ".csv"):
        raise InputError("readings", str(path), "a file that ends in .toml or .csv")
    text, is_csv = read_text(path, "readings", "a file", MAX_FILE_BYTES), path.suffix.lower() == ".csv"
    rows = parse_csv(text, str(path), SCAN_KEYS if is_scan else READING_KEYS) if is_csv else _parse_toml(text, str(path))
    if not 0 < len(rows) <= MAX_READINGS:
        raise InputError(str(path), Words(f"{len(rows)} readings"), f"1 to {MAX_READINGS} readings")
    if is_scan:
        return tuple(build_scan_reading(f"reading[{index}].", row, scene, noise) for index, row in enumerate(rows))
    return tuple(check_reading(f"reading[{index}].", row, scene, noise, stiffness_noise) for index, row in enumerate(rows))


def build_scan_reading(key_prefix: str, row: Mapping[str, object], scene: Scene, noise: NoiseAtForce | None = None) -> Reading:
    """Return one reading of a scan from its entries by ``SCAN_KEYS``, numbers in SI units or texts with units.

    Parameters
    ----------
    key_prefix
        Precedes its keys in messages.
    row
        Entries by key; x and y have to be stated.
    scene
        The scene of the readings.
    noise
        Relative standard deviations of ratio and stiffness by the force, N, or None, where the entries state none.

    Raises
    ------
    InputError
        An entry is missing or not allowed.
    """
    for key in ("x", "y"):
        if row.get(key) is None:
            raise InputError(key_prefix + key, Words("missing"), POSITION_QUANTITY.allowed)
    extra = {key: row[key] for key in SCAN_QUANTITIES if row.get(key) is not None}
    force = None if row.get("force") is None else read_force(f"{key_prefix}force", row["force"], scene)
    defaults = (None, None) if noise is None else noise(force)
    reading = check_reading(key_prefix, {key: row[key] for key in row if key not in extra}, scene, *defaults)
    numbers: dict[str, Any] = {key: SCAN_QUANTITIES[key].read(key_prefix + key, entry) for key, entry in extra.items()}
    return replace(reading, **numbers)


def _parse_toml(text: str, name: str) -> list[Mapping[str, object]]:
    """Return the entries of each reading of a TOML file."""
    data = parse_tables(text, name, "tables headed [[reading]]")
    rows = data.get("reading")
    if set(data) != {"reading"} or not isinstance(rows, list) or not all(isinstance(row, Mapping) for row in rows):
        raise InputError(name, Words(f"keys {', '.join(data) or 'missing'}"), "tables headed [[reading]] and nothing else")
    return rows


def check_reading(key_prefix: str, row: Mapping[str, object], scene: Scene, noise: Any, stiffness_noise: Any) -> Reading:
    """Return a reading from its entries, checked.

    Parameters
    ----------
    key_prefix
        Precedes its keys in messages.
    row
        Entries by key, of ``READING_KEYS``.
    scene
        Gives the default place.
    noise, stiffness_noise
        Defaults for missing entries.
    """
    for key in row:
        if key not in READING_KEYS:
            what = (
                "nothing: the places of these readings count as exact"
                if key in SCAN_KEYS
                else describe_choices(key, READING_KEYS)
            )
            raise InputError(f"{key_prefix}{key}", row[key], what)
    entries = {"noise": noise, "stiffness_noise": stiffness_noise, "blank": False}
    entries |= {key: value for key, value in row.items() if value is not None}
    ratio = read_number(f"{key_prefix}ratio", entries.get("ratio"), ALLOWED_RATIO)
    if not 0 < ratio < math.inf:
        raise InputError(f"{key_prefix}ratio", entries["ratio"], ALLOWED_RATIO)
    ratio_noise = read_noise(f"{key_prefix}noise", entries["noise"])
    given_noise = entries["stiffness_noise"]
    missing_phase_keys = {"ratio_phase", "ratio_phase_sd"} - entries.keys()
    if len(missing_phase_keys) == 1:
        key = f"{key_prefix}{missing_phase_keys.pop()}"
        raise InputError(key, Words("missing"), "ratio_phase and ratio_phase_sd, or neither")
    x, y = _read_place(key_prefix, entries, scene)
    optional_entries = {
        key: _read_with_si_unit(f"{key_prefix}{key}", entries[key], quantity)
        for key, quantity in SI_QUANTITIES.items()
        if key in entries
    }
    return Reading(
        x,
        y,
        ratio,
        noise=ratio_noise,
        stiffness_noise=ratio_noise if given_noise is None else read_noise(f"{key_prefix}stiffness_noise", given_noise),
        blank=_read_flag(f"{key_prefix}blank", entries["blank"]),
        force=read_force(f"{key_prefix}force", entries["force"], scene) if "force" in entries else None,
        **optional_entries,
    )


def read_force(key: str, value: object, scene: Scene) -> float:
    """Return the force of one reading, N; raise ``InputError`` where the scene's load is no press to a force from zero."""
    if scene.load.force is None or scene.load.preload:
        what = "load.preload" if scene.load.preload else "load.indentation"
        raise InputError(key, str(value), f"nothing in a scene with {what}: readings at several forces are presses from zero")
    return FORCE_QUANTITY.read(key, value)


def _read_place(key_prefix: str, entries: Mapping[str, object], scene: Scene) -> tuple[float, float]:
    """Return the place of the probe's axis, m, by default the scene's; the probe has to stand on the tissue there."""
    x, y = (
        POSITION_QUANTITY.read(f"{key_prefix}{key}", entries[key]) if key in entries else getattr(scene.placement, key)
        for key in "xy"
    )
    try:
        check_place(scene, x, y)
    except InputError as fault:
        key = fault.key.removeprefix("placement.")
        raise InputError(f"{key_prefix}{key}", format_mm(x if key == "x" else y), fault.allowed) from None
    return x, y


def check_place(scene: Scene, x: float, y: float) -> None:
    """Raise ``InputError`` where the probe with its axis at x, y, m, does not stand on the tissue."""
    check_bodies_fit(scene.model_copy(update={"placement": scene.placement.model_copy(update={"x": x, "y": y})}))


def is_on_tissue(scene: Scene, x: float, y: float) -> bool:
    """Return whether the whole probe stands on the tissue with its axis at x, y, m."""
    with suppress(InputError):
        check_place(scene, x, y)
        return True
    return False


def _read_flag(key: str, value: object) -> bool:
    """Return true or false, which CSV files contain as texts."""
    flag = {"true": True, "false": False}.get(value.lower()) if isinstance(value, str) else value
    if not isinstance(flag, bool):
        raise InputError(key, value, "true or false")
    return flag


def _read_with_si_unit(key: str, value: Any, quantity: Quantity) -> float:
    """Return a quantity; a number without unit is in its SI unit."""
    try:
        si_value = math.nan if isinstance(value, bool) else float(value)
    except (TypeError, ValueError, OverflowError):
        return quantity.read(key, value)
    try:
        return quantity.check(si_value)
    except ValueError:
        raise InputError(key, value, f"{quantity.allowed}; a bare number is in {quantity.si}") from None
