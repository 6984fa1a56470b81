"""The commands for a built probe as Python functions: `read`, `calibrate`, `check`, `survey`."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypedDict, TypeVar, Unpack

from geometry.scenes.scene import Scene
from geometry.scenes.scene_file import load_scene
from probe_design.commands.hardware import CalibrateRequest, CheckRequest, ReadRequest
from probe_design.commands.hardware_request import DEFAULT_PRESSES, SourceRequest
from probe_design.commands.locate import read_locate_design
from probe_design.commands.request import use_request
from probe_design.commands.survey import SurveyRequest
from probe_design.terminal.console import use_quiet

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from geometry.common.arrays import Floats
    from probe_design.built_probe.calibration_record import CalibrationRecord
    from probe_design.built_probe.reading import StressReading
    from probe_design.commands.hardware_sources import HardwareSetup
    from probe_design.estimation.measurements import Reading
    from probe_design.locating.location import Location
    from probe_design.locating.stopping import Stop
    from probe_design.populations.design_file import DesignSource
    from probe_design.probe_check.check import Check

RequestT = TypeVar("RequestT", bound=SourceRequest)


class SourceOptions(TypedDict, total=False):
    """Keywords of what is read, fields of ``SourceRequest`` and ``ReferenceRequest``, which hold their help and defaults."""

    virtual: bool
    replay: Path | str | Sequence[Path | str]
    column: Mapping[str, str] | Sequence[str]
    rate: str | None
    device: str | None
    seconds: float | None
    record: Path | str | None
    bench: Path | str | None
    built: Mapping[str, str] | Sequence[str]
    seed: int
    linear: bool
    any_probe: bool
    resume: bool
    wait: float | None


@dataclass(frozen=True, repr=False)
class SurveyResult:
    """The result of a survey.

    Attributes
    ----------
    location
        As of ``locate``.
    stop
        Why the survey ended.
    readings
        One for each press.
    files
        That were written.
    hidden
        Tumours of the virtual tissue, shape (n, 5): x, y, depth and diameter, m, and Young's modulus, Pa.
        None without a virtual tissue.
    """

    location: Location
    stop: Stop
    readings: tuple[Reading, ...]
    files: tuple[Path, ...]
    hidden: Floats | None

    def __str__(self) -> str:
        """Return the reason of the end, and the result of ``locate`` in a few lines."""
        from probe_design.locating.report import list_lines

        return "\n".join([f"Stopped after {len(self.readings)} presses: {self.stop.text}.", *list_lines(self.location)])

    __repr__ = __str__


@use_request(ReadRequest, checks=False)
def read(
    scene: Scene | Path | str | None = None, *, calibration: CalibrationRecord | Path | str | None = None,
    accuracy: float | None = None, hide: Path | str | None = None, **source: Unpack[SourceOptions],
) -> StressReading:  # fmt: skip
    """Read a built or virtual probe under a sinusoidal load, and compare stresses and ratio with the prediction.

    Parameters
    ----------
    scene : Scene, or the name of a scene file; default: the calibration's, or the built-in one
        Probe and tissue.
    calibration : CalibrationRecord, or the name of its file; default: nominal gains
        Gains, cross-talk and offsets.

    Returns
    -------
    StressReading
        Ratio and stresses, read and predicted, with standard deviations.

    Raises
    ------
    InputError
        Options contradict each other, or a file is not allowed.
    HardwareError
        A device or a reading cannot be used.

    Examples
    --------
    >>> from probe_design import read
    >>> read("examples/scene.toml", virtual=True, seconds=5).ratio  # doctest: +SKIP
    """
    request, setup = _prepare(ReadRequest, scene, calibration, {"accuracy": accuracy, "hide": hide, **source})
    with use_quiet(True):
        taken = request.take_reading(setup)
    return replace(taken.result, warnings=taken.warnings)


@use_request(CalibrateRequest, checks=False)
def calibrate(
    scene: Scene | Path | str | None = None, *, output: Path | str | None = None, **source: Unpack[SourceOptions]
) -> CalibrationRecord:
    """Calibrate a built or virtual probe: determine gains, cross-talk and offsets from readings on the bench's references.

    Parameters
    ----------
    scene : Scene, or the name of a scene file; default: the built-in one
        Probe and tissue.
    output : name of a new file, optional
        For the record.

    Returns
    -------
    CalibrationRecord
        For ``check`` and ``read``; ``output`` also writes it to a file.

    Raises
    ------
    InputError
        Options contradict each other, or a file is not allowed.
    HardwareError
        A device or a reading cannot be used.
    """
    path = None if output is None else Path(output)
    request, setup = _prepare(CalibrateRequest, scene, None, {"output": path or Path("none"), **source})
    with use_quiet(True):
        return request.calibrate(setup, path)


@use_request(CheckRequest, checks=False)
def check(
    scene: Scene | Path | str | None = None, *, calibration: CalibrationRecord | Path | str | None = None,
    **source: Unpack[SourceOptions],
) -> Check:  # fmt: skip
    """Check a built or virtual probe against its drawing by readings on blocks of tissue.

    Parameters
    ----------
    scene : Scene, or the name of a scene file; default: the calibration's, or the built-in one
        Probe and tissue.
    calibration : CalibrationRecord, or the name of its file; default: nominal gains
        Gains, cross-talk and offsets.

    Returns
    -------
    Check
        Verdict with its reason, deviations, what was tested and what could not be.

    Raises
    ------
    InputError
        Options contradict each other, or a file is not allowed.
    HardwareError
        A device or a reading cannot be used.
    """
    request, setup = _prepare(CheckRequest, scene, calibration, dict(source))
    with use_quiet(True):
        return request.check(setup)


@use_request(SurveyRequest, checks=False)
def survey(
    design: DesignSource, output: Path | str, *, presses: int = DEFAULT_PRESSES, hide: Path | str | None = None,
    outliers: float = 0.0, calibration: Path | str | None = None, **source: Unpack[SourceOptions],
) -> SurveyResult:  # fmt: skip
    """Survey a tissue with a built or virtual probe: press after press where the next reading says most, until a reason to stop.

    Parameters
    ----------
    design : Design, mapping, or the name of a design file
        Probe, tissue, population and noise.

    Returns
    -------
    SurveyResult
        The tumours as ``locate`` has them, why the survey stopped, and all readings; ``output`` holds recordings and report.

    Raises
    ------
    InputError
        Options contradict each other, or ``output`` holds another survey.
    HardwareError
        A device or a reading cannot be used.
    """
    options = {"presses": presses, "hide": hide, "outliers": outliers, "calibration": calibration, **source}
    # the request of the command line has the name of the design's file; here the design is read already
    request = SurveyRequest.build({"scene": Path("design"), "output": output, **options})
    with use_quiet(True):
        running = request.prepare_survey(read_locate_design(design))
        stop = running.press_until_stop()
        location, files = running.finish(stop)
    readings = tuple(press.reading for press in running.record.presses)
    hidden = None if running.tissue is None else running.tissue.tumours
    return SurveyResult(location, stop, readings, tuple(map(Path, files)), hidden)


def _prepare(
    kind: type[RequestT], scene: Scene | Path | str | None, calibration: Any, values: dict[str, Any]
) -> tuple[RequestT, HardwareSetup]:
    """Return the request with the values of its options, and scene, bench and calibration."""
    from probe_design.commands.hardware_sources import HardwareSetup

    request = kind.build(values)
    record = Path(calibration) if isinstance(calibration, str) else calibration
    source = Path(scene) if isinstance(scene, str) else scene
    if source is not None and not isinstance(source, Path):
        source = load_scene(source)  # which refuses what is no scene
    return request, HardwareSetup.from_files(source, request.bench, record)
