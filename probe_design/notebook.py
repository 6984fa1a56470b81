"""Display of results and figures in notebooks. IPython gets them when it imports the package; results do not know them."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from html import escape
from io import BytesIO
from typing import TYPE_CHECKING

import numpy as np

from probe_design.reporting.table import Table, format_number
from solver.results.record import find_shown_unit

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from probe_design.design_search.optimum import TumourOptimum
    from solver.results.record import Record

MAX_TABLE_ROWS = 12  # rows of a long table that a notebook shows

FIGURE_DPI = 72  # of a figure in a notebook: 500 to 800 pixels wide


def register_displays() -> None:
    """Make a running IPython show results as tables; nothing happens elsewhere, and no result is imported."""
    shell = sys.modules["IPython"].get_ipython() if "IPython" in sys.modules else None
    if shell is not None:
        formatters = shell.display_formatter.formatters
        formatters["image/png"].for_type_by_name("matplotlib.figure", "Figure", draw_png)  # those of ``plot`` are not pyplot's
        formatter = formatters["text/html"]
        formatter.for_type_by_name("solver.results.record", "Record", format_record)
        formatter.for_type_by_name("probe_design.design_search.optimum", "TumourOptimum", format_optimum)


def draw_png(figure: Figure) -> bytes:
    """Return a figure as the bytes of a PNG file."""
    file = BytesIO()
    figure.savefig(file, format="png", dpi=FIGURE_DPI, bbox_inches="tight")
    return file.getvalue()


def format_record(record: Record) -> str:
    """Return the numbers of a result, some rows of its arrays and its warnings as HTML."""
    notes = "".join(f"<li>{escape(str(text))}</li>" for text in getattr(record, "warnings", ()))
    return "".join(table.to_html() for table in _build_tables(record)) + (f"<ul>{notes}</ul>" if notes else "")


def format_optimum(optimum: TumourOptimum) -> str:
    """Return the verdict of an optimisation and the comparison of start and optimum as HTML."""
    from probe_design.design_report.tumour_report import build_comparison_table

    return f"<p>{escape(optimum.verdict)}</p>{build_comparison_table(optimum).to_html()}"


def _build_tables(record: Record) -> Iterator[Table]:
    numbers = record.collect_numbers().items()
    yield Table(("quantity", "value", "unit"), [_build_row(name, value) for name, value in numbers])
    if len(record.DIMENSIONS) == 1:
        dimension = record.DIMENSIONS[0]
        columns = {dimension: np.array(getattr(record, dimension))} | record.collect_arrays()
        units = {name: find_shown_unit(name) for name in columns}
        shown = {
            f"{name}, {units[name][0]}".rstrip(", "): ((units[name][1] * values).tolist(), 6) for name, values in columns.items()
        }
        yield Table.from_columns("", shown, MAX_TABLE_ROWS)


def _build_row(name: str, value: str | bool | float) -> tuple[str, str, str]:
    if isinstance(value, str | bool):
        return name, str(value), ""
    unit, scale = find_shown_unit(name)
    return name, format_number(scale * value, 6), unit
