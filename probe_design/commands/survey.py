"""The command `survey`: press, update the map, say where to press next, and when to stop."""

from __future__ import annotations

from typing import TYPE_CHECKING

from geometry.common.files import check_writable
from probe_design.commands.hardware_request import SurveyOptions
from probe_design.commands.locate import read_locate_design
from probe_design.commands.output import print_result
from probe_design.terminal.console import show_spinner, warn, write_message

if TYPE_CHECKING:
    from probe_design.commands.survey_session import Survey
    from probe_design.populations.design_file import Design


class SurveyRequest(SurveyOptions):
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

    def run(self) -> None:
        """Survey, and print the result."""
        from probe_design.locating.report import build_tables, list_lines

        survey = self.prepare_survey(read_locate_design(self.scene))
        stop = survey.press_until_stop()
        result, files = survey.finish(stop)
        json_object = result.as_dict() | survey.describe(stop) | {"files": files}
        lines = [survey.describe_end(stop), *list_lines(result)]
        print_result(lambda: json_object, lambda: build_tables(result), self.as_json, lambda: lines)
        if not self.as_json:
            warn(result.warnings)
            write_message(f"wrote {self.output / 'report.html'}")

    def prepare_survey(self, design: Design) -> Survey:
        """Return the survey before its next press, interrupted or not."""
        from probe_design.commands.reference_readings import require_terminal
        from probe_design.commands.survey_session import Survey

        require_terminal(self)  # before the map is prepared, which takes half a minute
        check_writable(self.output)
        survey = Survey.prepare(self, design)
        with show_spinner("preparing the map"):
            survey.start()
        return survey
