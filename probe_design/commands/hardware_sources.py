"""Scene, bench, calibration and the source of samples, which `read`, `calibrate`, `check` and `doctor` share."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from geometry.common.errors import InputError, Words, describe_choices
from geometry.common.files import check_writable_file
from geometry.common.resources import get_limits
from geometry.scenes.quantities import CHARGE_QUANTITY, LENGTH_QUANTITY
from geometry.scenes.scene import Scene
from geometry.scenes.scene_file import read_scene
from geometry.scenes.units import MODULUS_QUANTITY, read_number
from geometry.scenes.variables import PIEZO_KEYS, list_values
from hw.common.limits import ReadLimits
from hw.common.samples import Floats, Samples
from hw.files.columns import ColumnMap, read_rate
from hw.files.open_file import is_from_other_program
from hw.reader import DEFAULT_COLUMNS, Reader
from hw.recordings.recording import compute_sha256
from hw.simulation.virtual import make_virtual_probe
from probe_design.built_probe.bench import Bench, read_bench, read_builtin_bench
from probe_design.built_probe.block_predictions import express_by_outer_radius
from probe_design.built_probe.calibration_record import CalibrationRecord, Raw, read_record
from probe_design.built_probe.gains import Gains
from probe_design.built_probe.hidden_tumours import read_hidden_tumours
from probe_design.built_probe.probe_identity import describe_contrast, describe_probe_difference, list_probe_numbers
from probe_design.built_probe.reference_charges import scale_bonds
from probe_design.built_probe.virtual_probe import SAMPLE_RATE_HZ, VOLTS_PER_COUNT, VirtualBench
from probe_design.commands.hardware_request import ALLOWED_SOURCES, SourceRequest
from probe_design.data.builtin import read_builtin_bench_scene

CHANNEL_COUNT = 3
MAX_ATTEMPTS = 3  # for one reading with a live device

Opener = Callable[[], Reader]


def build_openers(
    source: SourceRequest, signals: Callable[[], tuple[Callable[[Floats], Floats], ...]], count: int, pace: bool
) -> tuple[Opener, ...]:
    """Return for each of ``count`` readings a function that opens its reader.

    Parameters
    ----------
    source
        What is read.
    signals
        Returns the signals of the virtual probe, one function of time for each reading.
    count
        Number of readings.
    pace
        Whether the virtual probe sends its samples in real time.

    Raises
    ------
    InputError
        There are more recordings than readings, or fewer and no other source.
    """
    recorded_files, (rate, columns) = list_recorded_files(source, count), _read_device_options(source)
    if source.virtual and None in recorded_files:
        source_openers: list[Opener] = [partial(open_virtual, signal, pace) for signal in signals()]
    else:
        source_openers = [build_device_opener(source)] * count
    return tuple(
        opener if path is None else partial(_open_recording, source, path, rate, columns)
        for path, opener in zip(recorded_files, source_openers, strict=True)
    )


def build_device_opener(source: SourceRequest) -> Opener:
    """Return a function that opens the device, by default the only probe on USB."""
    return partial(Reader.open, source.device or "usb", *_read_device_options(source))


def _read_device_options(source: SourceRequest) -> tuple[float | None, ColumnMap]:
    """Return the values of --rate, Hz or None, and of --column."""
    return None if source.rate is None else read_rate(source.rate), ColumnMap.from_texts(source.column)


def _open_recording(source: SourceRequest, path: Path, rate: float | None, columns: ColumnMap) -> Reader:
    """Open a recording.

    If a device is read, too, and the recording states its own rate and columns, --rate and --column are meant for the device.
    """
    if source.has_source and not is_from_other_program(path):
        rate, columns = None, DEFAULT_COLUMNS
    return Reader.open(f"replay:{path}", rate, columns, get_reading_limits())


def list_recorded_files(source: SourceRequest, count: int) -> tuple[Path | None, ...]:
    """Return for each of ``count`` readings its existing recording, or None if it is still to be read.

    The files of --replay are those of the first readings; with --resume the recordings of last attempts follow.

    Raises
    ------
    InputError
        There are more recordings than readings, or fewer and no other source.
    """
    if len(source.replay) > count or (len(source.replay) < count and not source.has_source):
        raise InputError("replay", Words(f"{len(source.replay)} files"), f"{count}: one for each reading, in their order")
    if count == 1 and source.replay and source.has_source:
        raise InputError("source", Words("several"), ALLOWED_SOURCES)
    other_files = [_find_last_attempt(source, k, count) if source.resume else None for k in range(len(source.replay), count)]
    return (*source.replay, *other_files)


def name_recording(source: SourceRequest, k: int, count: int, attempt: int = 1) -> Path | None:
    """Return the name of the recording of reading ``k`` (from 0) of ``count`` by --record, or None without that option.

    The name has a number if there are several readings, and one of the attempt from the second on.

    Raises
    ------
    InputError
        Its ending is that of another program's files.
    """
    if source.record is None:
        return None
    if is_from_other_program(source.record):  # it would be read as a table, and refused
        raise InputError("record", str(source.record), "a name that ends in .probe: a recording holds raw data")
    number = [str(k + 1)] if count > 1 else []
    name = "-".join([source.record.stem, *number] + ([f"again{attempt}"] if attempt > 1 else []))
    return source.record.with_name(f"{name}{source.record.suffix}")


def list_new_recordings(source: SourceRequest, count: int) -> tuple[Path | None, ...]:
    """Return the new file of each reading, None for recordings that exist already.

    Raises
    ------
    InputError
        A new file exists already, or cannot be written.
    """
    recorded_files = list_recorded_files(source, count)
    files = tuple(name_recording(source, k, count) if path is None else None for k, path in enumerate(recorded_files))
    for path in filter(None, files):
        if os.path.exists(path):
            raise InputError("record", str(path), "a name that is not taken: recordings are never overwritten")
        check_writable_file(path, "record")
    return files


def _find_last_attempt(source: SourceRequest, k: int, count: int) -> Path | None:
    """Return the existing recording of the last attempt at reading ``k`` (from 0) of ``count``, or None if there is none."""
    paths = (name_recording(source, k, count, attempt) for attempt in range(MAX_ATTEMPTS, 0, -1))
    return next((path for path in paths if path is not None and os.path.exists(path)), None)


@dataclass(frozen=True)
class HardwareSetup:
    """Scene, bench and, if given, calibration; ``origin`` holds the hashes of their files, which a recording stores."""

    scene: Scene
    bench: Bench
    calibration: CalibrationRecord | None = None
    origin: dict[str, object] = field(default_factory=dict)

    @classmethod
    def from_files(
        cls, scene: Scene | Path | None, bench: Path | None, calibration: CalibrationRecord | Path | None
    ) -> HardwareSetup:
        """Read scene, bench and calibration; a file not given is replaced by that of the calibration or the built-in one.

        Scene and calibration may be read already.

        Raises
        ------
        InputError
            A file is not valid, or the calibration is that of another probe or amplifier.
        """
        given = read_scene(scene) if isinstance(scene, Path) else scene
        hashes = {"scene_sha256": compute_sha256(scene)} if isinstance(scene, Path) else {}
        return cls.from_scene(given, bench, calibration, hashes)

    @classmethod
    def from_scene(
        cls, scene: Scene | None, bench: Path | None, calibration: CalibrationRecord | Path | None,
        origin: Mapping[str, object] | None = None,
    ) -> HardwareSetup:  # fmt: skip
        """Return the setup for a scene that is read already; see ``from_files``. ``origin`` holds the hash of its file."""
        record = read_record(calibration) if isinstance(calibration, Path) else calibration
        recorded_scene, recorded_bench = (None, None) if record is None else (record.build_scene(), record.build_bench())
        setup = cls(
            scene if scene is not None else recorded_scene or read_builtin_bench_scene(),
            read_bench(bench) if bench is not None else recorded_bench or read_builtin_bench(),
            record,
            dict(origin or {}) | ({"calibration_sha256": compute_sha256(calibration)} if isinstance(calibration, Path) else {}),
        )
        difference = (
            None if recorded_scene is None else describe_probe_difference(list_probe_numbers(recorded_scene), setup.scene)
        )
        if difference is not None:
            raise InputError("calibration", str(calibration), f"one of this probe: {difference}")
        if recorded_scene is not None and (contrast := describe_contrast(recorded_scene, setup.scene)) is not None:
            raise InputError("calibration", str(calibration), f"{contrast}: calibrate again")
        if recorded_bench is not None and recorded_bench.amplifier != setup.bench.amplifier:
            raise InputError("calibration", str(calibration), "one with this bench's amplifier")
        return setup

    @property
    def gains(self) -> Gains | None:
        """Gains of the calibration, with what a change of the temperature may have done to them; None without one."""
        return None if self.calibration is None else self.calibration.build_gains().add_warming(self.bench.channels.warming)

    @property
    def calibrated_at(self) -> float | None:
        """Frequency of the calibration's load, Hz; None without a calibration."""
        return None if self.calibration is None else self.calibration.frequency

    @property
    def calibrated_scene(self) -> Scene:
        """The scene with the modulus of its films' bonds that the calibration has determined, for predictions."""
        gains = None if self.calibration is None else self.calibration.build_gains()
        return self.scene if gains is None or gains.bonds is None else scale_bonds(self.scene, gains.bonds.log_factor)

    def collect_serials(self, readings: Mapping[str, str | None]) -> dict[str, str | None]:
        """Return the serial numbers of readings, and of the calibration if there is one, by their names."""
        calibration_serial = {} if self.calibration is None else {"the calibration": self.calibration.serial or None}
        return calibration_serial | dict(readings)

    def describe_recording(self, reader: Reader) -> Reader:
        """Add scene, calibration and place to the header of a reader, unless a replayed recording has them; return the reader."""
        placement_entry = {"placement": [self.scene.placement.x, self.scene.placement.y]}
        for key, value in (self.origin | placement_entry).items():
            reader.header.source.setdefault(key, value)
        return reader

    def build_virtual_bench(self, source: SourceRequest) -> VirtualBench:
        """Return the virtual probe on its bench, with the deviations of --built from the drawing."""
        scene = express_by_outer_radius(self.scene)
        if source.hide is not None:
            scene = scene.model_copy(update={"inclusion": read_hidden_tumours(source.hide, self.scene)})
        new_values = dict(_read_change(scene, text) for text in source.built)
        return VirtualBench(self.scene, scene.replace(new_values), self.bench, seed=source.seed)


