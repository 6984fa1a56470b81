"""What the bench page measures with: the probe, its bench, the sources of samples and the folder of recordings."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from geometry.scenes.scene import Scene
from geometry.scenes.scene_tables import Inclusion
from hw.files.columns import ColumnMap

if TYPE_CHECKING:
    from probe_design.built_probe.bench import Bench
    from probe_design.built_probe.calibration_record import CalibrationRecord
    from probe_design.populations.design_file import Design

VIRTUAL = "virtual"


@dataclass(frozen=True)
class BenchSettings:
    """What was named at the start of the command.

    Attributes
    ----------
    scene
        Probe and tissue.
    design
        Design file with the population, for the map; None: no map.
    bench, calibration
        Of the readings; without a calibration gains are nominal.
    device
        ``usb``, ``usb:SERIAL``, ``serial:PORT`` or ``visa:RESOURCE``, or None.
    recordings
        That may be replayed.
    rate, columns
        Of a device, Hz, or of a file of another program.
    hidden
        Tumours of the virtual tissue; None: drawn from the population, or those of the scene.
    seed
        Of the virtual tissue, and of the map.
    folder
        For recordings, readings and maps; None: a temporary one.
    """

    scene: Scene
    bench: Bench
    design: Design | None = None
    calibration: CalibrationRecord | None = None
    device: str | None = None
    recordings: tuple[Path, ...] = ()
    rate: float | None = None
    columns: ColumnMap = field(default_factory=ColumnMap)
    hidden: tuple[Inclusion, ...] | None = None
    seed: int = 0
    folder: Path | None = None

    @property
    def sources(self) -> tuple[str, ...]:
        """Sources by their names on the page, the first one chosen at the start."""
        device = [] if self.device is None else [self.device]
        return (*device, *(f"replay:{path}" for path in self.recordings), VIRTUAL)


@dataclass(frozen=True)
class DiscardRequest:
    """The last reading no longer counts; its recording stays."""


@dataclass(frozen=True)
class PressRequest:
    """What to read.

    Attributes
    ----------
    source
        One of ``BenchSettings.sources``.
    seconds
        Duration; None: until it is stopped, or the recording ends.
    keep
        Whether it is recorded and counts as a reading; otherwise it is shown alone.
    place
        x and y of the probe's axis, m.
    blank
        Whether it is the baseline reading, over tumour-free tissue.
    stop_file
        The reading ends when this file exists.
    """

    source: str
    seconds: float | None
    keep: bool
    place: tuple[float, float]
    blank: bool
    stop_file: Path
