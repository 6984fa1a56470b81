"""Predictions of the measured data, with derivatives and error bounds, for many bodies in the target's place."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from geometry.common.arrays import Bools, Floats, Ints
from probe_design.estimation.measurements import Measurements
from solver.equivalent_inclusion.readings import Readings

MAX_LOG_RATIO_ERROR = 0.3  # bodies with a larger error bound of ln ratio are not searched


@dataclass(frozen=True)
class Predictions:
    """Predictions for n bodies.

    Attributes
    ----------
    value
        Ln |ratio|, ln stiffness or phase, in the order of ``Measurements``, shape (n, k); 0 where ``resolved`` is false.
    by_modulus
        Derivatives of ``value`` by ln E_object, shape (n, k).
    by_diameter
        By ln diameter, 0 unless requested, shape (n, k).
    bound
        On the model's error of ``value``, shape (n, k).
    resolved
        Whether the error bounds of all ratios are at most ``MAX_LOG_RATIO_ERROR``, shape (n,).
    agrees
        Whether all ratios have the sign that was measured, shape (n,).
    """

    value: Floats
    by_modulus: Floats
    by_diameter: Floats
    bound: Floats
    resolved: Bools
    agrees: Bools

    @property
    def usable(self) -> Bools:
        """Whether both ``resolved`` and ``agrees`` hold, shape (n,)."""
        return self.resolved & self.agrees

    @classmethod
    def empty(cls, n: int, k: int, resolved: bool = True) -> Predictions:
        """Return predictions of zeros, to be filled in, or for bodies that cannot be predicted."""
        zeros = [np.zeros((n, k)) for _ in range(4)]
        return cls(zeros[0], zeros[1], zeros[2], zeros[3], resolved=np.full(n, resolved), agrees=np.ones(n, dtype=bool))

    def select_rows(self, which: Ints) -> Predictions:
        """Return the predictions for some of the bodies."""
        return Predictions(*(getattr(self, field.name)[which] for field in fields(self)))

    def transform_columns(self, function: Callable[[Floats], Floats]) -> Predictions:
        """Return the predictions of other data: a function of each array of shape (n, k)."""
        value, by_modulus, by_diameter, bound = map(function, (self.value, self.by_modulus, self.by_diameter, self.bound))
        return replace(self, value=value, by_modulus=by_modulus, by_diameter=by_diameter, bound=bound)

    @classmethod
    def join(cls, parts: Sequence[Predictions]) -> Predictions:
        """Return the predictions for all bodies of all parts."""
        return cls(*(np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(cls)))

    def fill(self, k: int, film_readings: Readings, rows: slice, data: Measurements) -> None:
        """Set datum k of all bodies from some rows of computed readings."""
        stiffness = bool(data.is_stiffness[k])
        differentiate = (
            film_readings.compute_log_stiffness_derivative if stiffness else film_readings.compute_log_ratio_derivative
        )
        for key, derivatives in (("youngs_modulus", self.by_modulus), ("diameter", self.by_diameter)):
            if key in film_readings.derivatives:
                derivatives[:, k] = differentiate(key)[rows]
        if stiffness:
            self.value[:, k] = np.log(film_readings.stiffness)[rows]
            self.bound[:, k] = (film_readings.bound.sum(axis=1) / film_readings.stiffness)[rows]
            return
        resolved, ratio = (film_readings.log_ratio_bound <= MAX_LOG_RATIO_ERROR)[rows], film_readings.ratio[rows]
        self.value[:, k] = np.log(np.abs(np.where(resolved, ratio, 1.0)))
        self.bound[:, k] = np.where(resolved, film_readings.log_ratio_bound[rows], 0.0)
        self.resolved[:] &= resolved
        self.agrees[:] &= np.where(resolved & (data.sign[k] != 0), np.sign(ratio) == data.sign[k], True)
