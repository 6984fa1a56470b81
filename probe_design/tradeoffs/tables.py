"""Tables of speed against accuracy: as Markdown, for the HTML report and for the terminal."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from html import escape
from statistics import median

from rich.box import SIMPLE_HEAD
from rich.table import Table

from geometry.common.errors import printable
from probe_design.tradeoffs.rows import Row, Setting
from probe_design.tradeoffs.study import Tradeoff

Cells = tuple[str, ...]
SUMMARY = (
    "evaluator", "accuracy asked", "scenes", "worst stated error", "worst true error", "log-sensitivity off by",
    "first answer, s", "new probe, s", "next tumour, s", "slowest, s",
)  # fmt: skip
BRIEF = ("evaluator", "asked", "scenes", "stated\nerror", "true\nerror", "new\nprobe, s", "next\ntumour, s")
CHOICES = ("scene", "within", "cheapest that states it", "cheapest that is within it")
EACH = (
    "scene", "evaluator", "accuracy asked", "ratio", "stated error", "true error", "log-sensitivity off by", "first answer, s",
    "new probe, s", "next tumour, s",
)  # fmt: skip
# signs with a meaning in Markdown: anywhere, beside words, or at the beginning of a line
_MARKS = re.compile(r"[\\`*\[\]~$]|(?<!\w)_|_(?!\w)|^[#+-]|(?<=^\d)[.)]|(?<=^\d\d)[.)]")
TEXT = ("evaluator", *CHOICES)  # left-aligned columns; numbers are right-aligned
NOTES = """\
Stated error: the bound on the relative error of the ratio that comes with each answer. True error: difference from the
reference, the finest result of any converging evaluator; `<`: at most this, as the difference is below the reference's own stated
error. `*`: for some scenes the reference is of the same evaluator: the difference then shows its convergence, but no error that
all its settings share; equivalent-inclusion and axisymmetric share the model of the probe on tissue without tumours.
Log-sensitivity off by: relative to the reference's, or to 1e-5 where that is smaller; the reference's own error is not counted.
First answer: includes what a process computes only once. New probe: nothing is cached. Next tumour: another one under the same
probe. Slowest: of the new probes. Times are medians of wall clock; only their ratios carry over to other machines."""


def summary_cells(study: Tradeoff) -> list[Cells]:
    """Return a table row for each setting: the worst errors over all scenes, and the median times."""
    return [_summary(study, setting) for setting in study.settings]


def choice_cells(study: Tradeoff) -> list[Cells]:
    """Return, for each scene and tolerance, the fastest setting with its stated error within it, and with its true error."""
    return [(name, f"{100 * tolerance:g} %", _chosen(stated), _chosen(true)) for name, tolerance, stated, true in study.choices()]


def row_cells(study: Tradeoff) -> list[Cells]:
    """Return a table row for each scene and setting with a result."""
    return [_each(row) for row in study.rows if row.ratio is not None]


def page(study: Tradeoff, picture: str) -> str:
    """Build the page with all tables in Markdown; ``picture`` is the file name of the plot."""
    refusals = [f"- {literal(f'{row.scene}, {row.evaluator}: {row.reason}')}" for row in study.rows if row.reason is not None]
    skipped = [f"- {literal(f'{name}: {why}')}" for name, why in study.skipped.items()]
    return "\n\n".join(
        (
            "# Speed against accuracy",
            f"![Error against time]({picture})",
            markdown(SUMMARY, summary_cells(study)),
            NOTES,
            "## The cheapest for each scene",
            markdown(CHOICES, _scenes_literal(choice_cells(study))),
            "## Every result",
            markdown(EACH, _scenes_literal(row_cells(study))),
            "## Not evaluated, or no result",
            "\n".join((*skipped, *dict.fromkeys(refusals))) + "\n",
        )
    )


def literal(text: str) -> str:
    """Escape untrusted text so that Markdown shows it literally: no HTML, links, emphasis or terminal codes."""
    return _MARKS.sub(r"\\\g<0>", escape(printable(text), quote=False))


def _scenes_literal(rows: Iterable[Cells]) -> list[Cells]:
    """Escape the first cell, a scene's name, of each row."""
    return [(literal(name), *others) for name, *others in rows]


