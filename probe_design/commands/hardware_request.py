"""What the commands for a built probe read: options of `read`, `calibrate`, `check`, `doctor` and `survey`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Self

from pydantic import Field, model_validator

from geometry.common.errors import InputError, Words
from probe_design.commands.fields import AnyProbe, Calibration, LimitedRequest, Linear, Outliers
from probe_design.commands.request import Number, Option

DEFAULT_READING_TIME_S = 10.0  # duration of a live reading
DEFAULT_PRESS_TIME_S = 5.0  # 25 periods of the built-in bench's load
DEFAULT_PRESSES = 60
ALLOWED_SOURCES = "one of --virtual, --replay and --device"
Seconds = Annotated[float, Number("a number of seconds above 0, up to 1e6", lambda seconds: 0 < seconds <= 1e6)]
Pause = Annotated[float, Number("a number of seconds from 0 to 86400", lambda seconds: 0 <= seconds <= 86400)]


class SourceRequest(LimitedRequest):
    """What all commands for a built probe read: recordings first, then a device, by default the only probe on USB."""

    scene: Annotated[Path | None, Option("File of a scene.", is_argument=True)] = None
    virtual: Annotated[bool, Option("Read a simulated probe: the solver's prediction with noise, hum and drift.")] = False
    replay: Annotated[
        tuple[Path, ...],
        Option("Read a recording, or a .csv, .txt, .h5 or .wav file of another program; once for each reading."),
    ] = ()
    column: Annotated[
        tuple[str, ...],
        Option(
            "Of such a file: 'inner=CH1 mV', for inner, outer, force, time: the column's name or number and the unit of its "
            "numbers; or a TOML file with the same. Of an oscilloscope: 'force=4', the channel."
        ),
    ] = ()
    rate: Annotated[
        str | None, Option("Samples per second, '10 kHz': requested from a device; assumed for a file without times.")
    ] = None
    device: Annotated[
        str | None,
        Option("usb, usb:SERIAL, serial:PORT or visa:RESOURCE.", left_out="usb, the only probe connected"),
    ] = None
    seconds: Annotated[Seconds | None, Option("How long to read.", left_out="10; a recording to its end")] = None
    record: Annotated[
        Path | None,
        Option("Write the raw data to this file; several are numbered."),
    ] = None
    bench: Annotated[Path | None, Option("TOML file of load, amplifier and references.")] = None
    built: Annotated[tuple[str, ...], Option("Deviation of the virtual probe from the drawing: 'probe.gap=0.12 mm'.")] = ()
    seed: Annotated[int, Field(ge=0, le=2**31), Option("Seed of its noise.")] = 0
    linear: Linear = False

    resume: bool = False  # these four are options of some commands only
    wait: float | None = None
    any_probe: bool = False
    hide: Path | None = None

    @model_validator(mode="after")
    def _check_sources(self) -> Self:
        """Refuse options that contradict each other."""
        if self.virtual and self.device is not None:
            raise InputError("source", Words("several"), ALLOWED_SOURCES)
        if self.resume and self.record is None:
            raise InputError("resume", Words("without --record"), "the name that the recordings were given with --record")
        if self.built and not self.virtual:
            raise InputError("built", self.built[0], "nothing without --virtual: it states how the virtual probe was built")
        if self.record is not None and not self.has_source:
            raise InputError("record", str(self.record), "nothing beside --replay alone, whose files are the recordings")
        if self.hide is not None and not self.virtual:
            raise InputError("hide", str(self.hide), "nothing without --virtual: it states what the virtual tissue holds")
        for key, value in (("column", self.column), ("rate", self.rate)):
            if value and self.virtual:
                raise InputError(key, value, "nothing beside --virtual, which has its own")
        return self

    @property
    def has_source(self) -> bool:
        """Whether a device or the virtual probe is read, besides recordings."""
        return not self.replay or self.virtual or self.device is not None

    @property
    def is_live(self) -> bool:
        """Whether a real device is read, for which a person has to change the references."""
        return self.has_source and not self.virtual

    @property
    def duration(self) -> float | None:
        """Duration of a reading, s; None for a whole recording."""
        return DEFAULT_READING_TIME_S if self.seconds is None and self.has_source else self.seconds


class ReferenceRequest(SourceRequest):
    """What the commands with several readings share."""

    resume: Annotated[bool, Option("Use the recordings that --record has written before; read the others.")] = False
    any_probe: AnyProbe = False
    wait: Annotated[Pause | None, Option("Seconds to change each reference in, without a terminal, in place of Enter.")] = None


class SurveyOptions(SourceRequest):
    """What a survey reads: presses one after the other, each at a place."""

    scene: Annotated[Path, Option("Design file, or folder of optimize.", is_argument=True, metavar="DESIGN")]
    output: Annotated[Path, Option("Folder for recordings, maps and report.", "-o/--output")]
    presses: Annotated[int, Field(ge=1, le=1000), Option("Largest number of presses.")] = DEFAULT_PRESSES
    hide: Annotated[
        Path | None, Option("File of the tumours that the virtual tissue holds.", left_out="drawn from the population by --seed")
    ] = None
    replay: Annotated[
        tuple[Path, ...],
        Option("Recording and, behind commas, its place: 'run.probe, x=4 mm, y=-8 mm, blank=true'; once for each press."),
    ] = ()
    seconds: Annotated[Seconds | None, Option("How long to read each press.", left_out=f"{DEFAULT_PRESS_TIME_S:g}")] = None
    calibration: Calibration = None
    outliers: Outliers = 0.0
    any_probe: AnyProbe = False
    wait: Annotated[Pause | None, Option("Seconds to move the probe in, without a terminal, in place of Enter.")] = None

    record: Path | None = None  # what a survey has no use for: everything raw is kept in its folder
    built: tuple[str, ...] = ()
    linear: bool = True

    @model_validator(mode="after")
    def _check_survey(self) -> Self:
        """Refuse options that contradict each other."""
        if self.replay and self.has_source:
            raise InputError("source", Words("several"), ALLOWED_SOURCES)
        return self
