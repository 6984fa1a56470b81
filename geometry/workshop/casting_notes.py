"""What the drawing of a cast block says of measuring it: the mould is measured, the soft block is not; its modulus is tested."""

from __future__ import annotations

import math
from collections.abc import Sequence

from geometry.cad.drawing import number
from geometry.scenes.probe import Probe
from geometry.workshop.mould_sizes import MouldSizes
from geometry.workshop.processes import find_process
from geometry.workshop.tolerance import CASTING, MACHINING, Budget, tolerance, written

DIAMETER = "\N{LATIN CAPITAL LETTER O WITH STROKE}"


def casting_notes(mould: MouldSizes, budget: Budget) -> tuple[str, ...]:
    """Return the lines of notes on a cast block's drawing.

    Args:
        mould: in which it is cast.
        budget: how well its modulus is known.
    """
    sizes = [
        f"{name} {number(size)} \N{PLUS-MINUS SIGN}{written(_of_mould(size))}" for name, size in mould_lengths(mould).items()
    ]
    general, draft = find_process(CASTING).general, f"{math.degrees(mould.draft):.3g}\N{DEGREE SIGN}"
    return (
        f"Cast; deviations are the casting's, {general}. Measure the mould, not the soft block; at half the height:",
        f"cavity {', '.join(sizes)}; shrinkage {100 * mould.shrinkage:g} %, draft {draft}.",
        f"Modulus: {_known(mould.name, budget)}test a cylinder cast of the same pour in compression (ISO 7743),",
        "and write what it measures into the scene.",
    )


def mould_lengths(mould: MouldSizes) -> dict[str, float]:
    """Return what is measured of a mould's cavity, mm: diameters at half its height, and the height."""
    inner, outer = mould.radii(mould.height / 2)
    diameters = {DIAMETER: 2 * outer, **({f"pin {DIAMETER}": 2 * inner} if inner else {})}
    return {**diameters, "height": mould.height}


def _of_mould(size: float) -> float:
    """The deviation of a mould, mm: the lowest that machining reaches, far below the casting's own."""
    finest = find_process(MACHINING).tightest(size)
    assert finest is not None  # machining has a table of them
    return finest


def _known(block: str, budget: Budget) -> str:
    known = budget.modulus_of(block)
    return "" if known is None else f"{known.nominal} \N{PLUS-MINUS SIGN}{100 * known.sd:.2g} % (1 sd); "


def gap_deviation(probe: Probe, moulds: Sequence[MouldSizes]) -> float:
    """Return the deviation of the gap, mm, that follows from the walls' on both of its sides: the root of the sum of squares."""
    cast = {one.name for one in moulds}
    sizes = {"inner": 2e3 * probe.inner_radius, "outer": 2e3 * probe.hole_radius}
    walls = (tolerance(size, process=CASTING if name in cast else MACHINING).deviation for name, size in sizes.items())
    return math.hypot(*walls) / 2


def gap_note(probe: Probe, moulds: Sequence[MouldSizes]) -> str:
    """Return the line on the assembly's drawing that says why the gap has no deviation of its own."""
    gap = f"{number(1e3 * probe.gap)} \N{PLUS-MINUS SIGN}{written(gap_deviation(probe, moulds))} mm"
    return f"The gap follows from the blocks on its sides, {gap}: centre them with shims."
