"""Read the probe press by press, and locate tumours after each: the work of the bench page's worker process."""

from __future__ import annotations

import io
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from geometry.common.errors import InputError, ProbeError, Words
from geometry.common.json_types import JsonObject
from hw.common.samples import Samples
from hw.reader import Reader
from hw.signal.measurement import Measurement
from hw.signal.reading_fit import ReadingFit
from hw.simulation.virtual import make_virtual_probe
from probe_design.built_probe.field_readings import (
    NO_SAMPLES,
    FieldReading,
    build_reading_without_prediction,
    parse_field_reading,
)
from probe_design.built_probe.film_forces import measure_reading, measure_samples
from probe_design.built_probe.probe_identity import check_serials, read_board_serial
from probe_design.built_probe.virtual_probe import SAMPLE_RATE_HZ, VOLTS_PER_COUNT
from probe_design.estimation.measurements import Reading
from probe_design.explorer.bench_settings import VIRTUAL, BenchSettings, PressRequest
from probe_design.explorer.messages import Put
from probe_design.explorer.waveform import Waveform
from probe_design.locating.locator import Locator
from probe_design.measuring.acquisition import fit_reading
from probe_design.populations.tables import NoiseModel
from probe_design.surveys.figures import Step, draw_step
from probe_design.surveys.record import Press, SurveyRecord, build_press_reading
from probe_design.surveys.virtual_tissue import VirtualTissue, convert_inclusions, draw_hidden_tumours

FRAME_S = 0.045  # s between two waveforms, at least: 20 a second, as chunks of a device come
LIVE_WINDOW_S, LIVE_PERIODS = 4.0, 4.0  # of the samples behind live numbers, at least
CHANNELS = 3


class Stopped(ProbeError):  # noqa: N818
    """The user has stopped the reading."""


class WatchedReader(Reader):
    """A reader that shows each block before it passes it on."""

    def __init__(self, reader: Reader, see: Callable[[Samples, bool], None]) -> None:
        super().__init__(reader.transport)
        self._see = see

    def blocks(self, seconds: float | None = None, record: Path | str | None = None) -> Iterator[Samples]:
        """Yield blocks of samples, see ``Reader.blocks``."""
        for block in super().blocks(seconds, record):
            self._see(block, self.is_behind)
            yield block