def markdown(headings: Sequence[str], rows: Iterable[Cells]) -> str:
    """Build a table in Markdown."""
    head = ["| " + " | ".join(headings) + " |", "|---" * len(headings) + "|"]
    return "\n".join([*head, *("| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in rows)])


def summary_table(study: Tradeoff) -> Table:
    """Build the summary for the terminal: the columns that fit into 80 characters."""
    columns = [0, 1, 2, 3, 4, 7, 8]
    rows = [tuple(row[k] for k in columns) for row in summary_cells(study)]
    return _terminal("errors and times of each setting", BRIEF, rows)


def choice_table(study: Tradeoff) -> Table:
    """Build the table of the fastest setting within each stated tolerance, for the terminal; each scene is named once."""
    rows = [row[:3] for row in choice_cells(study)]
    before = ["", *(row[0] for row in rows)]
    shown = [("" if row[0] == name else row[0], *row[1:]) for row, name in zip(rows, before, strict=False)]
    return _terminal("the fastest setting for each scene", CHOICES[:3], shown)


def _terminal(title: str, headings: Sequence[str], rows: Iterable[Cells]) -> Table:
    table = Table(title=title, box=SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False)
    for heading in headings:
        table.add_column(heading, justify="left" if heading in TEXT else "right", no_wrap=heading == "evaluator")
    for row in rows:
        table.add_row(*row)
    return table


def _summary(study: Tradeoff, setting: Setting) -> Cells:
    """Build the row of a setting: worst errors and median times over all scenes."""
    rows = [row for row in study.rows if row.setting == setting]
    answers = [row for row in rows if row.ratio is not None]
    if not answers:
        return (*_words(setting), f"0/{len(rows)}", *("-",) * (len(SUMMARY) - 3))
    largest = max(row.seconds_probe or 0.0 for row in answers)
    return (
        *_words(setting),
        f"{len(answers)}/{len(rows)}",
        _small(_most(answers, lambda row: row.stated_error)),
        _worst_true(answers),
        _small(_most(answers, lambda row: row.log_sensitivity_error)),
        _seconds(_middle(answers, lambda row: row.seconds_first)),
        _seconds(_middle(answers, lambda row: row.seconds_probe)),
        _seconds(_middle(answers, lambda row: row.seconds_tumour)),
        _seconds(largest),
    )


def _each(row: Row) -> Cells:
    times = (_seconds(seconds) for seconds in (row.seconds_first, row.seconds_probe, row.seconds_tumour))
    errors = (_small(row.stated_error), _true(row), _small(row.log_sensitivity_error))
    return (row.scene, *_words(row.setting), f"{row.ratio:.6g}", *errors, *times)


def _worst_true(answers: Sequence[Row]) -> str:
    """Format the worst true error of a setting; ``*`` if a reference is of the same evaluator."""
    compared = [row for row in answers if row.true_error is not None]
    if not compared:
        return "reference" if any(row.reference for row in answers) else "-"
    text = _true(max(compared, key=lambda row: row.true_error_most or 0.0)).rstrip("*")
    return text + "*" * any(row.same_level for row in compared)


def _true(row: Row) -> str:
    """Format the true error of a row; ``<`` if only its upper limit is known."""
    if row.reference:
        return "reference"
    if row.true_error is None:
        return "-"
    return (_small(row.true_error) if row.resolved else f"<{_small(row.true_error_most)}") + "*" * row.same_level


def _chosen(row: Row | None) -> str:
    return "none" if row is None else f"{_name(row.setting)}, {_seconds(row.seconds_probe)} s"


def _name(setting: Setting) -> str:
    return setting.evaluator if setting.accuracy is None else f"{setting.evaluator} at {setting.accuracy:g}"


def _words(setting: Setting) -> tuple[str, str]:
    return setting.evaluator, "-" if setting.accuracy is None else f"{setting.accuracy:g}"


def _values(rows: Sequence[Row], pick: Callable[[Row], float | None]) -> list[float]:
    return [value for value in map(pick, rows) if value is not None]


def _most(rows: Sequence[Row], pick: Callable[[Row], float | None]) -> float | None:
    return max(_values(rows, pick), default=None)


def _middle(rows: Sequence[Row], pick: Callable[[Row], float | None]) -> float | None:
    values = _values(rows, pick)
    return median(values) if values else None


def _small(value: float | None) -> str:
    return "-" if value is None else f"{value:.1e}"


def _seconds(value: float | None) -> str:
    if value is None:
        return "-"
    return f"{value:.2g}" if value < 100 else f"{value:.0f}"
