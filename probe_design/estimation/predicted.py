"""Predictions of the measured data, with derivatives and error bounds, for many bodies in the target's place."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from geometry.common.arrays import Bools, Floats, Ints
from probe_design.estimation.readings import Measurements
from solver.equivalent_inclusion.readings import Readings

WORST = 0.3  # bodies with a larger error bound of ln ratio are not searched


@dataclass(frozen=True)
class Predicted:
    """Predictions for n bodies.

    Attributes:
        value: ln |ratio|, ln stiffness or phase, in the order of ``Measurements``, shape (n, k); 0 where ``resolved`` is false.
        by_modulus: derivatives of ``value`` by ln E_object, shape (n, k).
        by_diameter: by ln diameter, 0 unless requested, shape (n, k).
        bound: on the model's error of ``value``, shape (n, k).
        resolved: whether the error bounds of all ratios are at most ``MAX_LOG_RATIO_ERROR``, shape (n,).
        agrees: whether all ratios have the sign that was measured, shape (n,).
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
    def empty(cls, n: int, k: int, resolved: bool = True) -> Predicted:
        """Return predictions of zeros, to be filled in, or for bodies that cannot be predicted."""
        none = [np.zeros((n, k)) for _ in range(4)]
        return cls(none[0], none[1], none[2], none[3], resolved=np.full(n, resolved), agrees=np.ones(n, dtype=bool))

    def rows(self, which: Ints) -> Predicted:
        """Return the predictions for some of the bodies."""
        return Predicted(*(getattr(self, field.name)[which] for field in fields(self)))

    @classmethod
    def joined(cls, parts: Sequence[Predicted]) -> Predicted:
        """Return the predictions for all bodies of all parts."""
        return cls(*(np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(cls)))

    def fill(self, k: int, answers: Readings, rows: slice, data: Measurements) -> None:
        """Set datum k of all bodies from some rows of computed readings."""
        stiffness = bool(data.is_stiffness[k])
        slopes = answers.log_stiffness_by if stiffness else answers.log_ratio_by
        for key, out in (("youngs_modulus", self.by_modulus), ("diameter", self.by_diameter)):
            if key in answers.by:
                out[:, k] = slopes(key)[rows]
        if stiffness:
            self.value[:, k] = np.log(answers.stiffness)[rows]
            self.bound[:, k] = (answers.bound.sum(axis=1) / answers.stiffness)[rows]
            return
        resolved, ratio = (answers.log_ratio_bound <= WORST)[rows], answers.ratio[rows]
        self.value[:, k] = np.log(np.abs(np.where(resolved, ratio, 1.0)))
        self.bound[:, k] = np.where(resolved, answers.log_ratio_bound[rows], 0.0)
        self.resolved[:] &= resolved
        self.agrees[:] &= np.where(resolved & (data.sign[k] != 0), np.sign(ratio) == data.sign[k], True)
