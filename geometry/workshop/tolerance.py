"""How tightly a dimension is held: as its process holds it, or tighter where the ratio wants it and the process can."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from geometry.workshop.processes import Process, find_process

MACHINING_PROCESS, CASTING_PROCESS = "machining", "casting"
# ISO 2768-1:1989, table 2, class m, for radii and chamfers that are machined: sizes up to, and the deviation, in mm
RADIUS_DEVIATIONS_MM = ((3.0, 0.2), (6.0, 0.5), (math.inf, 1.0))
SMALL_SIZE_FRACTION = 0.1  # of a machined size that is too small for the standard, or for its deviation: what it is given here
MAX_SIZE_FRACTION = 0.5  # of a size of any other process: no deviation takes more
DEVIATION_PER_SD = math.sqrt(3)
"""Deviation either way over standard deviation, anything within it being as likely (JCGM 100:2008, 4.3.7)."""


@dataclass(frozen=True)
class Tolerance:
    """Deviation allowed either way from a size.

    Attributes:
        size: in mm.
        deviation: in mm.
        source: what it follows from.
        is_stated: whether the drawing writes it beside the size.
    """

    size: float
    deviation: float
    source: str
    is_stated: bool


@dataclass(frozen=True)
class Scatter:
    """What scatters the ratio beside dimensions: a modulus, a Poisson's ratio or a film's gain.

    Attributes:
        name: key of the scene file, or of a film's gain.
        words: the same in words.
        nominal: with its unit.
        sd: its standard deviation relative to the nominal value.
        ratio: standard deviation that it gives the ratio, relative.
        source: of ``sd``.
    """

    name: str
    words: str
    nominal: str
    sd: float
    ratio: float
    source: str


@dataclass(frozen=True)
class Budget:
    """What the ratio of the two stresses leaves the dimensions, and what else scatters it.

    Attributes:
        percent: that dimensions, moduli and gains together may change of the ratio, a standard deviation.
        deviations: by the name of a block's dimension the deviation in mm that would do, of a radius where that is drawn as a
            diameter.
        sensitivities: likewise d ln ratio / d ln size.
        scatter: of all that no drawing holds.
        remark: why there are none.
    """

    percent: float = 0.0
    deviations: Mapping[str, float] = field(default_factory=dict)
    sensitivities: Mapping[str, float] = field(default_factory=dict)
    scatter: tuple[Scatter, ...] = ()
    remark: str = ""

    def find_bound(self, name: str) -> float | None:
        """Return the deviation of a dimension in mm, None where the ratio binds it not."""
        return self.deviations.get(name)

    def find_modulus(self, block: str) -> Scatter | None:
        """Return how well the modulus of a block is known; None where that is not known."""
        return next((scatter for scatter in self.scatter if scatter.name == f"probe.{block}.youngs_modulus"), None)


NO_BUDGET = Budget()


def find_tolerance(
    size: float, bound: float | None = None, radius: bool = False, *, process: str = MACHINING_PROCESS, closure: bool = False
) -> Tolerance:
    """Return the deviation of a size, all in mm: the process's, or ``bound`` where that is tighter and the process can.

    A machined size for which the standard has no deviation, or one of more than a tenth of it, gets a tenth. Castings and prints
    have their process's deviation beside each size: no bound makes them more exact.

    Args:
        size: of the dimension.
        bound: what the ratio leaves it.
        radius: whether it is the radius of an edge.
        process: by which the part is made.
        closure: whether the size lies across the parting plane of a mould.
    """
    made = find_process(process)
    if process != MACHINING_PROCESS:
        usual = made.find_deviation(size, closure)
        return Tolerance(size, min(MAX_SIZE_FRACTION * size, usual or math.inf), made.general, is_stated=True)
    usual, source, is_stated = _find_machined(made, size, radius)
    if bound is None or bound >= usual:
        return Tolerance(size, usual, source, is_stated)
    finest = made.find_tightest(size)
    if finest is not None and bound < min(finest, usual):
        return Tolerance(size, min(finest, usual), made.finest_source, is_stated=True)
    return Tolerance(size, bound, "the ratio", is_stated=True)


def _find_machined(made: Process, size: float, radius: bool) -> tuple[float, str, bool]:
    usual = made.find_deviation(size)
    if radius and usual is not None:
        usual = next(deviation for max_size, deviation in RADIUS_DEVIATIONS_MM if size <= max_size)
    if usual is None or usual > SMALL_SIZE_FRACTION * size:
        return SMALL_SIZE_FRACTION * size, f"{100 * SMALL_SIZE_FRACTION:g} % of the size", True
    return usual, made.general, False


def format_deviation(deviation: float) -> str:
    """Write a deviation in mm to two figures, rounded down: what is allowed is never more than was found."""
    exponent = math.floor(math.log10(deviation)) - 1
    step = 10.0**exponent
    figures = math.floor(deviation / step * (1 + 1e-9))
    return f"{figures * step:.{max(0, -exponent)}f}".rstrip("0").rstrip(".") if exponent < 0 else f"{figures * step:.0f}"
