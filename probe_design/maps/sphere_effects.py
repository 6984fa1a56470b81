"""Compute the effect of spheres on a reading, and the verdicts on it: detected, resolved, or open.

With R the ratio over a tumour, of charges or of stresses as the scene's observable says, R_0 the ratio without it, S the
log-sensitivity to its Young's modulus and g the noise,

    change = R / R_0 - 1                                        seen where |change| >= seen g           (MA.1)
    sd     = g / |S|, the standard deviation of ln E_object     resolved where sd <= resolved           (MA.2)

"seen" means detected; ``seen`` and ``resolved`` on the right are the thresholds of ``Thresholds``. Both are for one reading, R_0
and all other numbers of the scene being known. seen = 3 with a threshold at half of it, 1.5 g, misses a tumour, or reports one
over healthy tissue, in 6.7 % of all cases each: P(z > 1.5); 3.29 gives 5 % (Currie, Anal. Chem. 40 (1968) 586, the limit of
detection for a well-known blank). Eq. MA.2 is the Cramér-Rao bound, a linearisation: near a saturated ratio the true interval is
wider on the stiff side. `estimate` does not use it.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from geometry.common.arrays import Bools, Floats, Ints
from geometry.common.errors import InputError
from geometry.scenes.scene import Scene
from probe_design.data.noise import DEFAULT_NOISE, MAX_RESOLVED_LOG_SD, check_noise
from solver.equivalent_inclusion.readings import Readings
from solver.planning.load_check import LoadChanges
from solver.results.film_forces import FilmForces

MAX_THRESHOLD = 1e6  # upper limit of thresholds
BASE_ERROR_FACTOR = (
    2.0  # error of a tumour's effect dF over that of the base states: dF is quadratic in their strains, F_0 linear
)


@dataclass(frozen=True)
class Thresholds:
    """Thresholds of detection and resolution.

    Attributes
    ----------
    noise
        Relative standard deviation g of one reading of the ratio.
    seen
        Change of the ratio, in multiples of the noise, from which a tumour is detected.
    resolved
        Standard deviation of ln E_object up to which its stiffness is resolved.
    """

    noise: float = DEFAULT_NOISE
    seen: float = 3.0
    resolved: float = MAX_RESOLVED_LOG_SD

    @property
    def min_change(self) -> float:
        """Smallest detected change of the ratio, relative."""
        return self.seen * self.noise

    def __post_init__(self) -> None:
        """Raise ``InputError`` for thresholds that are not allowed."""
        check_noise(self.noise)
        for name in ("seen", "resolved"):
            value = getattr(self, name)
            if not 0 < value < MAX_THRESHOLD:
                raise InputError(name, value, f"a number above 0 and below {MAX_THRESHOLD:g}")


@dataclass(frozen=True)
class SphereEffects:
    """Effects of n spheres on a reading, shape (n,) each.

    Attributes
    ----------
    has_ratio
        Whether both ratios, with and without the sphere, are known.
    change, error
        eq. MA.1 and a bound on its error; inf where there is no ratio.
    sensitivity, sensitivity_error
        S and a bound on its error.
    stiffness
        Force per indentation over the sphere, N/m.
    """

    has_ratio: Bools
    change: Floats
    error: Floats
    sensitivity: Floats
    sensitivity_error: Floats
    stiffness: Floats

    def add_load_changes(self, load: LoadChanges) -> SphereEffects:
        """Return the effects with error bounds that count the load's effect on R, R_0 and S."""
        # the last element of ``load`` is of the reading without the target
        factor, sensitivity_change = (1 + load.ratio[:-1]) * (1 + load.ratio[-1]), load.log_sensitivity[:-1]
        error = self.error * factor + np.abs(1 + self.change) * (factor - 1)
        sensitivity_error = self.sensitivity_error * (1 + sensitivity_change) + np.abs(self.sensitivity) * sensitivity_change
        return replace(self, error=error, sensitivity_error=sensitivity_error)

    def replace_rows(self, rows: Ints, replacements: SphereEffects) -> SphereEffects:
        """Return the effects with those of the spheres ``rows`` replaced."""
        table = {field.name: getattr(self, field.name).copy() for field in fields(self)}
        for key, values in table.items():
            values[rows] = getattr(replacements, key)
        return SphereEffects(**table)

    @property
    def above_error(self) -> Bools:
        """Whether the change is above its error bound."""
        return np.asarray(self.error < np.abs(self.change))

    def decide_detection(self, thresholds: Thresholds) -> Floats:
        """Return whether each sphere is detected: 1, 0, or NaN where the error leaves it open."""
        return _decide(np.abs(self.change), self.error, thresholds.min_change)

    def decide_resolution(self, thresholds: Thresholds) -> Floats:
        """Return whether each sphere is resolved: 1, 0, or NaN where the error leaves it open.

        sd <= resolved of eq. MA.2 is equivalent to |S| >= noise / resolved.
        """
        return _decide(np.abs(self.sensitivity), self.sensitivity_error, thresholds.noise / thresholds.resolved)

    def find_open(self, thresholds: Thresholds) -> Bools:
        """Return whether the verdict on detection or that on resolution is open, shape (n,)."""
        return np.asarray(np.isnan(self.decide_detection(thresholds)) | np.isnan(self.decide_resolution(thresholds)))


