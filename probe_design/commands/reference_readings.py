"""Read the references of a bench one after the other, and simulate the signals of a virtual probe."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import sleep
from typing import Any

from geometry.common.errors import InputError, Words
from hw.common.errors import HardwareError, InvalidSource
from hw.common.samples import Samples
from hw.signal.fingerprint import Fingerprint
from hw.signal.measurement import Measurement
from hw.signal.waveform import Flawed
from probe_design.built_probe import reading
from probe_design.built_probe.bench import Reference
from probe_design.built_probe.field_readings import check_different
from probe_design.built_probe.film_forces import measure_strict_reading
from probe_design.built_probe.probe_identity import check_serials, read_board_serial
from probe_design.built_probe.virtual_probe import compute_load
from probe_design.commands.hardware_request import SourceRequest
from probe_design.commands.hardware_sources import (
    MAX_ATTEMPTS,
    HardwareSetup,
    Opener,
    build_device_opener,
    build_openers,
    list_new_recordings,
    list_recorded_files,
    name_recording,
)
from probe_design.measuring import prediction_process
from probe_design.terminal.console import write_line, write_message


@dataclass(frozen=True)
class ReferenceReading:
    """A valid reading: its samples and their fit, the file of its raw data or None, and the reference's name."""

    samples: Samples
    measurement: Measurement
    file: Path | None
    name: str

    @property
    def serial(self) -> str | None:
        """The serial number of the board that was read, or None if unknown."""
        return read_board_serial(self.samples.source)


def read_references(
    setup: HardwareSetup, source: SourceRequest, references: Sequence[Reference], run: int
) -> tuple[ReferenceReading, ...]:
    """Return one reading on each reference; each is checked as soon as it is complete.

    Parameters
    ----------
    setup
        Scene, bench and calibration.
    source
        Where samples come from.
    references
        To be read, in this order.
    run
        Number of the series of readings; the noise of a virtual probe differs from series to series.

    Raises
    ------
    InputError
        A file of the source is not allowed, or two files hold the same samples.
    HardwareError
        A reading cannot be used.
    """
    count = len(references)
    recorded = list_recorded_files(source, count)
    list_new_recordings(source, count)  # called for its checks: new files must not exist and must be writable
    openers = build_openers(source, lambda: simulate_on_references(setup, source, references, run), count, pace=False)
    reference_readings = tuple(
        _read_reference(setup, source, reference, index_and_count=(k, count), opener=opener, recorded=path)
        for k, (reference, opener, path) in enumerate(zip(references, openers, recorded, strict=True))
    )
    replayed = [
        (str(path), reading.samples) for path, reading in zip(recorded, reference_readings, strict=True) if path is not None
    ]
    check_different("replay", [(name, Fingerprint.from_samples(samples)) for name, samples in replayed])
    return reference_readings


def _read_reference(
    setup: HardwareSetup,
    source: SourceRequest,
    reference: Reference,
    *,
    index_and_count: tuple[int, int],
    opener: Opener,
    recorded: Path | None,
) -> ReferenceReading:
    """Return one valid reading on a reference. A flawed reading of a device is repeated, a flawed recording refused.

    Parameters
    ----------
    setup
        Scene, bench and calibration.
    source
        Where samples come from.
    reference
        To be read.
    index_and_count
        Index of this reading, from 0, and number of readings.
    opener
        Opens the reader.
    recorded
        An existing recording of this reading, or None.
    """
    for attempt in range(1, MAX_ATTEMPTS + 1):
        file = name_recording(source, *index_and_count, attempt) if recorded is None else recorded
        if recorded is None:
            if file is not None and file.exists():  # an earlier attempt of a resumed calibration
                continue
            ask_for(f"{index_and_count[0] + 1} of {index_and_count[1]}", reference.name, source)
        try:
            with opener() as reader:
                check_serials(setup.collect_serials({reference.name: read_board_serial(reader.header.source)}), source.any_probe)
                length = source.duration if recorded is None or source.seconds is not None else None
                new_file = file if recorded is None else None
                samples = setup.describe_recording(reader).collect(length, new_file).require_complete()
            measurement = measure_strict_reading(samples, setup.bench, setup.scene)
        except InvalidSource:  # the source given by the user is wrong, not the reading
            raise
        except HardwareError as fault:
            flaw = Flawed(f"{reference.name}: {fault}")
            if not source.is_live or recorded in source.replay or attempt == MAX_ATTEMPTS:
                raise flaw from fault
            write_message(f"{flaw}; it is read again")
            opener, recorded = build_device_opener(source), None
            continue
        return ReferenceReading(samples, measurement, file, reference.name)
    raise Flawed(f"{reference.name}: {MAX_ATTEMPTS} attempts are recorded, none of which can be used: record under another name")


def ask_for(label: str, place: str, source: SourceRequest) -> None:
    """Ask the user to press the probe on a reference or at a place, and wait; do nothing for recordings and the virtual probe."""
    if not source.is_live:
        return
    if source.wait is not None:
        write_line(f"{label}: press on: {place}; reading begins in {source.wait:g} s")
        sleep(source.wait)
        return
    require_terminal(source)
    write_line(f"{label}: press on: {place}; start the load, then press Enter")
    input()


def require_terminal(source: SourceRequest) -> None:
    """Refuse a device whose user can neither be asked nor has said how long to wait.

    Raises
    ------
    InputError
        There is no terminal, and no ``wait``.
    """
    if source.is_live and source.wait is None and not sys.stdin.isatty():
        raise InputError(
            "device",
            Words("without a terminal"),
            "a terminal, to ask for each press, or --wait SECONDS (wait=SECONDS), or --replay (replay=) for each reading",
        )


def simulate_on_scene(setup: HardwareSetup, source: SourceRequest, accuracy: float, *, linear: bool) -> Any:
    """Return the signals, as a function of time, of a virtual probe on the scene's tissue, predicted to ``accuracy``."""
    bench = setup.build_virtual_bench(source)
    prediction = choose_prediction(source.duration)(bench.as_built, accuracy, linear, setup.bench.load.frequency)
    return bench.build_scene_signals(prediction)


def choose_prediction(length: float | None) -> Callable[..., Any]:
    """Return the function that predicts a scene for a reading of ``length`` s, or of a whole recording (None).

    For a long reading it runs in a child process, so that its memory is free again when the reading starts.
    """
    needs_child_process = length is not None and length >= prediction_process.MIN_READING_S
    return prediction_process.predict_in_process if needs_child_process else reading.predict_scene


def simulate_on_references(setup: HardwareSetup, source: SourceRequest, references: Sequence[Reference], run: int) -> Any:
    """Return the signals, functions of time, of a virtual probe on references of the bench, in the bench's order.

    ``run`` numbers the series of readings, each with its own noise.
    """
    bench = setup.build_virtual_bench(source)
    load = compute_load(bench.scene, reading.predict_scene(bench.as_built, 0.01, linear=True).stiffness)
    signals = zip(setup.bench.reference, bench.build_reference_signals(load, run), strict=True)
    return tuple(signal for reference, signal in signals if any(reference is pressed for pressed in references))
