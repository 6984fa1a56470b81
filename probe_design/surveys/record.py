"""Record a survey in its folder press by press, so that an interruption loses nothing that was read."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from hashlib import sha256
from pathlib import Path

from geometry.common.errors import InputError, Words
from geometry.common.files import write_together
from geometry.common.json_types import JsonObject
from geometry.scenes.scene import Scene
from probe_design.built_probe.field_readings import FieldReading
from probe_design.data.noise import MIN_NOISE
from probe_design.estimation.made_readings import check_readings
from probe_design.estimation.measurements import Reading, build_scan_reading
from probe_design.populations.design_file import Design
from probe_design.populations.tables import NoiseModel
from probe_design.reporting.table import Table

RECORD_FILE, SCAN_FILE = "survey.json", "scan.csv"
MAX_ATTEMPTS = 100  # recordings of one press


@dataclass(frozen=True)
class Press:
    """One press of a survey.

    Attributes
    ----------
    reading
        What was read.
    file
        Name of its raw recording.
    probability
        Of no tumour, of one and so on, after it.
    """

    reading: Reading
    file: str
    probability: tuple[float, ...]

    def as_dict(self) -> JsonObject:
        """Return the entry of the record."""
        return {"reading": asdict(self.reading), "file": self.file, "probability": list(self.probability)}


def build_press_reading(scene: Scene, measured: FieldReading, noise: NoiseModel, place: Mapping[str, str]) -> Reading:
    """Return the reading of a press, with the noise of pressing beside that of the electronics.

    Parameters
    ----------
    scene
        Of probe and tissue.
    measured
        What the samples give, with the place and the force that their file states.
    noise
        Of a press.
    place
        Texts of x, y, blank and force, which replace those of the file.

    Raises
    ------
    InputError
        The place is missing or beside the tissue, or the force is not allowed.
    """
    total = max(math.hypot(noise.white, noise.tilt, measured.noise), MIN_NOISE)
    row: dict[str, object] = {"ratio": measured.ratio, "noise": total, "blank": str(measured.blank).lower()}
    if measured.placement is not None:
        row |= {key: f"{length!r} m" for key, length in zip(("x", "y"), measured.placement, strict=True)}
    if measured.load is not None:
        row["force"] = f"{measured.load!r} N"
    return build_scan_reading("reading: ", row | dict(place), scene)


@dataclass(frozen=True)
class SurveyRecord:
    """The folder of a survey.

    Attributes
    ----------
    folder
        Holds the recordings, the record and the scan's file.
    settings
        What all presses of one survey have in common.
    presses
        So far.
    extra
        Further entries, such as the tumours that a virtual tissue hides.
    """

    folder: Path
    settings: JsonObject
    presses: tuple[Press, ...]
    extra: JsonObject

    @classmethod
    def open(cls, folder: Path, design: Design | Scene, settings: JsonObject) -> SurveyRecord:
        """Return the record of a folder: a new one, or that of an interrupted survey.

        Raises
        ------
        InputError
            The folder holds a survey of another design or other settings, or its record cannot be read.
        """
        scene = design.scene if isinstance(design, Design) else design
        settings = {"design_sha256": sha256(design.model_dump_json().encode()).hexdigest()} | settings
        path = folder / RECORD_FILE
        if not path.exists():
            return cls(folder, settings, (), {})
        allowed = "a new folder, or that of a survey of this design with the same options"
        try:
            contents = json.loads(path.read_text(encoding="utf-8"))
            entries = contents["presses"]
            readings = check_readings([Reading(**entry["reading"]) for entry in entries], scene, is_scan=True)
            presses = tuple(
                Press(reading, str(entry["file"]), tuple(map(float, entry["probability"])))
                for reading, entry in zip(readings, entries, strict=True)
            )
            stored = dict(contents["settings"])
        except (ValueError, KeyError, TypeError, OSError):
            raise InputError("output", Words(f"{path} that cannot be read"), allowed) from None
        for key, value in settings.items():
            if stored.get(key) != value:
                raise InputError("output", Words(f"{folder} with another {key.removesuffix('_sha256')}"), allowed)
        extra = {key: value for key, value in contents.items() if key not in ("settings", "presses")}
        return cls(folder, settings, presses, extra)

    def name_recording(self) -> Path:
        """Return a new name for the next press's recording; that of an interrupted one stays."""
        number = len(self.presses) + 1
        for attempt in range(1, MAX_ATTEMPTS):
            path = self.folder / f"press-{number:03d}{'' if attempt == 1 else f'-again{attempt}'}.probe"
            if not path.exists():
                return path
        raise InputError("output", Words(f"{MAX_ATTEMPTS} recordings of press {number}"), "a new folder")

    def add(self, press: Press, extra: JsonObject) -> SurveyRecord:
        """Return the record with a press more, written whole."""
        record = SurveyRecord(self.folder, self.settings, (*self.presses, press), extra)
        record.write(extra)
        return record

    def discard(self) -> SurveyRecord:
        """Return the record without its last press, whose recording stays and is named under ``discarded``, written whole."""
        discarded = [*self.extra.get("discarded", []), self.presses[-1].file]
        record = SurveyRecord(self.folder, self.settings, self.presses[:-1], self.extra | {"discarded": discarded})
        record.write(record.extra)
        return record

    def build_table(self) -> Table:
        """Return the presses as a table, with their forces where they have one."""
        has_force = any(press.reading.force is not None for press in self.presses)
        names = ("press", "x, mm", "y, mm", *["force, mN"] * has_force, "ratio", "sd, %", "P(no tumour)", "recording")
        rows = []
        for number, press in enumerate(self.presses, start=1):
            reading = press.reading
            force = "" if reading.force is None else f"{1e3 * reading.force:.4g}"
            place = ("baseline", "") if reading.blank else (f"{1e3 * reading.x:.1f}", f"{1e3 * reading.y:.1f}")
            numbers = (f"{reading.ratio:.4g}", f"{100 * reading.noise:.2g}", f"{press.probability[0]:.2g}")
            rows.append((str(number), *place, *[force] * has_force, *numbers, press.file))
        return Table(names, tuple(rows))

    def write(self, extra: JsonObject) -> None:
        """Write the record, with further entries, and the scan's file for `locate`."""
        contents: JsonObject = {"settings": self.settings, "presses": [press.as_dict() for press in self.presses]} | extra
        with write_together(self.folder, (RECORD_FILE, SCAN_FILE)) as draft:
            (draft / RECORD_FILE).write_text(json.dumps(contents, indent=1, allow_nan=False) + "\n", encoding="utf-8")
            (draft / SCAN_FILE).write_text(format_scan([press.reading for press in self.presses]), encoding="utf-8")


def format_scan(readings: Sequence[Reading]) -> str:
    """Return readings as a scan's .csv file; it states forces where a reading has one."""
    has_force = any(part.force is not None for part in readings)
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(("x", "y", "ratio", "noise", "blank", *["force"] * has_force))
    for part in readings:
        force = "" if part.force is None else f"{part.force!r} N"
        row = (f"{part.x!r} m", f"{part.y!r} m", repr(part.ratio), repr(part.noise), str(part.blank).lower())
        writer.writerow((*row, *[force] * has_force))
    return text.getvalue()
