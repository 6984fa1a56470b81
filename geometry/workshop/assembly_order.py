"""Write the order in which the parts are cast, bonded and checked, as Markdown, and the notes on inspection of a cast block.

The mould of a cast block is measured in place of the soft block, and its modulus is tested.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from geometry.cad.stamp import Stamp
from geometry.common.percent import format_percent
from geometry.provenance.texts import format_markdown_comment
from geometry.scenes.base_sizes import assume_sizes
from geometry.scenes.film import Bond
from geometry.scenes.probe import Probe, format_mm
from geometry.workshop.csv_lists import combine_scatter
from geometry.workshop.film_pattern import FilmPattern
from geometry.workshop.mould_sizes import DEFAULT_DRAFT_RAD, MouldSizes, compute_cavity_volume
from geometry.workshop.parts import describe_bond
from geometry.workshop.sheet import DIAMETER_SIGN, format_number
from geometry.workshop.tolerance import (
    CASTING_PROCESS,
    MACHINING_PROCESS,
    Budget,
    find_process,
    find_tolerance,
    format_deviation,
)

MAX_LISTED_PARTS = 4  # contributions to the ratio's scatter that are listed
GAP_RISK_FRACTION = 0.5  # of the gap: larger deviations are reported
SMALL_HOLE_MM = 0.3  # mm: diameter of the smallest hole that is drilled routinely


def write_assembly_order(
    probe: Probe, stamp: Stamp, patterns: Sequence[FilmPattern], moulds: Sequence[MouldSizes],
    *, budget: Budget, scatter: Mapping[str, float],
) -> str:  # fmt: skip
    """Return the Markdown page with the order of assembly.

    Parameters
    ----------
    probe
        The probe to be built.
    stamp
        Stamp of the design.
    patterns
        Patterns of the films.
    moulds
        Moulds of the cast blocks.
    budget
        See ``geometry.workshop.tolerance.Budget``.
    scatter
        Contributions to the ratio's scatter, see ``geometry.workshop.csv_lists.compute_scatter_of_ratio``.
    """
    steps = [
        *_list_casting_steps(probe, moulds),
        *_list_bonding_steps(probe, patterns),
        _describe_gap(probe, moulds, budget),
        *_list_measuring_steps(moulds),
    ]
    remarks = [*_list_inset_remarks(patterns), *_list_remarks(probe, moulds, budget, scatter)]
    lines = [f"{count}. {text}" for count, text in enumerate(steps, start=1)]
    comment = format_markdown_comment(stamp.provenance)
    head = ["# Assembly and bonding", "", f"Millimetres. {stamp.text}", ""]
    return "\n".join([*head, *lines, "", *(("Remarks:", "") if remarks else ()), *(f"- {text}" for text in remarks), "", comment])


def _list_inset_remarks(patterns: Sequence[FilmPattern]) -> list[str]:
    """Return what to write into a scene whose electrodes reach the films' edges, as those of the patterns do not."""
    tables = {"film-inner": "probe.film", "film-outer": "probe.film.outer"}
    insets = [
        f'[{tables[pattern.name]}] electrode_inset = "{format_number(pattern.inset)} mm"'
        for pattern in patterns
        if pattern.assumed
    ]
    reason = "the scene's electrodes reach the films' edges, those of the patterns end inside, which changes the charges"
    return [f"Assumed: {reason}; write {' and '.join(insets)} into the scene."] if insets else []


def _list_casting_steps(probe: Probe, moulds: Sequence[MouldSizes]) -> list[str]:
    """Return a step for casting each block that has a mould."""
    steps = []
    for mould in moulds:
        material = (probe.inner if mould.name == "inner" else probe.outer).material or "elastomer"
        volume, grown = f"{compute_cavity_volume(mould):.4g} mm\u00b3", f"shrinkage {format_percent(mould.shrinkage, 6)}"
        angle = f"draft {math.degrees(mould.draft):.3g}\u00b0"
        steps.append(
            f"Cast the {mould.name} block: close `mould-{mould.name}-lower.step` and `mould-{mould.name}-upper.step` on their "
            f"pins, pour {volume} of degassed {material} through the larger hole ({grown}, {angle}); the film end is at the lid. "
            "Take it out upwards, cut the sprues flush."
        )
    return steps


def _list_bonding_steps(probe: Probe, patterns: Sequence[FilmPattern]) -> list[str]:
    """Return the steps for cutting and bonding films, or for bonding the blocks of a probe without films."""
    if probe.film is None:
        return ["Clean and prime the film ends of both blocks and the base.", _describe_block_bonding("base", probe)]
    steps = [
        f"Cut the films by {', '.join(f'`{pattern.name}-pattern.dxf`' for pattern in patterns)}; test each for a short "
        "between its faces."
    ]
    layers = _describe_bonds([film.bond_to_base for film in probe.film.by_block], "bond_to_base")
    axis = "the inner film's centre on the base's axis, an opening of the outer one at +x"
    steps.append(f"Bond each film to the base{layers}; {axis}.")
    steps += [_describe_exit(pattern) for pattern in patterns]
    steps.append(_describe_block_bonding("films", probe))
    if any(film.stack_height > film.thickness for film in probe.film.by_block):
        heights = [f"{format_number(1e3 * film.stack_height)} mm" for film in probe.film.by_block]
        text = heights[0] if heights[0] == heights[1] else f"{heights[0]} (inner) and {heights[1]} (outer)"
        steps.append(f"Measure the height of film and bonds between block and base: {text}; other heights change the charges.")
    return steps


