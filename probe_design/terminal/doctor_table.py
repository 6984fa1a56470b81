"""Build the table of the findings of `doctor`."""

from __future__ import annotations

from collections.abc import Sequence

from rich.markup import escape
from rich.table import Table

from geometry.common.errors import to_one_line
from probe_design.doctor.finding import Finding


def build_doctor_table(findings: Sequence[Finding], versions: dict[str, str | None]) -> Table:
    """Return findings as a table, one row each, with the versions below."""
    names = ", ".join(f"{name} {number}" for name, number in versions.items() if number is not None)
    table = Table(caption=escape(names), caption_justify="left")
    table.add_column("what")
    table.add_column("state")
    table.add_column("found", overflow="fold")
    for finding in findings:
        table.add_row(escape(to_one_line(finding.name)), finding.state, escape(to_one_line(finding.text)))
    return table
