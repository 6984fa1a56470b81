"""Write and read calibration records: TOML files that are written completely, and never over another file."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, fields
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Literal, TypeVar

import numpy as np
from pydantic import Field, ValidationError, model_validator

from geometry.common.errors import InputError, Words
from geometry.common.files import write_text
from geometry.common.json_types import JsonObject
from geometry.common.text_files import read_tables
from geometry.provenance.block import DISTRIBUTION, build_provenance
from geometry.provenance.texts import format_toml_comment
from geometry.scenes.quantities import Frozen
from geometry.scenes.scene import Scene
from geometry.scenes.scene_file import scene_from_dict, scene_to_dict
from geometry.scenes.validation_messages import convert_error
from probe_design.built_probe.bench import Bench, bench_from_dict
from probe_design.built_probe.calibration import Calibration
from probe_design.built_probe.gains import ENTRY_NAMES, BondFactor, Finite, ForceScale, Gains
from probe_design.built_probe.probe_identity import MAX_SERIAL_LENGTH
from probe_design.built_probe.reference_charges import compute_charge_units

RECORD_FORMAT: Literal["probe-design calibration"] = "probe-design calibration"
RECORD_VERSION: Literal[2] = 2
RECORD_HEADER = """# A calibration of a tactile probe, by `probe-design calibrate`; docs/guides/calibrate.md explains each number.
# reading / N of nominal gain = matrix @ film force / N; rows and columns: inner, outer film. Covariances row by row.
# Where readings are charges: = matrix @ predicted charges, with one scale of d per film on its diagonal; the fifth entry is
# ln of the factor on the moduli of the films' bonds, and a reading times charge_unit is the charge in C that was measured.
"""
GAIN_FIELDS = tuple(field.name for field in fields(Gains))
GAIN_ARRAYS = ("matrix", "covariance", "slopes", "workshop")
T = TypeVar("T")
Listed = Annotated[T, Field(strict=False)]  # a tuple, which TOML writes as a list
Row = Listed[tuple[Finite, ...]]


@dataclass(frozen=True)
class Raw:
    """The raw data of a reading.

    Attributes
    ----------
    sha256
        Of the recorded file, or of the samples if nothing was recorded.
    file
        Its name, or "" if nothing was recorded.
    """

    sha256: str
    file: str = ""


class ReadingRecord(Frozen):
    """The reading on one reference, in N of nominal gain."""

    on: str
    films: Row
    films_sd: Row
    force: Finite | None = None
    sha256: str
    file: str = ""


class CalibrationRecord(Frozen):
    """The tables of the file; ``build_gains``, ``build_scene`` and ``build_bench`` convert them to objects."""

    format: Literal["probe-design calibration"]
    version: Literal[2]
    software: str
    date: str
    device: str
    serial: str = Field(default="", max_length=MAX_SERIAL_LENGTH)
    frequency: float = Field(ge=1e-6, le=1e12)
    absolute: bool
    entries: Listed[tuple[str, ...]]
    matrix: Listed[tuple[Row, Row]]
    covariance: Listed[tuple[Row, ...]]
    cross_talk_resolved: Listed[tuple[bool, bool]]
    offsets: Row
    offsets_sd: Row
    chi_square: Finite
    degrees_of_freedom: int = Field(ge=0)
    variables: Listed[tuple[str, ...]]
    slopes: Listed[tuple[Row, ...]]
    workshop: Row
    warnings: Listed[tuple[str, ...]]
    reading: Listed[tuple[ReadingRecord, ...]]
    force_scale: ForceScale = ForceScale()
    charge_unit: Finite | Row  # a row: of inner and outer film, which differ
    bonds: BondFactor | None = None
    scene: JsonObject
    bench: JsonObject

    @model_validator(mode="after")
    def _check_shapes(self) -> CalibrationRecord:
        """Refuse arrays whose shapes do not fit each other, a singular matrix, and a covariance with a negative eigenvalue."""
        gains = self.build_gains()
        shapes = (gains.matrix.shape, gains.covariance.shape, gains.slopes.shape, gains.workshop.shape)
        n, v = 4 + (self.bonds is not None), len(self.variables)  # fitted entries, and variables of the design
        if (
            shapes != ((2, 2), (n, n), (n, v), (v,))
            or len(self.force_scale.entries) not in (4, n)
            or abs(np.linalg.det(gains.matrix)) < 1e-6
        ):
            entry = Words("of a shape that its covariance or slopes do not fit")
            raise InputError("calibration.matrix", entry, "what calibrate has written")
        # rounding may leave an eigenvalue slightly below 0; 1e-12 allows it for a covariance of zeros, too
        if np.linalg.eigvalsh(gains.remove_force_scale_error().covariance).min() < -1e-9 * max(np.trace(gains.covariance), 1e-12):
            raise InputError("calibration.covariance", Words("no covariance"), "what calibrate has written")
        return self

    def __str__(self) -> str:
        """Return a short table of the gain matrix with its standard deviations, and the warnings."""
        rows = [f"{name}  {value:.5g} ± {sd:.2g}" for name, value, sd in self.list_gains()]
        return "\n".join(["CalibrationRecord", *rows, *(f"warning: {text}" for text in self.warnings)])

    __repr__ = __str__

    def list_gains(self) -> list[tuple[str, float, float]]:
        """Return name, value and standard deviation of each entry of the gain matrix, and of a fitted bonds' modulus."""
        values = [*np.ravel(self.matrix), *([] if self.bonds is None else [self.bonds.log_factor])]
        return list(zip(self.entries, values, np.sqrt(np.diag(self.covariance)), strict=True))

    def build_gains(self) -> Gains:
        """Build the gain matrix with its covariance."""
        values = {name: getattr(self, name) for name in GAIN_FIELDS}
        return Gains(**values | {name: np.array(values[name], dtype=float) for name in GAIN_ARRAYS})

    def build_scene(self) -> Scene:
        """Build the scene that the calibration assumed."""
        return scene_from_dict(self.scene)

    def build_bench(self) -> Bench:
        """Build the bench that the calibration assumed."""
        return bench_from_dict(self.bench)