def _describe_bonds(bonds: Sequence[Bond | None], key: str) -> str:
    """Return with what the inner and the outer film are bonded on one side, " with ..."; ``key`` is that of the scene."""
    thin = f"adhesive as thin as it goes (the scene has no {key})"
    inner, outer = (describe_bond(bond) or (thin if bond is None else "adhesive as thin as it goes") for bond in bonds)
    return f" with {inner}" if inner == outer else f": the inner one with {inner}, the outer one with {outer}"


def _describe_exit(pattern: FilmPattern) -> str:
    """Return the step that leads a film's leads out."""
    exit_texts = {
        "groove": "through the outer block's groove, towards +x",
        "gap": "down the gap, folded at the block's edge, and out at its lower end: it must not touch the walls",
        "outside": "outwards, towards -x",
        "": "nowhere: no groove is deeper than the film and the gap is narrower; give the scene a [probe.groove]",
    }
    return f"Lead the {pattern.name.removeprefix('film-')} film's leads {exit_texts[pattern.exit]}."


def _describe_block_bonding(onto: str, probe: Probe) -> str:
    """Return the step that bonds both blocks to the films or the base, ``onto``."""
    bonds = [] if probe.film is None else [film.bond_to_block for film in probe.film.by_block]
    layers = _describe_bonds(bonds, "bond_to_block") if bonds else ""
    groove = "; its groove lies at +x" if probe.groove is not None else ""
    return f"Bond the inner block, concentric with the base, then the outer block to the {onto}{layers}{groove}."


def _describe_gap(probe: Probe, moulds: Sequence[MouldSizes], budget: Budget) -> str:
    """Return the step that holds the gap while the bonds set."""
    gap = 1e3 * probe.gap
    instruction = (
        f"Hold the gap while the bonds set: three shims of {format_number(gap)} mm, 120\u00b0 apart, from the "
        "tissue end between "
        "the blocks; "
    )
    if moulds:
        return (
            f"{instruction}they centre the inner block. The gap itself follows from both blocks' walls: {format_number(gap)} mm, "
            f"\u00b1{format_deviation(compute_gap_deviation(probe, moulds))} mm by their tolerances. Draw the shims out "
            "along the axis."
        )
    deviation = format_deviation(find_tolerance(gap, budget.find_bound("gap")).deviation)
    return f"{instruction}the gap is {format_number(gap)} \u00b1{deviation} mm all round. Draw them out along the axis."


def _list_measuring_steps(moulds: Sequence[MouldSizes]) -> list[str]:
    """Return the steps for measuring and calibrating the probe, with the moulds of cast blocks."""
    steps = []
    if moulds:
        names = " and ".join(mould.name for mould in moulds)
        steps.append(
            f"Measure the moulds of the {names} block, as their drawings say, not the soft blocks. From each pour cast a "
            "cylinder as well, test it in compression (ISO 7743), and write its modulus into the scene."
        )
    hard = "" if len(moulds) == 2 else "the block's and "
    steps.append(
        f"Measure {hard}the base's sizes against the drawings, and the gap with feeler gauges; both lower faces in one plane. "
        "Then calibrate: `probe-design calibrate`, `probe-design check`."
    )
    return steps


def describe_scatter(scatter: Mapping[str, float], budget: Budget) -> str:
    """Describe the scatter of probes built to the drawings, and its largest sources; empty where the scatter is unknown."""
    if not budget.sensitivities:
        return ""
    parts = ", ".join(f"{name} {format_percent(sd)}" for name, sd in list(scatter.items())[:MAX_LISTED_PARTS])
    total = combine_scatter(scatter)
    requested = f"requested: {budget.percent:g} %"
    advice = "" if total <= budget.percent else ": what dominates has to be measured, or calibrated, since no drawing holds it"
    summary = f"Probes built to these drawings scatter in the ratio by {total:.3g} % (1 sd, before calibration; {requested})"
    return f"{summary}: {parts}, ...{advice}"


def _list_remarks(probe: Probe, moulds: Sequence[MouldSizes], budget: Budget, scatter: Mapping[str, float]) -> list[str]:
    """Return the remarks at the end of the page on tolerances, assumed sizes and moulds."""
    remarks = [f"{describe_scatter(scatter, budget)} (`tolerances.csv`)."] if budget.sensitivities else []
    deviation = compute_gap_deviation(probe, moulds)
    if moulds and deviation >= GAP_RISK_FRACTION * 1e3 * probe.gap:
        remarks.append(
            f"The gap of {format_mm(probe.gap)} is within reach of the castings' tolerances "
            f"(\u00b1{format_deviation(deviation)} mm): measure "
            "both moulds before casting, so that it stays open."
        )
    if budget.remark:
        remarks.append(budget.remark)
    remarks += [f"Assumed, the scene does not give it: {key} = {format_mm(size)}." for key, size in assume_sizes(probe).items()]
    for mould in moulds:
        if 2 * mould.vent < SMALL_HOLE_MM:
            remarks.append(
                f"The {mould.name} block's lid: holes of {format_number(2 * mould.pour)} and "
                f"{format_number(2 * mould.vent)} mm are below what "
                "is drilled; fill the open lower half and close it, or have them made by laser."
            )
        if mould.draft < DEFAULT_DRAFT_RAD:
            remarks.append(
                f"The {mould.name} mould's draft is less than usual, so that the gap keeps its width; use a release agent."
            )
    return remarks


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
        f"cavity {', '.join(sizes)}; shrinkage {format_percent(mould.shrinkage, 6)}, draft {draft}.",
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
    """Return a block's modulus with its standard deviation; empty where the budget does not have it."""
    known = budget.find_modulus(block)
    return "" if known is None else f"{known.nominal} \N{PLUS-MINUS SIGN}{format_percent(known.sd)} (1 sd); "


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
