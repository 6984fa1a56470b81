"""Decide the verdict of a check: within the workshop's tolerances as far as tested, out of them, or not decidable, and why.

Causes of a deviation are tried from the most to the least frequent mistake: exchanged cables or blocks, one variable of the
design, one wrong reading, two variables.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from geometry.scenes.scene import Scene
from probe_design.built_probe.bench import Bench
from probe_design.built_probe.block_predictions import MODULI, Shares
from probe_design.probe_check.changed_designs import GAIN
from probe_design.probe_check.coverage import VariableCoverage
from probe_design.probe_check.deviation import LEVEL, Deviation
from probe_design.probe_check.explanations import ALIKE, Explanation, VariablePair, alike, explanations, paired, refined, told
from solver.results.evaluator import Tell, silent

WITHIN, OUT = "within workshop tolerance as far as tested", "out of workshop tolerance"
UNKNOWN, UNTESTED = "cannot tell", "nothing could be tested"
BENCH_S = {GAIN: "one film's gain (its cable, its amplifier, its temperature since calibration)", MODULI: "the blocks' moduli"}


@dataclass(frozen=True)
class Verdict:
    """The conclusion of a check; see ``probe_design.probe_check.check.Check`` for the fields."""

    verdict: str
    reason: str
    explanations: tuple[Explanation, ...]
    unresolved: tuple[str, ...]
    alike: tuple[str, ...] = ()
    pairs: tuple[VariablePair, ...] = ()


def judged(
    scene: Scene, bench: Bench, deviation: Deviation, shares: Shares, exchanged: Sequence[str],
    *, tested: Sequence[VariableCoverage], tell: Tell = silent,
) -> Verdict:  # fmt: skip
    """Decide the verdict for a deviation.

    Args:
        scene: the probe as drawn.
        bench: blocks and tolerances.
        deviation: of all blocks.
        shares: predictions for the probe as drawn.
        exchanged: descriptions of exchanges each of which would explain it.
        tested: how well each variable is tested.
        tell: called with reports of progress.
    """
    linear, unresolved = explanations(deviation, shares)
    if deviation.p_value >= LEVEL:
        return Verdict(*_within(tested), linear, unresolved)
    if exchanged:
        return Verdict(UNKNOWN, f"exchanged are: {', or '.join(exchanged)}; put it right, and read again", linear, unresolved)
    fits = refined(scene, bench, deviation, shares, [*(one.variable for one in linear), *unresolved], tell=tell)
    explained = tuple(told(one, deviation) for one in fits)
    if explained[0].explains:
        names = alike(explained)
        return Verdict(*_by_one(names), explained, (), names)
    pairs, odd = paired(deviation, shares, fits, tell=tell), _odd_ones(deviation, bench)
    return Verdict(*_by_more(pairs, odd), explained, (), (), pairs)


def _within(tested: Sequence[VariableCoverage]) -> tuple[str, str]:
    if any(one.tested for one in tested):
        return WITHIN, ""
    return UNTESTED, "no variable would be found off by five tolerances, so that readings that agree do not confirm the probe"


def _by_one(names: Sequence[str]) -> tuple[str, str]:
    """Return verdict and reason for indistinguishable variables; without a variable of the probe the bench is the cause."""
    if all(name in BENCH_S for name in names):
        return UNKNOWN, f"the bench, rather than the probe: {', or '.join(BENCH_S[name] for name in names)}"
    return OUT, ", or ".join(names)


def _by_more(pairs: Sequence[VariablePair], odd: Sequence[str]) -> tuple[str, str]:
    good = [one for one in pairs if one.explains]
    close = [" with ".join(one.variables) for one in good if one.chi_square - good[0].chi_square < ALIKE]
    if close:
        besides = f"; or the reading on the {odd[0]} alone is wrong" if len(odd) == 1 else ""
        return OUT, f"no single variable; two together: {', or '.join(close)}{besides}"
    if odd:
        return UNKNOWN, f"without the reading on the {', or on the '.join(odd)} the others agree: read it again"
    return OUT, "neither one variable nor two explain it"


def _odd_ones(deviation: Deviation, bench: Bench) -> list[str]:
    """Find the blocks each of which, if left out, leaves a probe within the tolerances; needs three blocks or more."""
    if len(bench.blocks) < 3:
        return []
    return [block.name for k, block in enumerate(bench.blocks) if deviation.without(k).p_value >= LEVEL]
