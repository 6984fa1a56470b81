"""Show speed against accuracy: tables for the terminal and the page, and the files of `probe-design tradeoff`."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from statistics import median

from geometry.common.files import write_together
from geometry.common.json_types import JsonObject
from geometry.common.percent import format_percent
from geometry.provenance.block import build_provenance
from probe_design.reporting.page import Chapter, Items, Picture, Text, build_page
from probe_design.reporting.scene_sections import build_scene_section
from probe_design.reporting.table import Table
from probe_design.tradeoffs.plot import plot_tradeoff
from probe_design.tradeoffs.rows import Row, Setting
from probe_design.tradeoffs.study import Tradeoff

FILE_NAMES = ("tradeoff.png", "tradeoff.md", "tradeoff.json", "report.html")
Cells = tuple[str, ...]
SUMMARY_HEADINGS = (
    "evaluator", "accuracy requested", "scenes", "worst stated error", "worst true error", "log-sensitivity error",
    "first result, s", "new probe, s", "next tumour, s", "slowest, s",
)  # fmt: skip
TERMINAL_HEADINGS = {  # of the columns of the summary that fit into 80 characters
    0: "evaluator", 1: "requested", 2: "scenes", 3: "stated\nerror", 4: "true\nerror", 7: "new\nprobe, s", 8: "next\ntumour, s",
}  # fmt: skip
CHOICE_HEADINGS = ("scene", "within", "cheapest that states it", "cheapest that is within it")
ROW_HEADINGS = (
    "scene", "evaluator", "accuracy requested", "ratio", "stated error", "true error", "log-sensitivity error", "first result, s",
    "new probe, s", "next tumour, s",
)  # fmt: skip
CHARGE_HEADINGS = ("charge per force, inner, pC/N", "charge per force, outer, pC/N")
COLUMN_NOTES = """\
Ratio: what the scene reads, of charges or of stresses. Stated error: the bound on the relative error of the ratio that comes with
each result. True error: difference from the reference, the finest result of any converging evaluator; <: at most this, as the
difference is below the reference's own stated error. *: for some scenes the reference is of the same evaluator: the difference
then shows its convergence, but no error that all its settings share; equivalent-inclusion and axisymmetric share the model of the
probe on tissue without tumours. Log-sensitivity error: relative to the reference's, or to 1e-5 where that is smaller; the
reference's own error is not counted. First result: includes what a process computes only once. New probe: nothing is cached. Next
tumour: another one under the same probe. Slowest: of the new probes. Times are medians of wall clock; only their ratios carry
over to other machines."""


def write_files(study: Tradeoff, folder: Path) -> list[Path]:
    """Write picture, table of all settings, JSON file and page into ``folder``, all or none; return their paths.

    Raises
    ------
    OSError
        The folder cannot be written.
    """
    files = [folder / name for name in FILE_NAMES]
    summary = study.as_dict() | {"files": [str(file) for file in files], "provenance": build_provenance()}
    with write_together(folder, FILE_NAMES) as new_folder:
        picture, table, data, page = (new_folder / name for name in FILE_NAMES)
        plot_tradeoff(study, picture)
        table.write_text(Table(SUMMARY_HEADINGS, build_summary_cells(study)).to_markdown(), encoding="utf-8")
        data.write_text(json.dumps(summary, indent=2, allow_nan=False) + "\n", encoding="utf-8")
        page.write_text(_build_page(study, picture, summary), encoding="utf-8")
    return files


def _build_page(study: Tradeoff, picture: Path, summary: JsonObject) -> str:
    """Return the page as HTML; ``picture`` is the file of the plot, ``summary`` the JSON object that the page contains."""
    has_charges = any(row.charge_per_force_inner is not None for row in study.rows)
    results = [row for row in study.rows if row.ratio is not None]
    rows = [(*_format_row(row), *_format_charges(row)[: 2 * has_charges]) for row in results]
    refusals = dict.fromkeys(f"{row.scene}, {row.evaluator}: {row.reason}" for row in study.rows if row.reason is not None)
    skipped = [f"{name}: {reason}" for name, reason in study.skipped.items()]
    sections = (
        Chapter("Error against time", (Picture.from_file(picture, "error against time of every evaluator and setting"),)),
        Chapter("Every setting", (Table(SUMMARY_HEADINGS, build_summary_cells(study)), Text(COLUMN_NOTES))),
        Chapter("The cheapest for each scene", (Table(CHOICE_HEADINGS, _build_choice_cells(study)),)),
        Chapter("Every result", (Table((*ROW_HEADINGS, *CHARGE_HEADINGS[: 2 * has_charges]), rows),)),
        Chapter("Not evaluated, or no result", (Items((*skipped, *refusals) or ("nothing",)),)),
        *(build_scene_section(scene, f"The scene {name}") for name, scene in study.scenes.items()),
    )
    headline = f"{len(study.rows)} results of {len(study.scenes)} scenes, timed and compared with a reference."
    return build_page("Speed against accuracy", headline, sections, summary)


def build_summary_table(study: Tradeoff) -> Table:
    """Return the summary for the terminal."""
    rows = [tuple(row[column] for column in TERMINAL_HEADINGS) for row in build_summary_cells(study)]
    return Table(tuple(TERMINAL_HEADINGS.values()), rows, "errors and times of each setting")


def build_choice_table(study: Tradeoff) -> Table:
    """Return the table of the fastest setting within each stated tolerance, for the terminal; each scene is named once."""
    rows = [row[:3] for row in _build_choice_cells(study)]
    previous_names = ["", *(row[0] for row in rows)]
    short_rows = [("" if row[0] == name else row[0], *row[1:]) for row, name in zip(rows, previous_names, strict=False)]
    return Table(CHOICE_HEADINGS[:3], short_rows, "the fastest setting for each scene", left=(0, 1, 2))


def _build_choice_cells(study: Tradeoff) -> list[Cells]:
    """Return a table row for each scene and tolerance: the fastest settings whose stated, and whose true error is within it."""
    return [
        (name, format_percent(tolerance, 6), _format_choice(stated), _format_choice(true))
        for name, tolerance, stated, true in study.iterate_choices()
    ]


def build_summary_cells(study: Tradeoff) -> list[Cells]:
    """Return a table row for each setting: the worst errors over all scenes, and the median times."""
    return [_summarize_setting(setting, [row for row in study.rows if row.setting == setting]) for setting in study.settings]


def _summarize_setting(setting: Setting, rows: Sequence[Row]) -> Cells:
    """Return the row of a setting: worst errors and median times over all scenes."""
    results = [row for row in rows if row.ratio is not None]
    cells = (*_format_setting_cells(setting), f"{len(results)}/{len(rows)}")
    if not results:
        return (*cells, *("-",) * (len(SUMMARY_HEADINGS) - len(cells)))

    def list_values(key: str) -> list[float]:
        """Return the known values of an attribute of the results."""
        return [value for value in (getattr(row, key) for row in results) if value is not None]

    times = [list_values(key) for key in ("seconds_first", "seconds_probe", "seconds_tumour")]
    return (
        *cells,
        _format_stated_error(max(results, key=lambda row: row.stated_error or 0.0)),
        _format_worst_error(results),
        _format_error(max(list_values("log_sensitivity_error"), default=None)),
        *(_format_seconds(median(seconds) if seconds else None) for seconds in times),
        _format_seconds(max(times[1])),
    )


def _format_row(row: Row) -> Cells:
    """Return the table row of one result."""
    times = (_format_seconds(seconds) for seconds in (row.seconds_first, row.seconds_probe, row.seconds_tumour))
    errors = (_format_stated_error(row), _format_true_error(row), _format_error(row.log_sensitivity_error))
    ratio = f"{row.ratio:.6g}" + (" (charges)" if row.observable == "charge" else "")
    return (row.scene, *_format_setting_cells(row.setting), ratio, *errors, *times)


def _format_charges(row: Row) -> Cells:
    """Return the cells of both films' charge per force; "-" where there is none."""
    values = (row.charge_per_force_inner, row.charge_per_force_outer)
    return tuple("-" if value is None else f"{1e12 * value:.5g}" for value in values)


