"""The commands for a built probe: `read`, `calibrate`, `check` and `doctor`."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from geometry.common.files import check_writable_file, write_text
from geometry.common.json_types import JsonObject
from probe_design.commands.fields import NO_ACCURACY, Accuracy, AnyProbe, Calibration
from probe_design.commands.hardware_request import ReferenceRequest, SourceRequest
from probe_design.commands.output import add_provenance, print_result
from probe_design.commands.request import Option
from probe_design.terminal.console import show_spinner, show_steps, warn, write_message

if TYPE_CHECKING:
    from hw.signal.measurement import Measurement
    from probe_design.built_probe.calibration_record import CalibrationRecord
    from probe_design.built_probe.reading import StressReading
    from probe_design.commands.hardware_sources import HardwareSetup
    from probe_design.doctor.finding import Finding
    from probe_design.probe_check.check import Check


@dataclass(frozen=True)
class TakenReading:
    """What `read` has read: the result, all warnings, a function that builds its JSON object, and the recording, if any."""

    result: StressReading
    warnings: tuple[str, ...]
    build_json: Callable[[], JsonObject]
    recording: Path | None


class ReadRequest(SourceRequest):
    """Read the probe under a sinusoidal load: ratio and stresses, compared with the prediction for SCENE.

    A terminal shows live numbers and curves; otherwise plain lines are printed. The reading ends by itself. Without SCENE the
    calibration's scene is used, or the built-in one.

    \b
    probe-design read scene.toml --virtual
    probe-design read scene.toml --record run.probe --calibration probe.toml
    probe-design read scene.toml --replay run.probe --calibration probe.toml --json
    probe-design read scene.toml --replay scope.csv --column "inner=CH1 mV" --column "outer=CH2 mV" --rate "1 kHz"
    """  # noqa: D301

    any_probe: AnyProbe = False
    calibration: Calibration = None
    accuracy: Annotated[Accuracy, Option("Relative error that the prediction may have.", left_out=NO_ACCURACY)] = None
    hide: Annotated[
        Path | None,
        Option("File of the tumours in the virtual probe's tissue, tables [[inclusion]].", left_out="those of SCENE"),
    ] = None

    def run(self) -> None:
        """Read the probe, and print the result."""
        from probe_design.commands.hardware_sources import HardwareSetup
        from probe_design.terminal.hardware_tables import build_reading_table

        taken = self.take_reading(HardwareSetup.from_files(self.scene, self.bench, self.calibration))
        print_result(taken.build_json, lambda: [build_reading_table(taken.result)], self.as_json)
        warn(taken.warnings)
        if taken.recording is not None:
            write_message(f"wrote {taken.recording}")

    def take_reading(self, setup: HardwareSetup) -> TakenReading:
        """Read the probe, show live numbers meanwhile, and compare the result with the prediction."""
        from hw.signal.reading_fit import ReadingFit
        from hw.signal.sine_fit import check_rate
        from probe_design.built_probe.field_readings import build_reading_json, compute_ratio_noise
        from probe_design.built_probe.film_forces import measure_reading, measure_samples
        from probe_design.built_probe.probe_identity import check_serials, read_board_serial
        from probe_design.built_probe.reading import compute_reading
        from probe_design.commands.hardware_sources import build_openers, list_new_recordings
        from probe_design.commands.reference_readings import choose_prediction, simulate_on_scene
        from probe_design.measuring.acquisition import fit_reading
        from probe_design.terminal.live import compute_live_window, show_live
        from solver.evaluators import choose_accuracy

        length, accuracy = self.duration, choose_accuracy(setup.scene, self.accuracy)
        (recording,) = list_new_recordings(self, 1)  # of the only source: a new file's path, or None
        signals = partial(simulate_on_scene, setup, self, accuracy, linear=self.linear)
        (opener,) = build_openers(self, lambda: (signals(),), 1, sys.stderr.isatty())
        with opener() as reader:  # a missing device or another probe is refused before anything is computed
            serial = read_board_serial(reader.header.source)
            serial_warnings = check_serials(setup.collect_serials({"the reading": serial}), self.any_probe)
            frequency = setup.bench.load.frequency
            with show_spinner("predicting"):
                predicted = choose_prediction(length)(setup.calibrated_scene, accuracy, self.linear, frequency)
            gains, calibration_frequency = setup.gains, setup.calibrated_at

            def compare(measurement: Measurement) -> StressReading:
                """Return the stresses of a measurement, compared with the prediction."""
                return compute_reading(measurement, setup.scene, setup.bench, predicted, gains)

            check_rate(frequency, reader.header.rate)
            running_fit = ReadingFit(frequency, setup.bench.force is not None)
            with show_live(
                lambda samples: compare(measure_samples(samples, setup.bench, calibration_frequency))
            ) as show_samples:  # the reading begins
                fit_reading(
                    setup.describe_recording(reader),
                    length,
                    recording,
                    running_fit,
                    show=show_samples,
                    last=compute_live_window(frequency),
                )
        measurement = measure_reading(running_fit, setup.bench, calibration_frequency)
        result = compare(measurement)
        origin = setup.origin | {"placement": reader.header.source.get("placement"), "serial": serial}

        def build_json() -> JsonObject:
            """Return the JSON object of the reading, with the noise of its ratio."""
            noise = compute_ratio_noise(measurement, setup.scene, setup.bench, gains)
            return build_reading_json(result, noise, origin, setup.scene, running_fit.fingerprint)

        notes = (str(note) for note in predicted.warnings if note.kind in ("linear", "null"))
        return TakenReading(result, (*result.warnings, *serial_warnings, *notes), build_json, recording)


class CalibrateRequest(ReferenceRequest):
    """Calibrate a built probe: determine gains, cross-talk and offsets from readings on the bench's references.

    Each reference is read in turn; with a device, the program asks for each. Readings with gaps, saturation or too few cycles are
    refused, and so are films that warm up. With a force channel the gains are absolute, otherwise relative to each other.

    \b
    probe-design calibrate scene.toml --virtual -o probe.toml
    probe-design calibrate scene.toml --record run.probe -o probe.toml
    """  # noqa: D301

    output: Annotated[Path, Option("New file for the calibration record.", "-o/--output")]

    def run(self) -> None:
        """Read the references, and write the record."""
        from probe_design.commands.hardware_sources import HardwareSetup
        from probe_design.terminal.hardware_tables import build_calibration_table

        record = self.calibrate(HardwareSetup.from_files(self.scene, self.bench, None), self.output)
        print_result(lambda: record.model_dump(mode="json"), lambda: [build_calibration_table(record)], self.as_json)
        warn(record.warnings)
        write_message(f"wrote {self.output}")

    def calibrate(self, setup: HardwareSetup, output: Path | None) -> CalibrationRecord:
        """Read the references, compute the record, and write it where a file is named."""
        from probe_design.built_probe.calibration import calibrate
        from probe_design.built_probe.calibration_record import build_record, check_free, write_record
        from probe_design.built_probe.probe_identity import check_serials, find_common_serial
        from probe_design.commands.hardware_sources import describe_device, hash_raw_data
        from probe_design.commands.reference_readings import read_references

        if output is not None:
            check_free(output)
            check_writable_file(output)
        readings = read_references(setup, self, setup.bench.reference, run=0)
        with show_spinner("calibrating"):
            calibration = calibrate(setup.scene, setup.bench, [reading.measurement for reading in readings], linear=self.linear)
        serials = {reading.name: reading.serial for reading in readings}
        serial_warnings = check_serials(serials, self.any_probe)
        calibration = replace(calibration, warnings=(*calibration.warnings, *serial_warnings))
        raw_hashes = [hash_raw_data(reading.samples, reading.file) for reading in readings]
        record = build_record(calibration, raw_hashes, describe_device(readings[0].samples), find_common_serial(serials))
        if output is not None:
            write_record(output, record)
        return record


class CheckRequest(ReferenceRequest):
    """Check a built probe against its drawing by readings on blocks of tissue, and name the dimension out of tolerance.

    Reports which variables were tested, which were not, and the reasons. The exit code is 1 if the readings contradict that the
    probe is within the workshop's tolerances. Without --calibration the gains are nominal, with the bench's tolerances, and
    hardly any variable can be tested.

    \b
    probe-design check --virtual --calibration probe.toml
    probe-design check --virtual --calibration probe.toml --built "probe.gap=0.2 mm"
    """  # noqa: D301

    calibration: Calibration = None
    output: Annotated[Path | None, Option("New file for the result, as JSON.", "-o/--output")] = None
    report: Annotated[Path | None, Option("File for the result as a page, .html.")] = None

    def run(self) -> None:
        """Read the blocks, compare with the drawing, and exit with 1 where the probe is out of tolerance."""
        from probe_design.built_probe.calibration_record import check_free
        from probe_design.commands.hardware_sources import HardwareSetup
        from probe_design.terminal.hardware_tables import list_check_tables, write_sentences

        setup = HardwareSetup.from_files(self.scene, self.bench, self.calibration)
        if self.output is not None:
            check_free(self.output)
            check_writable_file(self.output)
        if self.report is not None:
            check_writable_file(self.report, "report")
        result = self.check(setup)
        json_object, page = add_provenance(result.as_dict()), ""
        if self.report is not None:
            from probe_design.terminal.check_report import build_check_report

            with show_steps("the report") as progress:
                page = build_check_report(result, setup.scene, json_object, progress)
        if self.output is not None:  # both files are written last: the page takes seconds, in which a signal may end the program
            write_text(self.output, json.dumps(json_object, allow_nan=False, indent=1) + "\n")
        if self.report is not None:
            write_text(self.report, page)
        print_result(result.as_dict, lambda: list_check_tables(result), self.as_json, lambda: write_sentences(result))
        warn(result.warnings)
        if setup.calibration is None:
            warn(["not calibrated: nominal gains, with the bench's tolerances"])
        if result.failed:
            raise SystemExit(1)

    def check(self, setup: HardwareSetup) -> Check:
        """Read the blocks, and compare them with the drawing."""
        from probe_design.built_probe.probe_identity import check_serials, find_common_serial
        from probe_design.commands.reference_readings import read_references
        from probe_design.probe_check.check import check

        block_readings = read_references(setup, self, setup.bench.blocks, run=1)
        serials = {reading.name: reading.serial for reading in block_readings}
        serial_warnings = check_serials(setup.collect_serials(serials), self.any_probe)
        measurements = [reading.measurement for reading in block_readings]
        record = setup.calibration
        gains, variables = (None, ()) if record is None else (record.build_gains(), record.variables)
        with show_steps("checking") as progress:
            result = check(
                setup.scene, setup.bench, measurements, gains, variables=variables, linear=self.linear, progress=progress
            )
        return replace(result, serial=find_common_serial(serials), warnings=(*result.warnings, *serial_warnings))


class DoctorRequest(SourceRequest):
    """Report what is installed, connected and permitted for reading probes, and test the channels of a probe.

    Checks libusb, udev rules, probes, serial ports, VISA and versions; each problem comes with its remedy. The probe on USB, or
    the one of --device, --virtual or --replay, is then read under the bench's load, and its noise is compared with the noise of
    resistor and converter; polarity, load, clipping and mains hum are tested too. The exit code is 1 after a fault.

    \b
    probe-design doctor
    probe-design doctor --virtual
    probe-design doctor --device usb:1234 --bench bench.toml --json
    """  # noqa: D301

    def run(self) -> None:
        """Check what is installed and connected, and exit with 1 after a fault."""
        from probe_design.commands.hardware_sources import HardwareSetup
        from probe_design.doctor.installed import check_installation, list_versions
        from probe_design.terminal.hardware_tables import build_doctor_table, list_findings

        setup = HardwareSetup.from_files(self.scene, self.bench, None)
        computer_findings = check_installation()
        is_plugged = any(finding.name == "probe on USB" for finding in computer_findings)
        channel_findings = self._test_channels(setup, is_plugged)
        findings = [*computer_findings, *channel_findings]
        is_good = not any(finding.state == "fault" for finding in findings)
        json_object = {
            "good": is_good,
            "versions": list_versions(),
            "installed": [finding.as_dict() for finding in computer_findings],
            "self_test": [finding.as_dict() for finding in channel_findings],
        }
        table = build_doctor_table(findings, list_versions())
        print_result(lambda: json_object, lambda: [table], self.as_json, lambda: list_findings(findings))
        if not is_good:
            raise SystemExit(1)

    def _test_channels(self, setup: HardwareSetup, is_plugged: bool) -> list[Finding]:
        """Return the findings of a test of a probe's channels; none if the default, a probe on USB, is not there.

        Without a device or a recording the probe is a virtual one. ``is_plugged`` states whether a probe was detected on USB.
        """
        from hw.common.errors import HardwareError, InvalidSource
        from probe_design.commands.hardware_sources import build_openers, list_new_recordings
        from probe_design.commands.reference_readings import simulate_on_scene
        from probe_design.doctor.finding import Finding
        from probe_design.doctor.self_test import run_self_test

        (recording,) = list_new_recordings(self, 1)
        # a device is to be read, none is named, and the default, the probe on USB, is not there: nothing to test
        if self.is_live and self.device is None and not is_plugged:
            return []
        try:
            # a relative accuracy of 0.01 is enough for the signals of a virtual probe
            (opener,) = build_openers(self, lambda: (simulate_on_scene(setup, self, 0.01, linear=True),), 1, pace=False)
            with opener() as reader:
                samples = setup.describe_recording(reader).collect(self.duration, recording)
        except InvalidSource:  # a mistake on the command line, not a fault of the probe
            raise
        except HardwareError as fault:
            return [Finding("reading", "fault", str(fault))]
        return run_self_test(samples, setup.scene, setup.bench)
