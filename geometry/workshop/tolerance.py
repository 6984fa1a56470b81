"""Choose the tolerance of a dimension: its process's usual one, or a tighter one that the ratio needs and the process allows.

The deviations of the processes (machining, casting, printing) stand in ``processes.toml``, with their sources.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib.resources import files
from typing import Any

from geometry.cad.materials import find_part_materials
from geometry.common.percent import format_percent
from geometry.scenes.probe import Probe
from geometry.scenes.units import MM_PER_M

MACHINING_PROCESS, CASTING_PROCESS = "machining", "casting"
# ISO 2768-1:1989, table 2, class m, for radii and chamfers that are machined: sizes up to, and the deviation, in mm
RADIUS_DEVIATIONS_MM = ((3.0, 0.2), (6.0, 0.5), (math.inf, 1.0))
SMALL_SIZE_FRACTION = 0.1  # deviation over size for machined sizes that are too small for the standard, or for its deviation
MAX_SIZE_FRACTION = 0.5  # of a size, for any other process: the largest deviation
DEVIATION_PER_SD = math.sqrt(3)
"""± deviation over standard deviation of a uniform distribution (JCGM 100:2008, 4.3.7)."""
MIN_LENGTH_SD_M = (
    20e-6  # m: standard deviation of a length that a careful workshop reaches, and of films and base, which are bought
)
BLOCK_LENGTHS = {  # of each length of a block, by its key: the block, and whether it crosses the parting plane of the mould
    "probe.inner_radius": ("inner", False), "probe.gap": ("outer", False), "probe.outer_radius": ("outer", False),
    "probe.height": ("inner", True), "probe.inner_height": ("inner", True), "probe.outer_height": ("outer", True),
}  # fmt: skip


Table = tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class Process:
    """A manufacturing process; deviations are ±, mm.

    Attributes
    ----------
    name
        Name in ``processes.toml``, such as "casting".
    about
        Description.
    general
        Text of the title block on sizes without a deviation.
    source
        Source of the deviations.
    roughness, bonded
        Roughness of the faces, and of faces that are bonded.
    fixed
        Upper limits of size, each with its deviation.
    closure
        The same for sizes across the parting plane of a mould; empty: as ``fixed``.
    relative, minimum
        Deviation over size, and smallest deviation, beyond the tables; 0 and 0: no deviation there.
    smallest
        Size below which the tables have no deviation.
    finest, finest_source
        The smallest deviations that can be ordered, and their source; empty: none below the usual.
    """

    name: str
    about: str
    general: str
    source: str
    roughness: str
    bonded: str
    fixed: Table = ()
    closure: Table = ()
    relative: float = 0.0
    minimum: float = 0.0
    smallest: float = 0.0
    finest: Table = ()
    finest_source: str = ""

    def find_deviation(self, size: float, closure: bool = False) -> float | None:
        """Return the usual deviation of a size, mm; None where the source has none."""
        if size < self.smallest:
            return None
        deviation_found = _look_up((self.closure if closure else ()) or self.fixed, size)
        proportional = max(self.relative * size, self.minimum)
        return proportional or None if deviation_found is None else deviation_found

    def find_tightest(self, size: float) -> float | None:
        """Return the smallest deviation that can be ordered for a size, mm; None if it is the usual one."""
        deviation_found = _look_up(self.finest, size)
        # beyond the table the last deviation grows in proportion to the size
        return self.finest[-1][1] * size / self.finest[-1][0] if self.finest and deviation_found is None else deviation_found


def find_process(name: str) -> Process:
    """Return a process by its name."""
    return _read_processes()[name]


@cache
def _read_processes() -> dict[str, Process]:
    """Return the processes of ``processes.toml`` by name."""
    entries = tomllib.loads(files("geometry.workshop").joinpath("processes.toml").read_text(encoding="utf-8"))
    return {name: Process(name, **{key: _freeze(value) for key, value in entry.items()}) for name, entry in entries.items()}


def _freeze(value: Any) -> Any:
    """Return a table (a list of rows) as tuples, any other value as it is."""
    return tuple(tuple(row) for row in value) if isinstance(value, list) else value


def _look_up(table: Table, size: float) -> float | None:
    """Return the deviation of a size in a table of (upper limit, deviation); None where it is above the last limit."""
    return next((deviation for max_size, deviation in table if size <= max_size * (1 + 1e-12)), None)


@dataclass(frozen=True)
class Tolerance:
    """The ± deviation allowed for a size.

    Attributes
    ----------
    size
        The size, mm.
    deviation
        The deviation, mm.
    source
        Standard or requirement from which it follows.
    is_stated
        Whether the drawing states it next to the size.
    """

    size: float
    deviation: float
    source: str
    is_stated: bool


@dataclass(frozen=True)
class Scatter:
    """A number other than a dimension that scatters the ratio: a modulus, a Poisson's ratio or a film's gain.

    Attributes
    ----------
    name
        Key of the scene file, or of a film's gain.
    words
        Description of the number.
    nominal
        Nominal value with its unit.
    sd
        Its standard deviation relative to the nominal value.
    ratio
        Relative standard deviation of the ratio due to it.
    source
        Source of ``sd``.
    """

    name: str
    words: str
    nominal: str
    sd: float
    ratio: float
    source: str


@dataclass(frozen=True)
class Budget:
    """The deviations that the ratio of the two stresses allows the dimensions, and the other sources of its scatter.

    Attributes
    ----------
    percent
        Standard deviation allowed for the ratio, in percent, by dimensions, moduli and gains together.
    deviations
        Deviation allowed for a block's dimension, mm, by its name; of the radius for a diameter.
    sensitivities
        d ln ratio / d ln size, by the same names.
    scatter
        The numbers that no drawing limits.
    remark
        Reason why there is no budget.
    """

    percent: float = 0.0
    deviations: Mapping[str, float] = field(default_factory=dict)
    sensitivities: Mapping[str, float] = field(default_factory=dict)
    scatter: tuple[Scatter, ...] = ()
    remark: str = ""

    def find_bound(self, name: str) -> float | None:
        """Return the deviation that the ratio allows a dimension, mm; None where the ratio does not limit it."""
        return self.deviations.get(name)

    def find_modulus(self, block: str) -> Scatter | None:
        """Return the scatter of a block's modulus; None where it is unknown."""
        return next((scatter for scatter in self.scatter if scatter.name == f"probe.{block}.youngs_modulus"), None)