def _format_stated_error(row: Row) -> str:
    """Format the stated error of a row, and its kind where it is no bound."""
    return _format_error(row.stated_error) + ("" if row.error_kind == "bound" else f" ({row.error_kind})")


def _format_worst_error(results: Sequence[Row]) -> str:
    """Format the worst true error of a setting; ``*`` if a reference is of the same evaluator."""
    compared = [row for row in results if row.true_error is not None]
    if not compared:
        return "reference" if any(row.reference for row in results) else "-"
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
    """Format the chosen row as its setting and time; "none" without one."""
    return "none" if row is None else f"{row.setting}, {_format_seconds(row.seconds_probe)} s"


def _format_setting_cells(setting: Setting) -> tuple[str, str]:
    """Return the table cells of a setting: evaluator, and requested accuracy if it has one."""
    return setting.evaluator, "-" if setting.accuracy is None else format_percent(setting.accuracy, 6)


def _format_error(value: float | None) -> str:
    """Format a relative error with two digits; "-" if it is unknown."""
    return "-" if value is None else format_percent(value)


def _format_seconds(value: float | None) -> str:
    """Format a time in s with two digits, or whole seconds from 100 s; "-" if it is unknown."""
    if value is None:
        return "-"
    return f"{value:.2g}" if value < 100 else f"{value:.0f}"
