"""A survey as it goes on: its presses one after the other, the map after each, and the report."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from geometry.common.arrays import Floats
from geometry.common.errors import InputError, Words
from geometry.common.json_types import JsonObject
from hw.common.errors import HardwareError, InvalidSource
from hw.files.columns import ColumnMap, read_rate
from hw.reader import Reader
from probe_design.built_probe.hidden_tumours import read_hidden_tumours
from probe_design.commands.hardware_request import DEFAULT_PRESS_TIME_S, SurveyOptions
from probe_design.commands.hardware_sources import MAX_ATTEMPTS, HardwareSetup, build_device_opener, open_virtual
from probe_design.commands.reference_readings import ask_for
from probe_design.commands.scan_recordings import read_scan_recordings, use_calibration
from probe_design.estimation.measurements import FORCE_QUANTITY, Reading
from probe_design.locating.location import Location
from probe_design.locating.locator import Locator
from probe_design.locating.next_position import NextPosition
from probe_design.locating.report import format_probability, write_files
from probe_design.locating.stopping import Stop
from probe_design.populations.design_file import Design
from probe_design.reporting.page import Chapter, Picture, Text
from probe_design.reporting.picture_files import save_figure
from probe_design.surveys.figures import LEGEND, Step, draw_sequence, draw_step
from probe_design.surveys.record import Press, SurveyRecord
from probe_design.surveys.virtual_tissue import VirtualTissue, convert_inclusions, draw_hidden_tumours
from probe_design.terminal.console import warn, write_message

SEQUENCE_FILE = "sequence.png"


@dataclass
class Survey:
    """A survey as it goes on.

    Attributes
    ----------
    request
        Options of the command.
    design
        Of probe, population and noise; with the calibration, if one is given.
    setup
        Scene, bench and calibration for recordings.
    record
        The folder's record.
    locator
        The posterior.
    tissue
        The virtual one, or None.
    steps
        Map after each press.
    """

    request: SurveyOptions
    design: Design
    setup: HardwareSetup
    record: SurveyRecord
    locator: Locator
    tissue: VirtualTissue | None
    steps: list[Step]

    @classmethod
    def prepare(cls, request: SurveyOptions, design: Design) -> Survey:
        """Read calibration, bench and the record, and build the posterior before the readings."""
        setup = HardwareSetup.from_scene(design.scene, request.bench, request.calibration)
        design = use_calibration(design, request.calibration)
        settings: JsonObject = {"outliers": request.outliers, "seed": request.seed}
        settings["source"] = "virtual" if request.virtual else "replay" if request.replay else request.device or "usb"
        record = SurveyRecord.open(request.output, design, settings)
        locator = Locator(design, outliers=request.outliers, seed=request.seed)
        return cls(request, design, setup, record, locator, None, [])

    def start(self) -> None:
        """Prepare the virtual tissue, and take the presses of an interrupted survey into account."""
        if self.request.virtual:
            if self.request.hide is not None:
                tumours = convert_inclusions(read_hidden_tumours(self.request.hide, self.design.scene))
            else:
                tumours = draw_hidden_tumours(self.locator.prior, self.request.seed)
            self.tissue = VirtualTissue.from_scene(
                self.design.scene, tumours, self.locator.prior.poisson_ratio, bench=self.setup.bench, noise=self.design.noise,
                seed=self.request.seed, forces=self.locator.loads,
            )  # fmt: skip
            if self.record.presses and self.record.extra.get("hidden") != tumours.tolist():
                raise InputError("output", Words(f"{self.request.output} with other hidden tumours"), "a new folder")
        for press in self.record.presses:
            self.locator.update(press.reading)
            step = self._add_step()
            if not self._name_map(step).exists():  # the interruption came before it was drawn
                save_figure(draw_step(step, self._hidden), self._name_map(step))

    def press_until_stop(self) -> Stop:
        """Read press after press until there is a reason to stop."""
        replayed = self._list_replayed() if self.request.replay else None
        while True:
            following = self.locator.next_position()
            stop = self.locator.find_stop(following)
            if stop is not None:
                return stop
            number = len(self.record.presses)
            if number >= self.request.presses:
                return Stop("presses", f"{number} presses are made (--presses)")
            if replayed is not None and number >= len(replayed):
                return Stop("recordings", f"all {number} recordings are read; next would be {_format_press(following)}")
            if replayed is None:
                reading, file = self._press(following)
            else:
                reading, file = replayed[number]
            self.locator.update(reading)
            self._add(reading, file)

    def _press(self, following: NextPosition) -> tuple[Reading, str]:
        """Read one press, which is recorded before anything is computed from it; a flawed one is read again.

        The first presses are the baseline readings, one under each load, unless the protocol has none.
        """
        placement = self.design.scene.placement
        number, loads = len(self.record.presses), self.locator.loads
        is_blank = self.design.protocol.blank and number < len(loads)
        if is_blank:
            following = NextPosition(placement.x, placement.y, 0.0, loads[number])
        place = (following.x, following.y)
        for attempt in range(1, MAX_ATTEMPTS + 1):
            path = self.record.name_recording()
            try:
                with self._open(following, is_blank) as reader:
                    source = reader.header.source
                    source["placement"] = list(place)
                    source["blank"] = is_blank
                    if following.force is not None:
                        source["load"] = following.force
                    path.parent.mkdir(parents=True, exist_ok=True)
                    reader.collect(self.request.seconds or DEFAULT_PRESS_TIME_S, path)
                (reading,), _ = self._read_recordings((str(path),), ColumnMap())
                return reading, path.name
            except InvalidSource:
                raise
            except HardwareError as fault:
                if not self.request.is_live or attempt == MAX_ATTEMPTS:
                    raise
                write_message(f"{fault}; press again")
        raise AssertionError  # the loop returns or raises

    def _open(self, following: NextPosition, is_blank: bool) -> Reader:
        """Open the device, after the user has moved the probe, or the virtual probe at a place, under its load."""
        number = len(self.record.presses)
        if self.tissue is not None:
            place = (following.x, following.y)
            return open_virtual(self.tissue.build_press(number, place, blank=is_blank, force=following.force), False)
        where = _format_press(following, "tumour-free tissue, for the baseline reading" if is_blank else "")
        ask_for(f"press {number + 1}", where, self.request)
        return build_device_opener(self.request)()

    def _list_replayed(self) -> list[tuple[Reading, str]]:
        """Return the readings of all recordings of --replay."""
        texts = tuple(map(str, self.request.replay))
        rate = None if self.request.rate is None else read_rate(self.request.rate)
        readings, warnings = self._read_recordings(texts, ColumnMap.from_texts(self.request.column), rate)
        warn(warnings)
        return list(zip(readings, texts, strict=True))

    def _read_recordings(
        self, texts: tuple[str, ...], columns: ColumnMap, rate: float | None = None
    ) -> tuple[tuple[Reading, ...], list[str]]:
        """Return the readings of recordings, whose texts may add their places, and warnings."""
        any_probe = self.request.any_probe
        return read_scan_recordings(self.setup, self.design, texts, columns=columns, rate=rate, any_probe=any_probe)

    def _add(self, reading: Reading, file: str) -> None:
        """Store a press and its map, and report it."""
        self.record = self.record.add(Press(reading, file, self.locator.probability), self._hidden_entry)
        step = self._add_step()
        save_figure(draw_step(step, self._hidden), self._name_map(step))
        what = _format_press(reading, "baseline" if reading.blank else "")
        write_message(
            f"press {step.number}, {what}: ratio {reading.ratio:.4g}; no tumour: {format_probability(step.probability_none)}"
        )

    def _add_step(self) -> Step:
        """Return the map of the readings so far, which is stored for the sequence."""
        self.steps.append(Step.from_locator(self.locator, self.locator.next_position()))
        return self.steps[-1]

    def _name_map(self, step: Step) -> Path:
        """Return the file of a step's map."""
        return self.request.output / f"map-{step.number:03d}.png"

    @property
    def _hidden(self) -> Floats | None:
        return None if self.tissue is None else self.tissue.tumours

    @property
    def _hidden_entry(self) -> JsonObject:
        """The entry of a JSON object with the tumours of the virtual tissue, if there is one."""
        return {} if self.tissue is None else {"hidden": self.tissue.tumours.tolist()}

    def describe_end(self, stop: Stop) -> str:
        """Return the reason of the end as a sentence."""
        return f"Stopped after {len(self.record.presses)} presses: {stop.text}."

    def describe(self, stop: Stop) -> JsonObject:
        """Return the entries of the JSON object beside those of `locate`."""
        return {
            "stop": {"reason": stop.reason, "text": stop.text},
            "presses": [press.as_dict() for press in self.record.presses],
            "detectable_probability": self.locator.compute_detectable_probability(),
        } | self._hidden_entry

    def finish(self, stop: Stop) -> tuple[Location, list[str]]:
        """Write the report; return the result as that of `locate`, and the files."""
        result = replace(self.locator.map(), next=self.locator.next_position())
        chapters: list[Chapter] = []
        files = []
        if self.steps:
            self.steps[-1] = replace(self.steps[-1], following=None)
            path = self.request.output / SEQUENCE_FILE
            save_figure(draw_sequence(self.steps, self._hidden), path)
            parts = (
                Text(self.describe_end(stop)),
                Picture.from_file(path, "map after each press"),
                Text(LEGEND),
                self.record.build_table(),
            )
            chapters = [Chapter("Press by press", parts)]
            files = [str(path)]
        self.record.write({key: value for key, value in self.describe(stop).items() if key != "presses"})
        return result, [*files, *(str(path) for path in write_files(result, self.request.output, chapters))]


def _format_press(press: Reading | NextPosition, place: str = "") -> str:
    """Return the place of a press, by default its x and y, and its force where it is not the scene's load."""
    place = place or f"x = {press.x * 1e3:.1f} mm, y = {press.y * 1e3:.1f} mm"
    return place if press.force is None else f"{place}, {FORCE_QUANTITY.format_value(press.force)}"
