"""Write docs/evidence/extremes.md from the rows and cells of the matrix."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from itertools import groupby

from tests.support.extremes.classification import ACCURACY, MARKS, Cell
from tests.support.extremes.rows import FOLDERS, Row

COMMAND = "python -m benchmarks.extremes -o out/extremes --document docs/evidence/extremes.md"
TITLES = FOLDERS | {
    "laws": "by laws of linear elasticity",
    "zero": "a stress that crosses zero",
    "loads": "from no load to where nothing is known",
}
INTRODUCTION = f"""# The extremes

Scenes at the limits of the range of designs, by every evaluator, at an accuracy of {ACCURACY:g}. `{COMMAND}`
printed this page; a run that was interrupted goes on where it ended.

- **right**: the ratio is off by no more than the stated error; both stresses and the stiffness by no more than the
  accuracy, the stated error or the bound that a warning tells; the log-sensitivity by no more than five times the
  accuracy, 1e-5, or what a warning tells. A cell shows the ratio's true error / the stated one.
  `closed-form` states 95 % quantiles, so that up to four times the stated error counts as right there.
- **refused**: one line says why (numbers below).
- **null**: the ratio is null with the reason: a stress is below its own error.
- **wrong**: anything else: a bound that does not hold, a NaN or infinity in the output, a warning of numpy's or of any
  other library, an exception.

"Largest true / stated" is of what the true value's own uncertainty cannot explain.

The load does not matter in linear elasticity; a warning says where that ends, and `auto` evaluates under a thousandth of each,
or less of probes below 1 mm. The rows of `loads` are pressed, by `contact` and `auto`: beyond the largest load that another code
has reached a refusal alone is right. stress_inner crosses zero in the rows named `inner-...`, where the ring presses a lid of
tissue over a hollow, stress_outer in those of `zero`.

True values come from NGSolve (`benchmarks/references/axisymmetric.py`, `solid.py`, `half_space.py`;
values and their uncertainty in `tests/reference`), or follow from such a value by the law that stands in the table. Those
of `extremes` were found by `python -m benchmarks.references.extremes_scenes tests/reference/extremes`, then
`python -m benchmarks.references.axisymmetric tests/reference/extremes`.
"""


def document(rows: list[Row], cells: Iterable[Cell]) -> str:
    """Return the page."""
    cells, reasons = list(cells), Reasons()
    tables = [table(group, list(group_rows), cells, reasons) for group, group_rows in groupby(rows, key=lambda row: row.group)]
    return "\n".join(
        [
            INTRODUCTION,
            *counts(cells),
            *wrongs(cells),
            *(line for table_lines in tables for line in table_lines),
            *reasons.lines(),
        ]
    )


class Reasons:
    """The reasons for refusals, numbered; numbers of a scene in them are left out."""

    def __init__(self) -> None:
        self.numbers: dict[str, int] = {}

    def number(self, reason: str) -> int:
        """Return a reason's number."""
        return self.numbers.setdefault(general(reason), len(self.numbers) + 1)

    def lines(self) -> Iterator[str]:
        """Yield the list of reasons."""
        yield "## Reasons of refusals and nulls\n"
        yield from (f"{number}. {reason}" for reason, number in self.numbers.items())
        yield ""


def general(reason: str) -> str:
    """Return a reason without the numbers of the scene."""
    return re.sub(r"(?<![\w-])-?\d[\d.]*(e[+-]?\d+)?(?![\w-])", "#", reason).replace("|", "/")


def counts(cells: list[Cell]) -> Iterator[str]:
    """Yield the table of how many cells are what."""
    yield f"## {len(cells)} cells\n"
    heads = (f"right and within {ACCURACY:g}", "worst true error", "median stated", "largest true / stated", "median s")
    yield f"| evaluator | {' | '.join((*MARKS, *heads))} |"
    yield "|---" * (1 + len(MARKS) + len(heads)) + "|"
    levels = list(dict.fromkeys(cell.evaluator for cell in cells))
    for level in levels:
        level_cells = [cell for cell in cells if cell.evaluator == level]
        counts = " | ".join(str(sum(cell.mark == mark for cell in level_cells)) for mark in MARKS)
        yield f"| {level} | {counts} | {quality(level_cells)} |"
    totals = " | ".join(f"**{sum(cell.mark == mark for cell in cells)}**" for mark in MARKS)
    yield f"| all | {totals} | {sum(map(is_reached, cells))} | | | | |\n"


def quality(cells: list[Cell]) -> str:
    """Return the last columns of the table of counts: of what is right."""
    right = [cell for cell in cells if cell.mark == "right" and cell.true is not None and cell.stated is not None]
    if not right:
        return "0 | - | - | - | -"
    stated = sorted(cell.stated or 0.0 for cell in right)[len(right) // 2]
    worst, share = max(cell.true or 0.0 for cell in right), max(cell.share for cell in right)
    seconds = sorted(cell.seconds for cell in cells)[len(cells) // 2]
    return " | ".join([str(sum(map(is_reached, cells))), f"{worst:.1e}", f"{stated:.1e}", f"{share:.2g}", f"{seconds:.2g}"])


def is_reached(cell: Cell) -> bool:
    """Whether a result is right and its stated error no larger than the accuracy."""
    return cell.mark == "right" and cell.stated is not None and cell.stated <= ACCURACY


def wrongs(cells: list[Cell]) -> Iterator[str]:
    """Yield what is wrong with each wrong cell."""
    wrong = [cell for cell in cells if cell.mark == "wrong"]
    if wrong:
        yield "## Wrong\n"
        yield from (f"- {cell.row} by {cell.evaluator}: {cell.reason}" for cell in wrong)
        yield ""


def table(group: str, rows: list[Row], cells: list[Cell], reasons: Reasons) -> Iterator[str]:
    """Yield one table: a row for each scene, a column for each evaluator."""
    cells_by_key = {(cell.row, cell.evaluator): cell for cell in cells}
    levels = [
        level
        for level in dict.fromkeys(cell.evaluator for cell in cells)
        if any((row.key, level) in cells_by_key for row in rows)
    ]
    yield f"## {group}: {TITLES[group]}\n"
    yield f"| scene | {' | '.join(levels)} | true values |"
    yield "|---" * (len(levels) + 2) + "|"
    for row in rows:
        texts = (text(cells_by_key.get((row.key, level)), reasons) for level in levels)
        yield f"| {row.name} | {' | '.join(texts)} | {row.origin} |"
    yield ""


def text(cell: Cell | None, reasons: Reasons) -> str:
    """Return a cell in a few characters."""
    if cell is None:
        return ""
    if cell.mark == "right":
        return f"{cell.true:.0e} / {cell.stated:.0e}" if cell.true is not None and cell.stated is not None else "right"
    return "**wrong**" if cell.mark == "wrong" else f"{cell.mark} {reasons.number(cell.reason)}"
