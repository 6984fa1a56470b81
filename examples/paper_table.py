"""Hold the paper's Table 3 (section 3) as printed, and check it without a model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

POSITION_NAMES = {
    1: "between tumours 1 and 2",
    2: "on top of tumour 2",
    3: "on top of tumour 1",
    4: "far away from both",
}  # Table 2
AREA_RATIO = 3.7  # A2/A1, section 2.3


@dataclass(frozen=True)
class PublishedRow:
    """A row of Table 3: load in N; stresses with tension positive, without a unit; the last column."""

    load: float
    stress_1: float
    stress_2: float
    ratio: float


TABLE_3 = {
    1: (
        PublishedRow(1, -2.371, -1.571, 1.50923),
        PublishedRow(5, -11.859, -7.857, 1.509355),
        PublishedRow(10, -23.718, -15.715, 1.509259),
    ),
    2: (
        PublishedRow(1, -2.728, -1.791, 1.523171),
        PublishedRow(5, -13.639, -8.956, 1.52289),
        PublishedRow(10, -27.277, -17.912, 1.522834),
    ),
    3: (
        PublishedRow(1, -1.61, -0.61794, 2.60543),
        PublishedRow(5, -8.05, -3.09, 2.605178),
        PublishedRow(10, -16.1, -6.179, 2.6056),
    ),
    4: (
        PublishedRow(1, -1.059, 0.039825, 26.59134),
        PublishedRow(5, -5.294, 0.199124, 26.58645),
        PublishedRow(10, -10.587, 0.398248, 26.58395),
    ),
}


@dataclass(frozen=True)
class PositionCheck:
    """Consistency of the printed rows of one position.

    Attributes
    ----------
    spread
        Of the printed ratio over the loads, relative.
    arithmetic
        Maximum deviation of the printed ratio from the quotient of the printed stresses without signs, relative.
    signed
        That quotient at the first load, with its sign.
    area
        A1 with which these stresses, were they means, would balance the load, by the paper's A2/A1: N over the unit of stress.
    """

    spread: float
    arithmetic: float
    signed: float
    area: float


def check_position(rows: Sequence[PublishedRow]) -> PositionCheck:
    """Check the printed rows of one position for consistency."""
    ratios, quotients = [row.ratio for row in rows], [row.stress_1 / row.stress_2 for row in rows]
    max_deviation = max(abs(abs(quotient) / ratio - 1) for quotient, ratio in zip(quotients, ratios, strict=True))
    area = rows[0].load / -(AREA_RATIO * rows[0].stress_1 + rows[0].stress_2)
    return PositionCheck(max(ratios) / min(ratios) - 1, max_deviation, quotients[0], area)


def get_printed_ratios(signed: bool) -> dict[int, float]:
    """Return the ratio of each position at 1 N, as printed or with the sign of its stresses."""
    return {k: rows[0].stress_1 / rows[0].stress_2 if signed else rows[0].ratio for k, rows in TABLE_3.items()}