def _decide(value: Floats, error: Floats, threshold: float) -> Floats:
    """Return 1 where values reach the threshold for every error within the bound, 0 where they do for none, else NaN."""
    return np.where(value - error >= threshold, 1.0, np.where(value + error < threshold, 0.0, np.nan))


def compute_effects(scene: Scene, films: FilmForces, readings_with: Readings, readings_without: Readings) -> SphereEffects:
    """Return the effects of n spheres on the ratio that the scene reads.

    Parameters
    ----------
    scene
        Decides whether readings are ratios of charges or of stresses.
    films
        Film forces without tumours.
    readings_with
        With each of the spheres, n rows.
    readings_without
        Without the target, one row.
    """
    read, read_without = readings_with.get_observable(scene), readings_without.get_observable(scene)
    has_ratio = np.asarray(read.resolved & read_without.resolved)
    ratio_without = np.where(read_without.resolved, read_without.ratio, 1.0)
    change = np.where(has_ratio, read.ratio / ratio_without - 1, 0.0)
    log_error = _bound_log_error(films.get_observable(scene), read, read_without)
    log_error = np.minimum(log_error, 700.0)  # so that its exponential is finite
    return SphereEffects(
        has_ratio=has_ratio,
        change=change,
        error=np.where(has_ratio, np.abs(1 + change) * np.expm1(log_error), np.inf),
        sensitivity=read.log_sensitivity,
        sensitivity_error=np.where(has_ratio, read.sensitivity_error, np.inf),
        stiffness=readings_with.stiffness,
    )


def _bound_log_error(films: FilmForces, readings_with: Readings, readings_without: Readings) -> Floats:
    """Return a bound on the error of ln(R / R_0), shape (n,), of forces or of charges.

    It counts the error of the tumours' fields, and that of the base states (the solutions without tumours in which one block's
    base is displaced by one unit and the other is held) in dF / F_0, with F_0 the film forces or charges without the
    target and dF their change; otherwise the errors of the base states cancel in R / R_0. ``films`` are those without tumours.
    """
    tumour_error = sum(
        np.abs((film_readings.bound - films.bound.totals) / film_readings.totals)
        for film_readings in (readings_with, readings_without)
    )
    effect = np.abs((readings_with.totals - readings_without.totals) / readings_with.totals)
    relative_error = np.minimum(tumour_error + BASE_ERROR_FACTOR * films.relative_errors * effect, 0.999999)  # below 1: finite
    return np.asarray(-np.log1p(-relative_error).sum(axis=1))
