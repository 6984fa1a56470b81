"""Compute the effect of spheres on a reading, and the verdicts on it: detected, resolved, or open.

With R the ratio over a tumour, R_0 the ratio without it, S the log-sensitivity to its Young's modulus and g the noise,

    change = R / R_0 - 1                                        seen where |change| >= seen g           (MA.1)
    sd     = g / |S|, the standard deviation of ln E_object     resolved where sd <= resolved           (MA.2)

"seen" means detected; ``seen`` and ``resolved`` on the right are the thresholds of ``Thresholds``. Both are for one reading, R_0
and all other numbers of the scene being known. seen = 3 with a threshold at half of it, 1.5 g, misses a tumour, or reports one
at a healthy place, in 6.7 % of all cases each: P(z > 1.5); 3.29 gives 5 % (Currie, Anal. Chem. 40 (1968) 586, the limit of
detection for a well-known blank). Eq. MA.2 is the Cramér-Rao bound, a linearisation: near a saturated ratio the true interval is
wider on the stiff side. `estimate` does not use it.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from geometry.common.arrays import Bools, Floats, Ints
from geometry.common.errors import InputError
from probe_design.data.noise import NOISE, RESOLVED, checked_noise
from solver.equivalent_inclusion.probe_on_tissue import Undisturbed
from solver.equivalent_inclusion.readings import Readings
from solver.planning.load_check import LoadChanges

MOST = 1e6  # upper limit of thresholds
CHANGES = 2.0  # error of a tumour's effect dF over that of the base states: dF is quadratic in their strains, F_0 linear


@dataclass(frozen=True)
class Thresholds:
    """Thresholds of detection and resolution.

    Attributes:
        noise: relative standard deviation g of one reading of the ratio.
        seen: change of the ratio, in multiples of the noise, from which a tumour is detected.
        resolved: standard deviation of ln E_object up to which its stiffness is resolved.
    """

    noise: float = NOISE
    seen: float = 3.0
    resolved: float = RESOLVED

    @property
    def change(self) -> float:
        """Smallest detected change of the ratio, relative."""
        return self.seen * self.noise

    def __post_init__(self) -> None:
        """Raise ``InputError`` for thresholds that are not allowed."""
        checked_noise(self.noise)
        for name in ("seen", "resolved"):
            value = getattr(self, name)
            if not 0 < value < MOST:
                raise InputError(name, value, f"a number above 0 and below {MOST:g}")


@dataclass(frozen=True)
class SphereEffects:
    """Effects of n spheres on a reading, shape (n,) each.

    Attributes:
        has_ratio: whether both ratios, with and without the sphere, are known.
        change, error: eq. MA.1 and a bound on its error; inf where there is no ratio.
        sensitivity, sensitivity_error: S and a bound on its error.
        stiffness: N/m.
    """

    has_ratio: Bools
    change: Floats
    error: Floats
    sensitivity: Floats
    sensitivity_error: Floats
    stiffness: Floats

    def loaded(self, load: LoadChanges) -> SphereEffects:
        """Return the effects with error bounds that count the load's effect on R, R_0 and S."""
        ratio, slope = load.ratio[:-1], load.log_sensitivity[:-1]
        factor = (1 + ratio) * (1 + load.ratio[-1])
        error = self.error * factor + np.abs(1 + self.change) * (factor - 1)
        sensitivity_error = self.sensitivity_error * (1 + slope) + np.abs(self.sensitivity) * slope
        return replace(self, error=error, sensitivity_error=sensitivity_error)

    def replaced(self, which: Ints, others: SphereEffects) -> SphereEffects:
        """Return the effects with some rows replaced."""
        table = {field.name: getattr(self, field.name).copy() for field in fields(self)}
        for key, values in table.items():
            values[which] = getattr(others, key)
        return SphereEffects(**table)

    @property
    def above_error(self) -> Bools:
        """Whether the change is above its error bound."""
        return np.asarray(self.error < np.abs(self.change))

    def seen(self, limits: Thresholds) -> Floats:
        """Return whether each sphere is detected: 1, 0, or NaN where the error leaves it open."""
        return _verdict(np.abs(self.change), self.error, limits.change)

    def resolved(self, limits: Thresholds) -> Floats:
        """Return whether each sphere is resolved, likewise; sd <= resolved is equivalent to |S| >= noise / resolved."""
        return _verdict(np.abs(self.sensitivity), self.sensitivity_error, limits.noise / limits.resolved)

    def open(self, limits: Thresholds) -> Bools:
        """Return whether one of both verdicts is open."""
        return np.asarray(np.isnan(self.seen(limits)) | np.isnan(self.resolved(limits)))


def _verdict(value: Floats, error: Floats, threshold: float) -> Floats:
    """Return 1 where values reach the threshold for every error within the bound, 0 where for none, else NaN."""
    return np.where(value - error >= threshold, 1.0, np.where(value + error < threshold, 0.0, np.nan))


def effects_of(base: Undisturbed, together: Readings, alone: Readings) -> SphereEffects:
    """Return the effects of spheres from the readings with and without them."""
    has_ratio = np.asarray(together.resolved & alone.resolved)
    change = np.where(has_ratio, together.ratio / np.where(alone.resolved, alone.ratio, 1.0) - 1, 0.0)
    error = np.where(has_ratio, np.abs(1 + change) * np.expm1(np.minimum(_log_error(base, together, alone), 700.0)), np.inf)
    return SphereEffects(
        has_ratio,
        change,
        error,
        together.log_sensitivity,
        np.where(has_ratio, together.sensitivity_error, np.inf),
        together.stiffness,
    )


def _log_error(base: Undisturbed, together: Readings, alone: Readings) -> Floats:
    """Return a bound on the error of ln(R / R_0), shape (n,).

    It counts the error of the tumours' fields, and that of the base states in dF / F_0, with F_0 the film forces without the
    target and dF their change; otherwise the errors of the base states cancel in R / R_0.
    """
    films = base.films
    own = sum(np.abs((one.bound - films.bound.totals) / one.totals) for one in (together, alone))
    effect = np.abs((together.totals - alone.totals) / together.totals)
    share = np.minimum(own + CHANGES * films.relative_errors * effect, 0.999999)
    return np.asarray(-np.log1p(-share).sum(axis=1))
