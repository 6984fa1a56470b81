"""Which single variable would explain that a probe deviates from its prediction.

A variable that is off by e shifts d = ln rho measured - ln rho predicted by (J - G S) e (BP.5): J is what it does to the probe;
the calibration, which took the drawing as true, is off by -S e, S its slopes, and G carries that to ln rho. One e is fitted for
each variable alone, e = D^T C^-1 d / D^T C^-1 D, D = J - G S (BP.6); for the best ones again at the design so changed, until e
stays.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from geometry.common.arrays import Floats
from geometry.scenes.scene import Scene
from geometry.scenes.variables import changed
from probe_design.built_probe.bench import Bench
from probe_design.built_probe.block_predictions import MODULI, Shares, by_outer_radius, predicted

GAIN = "relative gain"
LEVEL = 0.01  # p-value below which a deviation is one, and the probe fails
ALIKE = 4.0  # difference of the remaining chi-squares below which two explanations are not told apart: 2 standard deviations
LOOSE = 1.0  # standard deviation, relative to the value, above which an explanation says nothing
WORTH_REFINING = 4  # of the best explanations: those whose chi-square is below FAR times the best's
FAR = 10.0
STEPS = 4  # of Newton
SETTLED = 0.05  # of the standard deviation


@dataclass(frozen=True)
class Deviation:
    """What was read and what was predicted of k blocks.

    Attributes:
        logs: ln(F_inner / F_outer) as read, shape (k,).
        drawn: as predicted for the probe as drawn, shape (k,).
        read: covariance of ``logs``, shape (k, k).
        model: variances of ``drawn``, shape (k,).
        calibration_bias: G S of eq. BP.5 by variable, shape (k,) each; 0 where one is missing.
    """

    logs: Floats
    drawn: Floats
    read: Floats
    model: Floats
    calibration_bias: Mapping[str, Floats]

    @property
    def weight(self) -> Floats:
        """C^-1, shape (k, k)."""
        return np.asarray(np.linalg.inv(self.read + np.diag(self.model)), dtype=float)

    @property
    def chi_square(self) -> float:
        """Of the probe as drawn, eq. BP.4 of ``probe_design.built_probe.check``."""
        off = self.logs - self.drawn
        return float(off @ self.weight @ off)

    def bias(self, name: str) -> Floats:
        """G S of a variable, shape (k,)."""
        return self.calibration_bias.get(name, np.zeros(len(self.logs)))


@dataclass(frozen=True)
class Explanation:
    """One variable that may be off its drawing.

    Attributes:
        variable: key of the scene file, ``reference.youngs_modulus`` (of all blocks) or ``relative gain``.
        change: by which it would be off, SI; relative for the last two.
        uncertainty: standard deviation of ``change``.
        nominal: as drawn; 1 for the last two.
        chi_square: that is left.
        p_value: of it.
        explains: whether what is left is no deviation any more.
    """

    variable: str
    change: float
    uncertainty: float
    nominal: float
    chi_square: float
    p_value: float
    explains: bool


def explanations(deviation: Deviation, shares: Shares) -> tuple[tuple[Explanation, ...], tuple[str, ...]]:
    """Return what each variable would explain, best first, and the names of those that the readings do not tell."""
    slopes = dict(zip(shares.variables, shares.slopes.T, strict=True)) | {GAIN: np.ones(len(deviation.logs))}
    nominal = dict(zip(shares.variables, shares.nominal.tolist(), strict=True)) | {GAIN: 1.0}
    off = deviation.logs - deviation.drawn
    fits = [_fitted(deviation, name, slope - deviation.bias(name), off, nominal[name]) for name, slope in slopes.items()]
    good = [one for one in fits if one.uncertainty < LOOSE * one.nominal]
    return _best_first(good), tuple(one.variable for one in fits if one not in good)


def refined(scene: Scene, bench: Bench, deviation: Deviation, explained: tuple[Explanation, ...]) -> tuple[Explanation, ...]:
    """Fit the best explanations again at the designs that they ask for; those that no design can have are left out."""
    drawn = by_outer_radius(scene)
    possible = [one for one in explained if _possible(drawn, one)]
    worth = [one for one in possible[:WORTH_REFINING] if one.chi_square <= FAR * possible[0].chi_square]
    again = (_settled(drawn, bench, deviation, one) for one in worth)
    return _best_first([*(one for one in again if one is not None), *possible[len(worth) :]])


def alike(explained: tuple[Explanation, ...]) -> tuple[str, ...]:
    """Return the best explanation's name and those that the readings do not tell apart from it."""
    return tuple(one.variable for one in explained if one.chi_square - explained[0].chi_square < ALIKE)


def _best_first(fits: list[Explanation]) -> tuple[Explanation, ...]:
    return tuple(sorted(fits, key=lambda one: one.chi_square))


def _possible(drawn: Scene, one: Explanation) -> bool:
    """Whether there is such a design: no blocks that overlap, no Poisson's ratio below 0."""
    if one.variable in (GAIN, MODULI):
        return one.nominal + one.change > 0
    try:
        changed(drawn, {one.variable: one.nominal + one.change})
    except ValueError:  # pydantic's and ours
        return False
    return True


def _settled(drawn: Scene, bench: Bench, deviation: Deviation, first: Explanation) -> Explanation | None:
    name, fit = first.variable, first
    for _ in range(STEPS if name != GAIN else 0):
        if not _possible(drawn, fit):
            return None
        there = _predicted(drawn, bench, name, fit)
        slope = there.slopes[:, there.variables.index(name)] - deviation.bias(name)
        # about e_0 the shift is J(e) - G S e = log ratios there - drawn + slope (e - e_0) - G S e_0
        off = deviation.logs - there.log_ratios + (slope + deviation.bias(name)) * fit.change
        last, fit = fit, _fitted(deviation, name, slope, off, first.nominal)
        if abs(fit.change - last.change) < SETTLED * fit.uncertainty:
            break
    return fit


def _predicted(drawn: Scene, bench: Bench, name: str, fit: Explanation) -> Shares:
    value = fit.nominal + fit.change
    if name != MODULI:
        return predicted(changed(drawn, {name: value}), bench.reference)
    blocks = [one.model_copy(update={"youngs_modulus": (one.youngs_modulus or 0.0) * value}) for one in bench.blocks]
    there = predicted(drawn, blocks)
    return replace(there, blocks=tuple(replace(one, slopes=one.slopes / value) for one in there.blocks))


def _fitted(deviation: Deviation, name: str, shift: Floats, off: Floats, nominal: float) -> Explanation:
    """Eq. BP.6, and what it leaves."""
    weight = deviation.weight
    information = max(float(shift @ weight @ shift), np.finfo(float).tiny)
    change = float(shift @ weight @ off) / information
    rest = off - shift * change
    left = float(rest @ weight @ rest)
    p_value = float(chi2.sf(left, len(off) - 1)) if len(off) > 1 else 1.0
    return Explanation(
        variable=name,
        change=change,
        uncertainty=float(information**-0.5),
        nominal=nominal,
        chi_square=left,
        p_value=p_value,
        explains=p_value >= LEVEL,
    )
