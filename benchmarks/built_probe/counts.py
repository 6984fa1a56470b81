"""Summarise a study of built probes: observed fractions with their intervals, beside the stated ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.stats import binomtest, kstest

from geometry.common.arrays import Floats
from probe_design.built_probe.gains import ENTRY_NAMES
from probe_design.probe_check.deviation import SIGNIFICANCE_LEVEL

MIN_LIKELY_POWER = 0.9  # power from which a probe counts as one that the check should find


@dataclass(frozen=True)
class ProbeOutcome:
    """What became of one probe.

    Attributes
    ----------
    off, turn
        The variable beyond its tolerance, and by how many tolerances.
    p_value
        Of the check; 0 where calibration or check was refused.
    power
        The check's own probability of detecting the variable so far off; None: within tolerance.
    errors
        Of the gain matrix over their standard deviations, shape (4,).
    refused
        Why, or empty.
    named
        Whether the explanation has the variable's name; None: not asked for.
    """

    off: str | None
    turn: float
    p_value: float = 0.0
    power: float | None = None
    errors: Floats = field(default_factory=lambda: np.zeros(0))
    refused: str = ""
    named: bool | None = None

    @property
    def alarmed(self) -> bool:
        """Whether the user was warned that something is off."""
        return self.p_value < SIGNIFICANCE_LEVEL


def print_within(outcomes: Sequence[ProbeOutcome]) -> None:
    """Print false alarms and coverage."""
    read = [outcome for outcome in outcomes if not outcome.refused]
    alarms = sum(outcome.alarmed for outcome in read)
    print(f"{len(outcomes)} within tolerance: {len(outcomes) - len(read)} calibrations refused")
    print(f"false alarms: {share(alarms, len(read))}, stated {100 * SIGNIFICANCE_LEVEL:g} %")
    print(f"p-values evenly spread: Kolmogorov-Smirnov p = {kstest([outcome.p_value for outcome in read], 'uniform').pvalue:.2g}")
    inside = np.sum([np.abs(outcome.errors) < 1.96 for outcome in read], axis=0)
    for name, count in zip(ENTRY_NAMES, inside, strict=True):
        print(f"{name} within 1.96 sd: {share(int(count), len(read))}, stated 95 %")


def print_out(outcomes: Sequence[ProbeOutcome]) -> None:
    """Print what is found of each variable beside the check's own power, and what is named."""
    print(
        f"{len(outcomes)} out of tolerance by 5 to 15: {sum(outcome.alarmed for outcome in outcomes)} found, or refused "
        "by calibrate"
    )
    for name in dict.fromkeys(outcome.off for outcome in outcomes):
        ours = [outcome for outcome in outcomes if outcome.off == name]
        stated = sum(outcome.power if outcome.power is not None else 1.0 for outcome in ours)
        print(f"{name}: {sum(outcome.alarmed for outcome in ours)} of {len(ours)} found, {stated:.1f} by the check's own power")
    likely = [outcome for outcome in outcomes if outcome.refused or (outcome.power or 0.0) >= MIN_LIKELY_POWER]
    print(
        f"of those with a power of {MIN_LIKELY_POWER:g} or more: "
        f"{share(sum(outcome.alarmed for outcome in likely), len(likely))} found"
    )
    named = [outcome.named for outcome in outcomes if outcome.named is not None]
    if named:
        print(f"explained: {len(named)}, of which {sum(named)} name the variable")


def share(count: int, total: int) -> str:
    """Return a share with its exact interval of 95 % (Clopper and Pearson)."""
    if not total:
        return "none"
    low, high = binomtest(count, total).proportion_ci(0.95, "exact")
    return f"{count} of {total} = {100 * count / total:.1f} % ({100 * low:.1f} to {100 * high:.1f} %)"
