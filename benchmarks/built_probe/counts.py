"""What a study of built probes comes to: shares with their intervals, beside what is stated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.stats import binomtest, kstest

from geometry.common.arrays import Floats
from probe_design.built_probe.gain_matrix import ENTRY_NAMES
from probe_design.probe_check.deviation import SIGNIFICANCE_LEVEL

LIKELY = 0.9  # power from which a probe counts as one that the check should find


@dataclass(frozen=True)
class ProbeOutcome:
    """What became of one probe.

    Attributes:
        off, turn: the variable beyond its tolerance, and by how many tolerances.
        p_value: of the check; 0 where calibration or check was refused.
        power: how likely the check says that it finds the variable off by so much; None: within tolerance.
        errors: of the gain matrix over their standard deviations, shape (4,).
        refused: why, or empty.
        named: whether the explanation has the variable's name; None: not asked for.
    """

    off: str | None
    turn: float
    p_value: float = 0.0
    power: float | None = None
    errors: Floats = field(default_factory=lambda: np.zeros(0))
    refused: str = ""
    named: bool | None = None

    @property
    def found(self) -> bool:
        """Whether somebody was told that something is off."""
        return self.p_value < SIGNIFICANCE_LEVEL


def print_within(outcomes: Sequence[ProbeOutcome]) -> None:
    """Print false alarms and coverage."""
    read = [one for one in outcomes if not one.refused]
    alarms = sum(one.found for one in read)
    print(f"{len(outcomes)} within tolerance: {len(outcomes) - len(read)} calibrations refused")
    print(f"false alarms: {share(alarms, len(read))}, stated {100 * SIGNIFICANCE_LEVEL:g} %")
    print(f"p-values evenly spread: Kolmogorov-Smirnov p = {kstest([one.p_value for one in read], 'uniform').pvalue:.2g}")
    inside = np.sum([np.abs(one.errors) < 1.96 for one in read], axis=0)
    for name, count in zip(ENTRY_NAMES, inside, strict=True):
        print(f"{name} within 1.96 sd: {share(int(count), len(read))}, stated 95 %")


def print_out(outcomes: Sequence[ProbeOutcome]) -> None:
    """Print what is found of each variable beside the check's own power, and what is named."""
    print(f"{len(outcomes)} out of tolerance by 5 to 15: {sum(one.found for one in outcomes)} found, or refused by calibrate")
    for name in dict.fromkeys(one.off for one in outcomes):
        ours = [one for one in outcomes if one.off == name]
        stated = sum(one.power if one.power is not None else 1.0 for one in ours)
        print(f"{name}: {sum(one.found for one in ours)} of {len(ours)} found, {stated:.1f} by the check's own power")
    likely = [one for one in outcomes if one.refused or (one.power or 0.0) >= LIKELY]
    print(f"of those with a power of {LIKELY:g} or more: {share(sum(one.found for one in likely), len(likely))} found")
    named = [one.named for one in outcomes if one.named is not None]
    if named:
        print(f"explained: {len(named)}, of which {sum(named)} name the variable")


def share(count: int, of: int) -> str:
    """Return a share with its exact interval of 95 % (Clopper and Pearson)."""
    if not of:
        return "none"
    low, high = binomtest(count, of).proportion_ci(0.95, "exact")
    return f"{count} of {of} = {100 * count / of:.1f} % ({100 * low:.1f} to {100 * high:.1f} %)"