NO_BUDGET = Budget()


def find_tolerance(
    size: float, bound: float | None = None, radius: bool = False, *, process: str = MACHINING_PROCESS, closure: bool = False
) -> Tolerance:
    """Return the tolerance of a size, in mm: the process's deviation, or a tighter ``bound`` that the process can hold.

    A machined size for which the standard has no deviation, or one above a tenth of the size, gets a tenth. Castings and prints
    state their process's deviation next to each size, since no bound makes them more accurate.

    Parameters
    ----------
    size
        The size.
    bound
        The deviation that the ratio allows.
    radius
        Whether the size is the radius of an edge.
    process
        The manufacturing process of the part.
    closure
        Whether the size crosses the parting plane of a mould.
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


@dataclass(frozen=True)
class LengthTolerance:
    """The tolerance of a block's length as it is made: a radius as a diameter, and the gap as that of the hole.

    Attributes
    ----------
    process
        Name of the block's process.
    usual
        The deviation that a drawing allows without a tighter requirement.
    tightest
        The smallest deviation that can be ordered, mm.
    measured_as
        "diameter" or "height".
    """

    process: str
    usual: Tolerance
    tightest: float
    measured_as: str

    def convert_to_sd(self, deviation: float) -> float:
        """Return the standard deviation of the length, m, for a deviation of its diameter or height, mm."""
        return deviation / (DEVIATION_PER_SD * MM_PER_M * (2 if self.measured_as == "diameter" else 1))


def find_length_tolerance(probe: Probe, key: str) -> LengthTolerance:
    """Return the tolerance of one of ``BLOCK_LENGTHS``, by its key in the scene file."""
    block, closure = BLOCK_LENGTHS[key]
    process = find_part_materials(probe)[block].process
    lengths = {
        "probe.inner_radius": 2 * probe.inner_radius,
        "probe.gap": 2 * probe.hole_radius,
        "probe.outer_radius": 2 * probe.tube_radius,
        "probe.outer_height": probe.tube_height,
    }
    usual = find_tolerance(MM_PER_M * lengths.get(key, probe.core_height), process=process, closure=closure)
    tightest = find_process(process).find_tightest(usual.size)
    return LengthTolerance(process, usual, usual.deviation if tightest is None else tightest, "height" if closure else "diameter")


def find_length_sd(probe: Probe, key: str) -> float:
    """Return the standard deviation, m, of one of a built probe's lengths, made to the tightest tolerance of its process.

    ``key`` is that of the scene file. It is never below ``MIN_LENGTH_SD_M``, which holds for the lengths of films and base, too.
    """
    if key not in BLOCK_LENGTHS:
        return MIN_LENGTH_SD_M
    tolerance = find_length_tolerance(probe, key)
    return max(MIN_LENGTH_SD_M, tolerance.convert_to_sd(tolerance.tightest))


def _find_machined(made: Process, size: float, radius: bool) -> tuple[float, str, bool]:
    """Return the usual deviation of a machined size, mm, its source, and whether a drawing has to state it."""
    usual = made.find_deviation(size)
    if radius and usual is not None:
        usual = next(deviation for max_size, deviation in RADIUS_DEVIATIONS_MM if size <= max_size)
    if usual is None or usual > SMALL_SIZE_FRACTION * size:
        return SMALL_SIZE_FRACTION * size, f"{format_percent(SMALL_SIZE_FRACTION, 6)} of the size", True
    return usual, made.general, False


def format_deviation(deviation: float) -> str:
    """Format a deviation in mm to two digits, rounded down, so that the drawing never allows more than computed."""
    exponent = math.floor(math.log10(deviation)) - 1
    step = 10.0**exponent
    figures = math.floor(deviation / step * (1 + 1e-9))  # 1e-9: a whole number must not fall below itself by rounding
    return f"{figures * step:.{max(0, -exponent)}f}".rstrip("0").rstrip(".") if exponent < 0 else f"{figures * step:.0f}"
