"""Tables of speed against accuracy: as Markdown, for the HTML report and for the terminal."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from html import escape
from statistics import median

from geometry.common.errors import escape_unprintable
from probe_design.reporting.table import Table
from probe_design.tradeoffs.rows import Row, Setting
from probe_design.tradeoffs.study import Tradeoff

Cells = tuple[str, ...]
SUMMARY_HEADINGS = (
    "evaluator", "accuracy requested", "scenes", "worst stated error", "worst true error", "log-sensitivity error",
    "first result, s", "new probe, s", "next tumour, s", "slowest, s",
)  # fmt: skip
TERMINAL_HEADINGS = ("evaluator", "requested", "scenes", "stated\nerror", "true\nerror", "new\nprobe, s", "next\ntumour, s")
CHOICE_HEADINGS = ("scene", "within", "cheapest that states it", "cheapest that is within it")
ROW_HEADINGS = (
    "scene", "evaluator", "accuracy requested", "ratio", "stated error", "true error", "log-sensitivity error", "first result, s",
    "new probe, s", "next tumour, s",
)  # fmt: skip
# signs with a meaning in Markdown: anywhere, beside words, or at the beginning of a line
_MARKDOWN_SIGNS = re.compile(r"[\\`*\[\]~$]|(?<!\w)_|_(?!\w)|^[#+-]|(?<=^\d)[.)]|(?<=^\d\d)[.)]")
COLUMN_NOTES = """\
Stated error: the bound on the relative error of the ratio that comes with each answer. True error: difference from the
reference, the finest result of any converging evaluator; `<`: at most this, as the difference is below the reference's own stated
error. `*`: for some scenes the reference is of the same evaluator: the difference then shows its convergence, but no error that
all its settings share; equivalent-inclusion and axisymmetric share the model of the probe on tissue without tumours.
Log-sensitivity error: relative to the reference's, or to 1e-5 where that is smaller; the reference's own error is not counted.
First result: includes what a process computes only once. New probe: nothing is cached. Next tumour: another one under the same
probe. Slowest: of the new probes. Times are medians of wall clock; only their ratios carry over to other machines."""


def build_summary_cells(study: Tradeoff) -> list[Cells]:
    """Return a table row for each setting: the worst errors over all scenes, and the median times."""
    return [_summarize_setting(study, setting) for setting in study.settings]


def build_choice_cells(study: Tradeoff) -> list[Cells]:
    """Return, for each scene and tolerance, the fastest setting with its stated error within it, and with its true error."""
    return [
        (name, f"{100 * tolerance:g} %", _format_choice(stated), _format_choice(true))
        for name, tolerance, stated, true in study.iterate_choices()
    ]


def build_row_cells(study: Tradeoff) -> list[Cells]:
    """Return a table row for each scene and setting with a result."""
    return [_format_row(row) for row in study.rows if row.ratio is not None]


def build_markdown_page(study: Tradeoff, picture: str) -> str:
    """Build the page with all tables in Markdown; ``picture`` is the file name of the plot."""
    refusals = [
        f"- {escape_markdown(f'{row.scene}, {row.evaluator}: {row.reason}')}" for row in study.rows if row.reason is not None
    ]
    skipped = [f"- {escape_markdown(f'{name}: {reason}')}" for name, reason in study.skipped.items()]
    return "\n\n".join(
        (
            "# Speed against accuracy",
            f"![Error against time]({picture})",
            Table(SUMMARY_HEADINGS, build_summary_cells(study)).to_markdown(),
            COLUMN_NOTES,
            "## The cheapest for each scene",
            Table(CHOICE_HEADINGS, _escape_scene_names(build_choice_cells(study))).to_markdown(),
            "## Every result",
            Table(ROW_HEADINGS, _escape_scene_names(build_row_cells(study))).to_markdown(),
            "## Not evaluated, or no result",
            "\n".join((*skipped, *dict.fromkeys(refusals))) + "\n",
        )
    )


def escape_markdown(text: str) -> str:
    """Escape untrusted text so that Markdown shows it literally: no HTML, links, emphasis or terminal codes."""
    return _MARKDOWN_SIGNS.sub(r"\\\g<0>", escape(escape_unprintable(text), quote=False))


def _escape_scene_names(rows: Iterable[Cells]) -> list[Cells]:
    """Escape the first cell, a scene's name, of each row."""
    return [(escape_markdown(name), *cells) for name, *cells in rows]


