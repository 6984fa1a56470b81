"""The order of the paper's four positions by ratio, in print and in ours."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations, pairwise

from paper_table import get_printed_ratios


def is_below(low: int, high: int, ratios: Mapping[int, float], bounds: Mapping[int, float]) -> bool:
    """Whether the ratio at one position is below that at another by more than both relative bounds together."""
    slack = sum(bounds.get(k, 0.0) * abs(ratios[k]) for k in (low, high))
    return ratios[high] - ratios[low] > slack


def order(ratios: Mapping[int, float], bounds: Mapping[int, float]) -> str:
    """Return the positions by rising ratio, with "<" where the bounds tell them apart, else "~"."""
    ranked = sorted(ratios, key=lambda k: ratios[k])
    signs = ["<" if is_below(low, high, ratios, bounds) else "~" for low, high in pairwise(ranked)]
    return "".join(f" {sign} {k}" for sign, k in zip(["", *signs], ranked, strict=False)).strip() or "unknown"


def agreed(ours: Mapping[int, float], bounds: Mapping[int, float]) -> dict[str, list[str]]:
    """Return the pairs of positions that rank alike in print and here, otherwise, or that our bounds leave open."""
    printed = get_printed_ratios(signed=False)
    pairs: dict[str, list[str]] = {"alike": [], "otherwise": [], "open": []}
    for first, second in combinations(sorted(ours), 2):
        low, high = (first, second) if printed[first] < printed[second] else (second, first)
        agrees, opposite = is_below(low, high, ours, bounds), is_below(high, low, ours, bounds)
        pairs["alike" if agrees else "otherwise" if opposite else "open"].append(f"{low} < {high}")
    return pairs
