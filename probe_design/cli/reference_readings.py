"""Read the references of a bench one after the other, and simulate the signals of a virtual probe."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from probe_design.cli.arguments import fraction

if TYPE_CHECKING:
    from hw.common.samples import Samples
    from hw.signal.measure import Measurement
    from probe_design.built_probe.bench import Reference
    from probe_design.cli.hardware_sources import HardwareSetup, Opener, SampleSource


@dataclass(frozen=True)
class ReferenceReading:
    """A valid reading: its samples and their fit, the file of its raw data or None, and the reference's name."""

    samples: Samples
    measurement: Measurement
    file: Path | None
    name: str

    @property
    def board(self) -> str | None:
        """The serial number of the board that was read, or None if unknown."""
        from probe_design.built_probe.probe_identity import board_serial

        return board_serial(self.samples.source)


def readings(
    setting: HardwareSetup, source: SampleSource, references: Sequence[Reference], run: int
) -> tuple[ReferenceReading, ...]:
    """Return one reading on each reference; each is checked as soon as it is complete."""
    from hw.signal.fingerprint import Fingerprint
    from probe_design.built_probe.field_readings import check_different

    count = len(references)
    recorded = source.recorded(count)
    source.recordings(count)
    openers = source.openers(lambda: on_references(setting, source, references, run), count, pace=False)
    found = tuple(
        _reading(setting, source, reference, which=(k, count), opener=opener, recorded=path)
        for k, (reference, opener, path) in enumerate(zip(references, openers, recorded, strict=True))
    )
    replayed = [(str(path), one.samples) for path, one in zip(recorded, found, strict=True) if path is not None]
    check_different("replay", [(name, Fingerprint.from_samples(samples)) for name, samples in replayed])
    return found


def _reading(
    setting: HardwareSetup,
    source: SampleSource,
    reference: Reference,
    *,
    which: tuple[int, int],
    opener: Opener,
    recorded: Path | None,
) -> ReferenceReading:
    """Return one valid reading on a reference. A flawed reading of a device is repeated, a flawed recording refused."""
    from hw.common.errors import HardwareError, InvalidSource
    from hw.signal.waveform import Flawed
    from probe_design.built_probe.film_forces import strict_reading
    from probe_design.built_probe.probe_identity import board_serial, check_serials
    from probe_design.cli.hardware_sources import ATTEMPTS
    from probe_design.terminal.console import message

    for attempt in range(1, ATTEMPTS + 1):
        file = source.recording(*which, attempt) if recorded is None else recorded
        if recorded is None:
            if file is not None and file.exists():  # an earlier attempt of a resumed calibration
                continue
            _ask_for(reference, f"{which[0] + 1} of {which[1]}", source)
        try:
            with opener() as reader:
                check_serials(setting.boards({reference.name: board_serial(reader.header.source)}), source.any_probe)
                length = source.length if recorded is None or source.seconds is not None else None
                written = file if recorded is None else source.copied(*which)
                samples = setting.described_by(reader).collect(length, written).whole()
            measurement = strict_reading(samples, setting.bench, setting.scene)
        except InvalidSource:  # the source given by the user is wrong, not the reading
            raise
        except HardwareError as fault:
            flaw = Flawed(f"{reference.name}: {fault}")
            if not source.live or recorded in source.replay or attempt == ATTEMPTS:
                raise flaw from fault
            message(f"{flaw}; it is read again")
            opener, recorded = source.device_opener(), None
            continue
        return ReferenceReading(samples, measurement, file, reference.name)
    raise Flawed(f"{reference.name}: {ATTEMPTS} attempts are recorded, none of which can be used: record under another name")


def _ask_for(reference: Reference, which: str, source: SampleSource) -> None:
    """Ask the user to press the probe on a reference, and wait; do nothing for recordings and the virtual probe."""
    from time import sleep

    from geometry.common.errors import InputError, Words
    from probe_design.terminal.console import message

    if not source.live:
        return
    if source.pause is not None:
        message(f"{which}: press on: {reference.name}; reading begins in {source.pause:g} s")
        sleep(source.pause)
        return
    if not sys.stdin.isatty():
        raise InputError(
            "device",
            Words("without a terminal"),
            "a terminal, to change references at, --wait SECONDS or --replay for each reading",
        )
    message(f"{which}: press on: {reference.name}; start the load, then press Enter")
    input()


def on_scene(setting: HardwareSetup, source: SampleSource, accuracy: str) -> Any:
    """Return the signals of a virtual probe that is pressed on the scene."""
    bench = setting.virtual(source)
    predicted = predicting(source.length)(bench.scene, fraction("accuracy", accuracy), True, setting.bench.load.frequency)
    return bench.on_scene(predicted)


def predicting(length: float | None) -> Callable[..., Any]:
    """Return the function that predicts a scene: for a long reading one that runs in a child process, to free its memory."""
    from probe_design.built_probe import reading
    from probe_design.measuring import prediction_apart

    apart = length is not None and length >= prediction_apart.LONG
    return prediction_apart.prediction_apart if apart else reading.prediction


def on_references(setting: HardwareSetup, source: SampleSource, references: Sequence[Reference], run: int) -> Any:
    """Return the signals of a virtual probe on given references, in their order."""
    from probe_design.built_probe.reading import prediction
    from probe_design.built_probe.virtual_probe import load_of

    bench = setting.virtual(source)
    load = load_of(bench.scene, prediction(bench.scene, 0.01, linear=True).stiffness)
    signals = zip(setting.bench.reference, bench.on_references(load, run), strict=True)
    return tuple(one for reference, one in signals if any(reference is pressed for pressed in references))
