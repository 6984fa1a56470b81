"""Decide the verdict of a check: within the workshop's tolerances as far as tested, out of them, or not decidable, and why.

Causes of a deviation are tried from the most to the least frequent mistake: exchanged cables or blocks, one variable of the
design, one wrong reading, two variables.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from geometry.scenes.scene import Scene
from probe_design.built_probe.bench import Bench
from probe_design.built_probe.block_predictions import BLOCK_MODULI, BlockPredictions
from probe_design.probe_check.changed_designs import GAIN_NAME
from probe_design.probe_check.coverage import VariableCoverage
from probe_design.probe_check.deviation import SIGNIFICANCE_LEVEL, Deviation
from probe_design.probe_check.explanations import (
    INDISTINGUISHABLE_CHI_SQUARE,
    Explanation,
    VariablePair,
    build_explanation,
    compute_explanations,
    fit_pairs,
    fit_variables,
    list_indistinguishable,
)
from solver.results.evaluator import ProgressCallback, ignore_progress

VERDICT_WITHIN, VERDICT_OUT = "within workshop tolerance as far as tested", "out of workshop tolerance"
VERDICT_UNKNOWN, VERDICT_UNTESTED = "undetermined", "nothing could be tested"
BENCH_FAULTS = {
    GAIN_NAME: "one film's gain (its cable, its amplifier, its temperature since calibration)",
    BLOCK_MODULI: "the blocks' moduli",
}


@dataclass(frozen=True)
class Verdict:
    """The conclusion of a check; see ``probe_design.probe_check.check.Check`` for the fields."""

    verdict: str
    reason: str
    explanations: tuple[Explanation, ...]
    unresolved: tuple[str, ...]
    alike: tuple[str, ...] = ()
    pairs: tuple[VariablePair, ...] = ()


def decide_verdict(
    scene: Scene, bench: Bench, deviation: Deviation, predictions: BlockPredictions, swaps: Sequence[str],
    *, coverage: Sequence[VariableCoverage], progress: ProgressCallback = ignore_progress,
) -> Verdict:  # fmt: skip
    """Decide the verdict for a deviation.

    Parameters
    ----------
    scene
        The probe as drawn.
    bench
        Blocks and tolerances.
    deviation
        Of all blocks.
    predictions
        Predictions for the probe as drawn.
    swaps
        Descriptions of exchanges of cables or blocks; each exchange alone would explain the deviation.
    coverage
        How well each variable is tested.
    progress
        Called with a line of text at each step.
    """
    linear, unresolved = compute_explanations(deviation, predictions)
    if deviation.p_value >= SIGNIFICANCE_LEVEL:
        return Verdict(*_decide_within(coverage), linear, unresolved)
    if swaps:
        reason = f"exchanged are: {', or '.join(swaps)}; put it right, and read again"
        return Verdict(VERDICT_UNKNOWN, reason, linear, unresolved)
    fits = fit_variables(
        scene, bench, deviation, predictions, [*(item.variable for item in linear), *unresolved], progress=progress
    )
    explained = tuple(build_explanation(item, deviation) for item in fits)
    if explained[0].explains:
        names = list_indistinguishable(explained)
        return Verdict(*_decide_single(names), explained, (), names)
    pairs, odd_blocks = (
        fit_pairs(deviation, predictions, fits, progress=progress),
        _find_odd_blocks(deviation, bench),
    )
    return Verdict(*_decide_several(pairs, odd_blocks), explained, (), (), pairs)


def _decide_within(coverage: Sequence[VariableCoverage]) -> tuple[str, str]:
    """Return verdict and reason for readings that agree with the drawing; ``coverage`` is how well each variable is tested."""
    if any(entry.tested for entry in coverage):
        return VERDICT_WITHIN, ""
    reason = "no deviation by five tolerances would be detected, so that readings that agree do not confirm the probe"
    return VERDICT_UNTESTED, reason


def _decide_single(names: Sequence[str]) -> tuple[str, str]:
    """Return verdict and reason for indistinguishable variables; without a variable of the probe the bench is the cause."""
    if all(name in BENCH_FAULTS for name in names):
        return VERDICT_UNKNOWN, f"the bench, rather than the probe: {', or '.join(BENCH_FAULTS[name] for name in names)}"
    return VERDICT_OUT, ", or ".join(names)


def _decide_several(pairs: Sequence[VariablePair], odd_blocks: Sequence[str]) -> tuple[str, str]:
    """Return verdict and reason where no single variable explains the deviation: a pair, a wrong reading, or neither."""
    explaining = [pair for pair in pairs if pair.explains]
    close = [
        " with ".join(pair.variables)
        for pair in explaining
        if pair.chi_square - explaining[0].chi_square < INDISTINGUISHABLE_CHI_SQUARE
    ]
    if close:
        besides = f"; or the reading on the {odd_blocks[0]} alone is wrong" if len(odd_blocks) == 1 else ""
        return VERDICT_OUT, f"no single variable; two together: {', or '.join(close)}{besides}"
    if odd_blocks:
        return VERDICT_UNKNOWN, f"without the reading on the {', or on the '.join(odd_blocks)} the others agree: read it again"
    return VERDICT_OUT, "neither one variable nor two explain it"


def _find_odd_blocks(deviation: Deviation, bench: Bench) -> list[str]:
    """Find each block without whose reading the others are within the tolerances; none if there are fewer than three blocks."""
    if len(bench.blocks) < 3:
        return []
    return [block.name for k, block in enumerate(bench.blocks) if deviation.drop_block(k).p_value >= SIGNIFICANCE_LEVEL]
