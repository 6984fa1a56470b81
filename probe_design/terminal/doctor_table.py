"""Build the table of the findings of `doctor`."""

from __future__ import annotations

from collections.abc import Sequence

from geometry.common.errors import to_one_line
from probe_design.doctor.finding import Finding
from probe_design.reporting.table import Table


def build_doctor_table(findings: Sequence[Finding], versions: dict[str, str | None]) -> Table:
    """Return findings as a table, one row each, with the versions below."""
    names = ", ".join(f"{name} {number}" for name, number in versions.items() if number is not None)
    rows = [(to_one_line(finding.name), finding.state, to_one_line(finding.text)) for finding in findings]
    return Table(("what", "state", "found"), rows, caption=names, left=(0, 1, 2))