class Measuring:
    """Readings so far, and the map of them.

    The folder of recordings holds all that is known, so that another process can go on after this one was killed.

    Parameters
    ----------
    settings
        What was named at the start; its folder is given.

    Raises
    ------
    InputError
        The folder holds readings of another design or seed.
    """

    def __init__(self, settings: BenchSettings) -> None:
        assert settings.folder is not None
        self.settings, self._tissue = settings, None
        design, self.noise = settings.design, NoiseModel() if settings.design is None else settings.design.noise
        self.record = SurveyRecord.open(
            settings.folder, design or settings.scene, {"outliers": 0.0, "seed": settings.seed, "source": "explore"}
        )
        self._locate_all()

    _tissue: VirtualTissue | None

    def describe(self) -> JsonObject:
        """Return readings, map and the next place for the page."""
        presses = [
            {"number": number, "x": part.reading.x, "y": part.reading.y, "blank": part.reading.blank,
             "ratio": part.reading.ratio, "noise": part.reading.noise, "file": part.file}
            for number, part in enumerate(self.record.presses, start=1)
        ]  # fmt: skip
        state: JsonObject = {"presses": presses, "probability": None, "next": None, "stop": None, "map": None}
        if self.locator is not None and self.settings.design is not None:
            following = self.locator.next_position()
            stop = self.locator.find_stop(following)
            picture, hidden = io.BytesIO(), None if self._tissue is None else self._tissue.tumours
            draw_step(Step.from_locator(self.locator, following), hidden).savefig(picture, format="png")
            is_blank = self.settings.design.protocol.blank and not presses
            placement = self.settings.scene.placement
            state |= {
                "probability": self.locator.probability,
                "next": (placement.x, placement.y) if is_blank else (following.x, following.y),
                "blank": is_blank,
                "information": following.information,
                "stop": None if stop is None else stop.text,
                "map": picture.getvalue(),
            }
        return state

    def discard(self) -> JsonObject:
        """Leave out the last reading, and return ``describe``. Raises ``InputError`` where there is none."""
        if not self.record.presses:
            raise InputError("reading", Words("none"), "a reading before one can be discarded: press Record")
        self.record = self.record.discard()
        self._locate_all()
        return self.describe()

    def press(self, request: PressRequest, put: Put) -> JsonObject | None:
        """Read, put waveforms and live numbers meanwhile, and return ``describe`` with the reading; None without one.

        Raises
        ------
        HardwareError
            Of the source, or no ratio can be computed.
        InputError
            The source, or the reading, is not allowed.
        """
        bench, calibration = self.settings.bench, self.settings.calibration
        name = request.source.removeprefix("replay:")
        if request.keep and name in [press.file for press in self.record.presses]:
            raise InputError("recording", name, "one that is not a reading already: its noise would count twice")
        calibrated_at = None if calibration is None else calibration.frequency
        if request.keep and not request.source.startswith("replay:"):  # a place beside the tissue is refused before the press
            assumed = FieldReading(ratio=1.0, noise=0.0, shared=0.0, calibration=None, force=1.0, placement=request.place)
            build_press_reading(self.settings.scene, assumed, self.noise, {})
        path = self.record.name_recording() if request.keep and not request.source.startswith("replay:") else None
        waveform, last_frame = Waveform(bench.load.frequency), 0.0

        def see(block: Samples, is_behind: bool) -> None:
            """Draw the waveform, and stop where the user has asked for it."""
            nonlocal last_frame
            waveform.add(block)
            if time.monotonic() - last_frame >= FRAME_S and not is_behind:
                last_frame = time.monotonic()
                put("waveform", waveform.to_json())
            if request.stop_file.exists():
                raise Stopped("stopped" + ("" if path is None else f"; what was read is kept in {path.name}"))

        def show(samples: Samples) -> None:
            """Put live numbers."""
            measurement = measure_samples(samples, bench, calibrated_at)
            put("numbers", self._list_numbers(measurement, self._build_entry(measurement, samples.source, None)))

        running = ReadingFit(bench.load.frequency, bench.force is not None)
        window = max(LIVE_WINDOW_S, LIVE_PERIODS / bench.load.frequency)
        with WatchedReader(self._open(request), see) as reader:
            source = reader.header.source
            if not request.source.startswith("replay:"):
                source["placement"], source["blank"] = list(request.place), request.blank
            if calibration is not None:
                serials = {"the calibration": calibration.serial or None, "the reading": read_board_serial(source)}
                for text in check_serials(serials, False):
                    put("progress", text)
            if path is not None:
                path.parent.mkdir(parents=True, exist_ok=True)
            try:
                fit_reading(reader, request.seconds, path, running, show=show, last=window)
            finally:
                put("waveform", waveform.to_json())
        if path is not None:  # as `locate` and `survey` read the file, which holds the last block whole
            with Reader.open(f"replay:{path}") as recording:
                samples = recording.collect()
            running = ReadingFit.from_samples(samples, bench.load.frequency, bench.force is not None)
        measurement = measure_reading(running, bench, calibrated_at)
        entry = self._build_entry(measurement, source, running)
        put("numbers", self._list_numbers(measurement, entry))
        if not request.keep:
            return None
        put("progress", "updating the map" if self.locator is not None else "storing the reading")
        self._add(entry, source, request, name if path is None else path.name)
        return self.describe()

    def _open(self, request: PressRequest) -> Reader:
        """Open the source."""
        settings = self.settings
        if request.source not in settings.sources:
            raise InputError("source", request.source[:80], f"one named at the start: {', '.join(settings.sources)}")
        if request.source != VIRTUAL:
            return Reader.open(request.source, settings.rate, settings.columns)
        if self._tissue is None:
            self._tissue = self._build_tissue()
        number = len(self.record.presses) + len(self.record.extra.get("discarded", []))  # each press has its own noise
        signals = self._tissue.build_press(number, request.place, blank=request.blank)
        return Reader.open(make_virtual_probe(signals, SAMPLE_RATE_HZ, channels=CHANNELS, scale=VOLTS_PER_COUNT, pace=True))

    def _build_tissue(self) -> VirtualTissue:
        """Return the virtual tissue with its hidden tumours."""
        settings, scene = self.settings, self.settings.scene
        bodies = scene.inclusion if settings.hidden is None else settings.hidden
        if settings.hidden is None and self.locator is not None:
            tumours = draw_hidden_tumours(self.locator.prior, settings.seed)
        else:
            tumours = convert_inclusions(bodies)
        if self.locator is not None:
            poisson_ratio = self.locator.prior.poisson_ratio
        else:
            poisson_ratio = bodies[0].poisson_ratio if bodies else scene.tissue.poisson_ratio
        return VirtualTissue.from_scene(scene, tumours, poisson_ratio, bench=settings.bench, noise=self.noise, seed=settings.seed)

    def _build_entry(self, measurement: Measurement, source: dict[str, object], running: ReadingFit | None) -> JsonObject:
        """Return the JSON object that `read` prints for a measurement."""
        settings = self.settings
        gains = None
        if settings.calibration is not None:
            gains = settings.calibration.build_gains().add_warming(settings.bench.channels.warming)
        origin = {"placement": source.get("placement"), "serial": read_board_serial(source)}
        fingerprint = NO_SAMPLES if running is None else running.fingerprint
        return build_reading_without_prediction(
            measurement, settings.scene, settings.bench, gains, origin=origin, fingerprint=fingerprint
        )

    @staticmethod
    def _list_numbers(measurement: Measurement, entry: JsonObject) -> JsonObject:
        """Return the numbers of a reading for the page, SI."""
        charges, sds = np.abs(measurement.in_phase), np.sqrt(np.diag(measurement.in_phase_covariance))
        keys = ("ratio", "ratio_uncertainty", "force", "force_uncertainty", "reference_force", "frequency", "cycles", "mains",
                "saturated", "gaps", "overruns", "warnings")  # fmt: skip
        hum = measurement.fit.hum[:2]
        return {key: entry.get(key) for key in keys} | {
            "charges": charges.tolist(),
            "charges_sd": sds.tolist(),
            "hum": float(hum.max()),
            "hum_ratio": float(hum.max() / np.abs(measurement.fit.amplitudes[:2]).max()),
        }

    def _add(self, entry: JsonObject, source: dict[str, object], request: PressRequest, name: str) -> None:
        """Take a reading into account, and store it."""
        measured = parse_field_reading(entry, name, self.settings.scene)
        is_blank = source.get("blank", request.blank) is True
        placed = replace(measured, placement=measured.placement or request.place, blank=is_blank)
        reading = build_press_reading(self.settings.scene, placed, self.noise, {})
        self._locate(reading)
        probability = () if self.locator is None else self.locator.probability
        extra = {} if self._tissue is None else {"hidden": self._tissue.tumours.tolist()}
        self.record = self.record.add(Press(reading, name, probability), self.record.extra | extra)

    def _locate_all(self) -> None:
        """Build the map of all readings."""
        design = self.settings.design
        if design is not None and design.protocol.loads:  # presses of the page are those under the scene's load
            design = design.model_copy(update={"protocol": design.protocol.model_copy(update={"loads": ()})})
        self.locator = None if design is None else Locator(design, seed=self.settings.seed)
        for press in self.record.presses:
            self._locate(press.reading)

    def _locate(self, reading: Reading) -> None:
        """Update the map."""
        if self.locator is not None:
            self.locator.update(reading)
