"""The command `survey`: press, update the map, say where to press next, and when to stop."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Self

from pydantic import Field, model_validator

from geometry.common.errors import InputError, Words
from geometry.common.json_types import JsonObject
from probe_design.commands.fields import AnyProbe
from probe_design.commands.hardware_request import ALLOWED_SOURCES, Pause, Seconds, SourceRequest
from probe_design.commands.locate import MAX_OUTLIER_RATE, read_locate_design
from probe_design.commands.output import print_result
from probe_design.commands.request import Number, Option

if TYPE_CHECKING:
    from geometry.common.arrays import Floats
    from hw.reader import Reader
    from probe_design.commands.hardware_sources import HardwareSetup
    from probe_design.estimation.measurements import Reading
    from probe_design.locating.locator import Locator
    from probe_design.locating.next_position import NextPosition
    from probe_design.locating.stopping import Stop
    from probe_design.populations.design_file import Design
    from probe_design.surveys.figures import Step
    from probe_design.surveys.record import SurveyRecord
    from probe_design.surveys.virtual_tissue import VirtualTissue

DEFAULT_PRESS_TIME_S = 5.0  # 25 periods of the built-in bench's load
DEFAULT_PRESSES = 60
SEQUENCE_FILE = "sequence.png"


class SurveyRequest(SourceRequest):
    """Survey a tissue: read press after press, update the map, say where to press next and when to stop.

    DESIGN is a design file as for `locate`: probe, tissue, noise, and what is known of tumours before. The first press is the
    baseline reading over tumour-free tissue, unless [protocol] has blank = false; with [protocol] loads there is one under each.
    Each next place, and load, is the one whose reading is expected to say the most. The survey stops when no tumour is less
    probable than 1 %, when tumours that the protocol's scan would detect with 90 % are less probable than 1 %, when no reading is
    expected to say more, or after --presses.

    \b
    probe-design survey DESIGN.toml --virtual -o out
    probe-design survey DESIGN.toml --virtual --hide tumours.toml -o out
    probe-design survey DESIGN.toml --device usb --calibration probe.toml -o out
    probe-design survey DESIGN.toml --replay "a.probe, x=30 mm, y=0 mm, blank=true" --replay "b.probe, x=4 mm, y=-8 mm" -o out
    probe-design survey DESIGN.toml --replay "a.probe, x=4 mm, y=-8 mm, force=0.1 N" -o out

    -o DIR holds every raw recording (press-001.probe ...), the readings (scan.csv, which `locate --readings` reads), a map after
    each press, and the report. The same command with the same DIR continues an interrupted survey. --hide states the tumours of
    the virtual tissue, tables [[inclusion]] as in a scene file; left out, they are drawn from the population by --seed.
    """  # noqa: D301

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
    calibration: Annotated[Path | None, Option("Calibration file that calibrate has written.")] = None
    outliers: Annotated[
        float,
        Number(f"a fraction from 0 to {MAX_OUTLIER_RATE:g}", lambda rate: 0 <= rate <= MAX_OUTLIER_RATE, percent=True),
        Option("Expected fraction of wild readings."),
    ] = 0.0
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

    def run(self) -> None:
        """Survey, and print the result."""
        from probe_design.terminal.console import warn, write_message

        survey = self.prepare_survey(read_locate_design(self.scene))
        stop = survey.press_until_stop()
        result, files = survey.finish(stop)
        json_object = result.as_dict() | survey.describe(stop) | {"files": files}

        def list_lines() -> list[str]:
            """Return the sentences below the tables."""
            from probe_design.locating.report import list_lines as list_location_lines

            return [f"Stopped after {len(survey.record.presses)} presses: {stop.text}.", *list_location_lines(result)]

        def build_tables() -> list[Any]:
            """Return the tables of the result."""
            from probe_design.locating.report import build_tables as build_location_tables

            return build_location_tables(result)

        print_result(lambda: json_object, build_tables, self.as_json, list_lines)
        if not self.as_json:
            warn(result.warnings)
            write_message(f"wrote {self.output / 'report.html'}")

    def prepare_survey(self, design: Design) -> Survey:
        """Return the survey before its next press, interrupted or not."""
        from geometry.common.files import check_writable
        from probe_design.commands.reference_readings import require_terminal
        from probe_design.terminal.console import show_spinner

        require_terminal(self)  # before the map is prepared, which takes half a minute
        check_writable(self.output)
        survey = Survey.prepare(self, design)
        with show_spinner("preparing the map"):
            survey.start()
        return survey


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

    request: SurveyRequest
    design: Design
    setup: HardwareSetup
    record: SurveyRecord
    locator: Locator
    tissue: VirtualTissue | None
    steps: list[Step]

    @classmethod
    def prepare(cls, request: SurveyRequest, design: Design) -> Survey:
        """Read calibration, bench and the record, and build the posterior before the readings."""
        from probe_design.commands.hardware_sources import HardwareSetup
        from probe_design.commands.scan_recordings import use_calibration
        from probe_design.locating.locator import Locator
        from probe_design.surveys.record import SurveyRecord

        setup = HardwareSetup.from_scene(design.scene, request.bench, request.calibration)
        design = use_calibration(design, request.calibration)
        settings: JsonObject = {"outliers": request.outliers, "seed": request.seed}
        settings["source"] = "virtual" if request.virtual else "replay" if request.replay else request.device or "usb"
        record = SurveyRecord.open(request.output, design, settings)
        locator = Locator(design, outliers=request.outliers, seed=request.seed)
        return cls(request, design, setup, record, locator, None, [])

    def start(self) -> None:
        """Prepare the virtual tissue, and take the presses of an interrupted survey into account."""
        from probe_design.surveys.figures import draw_step
        from probe_design.surveys.virtual_tissue import VirtualTissue, convert_inclusions, draw_hidden_tumours

        if self.request.virtual:
            if self.request.hide is not None:
                from probe_design.built_probe.hidden_tumours import read_hidden_tumours

                inclusions = read_hidden_tumours(self.request.hide, self.design.scene)
                tumours = convert_inclusions(inclusions)
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
                write_figure(draw_step(step, self._hidden), self._name_map(step))

    def press_until_stop(self) -> Stop:
        """Read press after press until there is a reason to stop."""
        from probe_design.locating.stopping import Stop

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
        from hw.common.errors import HardwareError, InvalidSource
        from probe_design.commands.hardware_sources import MAX_ATTEMPTS
        from probe_design.locating.next_position import NextPosition
        from probe_design.terminal.console import write_message

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
                return self._read(path), path.name
            except InvalidSource:
                raise
            except HardwareError as fault:
                if not self.request.is_live or attempt == MAX_ATTEMPTS:
                    raise
                write_message(f"{fault}; press again")
        raise AssertionError  # the loop returns or raises

    def _open(self, following: NextPosition, is_blank: bool) -> Reader:
        """Open the device, after the user has moved the probe, or the virtual probe at a place, under its load."""
        from probe_design.commands.hardware_sources import build_device_opener, open_virtual
        from probe_design.commands.reference_readings import ask_for

        number = len(self.record.presses)
        if self.tissue is not None:
            place = (following.x, following.y)
            return open_virtual(self.tissue.build_press(number, place, blank=is_blank, force=following.force), False)
        where = _format_press(following, "tumour-free tissue, for the baseline reading" if is_blank else "")
        ask_for(f"press {number + 1}", where, self.request)
        return build_device_opener(self.request)()

    def _read(self, path: Path, text: str = "") -> Reading:
        """Return the reading of a recording; ``text`` may add its place, as on the command line."""
        from hw.files.columns import ColumnMap, read_rate
        from probe_design.commands.scan_recordings import read_scan_recordings

        columns = ColumnMap.from_texts(self.request.column) if text else ColumnMap()
        rate = read_rate(self.request.rate) if text and self.request.rate is not None else None
        (reading,) = read_scan_recordings(
            self.setup, self.design, (text or str(path),), columns=columns, rate=rate, any_probe=self.request.any_probe
        )[0]
        return reading

    def _list_replayed(self) -> list[tuple[Reading, str]]:
        """Return the readings of all recordings of --replay."""
        from hw.files.columns import ColumnMap, read_rate
        from probe_design.commands.scan_recordings import read_scan_recordings
        from probe_design.terminal.console import warn

        texts = tuple(map(str, self.request.replay))
        rate = None if self.request.rate is None else read_rate(self.request.rate)
        readings, warnings = read_scan_recordings(
            self.setup, self.design, texts, columns=ColumnMap.from_texts(self.request.column), rate=rate,
            any_probe=self.request.any_probe,
        )  # fmt: skip
        warn(warnings)
        return [(reading, text) for reading, text in zip(readings, texts, strict=True)]

    def _add(self, reading: Reading, file: str) -> None:
        """Store a press and its map, and report it."""
        from probe_design.locating.report import format_probability
        from probe_design.surveys.figures import draw_step
        from probe_design.surveys.record import Press
        from probe_design.terminal.console import write_message

        press = Press(reading, file, self.locator.probability)
        extra = {} if self.tissue is None else {"hidden": self.tissue.tumours.tolist()}
        self.record = self.record.add(press, extra)
        step = self._add_step()
        write_figure(draw_step(step, self._hidden), self._name_map(step))
        what = _format_press(reading, "baseline" if reading.blank else "")
        write_message(
            f"press {step.number}, {what}: ratio {reading.ratio:.4g}; no tumour: {format_probability(step.probability_none)}"
        )

    def _add_step(self) -> Step:
        """Return the map of the readings so far, which is stored for the sequence."""
        from probe_design.surveys.figures import Step

        self.steps.append(Step.from_locator(self.locator, self.locator.next_position()))
        return self.steps[-1]

    def _name_map(self, step: Step) -> Path:
        """Return the file of a step's map."""
        return self.request.output / f"map-{step.number:03d}.png"

    @property
    def _hidden(self) -> Floats | None:
        return None if self.tissue is None else self.tissue.tumours

    def describe(self, stop: Stop) -> JsonObject:
        """Return the entries of the JSON object beside those of `locate`."""
        hidden = {} if self.tissue is None else {"hidden": self.tissue.tumours.tolist()}
        return {
            "stop": {"reason": stop.reason, "text": stop.text},
            "presses": [press.as_dict() for press in self.record.presses],
            "detectable_probability": self.locator.compute_detectable_probability(),
        } | hidden

    def finish(self, stop: Stop) -> tuple[Any, list[str]]:
        """Write the report; return the result as that of `locate`, and the files."""
        from probe_design.locating.report import write_files
        from probe_design.reporting.page import Chapter, Picture, Text
        from probe_design.surveys.figures import LEGEND, draw_sequence

        result = replace(self.locator.map(), next=self.locator.next_position())
        chapters: list[Chapter] = []
        files = []
        if self.steps:
            self.steps[-1] = replace(self.steps[-1], following=None)
            path = self.request.output / SEQUENCE_FILE
            write_figure(draw_sequence(self.steps, self._hidden), path)
            text = f"Stopped after {len(self.record.presses)} presses: {stop.text}."
            parts = (Text(text), Picture.from_file(path, "map after each press"), Text(LEGEND), self.record.build_table())
            chapters = [Chapter("Press by press", parts)]
            files = [str(path)]
        self.record.write({key: value for key, value in self.describe(stop).items() if key != "presses"})
        return result, [*files, *(str(path) for path in write_files(result, self.request.output, chapters))]


def write_figure(figure: Any, path: Path) -> None:
    """Write a figure whole."""
    from probe_design.reporting.picture_files import save_figure

    save_figure(figure, path)


def _format_press(press: Reading | NextPosition, place: str = "") -> str:
    """Return the place of a press, by default its x and y, and its force where it is not the scene's load."""
    from probe_design.estimation.measurements import FORCE_QUANTITY

    place = place or f"x = {press.x * 1e3:.1f} mm, y = {press.y * 1e3:.1f} mm"
    return place if press.force is None else f"{place}, {FORCE_QUANTITY.format_value(press.force)}"
