"""What `read`, `calibrate` and `check` have in common: which scene, bench and calibration, and where samples come from."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from geometry.common.errors import InputError, Words
from geometry.common.files import check_writable_file
from geometry.scenes.probe import LENGTH, MODULUS
from geometry.scenes.scene import Scene
from geometry.scenes.scene_file import read_scene
from geometry.scenes.variables import changed, values
from hw.common.samples import Floats, Samples
from hw.foreign.columns import ColumnMap
from hw.foreign.files import HDF5
from hw.foreign.units import read_rate
from hw.reader import Reader
from hw.recordings.recording import sha256
from hw.simulation.virtual import virtual
from probe_design.built_probe.bench import Bench, builtin_bench, read_bench
from probe_design.built_probe.block_predictions import by_outer_radius
from probe_design.built_probe.calibration_record import CalibrationRecord, Raw, read_record
from probe_design.built_probe.virtual_probe import RATE, SCALE, VirtualBench
from probe_design.cli.arguments import number
from probe_design.data.builtin import builtin_reading

SECONDS = 10.0  # of a live reading
CHANNELS = 3
SAME = 1e-9  # relative, within which two probes are the same

Opener = Callable[[], Reader]


@dataclass(frozen=True)
class SampleSource:
    """Where samples come from, as the command line says it; exactly one of the first three, or the only probe on USB."""

    virtual: bool = False
    replay: tuple[Path, ...] = ()
    device: str | None = None
    seconds: str | None = None
    record: Path | None = None
    built: tuple[str, ...] = ()
    seed: int = 0
    column: tuple[str, ...] = ()
    rate: str | None = None

    def __post_init__(self) -> None:
        sources = [self.virtual, bool(self.replay), self.device is not None]
        if sum(sources) > 1:
            raise InputError("source", Words("several"), "one of --virtual, --replay and --device")
        if self.built and not self.virtual:
            raise InputError("built", self.built[0], "nothing without --virtual: it says how the virtual probe was built")
        if self.record is not None and self.replay and self.record.suffix.lower() not in HDF5:
            raise InputError("record", str(self.record), "a name that ends in .h5 beside --replay, whose file is the recording")
        for key, given in (("column", self.column), ("rate", self.rate)):
            if given and self.virtual:
                raise InputError(key, given, "nothing beside --virtual, which has its own")

    @property
    def live(self) -> bool:
        """Whether a real device is read, on which somebody has to change what is pressed."""
        return not self.virtual and not self.replay

    @property
    def length(self) -> float | None:
        """How long to read, s; None: a recording as long as it is."""
        if self.seconds is None:
            return None if self.replay else SECONDS
        length = number("seconds", self.seconds, "a number of seconds above 0, up to 1e6")
        if not 0 < length <= 1e6:
            raise InputError("seconds", self.seconds, "a number of seconds above 0, up to 1e6")
        return length

    def openers(
        self, signals: Callable[[], tuple[Callable[[Floats], Floats], ...]], count: int, pace: bool
    ) -> tuple[Opener, ...]:
        """Return what opens a reader for each of ``count`` readings; ``signals`` are the virtual probe's."""
        if self.virtual:
            return tuple(partial(_virtual, one, pace) for one in signals())
        if self.replay and len(self.replay) != count:
            raise InputError("replay", Words(f"{len(self.replay)} files"), f"{count}: one for each reading, in their order")
        names = [f"replay:{path}" for path in self.replay] or [self.device or "usb"] * count
        columns = ColumnMap.of(self.column)
        rate = None if self.rate is None else read_rate(self.rate)
        return tuple(partial(Reader.open, name, rate, columns) for name in names)

    def recordings(self, count: int) -> tuple[Path | None, ...]:
        """Return the file of each reading's raw data: numbered where there are several.

        Raises:
            InputError: one of them exists, or cannot be written.
        """
        if self.record is None:
            return (None,) * count
        stem, suffix = self.record.stem, self.record.suffix
        paths = [self.record] if count == 1 else [self.record.with_name(f"{stem}-{k + 1}{suffix}") for k in range(count)]
        for path in paths:
            if path.exists():
                raise InputError("record", str(path), "a name that is not taken: recordings are never overwritten")
            check_writable_file(path, "record")
        return tuple(paths)


