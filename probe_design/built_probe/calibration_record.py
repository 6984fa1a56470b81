"""Write and read calibration records: TOML files that are written completely, and never over another file."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass
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
from geometry.provenance.block import build_provenance
from geometry.provenance.texts import format_toml_comment
from geometry.scenes.probe import Frozen
from geometry.scenes.scene import Scene
from geometry.scenes.scene_file import scene_from_dict, scene_to_dict
from geometry.scenes.validation_messages import convert_error
from probe_design.built_probe.bench import Bench, bench_from_dict
from probe_design.built_probe.calibration import Calibration
from probe_design.built_probe.force_scale import ForceScale
from probe_design.built_probe.gain_matrix import ENTRY_NAMES, Gains
from probe_design.built_probe.probe_identity import MAX_SERIAL_LENGTH

RECORD_FORMAT: Literal["probe-design calibration"] = "probe-design calibration"
RECORD_VERSION: Literal[1] = 1
RECORD_HEADER = """# A calibration of a tactile probe, by `probe-design calibrate`; docs/guides/hardware.md explains each number.
# reading / N of nominal gain = matrix @ film force / N; rows and columns: inner, outer film. Covariances row by row.
"""
T = TypeVar("T")
Listed = Annotated[T, Field(strict=False)]  # a tuple, which TOML writes as a list
Finite = Annotated[float, Field(ge=-1e30, le=1e30)]  # so that products are finite, too
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


class ForceScaleRecord(Frozen):
    """The estimated scale of the force channel; see ``force_scale.ForceScale``."""

    factor: float = Field(default=1.0, ge=1e-3, le=1e3)
    sd: float = Field(default=0.0, ge=0.0, le=1e3)
    entries: Listed[tuple[Finite, Finite, Finite, Finite]] = (0.0, 0.0, 0.0, 0.0)
    confirmed: bool = True


class CalibrationRecord(Frozen):
    """The tables of the file; ``build_gains``, ``build_scene`` and ``build_bench`` convert them to objects."""

    format: Literal["probe-design calibration"]
    version: Literal[1]
    software: str
    date: str
    device: str
    serial: str = Field(default="", max_length=MAX_SERIAL_LENGTH)
    frequency: float = Field(ge=1e-6, le=1e12)
    absolute: bool
    entries: Listed[tuple[str, ...]]
    matrix: Listed[tuple[Row, Row]]
    covariance: Listed[tuple[Row, Row, Row, Row]]
    cross_talk_resolved: Listed[tuple[bool, bool]]
    offsets: Row
    offsets_sd: Row
    chi_square: Finite
    degrees_of_freedom: int = Field(ge=0)
    variables: Listed[tuple[str, ...]]
    slopes: Listed[tuple[Row, Row, Row, Row]]
    workshop: Row
    warnings: Listed[tuple[str, ...]]
    reading: Listed[tuple[ReadingRecord, ...]]
    force_scale: ForceScaleRecord = ForceScaleRecord()
    scene: JsonObject
    bench: JsonObject

    @model_validator(mode="after")
    def _check_shapes(self) -> CalibrationRecord:
        gains = self.build_gains()
        shapes = (gains.matrix.shape, gains.covariance.shape, gains.slopes.shape, gains.workshop.shape)
        v = len(self.variables)
        if shapes != ((2, 2), (4, 4), (4, v), (v,)) or abs(np.linalg.det(gains.matrix)) < 1e-6:
            raise InputError(
                "calibration.matrix", Words("of a shape that its covariance or slopes do not fit"), "what calibrate has written"
            )
        own_covariance = gains.covariance - gains.force_scale.covariance
        if np.linalg.eigvalsh(own_covariance).min() < -1e-9 * max(np.trace(gains.covariance), 1e-12):
            raise InputError("calibration.covariance", Words("no covariance"), "what calibrate has written")
        return self

    def build_gains(self) -> Gains:
        """Build the gain matrix with its covariance."""
        return Gains(
            matrix=np.array(self.matrix, dtype=float),
            covariance=np.array(self.covariance, dtype=float),
            slopes=np.array(self.slopes, dtype=float),
            workshop=np.array(self.workshop, dtype=float),
            absolute=self.absolute,
            cross_talk_resolved=self.cross_talk_resolved,
            chi_square=self.chi_square,
            freedom=self.degrees_of_freedom,
            force_scale=ForceScale(**self.force_scale.model_dump() | {"entries": np.array(self.force_scale.entries)}),
        )

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
    gains = calibration.gains
    readings = tuple(
        ReadingRecord(
            on=observation.reference.name, films=tuple(observation.films.tolist()),
            films_sd=tuple(np.sqrt(np.diag(observation.covariance)).tolist()),
            force=observation.force, sha256=data.sha256, file=data.file,
        )
        for observation, data in zip(calibration.readings, raw, strict=True)
    )  # fmt: skip
    scale = ForceScaleRecord.model_validate(asdict(gains.force_scale) | {"entries": gains.force_scale.entries.tolist()})
    tables: dict[str, object] = {name: getattr(gains, name).tolist() for name in ("matrix", "covariance", "slopes", "workshop")}
    return CalibrationRecord.model_validate(
        tables
        | {
            "format": RECORD_FORMAT, "version": RECORD_VERSION, "software": f"probe-design {version('probe-design')}",
            "date": datetime.now(UTC).isoformat(timespec="seconds"), "device": device,
            "serial": serial or "", "frequency": calibration.frequency,
            "absolute": gains.absolute, "entries": ENTRY_NAMES, "cross_talk_resolved": gains.cross_talk_resolved,
            "offsets": tuple(calibration.offsets.tolist()), "offsets_sd": tuple(calibration.offsets_sd.tolist()),
            "chi_square": gains.chi_square, "degrees_of_freedom": gains.freedom, "variables": calibration.variables,
            "warnings": calibration.warnings, "reading": readings, "force_scale": scale,
            "scene": scene_to_dict(calibration.scene),
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
    return write_text(
        path,
        format_toml_comment(build_provenance())
        + RECORD_HEADER
        + tomli_w.dumps(contents.model_dump(mode="json", exclude_none=True)),
    )


def read_record(path: Path | str) -> CalibrationRecord:
    """Read a record. Raises ``InputError``."""
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
    if os.path.exists(path):
        raise InputError("output", str(path), "a name that is not taken: calibrations are never overwritten")
