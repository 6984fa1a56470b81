"""Scene, bench, calibration and the source of samples, which `read`, `calibrate`, `check` and `doctor` share."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from geometry.common.errors import InputError, Words, one_of
from geometry.common.files import check_writable_file
from geometry.common.resources import limits
from geometry.scenes.probe import LENGTH
from geometry.scenes.scene import Scene
from geometry.scenes.scene_file import read_scene
from geometry.scenes.units import MODULUS
from geometry.scenes.variables import changed, values
from hw.common.limits import ReadLimits
from hw.common.samples import Floats, Samples
from hw.foreign.columns import ColumnMap
from hw.foreign.files import HDF5, raw_beside, tells_itself
from hw.foreign.units import read_rate
from hw.reader import AS_IT_IS, Reader
from hw.recordings.recording import sha256
from hw.simulation.virtual import virtual
from probe_design.built_probe.bench import Bench, builtin_bench, read_bench
from probe_design.built_probe.block_predictions import by_outer_radius
from probe_design.built_probe.calibration_record import CalibrationRecord, Raw, read_record
from probe_design.built_probe.probe_identity import probe_difference, probe_numbers
from probe_design.built_probe.virtual_probe import RATE, SCALE, VirtualBench
from probe_design.cli.arguments import number
from probe_design.data.builtin import builtin_bench_scene

SECONDS = 10.0  # duration of a live reading
CHANNELS = 3
SOURCES = "one of --virtual, --replay and --device"
ATTEMPTS = 3  # for one reading with a live device

Opener = Callable[[], Reader]


@dataclass(frozen=True)
class SampleSource:
    """Sources of samples given on the command line: recordings first, then a device, by default the only probe on USB."""

    virtual: bool = False
    replay: tuple[Path, ...] = ()
    device: str | None = None
    seconds: str | None = None
    record: Path | None = None
    resume: bool = False
    built: tuple[str, ...] = ()
    seed: int = 0
    wait: str | None = None
    column: tuple[str, ...] = ()
    rate: str | None = None
    any_probe: bool = False

    def __post_init__(self) -> None:
        if self.virtual and self.device is not None:
            raise InputError("source", Words("several"), SOURCES)
        if self.resume and self.record is None:
            raise InputError("resume", Words("without --record"), "the name that the recordings were given with --record")
        if self.built and not self.virtual:
            raise InputError("built", self.built[0], "nothing without --virtual: it says how the virtual probe was built")
        if self.record is not None and not self.more and self.record.suffix.lower() not in HDF5:
            raise InputError("record", str(self.record), "a name that ends in .h5 beside --replay, whose file is the recording")
        for key, given in (("column", self.column), ("rate", self.rate)):
            if given and self.virtual:
                raise InputError(key, given, "nothing beside --virtual, which has its own")

    @property
    def more(self) -> bool:
        """Whether a device or the virtual probe is read, besides recordings."""
        return not self.replay or self.virtual or self.device is not None

    @property
    def live(self) -> bool:
        """Whether a real device is read, for which a person has to change the references."""
        return self.more and not self.virtual

    @property
    def length(self) -> float | None:
        """Duration of a reading, s; None for a whole recording."""
        if self.seconds is None:
            return SECONDS if self.more else None
        length = number("seconds", self.seconds, "a number of seconds above 0, up to 1e6")
        if not 0 < length <= 1e6:
            raise InputError("seconds", self.seconds, "a number of seconds above 0, up to 1e6")
        return length

    @property
    def pause(self) -> float | None:
        """Time to change a reference, s; None: until Enter is pressed."""
        if self.wait is None:
            return None
        pause = number("wait", self.wait, "a number of seconds from 0 to 86400")
        if not 0 <= pause <= 86400:
            raise InputError("wait", self.wait, "a number of seconds from 0 to 86400")
        return pause

    def openers(
        self, signals: Callable[[], tuple[Callable[[Floats], Floats], ...]], count: int, pace: bool
    ) -> tuple[Opener, ...]:
        """Return for each of ``count`` readings a function that opens its reader.

        Args:
            signals: returns the signals of the virtual probe, one function of time for each reading.
            count: number of readings.
            pace: whether the virtual probe sends its samples in real time.

        Raises:
            InputError: there are more recordings than readings, or fewer and no other source.
        """
        recorded, (rate, columns) = self.recorded(count), self._asked()
        if self.virtual and None in recorded:
            live: list[Opener] = [partial(_virtual, one, pace) for one in signals()]
        else:
            live = [self.device_opener()] * count
        return tuple(
            opener if path is None else partial(self._replayed, path, rate, columns)
            for path, opener in zip(recorded, live, strict=True)
        )

    def device_opener(self) -> Opener:
        """Return a function that opens the device, by default the only probe on USB."""
        return partial(Reader.open, self.device or "usb", *self._asked())

    def _asked(self) -> tuple[float | None, ColumnMap]:
        """Return --rate in Hz and --column."""
        return None if self.rate is None else read_rate(self.rate), ColumnMap.of(self.column)

    def _replayed(self, path: Path, rate: float | None, columns: ColumnMap) -> Reader:
        """Open a recording. Together with a device, --rate and --column belong to the device if the recording states its own."""
        if self.more and tells_itself(path, read_limits()):
            rate, columns = None, AS_IT_IS
        return Reader.open(f"replay:{path}", rate, columns, read_limits())

    def recorded(self, count: int) -> tuple[Path | None, ...]:
        """Return the existing recording of each reading or None: those of --replay, then with --resume the last attempts."""
        if len(self.replay) > count or (len(self.replay) < count and not self.more):
            raise InputError("replay", Words(f"{len(self.replay)} files"), f"{count}: one for each reading, in their order")
        if count == 1 and self.replay and self.more:
            raise InputError("source", Words("several"), SOURCES)
        rest = [self._last_attempt(k, count) if self.resume else None for k in range(len(self.replay), count)]
        return (*self.replay, *rest)

    def recording(self, k: int, count: int, attempt: int = 1) -> Path | None:
        """Return the name of a reading's recording, numbered if there are several readings, and from the second attempt on."""
        if self.record is None:
            return None
        number = [str(k + 1)] if count > 1 else []
        name = "-".join([self.record.stem, *number] + ([f"again{attempt}"] if attempt > 1 else []))
        return self.record.with_name(f"{name}{self.record.suffix}")

    def copied(self, k: int, count: int) -> Path | None:
        """Return the name of the copy of a replayed recording: that of --record where only recordings are read, else None."""
        return None if self.more else self.recording(k, count)

    def recordings(self, count: int) -> tuple[Path | None, ...]:
        """Return the new file of each reading, None for recordings that exist already and are not copied.

        Raises:
            InputError: a new file exists already, or cannot be written.
        """
        recorded = self.recorded(count)
        files = tuple(self.recording(k, count) if path is None else self.copied(k, count) for k, path in enumerate(recorded))
        for path in filter(None, files):
            for one in _written(path):
                if os.path.exists(one):
                    raise InputError("record", str(one), "a name that is not taken: recordings are never overwritten")
                check_writable_file(one, "record")
        return files

    def _last_attempt(self, k: int, count: int) -> Path | None:
        paths = (self.recording(k, count, attempt) for attempt in range(ATTEMPTS, 0, -1))
        return next((one for path in paths if path is not None for one in _written(path) if os.path.exists(one)), None)


