"""Find the variable, or the two variables, that would explain a probe's deviation from its prediction.

A variable that is off by e shifts d = ln rho measured - ln rho predicted by (J - G S) e (PC.2): J is its effect
on the probe's ln rho; the calibration, which assumed the drawing, is wrong by -S e, with its derivatives S, and G as in eq. PC.1.
One e is fitted for
each variable alone, e = D^T C^-1 d / D^T C^-1 D, D = J - G S (PC.3), where C includes the tolerances of all others. Then all
of them are fitted again with changed designs, since large changes are not linear. If none explains the deviation, pairs are
tried, starting from each variable's own best design.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.special import chdtrc

from geometry.common.arrays import Floats
from geometry.scenes.scene import Scene
from probe_design.built_probe.bench import Bench
from probe_design.built_probe.block_predictions import Shares
from probe_design.probe_check.changed_designs import GAIN, Changes, Fit, linear_left, settled
from probe_design.probe_check.deviation import LEVEL, Deviation
from solver.results.evaluator import Tell, silent

ALIKE = 4.0  # difference of chi-squares, 2 standard deviations, below which two explanations cannot be distinguished
LOOSE = 1.0  # standard deviation relative to the value above which a variable is not determined
PAIRS = 6  # pairs that are fitted with changed designs, the best by linear theory


@dataclass(frozen=True)
class Explanation:
    """One variable that may differ from the drawing.

    Attributes:
        variable: key of the scene file, ``reference.youngs_modulus`` (of all blocks) or ``relative gain``.
        change: its difference from the drawing, SI; relative for the last two.
        uncertainty: standard deviation of ``change``.
        nominal: as drawn; 1 for the last two.
        chi_square: of the remaining deviation.
        p_value: of ``chi_square``.
        explains: whether the remaining deviation is not significant.
    """

    variable: str
    change: float
    uncertainty: float
    nominal: float
    chi_square: float
    p_value: float
    explains: bool


@dataclass(frozen=True)
class VariablePair:
    """Two variables that may differ together; chi-square and p-value are those of both, also in ``first`` and ``second``."""

    first: Explanation
    second: Explanation
    chi_square: float
    p_value: float
    explains: bool

    @property
    def variables(self) -> tuple[str, str]:
        """Names of both variables."""
        return self.first.variable, self.second.variable


def explanations(deviation: Deviation, shares: Shares) -> tuple[tuple[Explanation, ...], tuple[str, ...]]:
    """Fit each variable alone by linear theory; return the explanations, best first, and the names of undetermined variables."""
    slopes = dict(zip(shares.variables, shares.slopes.T, strict=True)) | {GAIN: np.ones(len(deviation.logs))}
    nominal = dict(zip(shares.variables, shares.nominal.tolist(), strict=True)) | {GAIN: 1.0}
    off = deviation.logs - deviation.drawn
    fits = [_fitted(deviation, name, slope - deviation.bias(name), off, nominal[name]) for name, slope in slopes.items()]
    good = [one for one in fits if one.uncertainty < LOOSE * one.nominal]
    return _best_first(good), tuple(one.variable for one in fits if one not in good)


def refined(
    scene: Scene, bench: Bench, deviation: Deviation, shares: Shares, names: Sequence[str], *, tell: Tell = silent
) -> tuple[Fit, ...]:
    """Fit each of these variables alone with changed designs, best first; ``tell`` reports progress."""
    fits = []
    for k, name in enumerate(names, 1):
        tell(f"what would explain it: {name}, {k} of {len(names)}")
        fits.append(settled(Changes.none(scene, bench, shares, name), deviation))
    return tuple(sorted(fits, key=lambda one: one.chi_square))


def paired(deviation: Deviation, shares: Shares, fits: Sequence[Fit], *, tell: Tell = silent) -> tuple[VariablePair, ...]:
    """Fit the most promising pairs, best first, from the fits of single variables; none for fewer than three blocks."""
    if len(deviation.logs) < 3:
        return ()
    best: dict[frozenset[str], tuple[float, Fit, str]] = {}
    for one, other in product(fits, [name for fit in fits for name in fit.changes.names]):
        pair = frozenset((*one.changes.names, other))
        if len(pair) == 2 and (left := linear_left(one, deviation, other)) < best.get(pair, (np.inf,))[0]:
            best[pair] = left, one, other
    worth = sorted(best.values(), key=lambda start: start[0])[:PAIRS]
    joint = []
    for k, (_, one, other) in enumerate(worth, 1):
        tell(f"which two would: {one.changes.names[0]} and {other}, {k} of {len(worth)}")
        joint.append(settled(one.changes.and_other(shares, other), deviation))
    return tuple(sorted((_pair(one, deviation) for one in joint), key=lambda pair: pair.chi_square))


def alike(explained: Sequence[Explanation]) -> tuple[str, ...]:
    """List the best explanation's name and those that the readings do not distinguish from it."""
    return tuple(one.variable for one in explained if one.chi_square - explained[0].chi_square < ALIKE)


def _best_first(fits: Sequence[Explanation]) -> tuple[Explanation, ...]:
    return tuple(sorted(fits, key=lambda one: one.chi_square))


def told(fit: Fit, deviation: Deviation, at: int = 0) -> Explanation:
    """Build the explanation by one of a fit's variables."""
    p_value = _p_value(fit.chi_square, len(deviation.logs) - len(fit.changes.names))
    return Explanation(
        variable=fit.changes.names[at],
        change=float(fit.changes.values[at] - fit.changes.nominal[at]),
        uncertainty=float(fit.uncertainties[at]),
        nominal=float(fit.changes.nominal[at]),
        chi_square=fit.chi_square,
        p_value=p_value,
        explains=p_value >= LEVEL,
    )


def _pair(fit: Fit, deviation: Deviation) -> VariablePair:
    first, second = (told(fit, deviation, at) for at in (0, 1))
    return VariablePair(first, second, first.chi_square, first.p_value, first.explains)


def _p_value(left: float, freedom: int) -> float:
    return float(chdtrc(freedom, left)) if freedom > 0 else 1.0


def _fitted(deviation: Deviation, name: str, shift: Floats, off: Floats, nominal: float) -> Explanation:
    """Fit one variable by eq. PC.3, and compute the remaining chi-square."""
    weight = deviation.weight(name)
    information = max(float(shift @ weight @ shift), np.finfo(float).tiny)
    change = float(shift @ weight @ off) / information
    rest = off - shift * change
    left = float(rest @ weight @ rest)
    p_value = _p_value(left, len(off) - 1)
    return Explanation(
        variable=name,
        change=change,
        uncertainty=float(information**-0.5),
        nominal=nominal,
        chi_square=left,
        p_value=p_value,
        explains=p_value >= LEVEL,
    )