def build_record(calibration: Calibration, raw: Sequence[Raw], device: str, serial: str | None = None) -> CalibrationRecord:
    """Build the record of a calibration.

    Parameters
    ----------
    calibration
        The result.
    raw
        Raw data of its readings, in their order.
    device
        Description of the device.
    serial
        Serial number of its board, if all readings have the same one.
    """
    gains = {name: getattr(calibration.gains, name) for name in GAIN_FIELDS}
    units = compute_charge_units(calibration.scene).tolist()
    readings = tuple(
        ReadingRecord(
            on=observation.reference.name, films=tuple(observation.films.tolist()),
            films_sd=tuple(np.sqrt(np.diag(observation.covariance)).tolist()),
            force=observation.force, sha256=data.sha256, file=data.file,
        )
        for observation, data in zip(calibration.readings, raw, strict=True)
    )  # fmt: skip
    return CalibrationRecord.model_validate(
        gains
        | {name: gains[name].tolist() for name in GAIN_ARRAYS}
        | {
            "format": RECORD_FORMAT, "version": RECORD_VERSION, "software": f"probe-design {version(DISTRIBUTION)}",
            "date": datetime.now(UTC).isoformat(timespec="seconds"), "device": device, "serial": serial or "",
            "frequency": calibration.frequency, "entries": ENTRY_NAMES[: len(calibration.gains.covariance)],
            "charge_unit": units[0] if units[0] == units[1] else tuple(units), "variables": calibration.variables,
            "offsets": tuple(calibration.offsets.tolist()), "offsets_sd": tuple(calibration.offsets_sd.tolist()),
            "warnings": calibration.warnings, "reading": readings, "scene": scene_to_dict(calibration.scene),
            "bench": calibration.bench.model_dump(mode="json", exclude_none=True),
        }
    )  # fmt: skip


def write_record(path: Path, contents: CalibrationRecord) -> Path:
    """Write a record and return ``path``.

    Raises
    ------
    InputError
        The file exists.
    """
    import tomli_w

    check_free(path)
    tables = tomli_w.dumps(contents.model_dump(mode="json", exclude_none=True))
    return write_text(path, format_toml_comment(build_provenance()) + RECORD_HEADER + tables)


def read_record(path: Path | str) -> CalibrationRecord:
    """Read a calibration record. Raises ``InputError`` if the file is not one of this format and version."""
    data = read_tables(path, "calibration", "a calibration that `probe-design calibrate` has written")
    if (data.get("format"), data.get("version")) != (RECORD_FORMAT, RECORD_VERSION):
        header = Words(f"{path}: {data.get('format', 'no format')}, version {data.get('version', 'missing')}")
        raise InputError("calibration", header, f"{RECORD_FORMAT}, version {RECORD_VERSION}")
    try:
        return CalibrationRecord.model_validate(data)
    except ValidationError as refused:
        raise convert_error(refused, CalibrationRecord, "calibration") from None


def check_free(path: Path) -> None:
    """Raise ``InputError`` if the file exists."""
    if os.path.exists(path):  # of too long a name `Path.exists` raises
        raise InputError("output", str(path), "a name that is not taken: calibrations are never overwritten")
