"""The commands for a built probe: `read`, `calibrate`, `check` and `doctor`."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from probe_design.cli.arguments import FILE_NAME, any_probe_option, fraction, limiting, linear_option
from probe_design.cli.output import print_json, with_provenance
from probe_design.cli.reference_readings import on_scene, predicting, readings

if TYPE_CHECKING:
    from probe_design.cli.hardware_sources import HardwareSetup, SampleSource
    from probe_design.doctor.finding import Finding

Verb = Callable[..., None]


_RESUME = click.option("--resume", is_flag=True, help="Use the recordings that --record has written before; read the others.")


def _with_source(verb: Verb, resumes: bool = False) -> Verb:
    """Add the options of all commands for a built probe, and --resume to those with several readings."""
    options = (
        click.argument("scene", type=FILE_NAME, required=False),
        click.option(
            "--virtual", is_flag=True, help="Read a simulated probe: the solver's prediction with noise, hum and drift."
        ),
        click.option(
            "--replay",
            type=FILE_NAME,
            multiple=True,
            help="Read a recording, or a .csv, .txt, .h5 or .wav file of another program; once for each reading.",
        ),
        click.option(
            "--column",
            multiple=True,
            help="Of such a file: 'inner=CH1 mV', for inner, outer, force, time: the column's name or number and the unit of its "
            "numbers; or a TOML file with the same. Of an oscilloscope: 'force=4', the channel.",
        ),
        click.option("--rate", help="Samples per second, '10 kHz': requested from a device; assumed for a file without times."),
        click.option("--device", help="usb, usb:SERIAL, serial:PORT or visa:RESOURCE.  [default: usb, the only probe connected]"),
        click.option("--seconds", help="How long to read.  [default: 10; a recording to its end]"),
        click.option(
            "--record",
            type=FILE_NAME,
            help="Write the raw data to this file, or samples in volts where it ends in .h5; several are numbered.",
        ),
        *([_RESUME] if resumes else []),
        click.option("--bench", type=FILE_NAME, help="TOML file of load, amplifier and references."),
        click.option("--built", multiple=True, help="Deviation of the virtual probe from the drawing: 'probe.gap=0.12 mm'."),
        click.option("--seed", default=0, show_default=True, type=click.IntRange(0, 2**31), help="Seed of its noise."),
        linear_option,
        click.option("--json", "as_json", is_flag=True, help="Print one JSON object."),
    )
    for option in reversed(options):
        verb = option(verb)
    return limiting(verb)


@click.command()
@_with_source
@any_probe_option
@click.option("--calibration", type=FILE_NAME, help="Calibration file that calibrate has written.")
@click.option("--accuracy", default="0.01", show_default=True, help="Relative error that the prediction may have.")
def read(
    scene: Path | None, bench: Path | None, calibration: Path | None, accuracy: str, linear: bool, as_json: bool, **source: Any
) -> None:
    """Read the probe under a sinusoidal load: ratio and stresses, compared with the prediction for SCENE.

    A terminal shows live numbers and curves; otherwise plain lines are printed. The reading ends by itself. Without SCENE the
    calibration's scene is used, or the built-in one.

    \b
    probe-design read scene.toml --virtual
    probe-design read scene.toml --record run.probe --calibration probe.toml
    probe-design read scene.toml --replay run.probe --calibration probe.toml --json
    probe-design read scene.toml --replay scope.csv --column "inner=CH1 mV" --column "outer=CH2 mV" --rate "1 kHz"
    probe-design read scene.toml --replay run.probe --record run.h5
    """  # noqa: D301
    from hw.signal.running import RunningFit
    from hw.signal.sine_fit import check_rate
    from probe_design.built_probe.field_readings import noise_of, placement_of, read_told
    from probe_design.built_probe.film_forces import reading, running_reading
    from probe_design.built_probe.probe_identity import board_serial, check_serials
    from probe_design.built_probe.reading import read as judged
    from probe_design.cli.hardware_sources import HardwareSetup, SampleSource
    from probe_design.measuring.acquisition import collected
    from probe_design.terminal.console import show, warn, working
    from probe_design.terminal.hardware_tables import read_table
    from probe_design.terminal.live import followed, following

    origin, setting = SampleSource(**source), HardwareSetup.of(scene, bench, calibration)
    length, (recording,) = origin.length, origin.recordings(1)
    (opener,) = origin.openers(lambda: (on_scene(setting, origin, accuracy),), 1, sys.stderr.isatty())
    with opener() as reader:  # a missing device or another probe is refused before anything is computed
        serial = board_serial(reader.header.source)
        of_boards = check_serials(setting.boards({"the reading": serial}), origin.any_probe)
        with working("predicting"):
            predicted = predicting(length)(setting.scene, fraction("accuracy", accuracy), linear, setting.bench.load.frequency)
        gains, at = None, None
        if setting.calibration is not None:
            gains = setting.calibration.gains().warmed(setting.bench.channels.warming)
            at = setting.calibration.frequency

        def judge(measurement: Any) -> Any:
            return judged(measurement, setting.scene, setting.bench, predicted, gains)

        frequency = setting.bench.load.frequency
        check_rate(frequency, reader.header.rate)
        running = RunningFit(frequency, setting.bench.force is not None)
        with following(lambda samples: judge(reading(samples, setting.bench, at))) as follow:  # the reading begins
            collected(setting.described_by(reader), length, recording, running, show=follow, last=followed(frequency))
    measurement = running_reading(running, setting.bench, at)
    result = judge(measurement)
    if as_json:
        known = setting.origin | {"placement": placement_of(reader.header.source), "serial": serial}
        noise = noise_of(measurement, setting.scene, setting.bench, gains)
        print_json(read_told(result, noise, known, setting.scene, running.fingerprint))
    else:
        show(read_table(result))
    warn((*result.warnings, *of_boards, *(note for note in predicted.warnings if note.kind in ("linear", "null"))))
    _tell_written(recording)


WAIT = click.option("--wait", help="Seconds to change each reference in, without a terminal, in place of Enter.")


@click.command()
@partial(_with_source, resumes=True)
@any_probe_option
@WAIT
@click.option("-o", "--output", type=FILE_NAME, required=True, help="New file for the calibration record.")
def calibrate(scene: Path | None, bench: Path | None, output: Path, linear: bool, as_json: bool, **source: Any) -> None:
    """Calibrate a built probe: determine gains, cross-talk and offsets from readings on the bench's references.

    Each reference is read in turn; with a device, the program asks for each. Readings with gaps, saturation or too few cycles are
    refused, and so are films that warm up. With a force channel the gains are absolute, otherwise relative to each other.

    \b
    probe-design calibrate scene.toml --virtual -o probe.toml
    probe-design calibrate scene.toml --record run.probe -o probe.toml
    """  # noqa: D301
    from geometry.common.files import check_writable_file
    from probe_design.built_probe.calibration import calibrated
    from probe_design.built_probe.calibration_record import check_free, record, write_record
    from probe_design.built_probe.probe_identity import check_serials, common_serial
    from probe_design.cli.hardware_sources import HardwareSetup, SampleSource, described, raw
    from probe_design.terminal.console import message, show, warn, working
    from probe_design.terminal.hardware_tables import calibration_table

    origin, setting = SampleSource(**source), HardwareSetup.of(scene, bench, None)
    check_free(output)
    check_writable_file(output)
    read = readings(setting, origin, setting.bench.reference, run=0)
    with working("calibrating"):
        calibration = calibrated(setting.scene, setting.bench, [one.measurement for one in read], linear=linear)
    boards = {one.name: one.board for one in read}
    of_boards = check_serials(boards, origin.any_probe)
    calibration = replace(calibration, warnings=(*calibration.warnings, *of_boards))
    raws = [raw(one.samples, one.file) for one in read]
    recorded = record(calibration, raws, described(read[0].samples), common_serial(boards))
    write_record(output, recorded)
    if as_json:
        print_json(recorded.model_dump(mode="json"))
    else:
        show(calibration_table(recorded))
    warn(recorded.warnings)
    message(f"wrote {output}")


@click.command()
@partial(_with_source, resumes=True)
@any_probe_option
@WAIT
@click.option("--calibration", type=FILE_NAME, help="Calibration file that calibrate has written.")
@click.option("-o", "--output", type=FILE_NAME, help="New file for the result, as JSON.")
@click.option("--report", type=FILE_NAME, help="File for the result as a page, .html.")
def check(
    scene: Path | None, bench: Path | None, calibration: Path | None, output: Path | None, report: Path | None, linear: bool,
    as_json: bool, **source: Any,
) -> None:  # fmt: skip
    """Check a built probe against its drawing by readings on blocks of tissue, and name the dimension out of tolerance.

    Reports which variables were tested, which were not, and the reasons. The exit code is 1 if the readings contradict that the
    probe is within the workshop's tolerances. Without --calibration the gains are nominal, with the bench's tolerances, and
    hardly any variable can be tested.

    \b
    probe-design check --virtual --calibration probe.toml
    probe-design check --virtual --calibration probe.toml --built "probe.gap=0.2 mm"
    """  # noqa: D301
    import json

    from geometry.common.files import check_writable_file, write_text
    from probe_design.built_probe.calibration_record import check_free
    from probe_design.built_probe.probe_identity import check_serials, common_serial
    from probe_design.cli.hardware_sources import HardwareSetup, SampleSource
    from probe_design.probe_check.check import checked
    from probe_design.terminal.console import saying, show, warn
    from probe_design.terminal.hardware_tables import check_table, coverage_table, explanations_table, pairs_table, sentences

    origin, setting = SampleSource(**source), HardwareSetup.of(scene, bench, calibration)
    if output is not None:
        check_free(output)
        check_writable_file(output)
    if report is not None:
        check_writable_file(report, "report")
    pressed = readings(setting, origin, setting.bench.blocks, run=1)
    boards = {one.name: one.board for one in pressed}
    of_boards = check_serials(setting.boards(boards), origin.any_probe)
    read = [one.measurement for one in pressed]
    record = setting.calibration
    gains, variables = (None, ()) if record is None else (record.gains(), record.variables)
    with saying("checking") as tell:
        result = checked(setting.scene, setting.bench, read, gains, variables=variables, linear=linear, tell=tell)
    result = replace(result, serial=common_serial(boards), warnings=(*result.warnings, *of_boards))
    told, page = with_provenance(result.as_dict()), ""
    if report is not None:
        from probe_design.terminal.check_report import check_report

        with saying("the report") as tell:
            page = check_report(result, setting.scene, told, tell)
    if output is not None:  # both files are written last: computing the page takes seconds, in which a signal may end the program
        write_text(output, json.dumps(told, allow_nan=False, indent=1) + "\n")
    if report is not None:
        write_text(report, page)
    if as_json:
        print_json(result.as_dict())
    else:
        show(check_table(result))
        if result.alike:
            show(explanations_table(result))
        if result.pairs:
            show(pairs_table(result))
        show(coverage_table(result))
        print("\n".join(sentences(result)))
    warn(result.warnings)
    if record is None:
        warn(["not calibrated: nominal gains, with the bench's tolerances"])
    if result.failed:
        raise SystemExit(1)


@click.command()
@_with_source
def doctor(scene: Path | None, bench: Path | None, linear: bool, as_json: bool, **source: Any) -> None:
    """Report what is installed, connected and permitted for reading probes, and test the channels of a probe.

    Checks libusb, udev rules, probes, serial ports, VISA and versions; each problem comes with its remedy. The probe on USB, or
    the one of --device, --virtual or --replay, is then read under the bench's load, and its noise is compared with the noise of
    resistor and converter; polarity, load, clipping and mains hum are tested too. The exit code is 1 after a fault.

    \b
    probe-design doctor
    probe-design doctor --virtual
    probe-design doctor --device usb:1234 --bench bench.toml --json
    """  # noqa: D301
    from probe_design.cli.hardware_sources import HardwareSetup, SampleSource
    from probe_design.doctor.installed import installed, versions
    from probe_design.terminal.console import show
    from probe_design.terminal.doctor_table import doctor_table

    origin, setting = SampleSource(**source), HardwareSetup.of(scene, bench, None)
    length = origin.length
    computer = installed()
    channels = _channels(origin, setting, length, any(one.name == "probe on USB" for one in computer))
    found = [*computer, *channels]
    good = not any(one.state == "fault" for one in found)
    if as_json:
        told = {"installed": [one.as_dict() for one in computer], "self_test": [one.as_dict() for one in channels]}
        print_json({"good": good, "versions": versions(), **told})
    else:
        show(doctor_table(found, versions()))
        for state, words in (("fault", "at fault"), ("doubtful", "doubtful")):
            names = ", ".join(one.name for one in found if one.state == state)
            print(f"{words}: {names or 'nothing'}")
        for one in found:
            if one.state != "good" and one.remedy:
                print(f"{one.name}: {one.remedy}")
    if not good:
        raise SystemExit(1)


def _channels(origin: SampleSource, setting: HardwareSetup, length: float | None, plugged: bool) -> list[Finding]:
    """Return the findings of a test of a probe's channels; none where no probe is connected."""
    from hw.common.errors import HardwareError, InvalidSource
    from probe_design.doctor.finding import Finding
    from probe_design.doctor.self_test import self_test

    (recording,) = origin.recordings(1)
    if origin.live and origin.device is None and not plugged:
        return []
    try:
        (opener,) = origin.openers(lambda: (on_scene(setting, origin, "0.01"),), 1, pace=False)
        with opener() as reader:
            samples = setting.described_by(reader).collect(length, recording)
    except InvalidSource:
        raise
    except HardwareError as fault:
        return [Finding("reading", "fault", str(fault))]
    return self_test(samples, setting.scene, setting.bench)


def _tell_written(recording: Path | None) -> None:
    """Report the file of a recording, if it was written."""
    from probe_design.terminal.console import message

    if recording is not None and recording.exists():  # on a full disk no HDF5 file is written, and a warning says so
        message(f"wrote {recording}")
