"""The paper's Table 3 against its print, and what the printed numbers say of themselves (PHYSICS section 1)."""

from __future__ import annotations

import sys

from tests.support.paths import EXAMPLES

sys.path.insert(0, str(EXAMPLES))

import paper_table

# Table 3 of "Detecting Embedded Objects Using Haptics with Applications in Artificial Palpation of Tumors", as printed
PRINTED = """
| Position 1 | Stress 1 | Stress 2 | |
| 1 N | -2.371 | -1.571 | 1.50923 |
| 5 N | -11.859 | -7.857 | 1.509355 |
| 10 N | -23.718 | -15.715 | 1.509259 |
| Position 2 | | | |
| 1 N | -2.728 | -1.791 | 1.523171 |
| 5 N | -13.639 | -8.956 | 1.52289 |
| 10 N | -27.277 | -17.912 | 1.522834 |
| Position 3 | | | |
| 1 N | -1.61 | -0.61794 | 2.60543 |
| 5 N | -8.05 | -3.09 | 2.605178 |
| 10 N | -16.1 | -6.179 | 2.6056 |
| Position 4 | | | |
| 1 N | -1.059 | 0.039825 | 26.59134 |
| 5 N | -5.294 | 0.199124 | 26.58645 |
| 10 N | -10.587 | 0.398248 | 26.58395 |
"""


def printed() -> dict[int, tuple[paper_table.PublishedRow, ...]]:
    rows_by_page: dict[int, list[paper_table.PublishedRow]] = {}
    for line in PRINTED.strip().splitlines():
        first, *cells = (cell.strip() for cell in line.strip("|").split("|"))
        if first.startswith("Position"):
            rows = rows_by_page.setdefault(int(first.split()[1]), [])
        else:
            rows.append(paper_table.PublishedRow(float(first.removesuffix(" N")), *map(float, cells)))
    return {k: tuple(rows) for k, rows in rows_by_page.items()}


def test_the_table_is_the_paper_s() -> None:
    assert printed() == paper_table.TABLE_3


def test_what_the_printed_numbers_say_of_themselves() -> None:
    checks = {k: paper_table.check_position(rows) for k, rows in paper_table.TABLE_3.items()}
    for k, check in checks.items():
        assert check.arithmetic < 1e-6
        assert check.spread < 3e-4
        assert (check.signed < 0) == (k == 4)
    # PHYSICS.md section 1: A1 of 97, 84, 152 and 258 units of a thousandth
    assert [round(1e3 * check.area) for check in checks.values()] == [97, 84, 152, 258]
    middle, large = paper_table.TABLE_3[1][0], paper_table.TABLE_3[3][0]
    assert abs(large.stress_1) < abs(middle.stress_1)
    assert abs(large.stress_2) < abs(middle.stress_2)