@dataclass(frozen=True)
class HardwareSetup:
    """Scene, bench and, if given, calibration; ``origin`` holds the hashes of their files, which a recording stores."""

    scene: Scene
    bench: Bench
    calibration: CalibrationRecord | None = None
    origin: dict[str, Any] = field(default_factory=dict)

    @classmethod
    def of(cls, scene: Path | None, bench: Path | None, calibration: Path | None) -> HardwareSetup:
        """Read scene, bench and calibration; a file not given is replaced by that of the calibration or the built-in one.

        Raises:
            InputError: a file is not valid, or the calibration is that of another probe or amplifier.
        """
        record = None if calibration is None else read_record(calibration)
        known_scene, known_bench = (None, None) if record is None else (record.scene_read(), record.bench_read())
        setting = cls(
            read_scene(scene) if scene is not None else known_scene or builtin_bench_scene(),
            read_bench(bench) if bench is not None else known_bench or builtin_bench(),
            record,
            {f"{key}_sha256": sha256(path) for key, path in (("scene", scene), ("calibration", calibration)) if path is not None},
        )
        difference = None if known_scene is None else probe_difference(probe_numbers(known_scene), setting.scene)
        if difference is not None:
            raise InputError("calibration", str(calibration), f"one of this probe: {difference}")
        if known_bench is not None and known_bench.amplifier != setting.bench.amplifier:
            raise InputError("calibration", str(calibration), "one with this bench's amplifier")
        return setting

    def boards(self, readings: Mapping[str, str | None]) -> dict[str, str | None]:
        """Return the serial numbers of readings, and of the calibration if there is one, by their names."""
        known = {} if self.calibration is None else {"the calibration": self.calibration.serial or None}
        return known | dict(readings)

    def described_by(self, reader: Reader) -> Reader:
        """Add scene, calibration and place to the header of a reader, unless a replayed recording has them; return the reader."""
        place = {"placement": [self.scene.placement.x, self.scene.placement.y]}
        for key, value in (self.origin | place).items():
            reader.header.source.setdefault(key, value)
        return reader

    def virtual(self, source: SampleSource) -> VirtualBench:
        """Return the virtual probe with the deviations of --built."""
        scene = by_outer_radius(self.scene)
        new = dict(_change(scene, one) for one in source.built)
        return VirtualBench(self.scene, changed(scene, new), self.bench, seed=source.seed)


