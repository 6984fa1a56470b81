"""The commands for a built probe: `read`, `calibrate`, `check` and `doctor`."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from probe_design.cli.arguments import FILE_NAME, add_limit_options, any_probe_option, linear_option, read_fraction
from probe_design.cli.output import add_provenance, print_json
from probe_design.cli.reference_readings import choose_prediction, read_references, simulate_on_scene

if TYPE_CHECKING:
    from probe_design.cli.hardware_sources import HardwareSetup, SampleSource
    from probe_design.doctor.finding import Finding

CommandCallback = Callable[..., None]


_RESUME_OPTION = click.option(
    "--resume", is_flag=True, help="Use the recordings that --record has written before; read the others."
)


def _add_source_options(command: CommandCallback, resumes: bool = False) -> CommandCallback:
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
        *([_RESUME_OPTION] if resumes else []),
        click.option("--bench", type=FILE_NAME, help="TOML file of load, amplifier and references."),
        click.option("--built", multiple=True, help="Deviation of the virtual probe from the drawing: 'probe.gap=0.12 mm'."),
        click.option("--seed", default=0, show_default=True, type=click.IntRange(0, 2**31), help="Seed of its noise."),
        linear_option,
        click.option("--json", "as_json", is_flag=True, help="Print one JSON object."),
    )
    for option in reversed(options):
        command = option(command)
    return add_limit_options(command)


@click.command()
@_add_source_options
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
    from hw.signal.running_fit import RunningFit
    from hw.signal.sine_fit import check_rate
    from probe_design.built_probe.field_readings import build_reading_json, compute_ratio_noise, read_placement
    from probe_design.built_probe.film_forces import measure_reading, measure_running_reading
    from probe_design.built_probe.probe_identity import check_serials, read_board_serial
    from probe_design.built_probe.reading import compute_reading as compare_reading
    from probe_design.cli.hardware_sources import HardwareSetup, SampleSource
    from probe_design.measuring.acquisition import fit_reading
    from probe_design.terminal.console import show_spinner, show_table, warn
    from probe_design.terminal.hardware_tables import build_reading_table
    from probe_design.terminal.live import compute_live_window, show_live

    sample_source, setup = SampleSource(**source), HardwareSetup.from_files(scene, bench, calibration)
    length, (recording,) = sample_source.duration, sample_source.list_new_recordings(1)
    (opener,) = sample_source.build_openers(lambda: (simulate_on_scene(setup, sample_source, accuracy),), 1, sys.stderr.isatty())
    with opener() as reader:  # a missing device or another probe is refused before anything is computed
        serial = read_board_serial(reader.header.source)
        serial_warnings = check_serials(setup.collect_serials({"the reading": serial}), sample_source.any_probe)
        with show_spinner("predicting"):
            predicted = choose_prediction(length)(
                setup.scene, read_fraction("accuracy", accuracy), linear, setup.bench.load.frequency
            )
        gains, calibration_frequency = None, None
        if setup.calibration is not None:
            gains = setup.calibration.build_gains().add_warming(setup.bench.channels.warming)
            calibration_frequency = setup.calibration.frequency

        def compare(measurement: Any) -> Any:
            return compare_reading(measurement, setup.scene, setup.bench, predicted, gains)

        frequency = setup.bench.load.frequency
        check_rate(frequency, reader.header.rate)
        running_fit = RunningFit(frequency, setup.bench.force is not None)
        with show_live(
            lambda samples: compare(measure_reading(samples, setup.bench, calibration_frequency))
        ) as show_samples:  # the reading begins
            fit_reading(
                setup.describe_recording(reader),
                length,
                recording,
                running_fit,
                show=show_samples,
                last=compute_live_window(frequency),
            )
    measurement = measure_running_reading(running_fit, setup.bench, calibration_frequency)
    result = compare(measurement)
    if as_json:
        recorded_origin = setup.origin | {"placement": read_placement(reader.header.source), "serial": serial}
        noise = compute_ratio_noise(measurement, setup.scene, setup.bench, gains)
        print_json(build_reading_json(result, noise, recorded_origin, setup.scene, running_fit.fingerprint))
    else:
        show_table(build_reading_table(result))
    warn((*result.warnings, *serial_warnings, *(note for note in predicted.warnings if note.kind in ("linear", "null"))))
    _report_written(recording)


WAIT_OPTION = click.option("--wait", help="Seconds to change each reference in, without a terminal, in place of Enter.")


@click.command()
@partial(_add_source_options, resumes=True)
@any_probe_option
@WAIT_OPTION
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
    from probe_design.built_probe.calibration import calibrate as calibrate_probe
    from probe_design.built_probe.calibration_record import build_record, check_free, write_record
    from probe_design.built_probe.probe_identity import check_serials, find_common_serial
    from probe_design.cli.hardware_sources import HardwareSetup, SampleSource, describe_device, hash_raw_data
    from probe_design.terminal.console import show_spinner, show_table, warn, write_message
    from probe_design.terminal.hardware_tables import build_calibration_table

    sample_source, setup = SampleSource(**source), HardwareSetup.from_files(scene, bench, None)
    check_free(output)
    check_writable_file(output)
    reference_readings = read_references(setup, sample_source, setup.bench.reference, run=0)
    with show_spinner("calibrating"):
        calibration = calibrate_probe(
            setup.scene, setup.bench, [reading.measurement for reading in reference_readings], linear=linear
        )
    serials = {reading.name: reading.serial for reading in reference_readings}
    serial_warnings = check_serials(serials, sample_source.any_probe)
    calibration = replace(calibration, warnings=(*calibration.warnings, *serial_warnings))
    raw_hashes = [hash_raw_data(reading.samples, reading.file) for reading in reference_readings]
    calibration_record = build_record(
        calibration, raw_hashes, describe_device(reference_readings[0].samples), find_common_serial(serials)
    )
    write_record(output, calibration_record)
    if as_json:
        print_json(calibration_record.model_dump(mode="json"))
    else:
        show_table(build_calibration_table(calibration_record))
    warn(calibration_record.warnings)
    write_message(f"wrote {output}")


@click.command()
@partial(_add_source_options, resumes=True)
@any_probe_option
@WAIT_OPTION
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
    from probe_design.built_probe.probe_identity import check_serials, find_common_serial
    from probe_design.cli.hardware_sources import HardwareSetup, SampleSource
    from probe_design.probe_check.check import check as check_probe
    from probe_design.terminal.console import show_steps, show_table, warn
    from probe_design.terminal.hardware_tables import (
        build_check_table,
        build_coverage_table,
        build_explanations_table,
        build_pairs_table,
        write_sentences,
    )

    sample_source, setup = SampleSource(**source), HardwareSetup.from_files(scene, bench, calibration)
    if output is not None:
        check_free(output)
        check_writable_file(output)
    if report is not None:
        check_writable_file(report, "report")
    block_readings = read_references(setup, sample_source, setup.bench.blocks, run=1)
    serials = {reading.name: reading.serial for reading in block_readings}
    serial_warnings = check_serials(setup.collect_serials(serials), sample_source.any_probe)
    measurements = [reading.measurement for reading in block_readings]
    record = setup.calibration
    gains, variables = (None, ()) if record is None else (record.build_gains(), record.variables)
    with show_steps("checking") as tell:
        result = check_probe(setup.scene, setup.bench, measurements, gains, variables=variables, linear=linear, tell=tell)
    result = replace(result, serial=find_common_serial(serials), warnings=(*result.warnings, *serial_warnings))
    json_object, page = add_provenance(result.as_dict()), ""
    if report is not None:
        from probe_design.terminal.check_report import build_check_report

        with show_steps("the report") as tell:
            page = build_check_report(result, setup.scene, json_object, tell)
    if output is not None:  # both files are written last: computing the page takes seconds, in which a signal may end the program
        write_text(output, json.dumps(json_object, allow_nan=False, indent=1) + "\n")
    if report is not None:
        write_text(report, page)
    if as_json:
        print_json(result.as_dict())
    else:
        show_table(build_check_table(result))
        if result.alike:
            show_table(build_explanations_table(result))
        if result.pairs:
            show_table(build_pairs_table(result))
        show_table(build_coverage_table(result))
        print("\n".join(write_sentences(result)))
    warn(result.warnings)
    if record is None:
        warn(["not calibrated: nominal gains, with the bench's tolerances"])
    if result.failed:
        raise SystemExit(1)


@click.command()
@_add_source_options
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
    from probe_design.doctor.installed import check_installation, list_versions
    from probe_design.terminal.console import show_table
    from probe_design.terminal.doctor_table import build_doctor_table

    sample_source, setup = SampleSource(**source), HardwareSetup.from_files(scene, bench, None)
    length = sample_source.duration
    computer_findings = check_installation()
    channel_findings = _test_channels(
        sample_source, setup, length, any(finding.name == "probe on USB" for finding in computer_findings)
    )
    findings = [*computer_findings, *channel_findings]
    is_good = not any(finding.state == "fault" for finding in findings)
    if as_json:
        json_parts = {
            "installed": [finding.as_dict() for finding in computer_findings],
            "self_test": [finding.as_dict() for finding in channel_findings],
        }
        print_json({"good": is_good, "versions": list_versions(), **json_parts})
    else:
        show_table(build_doctor_table(findings, list_versions()))
        for state, heading in (("fault", "at fault"), ("doubtful", "doubtful")):
            names = ", ".join(finding.name for finding in findings if finding.state == state)
            print(f"{heading}: {names or 'nothing'}")
        for finding in findings:
            if finding.state != "good" and finding.remedy:
                print(f"{finding.name}: {finding.remedy}")
    if not is_good:
        raise SystemExit(1)


def _test_channels(sample_source: SampleSource, setup: HardwareSetup, length: float | None, is_plugged: bool) -> list[Finding]:
    """Return the findings of a test of a probe's channels; none where no probe is connected."""
    from hw.common.errors import HardwareError, InvalidSource
    from probe_design.doctor.finding import Finding
    from probe_design.doctor.self_test import run_self_test

    (recording,) = sample_source.list_new_recordings(1)
    if sample_source.is_live and sample_source.device is None and not is_plugged:
        return []
    try:
        (opener,) = sample_source.build_openers(lambda: (simulate_on_scene(setup, sample_source, "0.01"),), 1, pace=False)
        with opener() as reader:
            samples = setup.describe_recording(reader).collect(length, recording)
    except InvalidSource:
        raise
    except HardwareError as fault:
        return [Finding("reading", "fault", str(fault))]
    return run_self_test(samples, setup.scene, setup.bench)


def _report_written(recording: Path | None) -> None:
    """Report the file of a recording, if it was written."""
    from probe_design.terminal.console import write_message

    if recording is not None and recording.exists():  # on a full disk no HDF5 file is written, and a warning says so
        write_message(f"wrote {recording}")
