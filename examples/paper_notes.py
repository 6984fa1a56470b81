"""What of the paper's Table 3 can be compared with ours and what cannot, in plain lines."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

from paper_order import agreed, order
from paper_table import AREA_RATIO, TABLE_3, check_position, get_printed_ratios

if TYPE_CHECKING:
    from solver import Result

NOISE = 0.05  # section 3: "about 5%"


def notes(results: Mapping[int, Result]) -> Iterator[str]:
    """Yield what can be compared, what cannot, and what was assumed."""
    yield from _comparable(results)
    yield from _incomparable(results)
    yield (
        "Assumed where the paper gives nothing, as in probe_design/data/builtin.toml: inner radius 5 mm, height 5 mm, rigid "
        "base, bonded contact, tumours 10 mm deep; and in examples/paper-study.toml: tumours 30 mm apart along the block, "
        "tumour 1 25 mm from its end, the far place 25 mm beside tumour 2. 5 and 8 mm stand for the printed 50 and 80 mm."
    )
    yield (
        "Work: one solution a position serves the three loads. No two positions are mirror images of each other (the tumours "
        "differ, the groove is on the +x side), so that each has meshes of its own, of half the block, as y and -y are alike. "
        "solid keeps its meshes: the next run is faster."
    )


def _comparable(results: Mapping[int, Result]) -> Iterator[str]:
    yield (
        "Can be compared, linearity: the printed ratio is the same at 1, 5 and 10 N within 0.03 %, as closely as its digits "
        "tell; so is ours, by linear elasticity. So nothing that grows out of proportion (the gap closing, large "
        "strains) had any part in the paper's model either."
    )
    ours = {k: result.ratio for k, result in results.items() if result.ratio is not None}
    bounds = {k: result.error_estimate or 0.0 for k, result in results.items()}
    printed, signed = (order(get_printed_ratios(sign), {}) for sign in (False, True))
    pairs = "; ".join(f"{how}: {', '.join(which)}" for how, which in agreed(ours, bounds).items() if which)
    yield (
        f"Can be compared, order of the positions by ratio: printed {printed}, with the stresses' own signs {signed}; ours "
        f"{order(ours, bounds)} (~: closer than the error bounds). Pairs of the printed order, in ours {pairs}."
    )
    if all((result.ratio or 0.0) > 1 for result in results.values()):
        yield "Can be compared, the stiffer block: stress 1 is larger in size than stress 2 everywhere, in print and here."


def _incomparable(results: Mapping[int, Result]) -> Iterator[str]:
    middle, small, large = (f"{TABLE_3[k][0].stress_1:g} / {TABLE_3[k][0].stress_2:g}" for k in (1, 2, 3))
    yield (
        f"Cannot be compared, where stresses are largest: the text says on tumour 1, the table has {large} there, less than "
        f"between the tumours ({middle}) and on the smaller one ({small}). Nor can both means rise at one load, which is "
        f"A2 stress 1 + A1 stress 2: ours at 1 N are {_pair(results[3])} kPa on tumour 1, {_pair(results[1])} kPa between."
    )
    areas = [check_position(rows).area for rows in TABLE_3.values()]
    yield (
        "Cannot be compared, size of stresses and ratios: no unit, radius, height, depth or coordinate is printed; and with "
        f"A2/A1 = {AREA_RATIO:g} the force balance asks for another A1 at each position, {min(areas):.3f} to "
        f"{max(areas):.3f}, so that these are not mean stresses of one probe. At position 4 stress 2 has the other sign: that "
        "ratio is -26.6."
    )
    deep = [1e3 / result.stiffness for result in results.values() if result.stiffness]
    pressed = f" and would press the probe {min(deep):.0f} to {max(deep):.0f} mm into a block 60 mm deep" if deep else ""
    yield (
        f"Cannot be compared, loads: 1 N crushes a block of 100 Pa{pressed}, were all linear. Of ours the ratio alone, the limit "
        "of small loads, means anything."
    )
    derivative = results[3].log_sensitivity
    if derivative:
        yield (
            f"Not determined: E_object. On tumour 1 d ln(ratio) / d ln(E_object) is {derivative:.2g}, so that the paper's 5 % "
            f"error of measurement, on the ratio, leaves a standard deviation of {NOISE / abs(derivative):.0f} in ln E_object."
        )


def _pair(result: Result) -> str:
    inner, two = result.stress_inner, result.stress_outer
    return "unknown" if inner is None or two is None else f"{inner / 1e3:.4g} / {two / 1e3:.4g}"