def read_limits() -> ReadLimits:
    """Return --memory and --time as limits for reading a recording."""
    return ReadLimits(limits().memory, limits().seconds)


def raw(samples: Samples, recording: Path | None) -> Raw:
    """Return the hash of a reading's raw data: of its file, or of index and volts if there is no file."""
    kept = None if recording is None else next((one for one in _written(recording) if one.exists()), None)
    if kept is not None:
        return Raw(sha256(kept), kept.name)
    return Raw(hashlib.sha256(samples.index.astype("<i8").tobytes() + samples.volts.astype("<f8").tobytes()).hexdigest())


def _written(path: Path) -> tuple[Path, ...]:
    """Return a recording's file, and for HDF5 also the file that holds its raw bytes until it is complete."""
    return (path, raw_beside(path)) if path.suffix.lower() in HDF5 else (path,)


def described(samples: Samples) -> str:
    """Return transport, serial number and firmware of the device in one line."""
    return ", ".join(f"{key} {value}" for key, value in samples.source.items() if key in ("transport", "serial", "firmware"))


def _virtual(signals: Callable[[Floats], Floats], pace: bool) -> Reader:
    return Reader.open(virtual(signals, RATE, channels=CHANNELS, scale=SCALE, pace=pace))


def _change(scene: Scene, text: str) -> tuple[str, float]:
    """Return key and value, SI, of a text of --built such as "probe.gap=0.12 mm"."""
    key, _, value = text.partition("=")
    names = [name for name in values(scene) if name.startswith("probe.")]
    if key.strip() not in names:
        raise InputError("built", text, f"KEY=VALUE with a key that is {one_of(key.strip(), names)}")
    if key.strip().endswith("poisson_ratio"):
        return key.strip(), number("built", value, "a number from 0 to below 0.5")
    return key.strip(), (MODULUS if key.strip().endswith("modulus") else LENGTH).read("built", value.strip())
