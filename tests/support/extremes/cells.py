"""The cells of the matrix of extremes: which scene is given to which evaluator."""

from __future__ import annotations

from collections.abc import Iterator

from tests.support.extremes.rows import Row

LEVELS = ("closed-form", "equivalent-inclusion", "axisymmetric", "auto")
UNDER_LOAD = ("contact", "auto")
SOLID = (
    "extremes/middle", "extremes/contrast-1e6", "extremes/contrast-1e-6", "extremes/incompressible",
    "extremes/diameter-0.1-mm", "off-axis/contrast-1000", "off-axis/stiff-cover-0.025-offset-0.5",
)  # fmt: skip
"""The rows that ``solid`` answers too: it takes half a minute each, and many minutes for thin walls, gaps and covers."""


def cells(rows: list[Row]) -> Iterator[tuple[Row, str]]:
    """Yield every row with every evaluator."""
    for row in rows:
        yield from ((row, evaluator) for evaluator in (UNDER_LOAD if row.group == "loads" else LEVELS))
    for row in rows:
        if row.key in SOLID or row.group == "zero":
            yield row, "solid"
