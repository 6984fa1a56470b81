"""Draw the designs of a sweep: a grid, or a reproducible sample of the unit cube with one column per variable."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import InputError
from geometry.scenes.keys import Key, Value

RANDOM_KINDS = ("sobol", "latin-hypercube", "saltelli")
SAMPLE_KINDS = ("grid", *RANDOM_KINDS)
MAX_DESIGNS = 10_000_000  # designs of a sweep


@dataclass(frozen=True)
class Variable:
    """A variable of a sweep: a key with a list of values, or a range.

    Attributes
    ----------
    key
        Of the scene.
    values
        Of a grid; of a sample the values drawn, each equally likely.
    low, high
        Range of a sample without ``values``; SI.
    log
        Whether the range is uniform in the logarithm.
    """

    key: Key
    values: tuple[Value, ...] = ()
    low: float = 0.0
    high: float = 0.0
    log: bool = False

    def interpolate(self, fraction: float) -> Value:
        """Return the value at a fraction of the range, from 0 to 1."""
        if self.values:
            return self.values[min(int(fraction * len(self.values)), len(self.values) - 1)]
        if self.log:
            return float(self.low * (self.high / self.low) ** fraction)
        return float(self.low + (self.high - self.low) * fraction)


@dataclass(frozen=True)
class DesignSampling:
    """How the designs are drawn.

    Attributes
    ----------
    kind
        One of ``SAMPLE_KINDS``. ``saltelli`` draws n (d + 2) designs of d variables, for Sobol indices.
    n
        Number of points; unused by a grid.
    seed
        Of the random generator.
    """

    kind: str = "grid"
    n: int = 0
    seed: int = 0

    def draw_designs(self, variables: tuple[Variable, ...]) -> list[tuple[Value, ...]]:
        """Return the values of all variables, a tuple for each design; in a grid the last variable changes fastest.

        Raises
        ------
        InputError
            There are too many designs.
        """
        count = self.count_designs(variables)
        if count > MAX_DESIGNS:
            raise InputError("sample", f"{count} designs", f"at most {MAX_DESIGNS}")
        if self.kind == "grid":
            shape = tuple(len(variable.values) for variable in variables)
            grid_indices = np.unravel_index(np.arange(count), shape)
            columns = [
                [variable.values[place] for place in indices.tolist()]
                for variable, indices in zip(variables, grid_indices, strict=True)
            ]
        else:
            points = self._draw_points(len(variables))
            columns = [
                [variable.interpolate(fraction) for fraction in column]
                for variable, column in zip(variables, points.T.tolist(), strict=True)
            ]
        return list(zip(*columns, strict=True))

    def count_designs(self, variables: tuple[Variable, ...]) -> int:
        """Return the number of designs, without constraints."""
        if self.kind == "grid":
            return int(np.prod([float(len(variable.values)) for variable in variables]))
        return self.n * (len(variables) + 2) if self.kind == "saltelli" else self.n

    def _draw_points(self, d: int) -> Floats:
        """Draw points of the unit cube, shape (designs, d)."""
        from scipy.stats import qmc

        columns = 2 * d if self.kind == "saltelli" else d
        engine = qmc.LatinHypercube(d, rng=self.seed) if self.kind == "latin-hypercube" else qmc.Sobol(columns, rng=self.seed)
        with warnings.catch_warnings():
            # any n is allowed; docs/guides/sweep.md recommends powers of 2
            warnings.simplefilter("ignore", UserWarning)
            points: Floats = engine.random(self.n)
        return _arrange_saltelli(points) if self.kind == "saltelli" else points


def _arrange_saltelli(points: Floats) -> Floats:
    """Return, for each point (A, B): A, A with one variable of B for each variable in turn, B; the order that SALib expects.

    Saltelli et al., Computer Physics Communications 181 (2010) 259-270, table 2, radial design.
    """
    d = points.shape[1] // 2
    a, b = points[:, :d], points[:, d:]
    block = np.repeat(a[:, None, :], d + 2, axis=1)
    for k in range(d):
        block[:, k + 1, k] = b[:, k]
    block[:, d + 1] = b
    return block.reshape(-1, d)