def get_reading_limits() -> ReadLimits:
    """Return the limits of --memory and --time as limits for reading a recording."""
    return ReadLimits(get_limits().memory, get_limits().seconds)


def hash_raw_data(samples: Samples, recording: Path | None) -> Raw:
    """Return the hash of a reading's raw data: of its file, or of index and volts if there is no file."""
    if recording is not None:
        return Raw(compute_sha256(recording), recording.name)
    # in fixed types and byte order, so that the hash is the same on every computer
    return Raw(hashlib.sha256(samples.index.astype("<i8").tobytes() + samples.volts.astype("<f8").tobytes()).hexdigest())


def describe_device(samples: Samples) -> str:
    """Return transport, serial number and firmware of the device in one line."""
    return ", ".join(f"{key} {value}" for key, value in samples.source.items() if key in ("transport", "serial", "firmware"))


def open_virtual(signals: Callable[[Floats], Floats], pace: bool) -> Reader:
    """Open the virtual probe with given signals, a function of time; with ``pace`` it sends them in real time."""
    return Reader.open(make_virtual_probe(signals, SAMPLE_RATE_HZ, channels=CHANNEL_COUNT, scale=VOLTS_PER_COUNT, pace=pace))


def _read_change(scene: Scene, text: str) -> tuple[str, float]:
    """Return key and value, SI, of a text of --built such as "probe.gap=0.12 mm"."""
    key, _, value = text.partition("=")
    names = [name for name in list_values(scene) if name.startswith("probe.")]
    if key.strip() not in names:
        raise InputError("built", text, f"KEY=VALUE with a key that is {describe_choices(key.strip(), names)}")
    if key.strip().endswith("poisson_ratio"):
        return key.strip(), read_number("built", value, "a number from 0 to below 0.5")
    quantity = MODULUS_QUANTITY if key.strip().endswith("modulus") else LENGTH_QUANTITY
    return key.strip(), (CHARGE_QUANTITY if key.strip().endswith(PIEZO_KEYS) else quantity).read("built", value.strip())
