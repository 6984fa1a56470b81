"""What may press and shear under a block: a few smooth functions and the singularities of its edges, as sums of rings.

Every function is a value on each of ``RINGS`` rings, narrow at the edges; y is the share of the width (0 at the axis or hole).
With pressures 1, y^2 and (1-y^2)^(-1/2) under a disc, 1, y, y^(-1/2) and (1-y)^(-1/2) under a tube, and shears r times such, two
blocks as stiff as one likes or as soft are served by eleven unknowns.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.polynomial import legendre

RINGS = 6  # per block
RADII = 4  # at which a block's loads act in the integrals over wave numbers


@dataclass(frozen=True)
class Loads:
    """The functions under one kind of block, the same for all of that kind.

    Attributes:
        cuts: shares of the width where rings meet, shape (rings + 1,).
        pressure, shear: values on the rings, shapes (rings, functions).
        solid: whether the block is a disc.
    """

    cuts: Any
    pressure: Any
    shear: Any
    solid: bool

    @property
    def radii(self) -> Any:
        """Shares of the width at which the loads are concentrated for the integrals over wave numbers.

        Waves are even functions of the radius: under a disc the radii are Gauss's in its square.
        """
        x = (legendre.leggauss(RADII)[0] + 1) / 2
        return np.sqrt(x) if self.solid else x

    def concentrated(self, values: Any) -> Any:
        """The matrix that takes a wave at ``radii`` to its integrals, dr r / width, with the functions; shape (radii, functions).

        A disc's carry the factor r, a tube's leave it to the wave's values.
        """
        polynomials = [legendre.Legendre(row, domain=[0, 1]) for row in np.eye(RADII)]
        x, cuts = (self.radii**2, self.cuts**2) if self.solid else (self.radii, self.cuts)
        moments = np.array([np.diff(p.integ()(cuts)) for p in polynomials])
        weights = np.linalg.solve(np.array([p(x) for p in polynomials]), moments) @ values
        return weights / (2 * self.radii[:, None]) if self.solid else weights


def batched_matmul(many: Any, one: Any) -> Any:
    """Matrices (n, i, j) times one matrix (j, k), as a single product: faster than one for each."""
    return (many.reshape(-1, len(one)) @ one).reshape(*many.shape[:-1], -1)


def _means(cuts: Any, function: Any) -> Any:
    """Means over the rings, by a rule that integrates inverse square roots at both ends of (0, 1)."""
    angle, weight = legendre.leggauss(8)
    low, high = (np.arccos(1 - 2 * c)[:, None] for c in (cuts[:-1], cuts[1:]))
    turn = (low + high) / 2 + (high - low) / 2 * angle
    y, jacobian = (1 - np.cos(turn)) / 2, np.sin(turn) / 2 * (high - low) / 2
    return (function(y) * jacobian) @ weight / ((jacobian) @ weight)


def _loads(cuts: Any, pressures: Any, shears: Any, solid: bool) -> Loads:
    pressure, shear = (np.array([_means(cuts, f) for f in kind]).T for kind in (pressures, shears))
    return Loads(cuts, pressure, shear, solid)


_STEP = np.arange(RINGS + 1) / RINGS
_SOLID = (lambda y: 1 + 0 * y, lambda y: (1 - y**2) ** -0.5, lambda y: y**2)
_TUBE = (lambda y: y**-0.5, lambda y: (1 - y) ** -0.5, lambda y: 1 + 0 * y, lambda y: y)
SOLID = _loads(1 - (1 - _STEP) ** 3, _SOLID, _SOLID[:2], True)
TUBE = _loads(_STEP**3 / (_STEP**3 + (1 - _STEP) ** 3), _TUBE, _TUBE[:2], False)
