"""How tightly a dimension is held: ISO 2768-1, class m, unless what it does to the ratio wants it tighter."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

GENERAL = "ISO 2768-m"
# ISO 2768-1:1989, table 1, class m: sizes up to, and the deviation, in mm; table 2 for radii and chamfers
LENGTHS = ((6.0, 0.1), (30.0, 0.2), (120.0, 0.3), (400.0, 0.5), (1000.0, 0.8), (2000.0, 1.2), (4000.0, 2.0))
RADII = ((3.0, 0.2), (6.0, 0.5), (math.inf, 1.0))
SMALLEST = 0.5  # mm: below it the standard wants a deviation beside each size
OF_SMALL = 0.1  # of a size that is too small for the standard, or for its deviation: what it is given here


@dataclass(frozen=True)
class Tolerance:
    """Deviation allowed either way from a size.

    Attributes:
        size: in mm.
        deviation: in mm.
        source: what it follows from.
        told: whether the drawing writes it beside the size.
    """

    size: float
    deviation: float
    source: str
    told: bool


@dataclass(frozen=True)
class Budget:
    """What the ratio of the two stresses leaves the dimensions.

    Attributes:
        percent: that all dimensions together may change of the ratio.
        deviations: by the name of a dimension the deviation in mm of it, of a radius where that is drawn as a diameter.
        sensitivities: likewise d ln ratio / d ln size.
        remark: why there are none.
    """

    percent: float = 0.0
    deviations: Mapping[str, float] = field(default_factory=dict)
    sensitivities: Mapping[str, float] = field(default_factory=dict)
    remark: str = ""

    def bound(self, name: str) -> float | None:
        """Return the deviation of a dimension in mm, None where the ratio binds it not."""
        return self.deviations.get(name)


UNBOUND = Budget()


def general(size: float, radius: bool = False) -> float | None:
    """Return the deviation of a size in mm, or of a radius, by ISO 2768-m; None where the standard has none."""
    if size < SMALLEST:
        return None
    return next((deviation for most, deviation in (RADII if radius else LENGTHS) if size <= most), None)


def tolerance(size: float, bound: float | None = None, radius: bool = False) -> Tolerance:
    """Return the tighter of the standard's deviation and ``bound``, both in mm.

    A size for which the standard has none, or one of more than a tenth of it, gets a tenth.
    """
    usual = general(size, radius)
    if usual is None or usual > OF_SMALL * size:
        usual, source, told = OF_SMALL * size, f"{100 * OF_SMALL:g} % of the size", True
    else:
        source, told = GENERAL, False
    if bound is not None and bound < usual:
        return Tolerance(size, bound, "the ratio", True)
    return Tolerance(size, usual, source, told)


def written(deviation: float) -> str:
    """Write a deviation in mm to two figures, rounded down: what is allowed is never more than was found."""
    exponent = math.floor(math.log10(deviation)) - 1
    step = 10.0**exponent
    figures = math.floor(deviation / step * (1 + 1e-9))
    return f"{figures * step:.{max(0, -exponent)}f}".rstrip("0").rstrip(".") if exponent < 0 else f"{figures * step:.0f}"
