"""Write the notes on inspection of a cast block: its mould is measured in place of the soft block, and its modulus is tested."""

from __future__ import annotations

import math
from collections.abc import Sequence

from geometry.scenes.probe import Probe
from geometry.workshop.mould_sizes import MouldSizes
from geometry.workshop.processes import find_process
from geometry.workshop.sheet import DIAMETER_SIGN, format_number
from geometry.workshop.tolerance import CASTING_PROCESS, MACHINING_PROCESS, Budget, find_tolerance, format_deviation


def list_casting_notes(mould: MouldSizes, budget: Budget) -> tuple[str, ...]:
    """Return the notes on a cast block's drawing, one line each.

    Parameters
    ----------
    mould
        The block's mould.
    budget
        The ratio's budget, with the standard deviation of the block's modulus.
    """
    sizes = [
        f"{name} {format_number(size)} \N{PLUS-MINUS SIGN}{format_deviation(_find_mould_deviation(size))}"
        for name, size in list_mould_lengths(mould).items()
    ]
    general, draft = find_process(CASTING_PROCESS).general, f"{math.degrees(mould.draft):.3g}\N{DEGREE SIGN}"
    return (
        f"Cast; deviations are the casting's, {general}. Measure the mould, not the soft block; at half the height:",
        f"cavity {', '.join(sizes)}; shrinkage {100 * mould.shrinkage:g} %, draft {draft}.",
        f"Modulus: {_describe_modulus(mould.name, budget)}test a cylinder cast of the same pour in compression (ISO 7743),",
        "and write what it measures into the scene.",
    )


def list_mould_lengths(mould: MouldSizes) -> dict[str, float]:
    """Return the dimensions of a mould's cavity that are measured, mm: diameters at half its height, and the height."""
    inner, outer = mould.compute_radii(mould.height / 2)
    diameters = {DIAMETER_SIGN: 2 * outer, **({f"pin {DIAMETER_SIGN}": 2 * inner} if inner else {})}
    return {**diameters, "height": mould.height}


def _find_mould_deviation(size: float) -> float:
    """Return the deviation of a mould's dimension, mm: the smallest that machining reaches, far below that of the casting."""
    finest = find_process(MACHINING_PROCESS).find_tightest(size)
    assert finest is not None  # machining has a table of them
    return finest


def _describe_modulus(block: str, budget: Budget) -> str:
    known = budget.find_modulus(block)
    return "" if known is None else f"{known.nominal} \N{PLUS-MINUS SIGN}{100 * known.sd:.2g} % (1 sd); "


def compute_gap_deviation(probe: Probe, moulds: Sequence[MouldSizes]) -> float:
    """Return the deviation of the gap, mm: the root of the sum of squares of the deviations of both walls."""
    cast = {mould.name for mould in moulds}
    sizes = {"inner": 2e3 * probe.inner_radius, "outer": 2e3 * probe.hole_radius}
    walls = (
        find_tolerance(size, process=CASTING_PROCESS if name in cast else MACHINING_PROCESS).deviation
        for name, size in sizes.items()
    )
    return math.hypot(*walls) / 2


def describe_gap(probe: Probe, moulds: Sequence[MouldSizes]) -> str:
    """Return the line on the assembly's drawing that explains why the gap has no deviation of its own."""
    gap = f"{format_number(1e3 * probe.gap)} \N{PLUS-MINUS SIGN}{format_deviation(compute_gap_deviation(probe, moulds))} mm"
    return f"The gap follows from the blocks on its sides, {gap}: centre them with shims."
