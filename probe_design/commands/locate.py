"""The command `locate`: from a scan of readings to number, place, depth and size of the tumours."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import Field

from geometry.common.errors import InputError, Words
from geometry.common.files import check_writable
from probe_design.commands.estimate import check_readings_source
from probe_design.commands.fields import AnyProbe, LimitedRequest, Outliers, Picture
from probe_design.commands.output import print_result
from probe_design.commands.request import Option, use_request
from probe_design.reporting.picture_files import save_figure
from probe_design.terminal.console import show_spinner, warn, write_message

if TYPE_CHECKING:
    from probe_design.estimation.measurements import Reading
    from probe_design.locating.location import Location
    from probe_design.populations.design_file import Design, DesignSource


class LocateRequest(LimitedRequest):
    """Infer from a scan how many tumours there are, and where, how deep, how large and how stiff each one is.

    DESIGN is a design file (`optimize --template` prints one), or the folder that optimize wrote. Its scene is the probe and the
    tissue, [population] says what is known of tumours before the readings, [noise] how uncertain a reading is. The result is
    conditional on that population: it is no diagnosis. Before the readings every number of tumours from none to [population]
    tumours is equally probable, unless weights says otherwise. Where the readings do not narrow a quantity, the result says so.

    \b
    probe-design locate DESIGN.toml --readings scan.csv -o out
    probe-design locate DESIGN.toml --readings scan.csv --next --json
    probe-design locate DESIGN.toml --reading "a.probe, x=30 mm, y=0 mm, blank=true" --reading "b.probe, x=-8 mm, y=-8 mm" ...

    \b
    scan.csv holds one press a line (or scan.toml, tables [[reading]] with these keys):
    x,     y,     ratio, stiffness, x_sd,   y_sd,   blank
    30 mm, 0 mm,  0.51,  78 N/m,    0 mm,   0 mm,   true
    -8 mm, -8 mm, 0.55,  79 N/m,    0.5 mm, 0.5 mm, false

    x and y are the probe's axis in the scene's frame. blank is true for the baseline reading, over tumour-free tissue, which has
    the gain of the scan. noise and stiffness_noise, where a column states them, replace those of the design file, x_sd and y_sd
    its pose. --outliers states the fraction of wild readings that is expected: these then count less, and intervals widen.
    """  # noqa: D301

    design: Annotated[
        Path | Any,
        Field(description="a Design, its tables, or the name of a design file"),  # which ``read_locate_design`` checks
        Option("Design file, or folder of optimize.", is_argument=True),
    ]
    readings_file: Annotated[Path | None, Option("Readings of the scan: a .toml or .csv file, see below.", "--readings")] = None
    reading: Annotated[
        tuple[str, ...],
        Option("In place of --readings: a recording, and its place where it states none, once for each press; see below."),
    ] = ()
    calibration: Annotated[Path | None, Option("Of recordings: file that calibrate has written.")] = None
    bench: Annotated[Path | None, Option("Of recordings: TOML file of load and amplifier.")] = None
    any_probe: AnyProbe = False
    output: Annotated[Path | None, Option("Folder for a report with pictures and numbers.", "-o/--output")] = None
    advise: Annotated[bool, Option("Report which place is expected to say the most about the tumours.", "--next")] = False
    outliers: Outliers = 0.0
    seed: Annotated[int, Field(ge=0, le=2**31 - 1), Option("Of the random numbers; the same seed gives the same result.")] = 0
    picture: Annotated[Picture, Option("Draw the map and the residuals to this .png, .svg or .pdf file.", "--plot")] = None

    def run(self) -> None:
        """Locate the tumours, draw and write what is requested, and print the result."""
        from probe_design.locating.figures import draw_location
        from probe_design.locating.report import build_tables, list_lines, write_files
        from probe_design.locating.run import run_locate

        if self.output is not None:
            check_writable(self.output)
        design, readings = self.read_input()
        with show_spinner(f"locating tumours in {self.readings_file or 'recordings'}"):
            result = run_locate(design, readings, self.outliers, self.seed, advise=self.advise)
        if self.picture is not None:
            save_figure(draw_location(result), self.picture)
        if self.output is not None:
            write_files(result, self.output)
        print_result(result.as_dict, lambda: build_tables(result), self.as_json, lambda: list_lines(result))
        if not self.as_json:
            warn(result.warnings)
            if self.output is not None:
                write_message(f"wrote {self.output / 'report.html'}")

    def read_input(self) -> tuple[Design, tuple[Reading, ...] | Path]:
        """Return the design and the readings: their file, or those of the recordings with the gain of their calibration."""
        design = read_locate_design(self.design)
        if (self.readings_file is None) == (not self.reading):
            given = Words("missing" if self.readings_file is None else "given beside --reading")
            raise InputError("readings", given, "--readings FILE, or --reading RECORDING once for each press")
        if self.readings_file is not None:
            if self.calibration is not None or self.bench is not None:
                raise InputError("calibration", Words("given beside --readings"), "nothing: it is that of recordings, --reading")
            return design, self.readings_file
        from hw.files.columns import ColumnMap
        from probe_design.commands.hardware_sources import HardwareSetup
        from probe_design.commands.scan_recordings import read_scan_recordings, use_calibration

        setup = HardwareSetup.from_scene(design.scene, self.bench, self.calibration)
        readings, warnings = read_scan_recordings(
            setup, design, self.reading, columns=ColumnMap(), rate=None, any_probe=self.any_probe
        )
        warn(warnings)
        return use_calibration(design, self.calibration), readings


@use_request(LocateRequest)
def locate(
    design: DesignSource,
    *,
    readings: tuple[Reading, ...] | Path | str,
    outliers: float = 0.0,
    seed: int = 0,
    advise: bool = False,
) -> Location:
    """Infer number, place, depth, size and contrast of tumours from a scan.

    Parameters
    ----------
    design : Design, mapping, or the name of a design file
        Probe, tissue, population and noise.
    readings : tuple of Reading, or the name of a .toml or .csv file
        The scan; see ``probe-design locate --help``.

    Returns
    -------
    Location
        Probabilities of the number of tumours, and the posterior of each tumour, conditional on the population.

    Raises
    ------
    InputError
        A reading is not allowed, there are too few of them, or all lie at one place.
    Refusal
        The evaluator cannot model the scene or its load.
    """
    from probe_design.locating.run import run_locate

    return run_locate(read_locate_design(design), check_readings_source(readings), outliers, seed, advise=advise)


def read_locate_design(source: DesignSource) -> Design:
    """Return a design; raise ``InputError`` for a scene, which has no population."""
    from probe_design.populations.design_file import Design, read_design_source

    design = read_design_source(source)
    if not isinstance(design, Design):
        allowed = "a design file, with [population] and [noise]; `probe-design optimize --template` prints one"
        raise InputError("design", Words("a scene file"), allowed)
    return design