def build_summary_table(study: Tradeoff) -> Table:
    """Build the summary for the terminal: the columns that fit into 80 characters."""
    columns = [0, 1, 2, 3, 4, 7, 8]
    rows = [tuple(row[k] for k in columns) for row in build_summary_cells(study)]
    return Table(TERMINAL_HEADINGS, rows, "errors and times of each setting")


def build_choice_table(study: Tradeoff) -> Table:
    """Build the table of the fastest setting within each stated tolerance, for the terminal; each scene is named once."""
    rows = [row[:3] for row in build_choice_cells(study)]
    previous_names = ["", *(row[0] for row in rows)]
    short_rows = [("" if row[0] == name else row[0], *row[1:]) for row, name in zip(rows, previous_names, strict=False)]
    return Table(CHOICE_HEADINGS[:3], short_rows, "the fastest setting for each scene", left=(0, 1, 2))


def _summarize_setting(study: Tradeoff, setting: Setting) -> Cells:
    """Build the row of a setting: worst errors and median times over all scenes."""
    rows = [row for row in study.rows if row.setting == setting]
    answers = [row for row in rows if row.ratio is not None]
    if not answers:
        return (*_format_setting_cells(setting), f"0/{len(rows)}", *("-",) * (len(SUMMARY_HEADINGS) - 3))
    slowest = max(row.seconds_probe or 0.0 for row in answers)
    return (
        *_format_setting_cells(setting),
        f"{len(answers)}/{len(rows)}",
        _format_stated_error(max(answers, key=lambda row: row.stated_error or 0.0)),
        _format_worst_error(answers),
        _format_error(_pick_max(answers, lambda row: row.log_sensitivity_error)),
        _format_seconds(_pick_median(answers, lambda row: row.seconds_first)),
        _format_seconds(_pick_median(answers, lambda row: row.seconds_probe)),
        _format_seconds(_pick_median(answers, lambda row: row.seconds_tumour)),
        _format_seconds(slowest),
    )


def _format_row(row: Row) -> Cells:
    times = (_format_seconds(seconds) for seconds in (row.seconds_first, row.seconds_probe, row.seconds_tumour))
    errors = (_format_stated_error(row), _format_true_error(row), _format_error(row.log_sensitivity_error))
    return (row.scene, *_format_setting_cells(row.setting), f"{row.ratio:.6g}", *errors, *times)


def _format_stated_error(row: Row) -> str:
    """Format the stated error of a row, and its kind where it is no bound."""
    return _format_error(row.stated_error) + ("" if row.error_kind == "bound" else f" ({row.error_kind})")


def _format_worst_error(answers: Sequence[Row]) -> str:
    """Format the worst true error of a setting; ``*`` if a reference is of the same evaluator."""
    compared = [row for row in answers if row.true_error is not None]
    if not compared:
        return "reference" if any(row.reference for row in answers) else "-"
    text = _format_true_error(max(compared, key=lambda row: row.true_error_most or 0.0)).rstrip("*")
    return text + "*" * any(row.same_level for row in compared)


def _format_true_error(row: Row) -> str:
    """Format the true error of a row; ``<`` if only its upper limit is known."""
    if row.reference:
        return "reference"
    if row.true_error is None:
        return "-"
    return (_format_error(row.true_error) if row.is_resolved else f"<{_format_error(row.true_error_most)}") + "*" * row.same_level


def _format_choice(row: Row | None) -> str:
    return "none" if row is None else f"{_format_setting(row.setting)}, {_format_seconds(row.seconds_probe)} s"


def _format_setting(setting: Setting) -> str:
    return setting.evaluator if setting.accuracy is None else f"{setting.evaluator} at {setting.accuracy:g}"


def _format_setting_cells(setting: Setting) -> tuple[str, str]:
    return setting.evaluator, "-" if setting.accuracy is None else f"{setting.accuracy:g}"


def _pick_values(rows: Sequence[Row], pick: Callable[[Row], float | None]) -> list[float]:
    return [value for value in map(pick, rows) if value is not None]


def _pick_max(rows: Sequence[Row], pick: Callable[[Row], float | None]) -> float | None:
    return max(_pick_values(rows, pick), default=None)


def _pick_median(rows: Sequence[Row], pick: Callable[[Row], float | None]) -> float | None:
    values = _pick_values(rows, pick)
    return median(values) if values else None


def _format_error(value: float | None) -> str:
    return "-" if value is None else f"{value:.1e}"


def _format_seconds(value: float | None) -> str:
    if value is None:
        return "-"
    return f"{value:.2g}" if value < 100 else f"{value:.0f}"