@dataclass(frozen=True)
class HardwareSetup:
    """Scene, bench and, where there is one, calibration; ``origin`` is what a recording keeps of them."""

    scene: Scene
    bench: Bench
    calibration: CalibrationRecord | None = None
    origin: dict[str, Any] = field(default_factory=dict)

    @classmethod
    def of(cls, scene: Path | None, bench: Path | None, calibration: Path | None) -> HardwareSetup:
        """Read the files; what is not given is the calibration's or the built-in one.

        Raises:
            InputError: a file is not what it should be, or the calibration is another probe's or amplifier's.
        """
        record = None if calibration is None else read_record(calibration)
        known_scene, known_bench = (None, None) if record is None else (record.scene_read(), record.bench_read())
        setting = cls(
            read_scene(scene) if scene is not None else known_scene or builtin_reading(),
            read_bench(bench) if bench is not None else known_bench or builtin_bench(),
            record,
            {f"{key}_sha256": sha256(path) for key, path in (("scene", scene), ("calibration", calibration)) if path is not None},
        )
        if known_scene is not None and not _same_probe(known_scene, setting.scene):
            raise InputError("calibration", str(calibration), "one of this probe: dimensions, moduli or films differ")
        if known_bench is not None and known_bench.amplifier != setting.bench.amplifier:
            raise InputError("calibration", str(calibration), "one with this bench's amplifier")
        return setting

    def described_by(self, reader: Reader) -> Reader:
        """Return a reader whose recording tells scene, calibration and place, unless what it replays has told them."""
        place = {"placement": [self.scene.placement.x, self.scene.placement.y]}
        for key, value in (self.origin | place).items():
            reader.header.source.setdefault(key, value)
        return reader

    def virtual(self, source: SampleSource) -> VirtualBench:
        """Return the virtual probe, built as the source says."""
        scene = by_outer_radius(self.scene)
        new = dict(_change(scene, one) for one in source.built)
        return VirtualBench(self.scene, changed(scene, new), self.bench, seed=source.seed)


def raw(samples: Samples, recording: Path | None) -> Raw:
    """Return the hash of a reading's raw data: of its file, or of index and volts where there is none."""
    if recording is not None:
        return Raw(sha256(recording), recording.name)
    return Raw(hashlib.sha256(samples.index.astype("<i8").tobytes() + samples.volts.astype("<f8").tobytes()).hexdigest())


def described(samples: Samples) -> str:
    """Return the device in one line."""
    return ", ".join(f"{key} {value}" for key, value in samples.source.items() if key in ("transport", "serial", "firmware"))


def _virtual(signals: Callable[[Floats], Floats], pace: bool) -> Reader:
    return Reader.open(virtual(signals, RATE, channels=CHANNELS, scale=SCALE, pace=pace))


def _same_probe(one: Scene, other: Scene) -> bool:
    first, second = (
        {k: v for k, v in values(by_outer_radius(scene)).items() if k.startswith("probe.")} for scene in (one, other)
    )
    charges = [None if scene.probe.film is None else scene.probe.film.charge_per_force for scene in (one, other)]
    alike = first.keys() == second.keys() and all(np.isclose(first[key], second[key], rtol=SAME, atol=0) for key in first)
    return bool(alike) and charges[0] == charges[1]


def _change(scene: Scene, text: str) -> tuple[str, float]:
    key, _, value = text.partition("=")
    names = [name for name in values(scene) if name.startswith("probe.")]
    if key.strip() not in names:
        raise InputError("built", text, f"KEY=VALUE with a key of {', '.join(names)}")
    if key.strip().endswith("poisson_ratio"):
        return key.strip(), number("built", value, "a number from 0 to below 0.5")
    return key.strip(), (MODULUS if key.strip().endswith("modulus") else LENGTH).read("built", value.strip())
