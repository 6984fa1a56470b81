"""Define the readings of a scan over each tumour of a population, and their changes by the tumour.

The m readings are logarithms: of the ratio at all positions, then of the stiffness if it is read. With F_j the force on film j
per unit indentation, and a constant that contains the films' areas,

    ln ratio = ln F_inner - ln F_outer + const,   ln stiffness = ln (F_inner + F_outer)             (PO.1)

The signal of a tumour is the difference of the readings from those in the same tissue without it. Load and areas cancel.
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

    Attributes
    ----------
    signal
        eq. PO.1 with the tumour less that without, shape (n, m).
    errors
        Error bounds of the signal by cause, see ``scan_errors.ERROR_CAUSES``, shape (n, m); may be empty.
    tissue
        Number of each tumour's tissue, shape (n,).
    blank
        Film forces per unit indentation without tumours, N/m, shape (t, 2).
    mean_forces
        Geometric mean over the tumours of the film forces at each position, shape (p, 2).
    blank_error
        Error bound of eq. PO.1 without tumours, shape (t, c).
    derivatives
        Of ``signal`` with respect to the parameters named in ``ScenePopulation.ranges``: to their logarithms, per m of x; shape
        (n, m).
    blank_derivatives
        Derivatives of eq. PO.1 without tumours by the tissue's numbers, shape (t, c).
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
        """Number of positions."""
        return int(self.signal.shape[1]) // self.channels

    @property
    def channels(self) -> int:
        """Number of readings at each position."""
        return int(self.blank_error.shape[1])

    @property
    def error(self) -> Floats:
        """Error bound of ``signal``, all causes together, shape (n, m)."""
        return np.asarray(sum(self.errors.values(), np.zeros_like(self.signal)))

    def list_columns(self, positions: Ints, channels: Sequence[int]) -> Ints:
        """Return the indices among the m readings of some channels at some positions, by number."""
        return np.asarray((np.asarray(channels)[:, None] * self.positions + positions).ravel())

    def select(self, positions: Ints, channels: Sequence[int]) -> ScanReadings:
        """Return the readings of some channels at some positions, by number, shape (p,)."""
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
        """Repeat numbers of each channel, shape (..., c), for all readings, shape (..., m)."""
        return np.repeat(values, self.positions, axis=-1)


def compute_logarithms(totals: Any, stiffness: bool) -> Any:
    """Return the logarithms of ratio and stiffness, eq. PO.1 without its constant.

    Parameters
    ----------
    totals
        F_inner and F_outer, shape (..., p, 2), real or complex.
    stiffness
        Whether the stiffness is read.

    Returns
    -------
    Any
        Logarithms, shape (..., m): ln ratio at the p positions, then ln stiffness.
    """
    ratio = np.log(totals[..., 0]) - np.log(totals[..., 1])
    return np.concatenate([ratio, np.log(totals.sum(axis=-1))], axis=-1) if stiffness else ratio
