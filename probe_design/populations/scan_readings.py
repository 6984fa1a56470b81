"""What a scan reads over each tumour of a population, beside what it would read without the tumour.

Readings are logarithms: of the ratio at all positions, then of the stiffness where it is read, m in all. With F_j the force on
film j per unit of indentation, A_j its area,

    ln ratio = ln F_inner - ln F_outer + const,   ln stiffness = ln (F_inner + F_outer)             (PO.1)

and the signal of a tumour is by how much they are more than in its own tissue without it. A load and the areas cancel.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from geometry.common.arrays import Floats, Ints


@dataclass(frozen=True)
class ScanReadings:
    """Readings over n tumours in t tissues, m readings of c channels each.

    Attributes:
        signal: eq. PO.1 with the tumour minus without, shape (n, m).
        errors: bounds on what the evaluator is off in it, by cause, see ``scan_errors.ERROR_CAUSES``, shape (n, m); or none.
        tissue: number of each tumour's tissue, shape (n,).
        blank: film forces per unit of indentation without tumours, N/m, shape (t, 2).
        mean_forces: the same over the tumours at each position, in their geometric mean, shape (p, 2).
        blank_error: bound on the error of eq. PO.1 there, shape (t, c).
        derivatives: of ``signal`` with respect to the parameters named in ``ScenePopulation.ranges``: to their
            logarithms, per m of x; shape (n, m).
        blank_derivatives: derivatives of eq. PO.1 without tumours by the tissue's numbers, shape (t, c).
    """

    signal: Floats
    errors: dict[str, Floats]
    tissue: Ints
    blank: Floats
    mean_forces: Floats
    blank_error: Floats
    derivatives: dict[str, Floats] = field(default_factory=dict)
    blank_derivatives: dict[str, Floats] = field(default_factory=dict)

    @property
    def positions(self) -> int:
        """How many positions were read."""
        return int(self.signal.shape[1]) // self.channels

    @property
    def channels(self) -> int:
        """How many readings at each."""
        return int(self.blank_error.shape[1])

    @property
    def error(self) -> Floats:
        """Bound on what the evaluator is off in ``signal``, all causes together, shape (n, m)."""
        return np.asarray(sum(self.errors.values(), np.zeros_like(self.signal)))

    def list_columns(self, positions: Ints, channels: Sequence[int]) -> Ints:
        """Return where the readings at some positions, by number, of some channels stand among the m."""
        return np.asarray((np.asarray(channels)[:, None] * self.positions + positions).ravel())

    def select(self, positions: Ints, channels: Sequence[int]) -> ScanReadings:
        """Return those at some positions, by number, shape (p,), of some channels."""
        columns, chosen = self.list_columns(positions, channels), list(channels)
        return replace(
            self,
            signal=self.signal[:, columns],
            errors={cause: error[:, columns] for cause, error in self.errors.items()},
            mean_forces=self.mean_forces[positions],
            blank_error=self.blank_error[:, chosen],
            derivatives={name: slopes[:, columns] for name, slopes in self.derivatives.items()},
            blank_derivatives={name: slopes[:, chosen] for name, slopes in self.blank_derivatives.items()},
        )

    def repeat_over_positions(self, values: Floats) -> Floats:
        """Return numbers of each channel, shape (..., c), for all readings, shape (..., m)."""
        return np.repeat(values, self.positions, axis=-1)


def compute_logarithms(totals: Any, stiffness: bool) -> Any:
    """Return the logarithms of ratio and stiffness, eq. PO.1 without its constant.

    Args:
        totals: F_inner and F_outer, shape (..., p, 2), real or complex.
        stiffness: whether it is read.

    Returns:
        shape (..., m): ln ratio at the p positions, then ln stiffness.
    """
    ratio = np.log(totals[..., 0]) - np.log(totals[..., 1])
    return np.concatenate([ratio, np.log(totals.sum(axis=-1))], axis=-1) if stiffness else ratio
