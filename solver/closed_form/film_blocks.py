"""The blocks between tissue and films: stiffness of the film end and what the tissue's tractions do to it, from a table.

Of a block whose tissue end is loaded and whose sides are free, the displacements of the film end are

    u = sum X_k u_k(y),   w = sum X_k w_k(y),   disc: u_k = y J_k(y^2), w_k = J_k(y^2);   tube: u_k = w_k = J_k(y)       (CF.24)

outward and towards the base, with y the fraction of the width and J_k polynomials that are orthogonal with the weight that
tractions have at the edges of a rigid face, (1 - y)^(-1/3) at either edge. Its energy is X K X / 2 - X B t, with t the factors of
the loads of ``tractions``. K over 2 pi mu R and B over 2 pi R w (shear modulus mu, outer radius R, width w) are polynomials of
the logarithms of height / width and of a tube's width / R and of Poisson's ratio, fitted to finite elements by
``python -m benchmarks.closed_form.film_blocks``. Numbers outside the table's range are replaced by its limits.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from geometry.common.arrays import Ints
from solver.closed_form.bessel import Array
from solver.closed_form.tractions import LOADS, ElasticBlocks, Loads

TABLE_FILE = Path(__file__).with_name("film_blocks.npz")
EDGE_EXPONENT = -1 / 3  # of tractions at the edges of a rigid face: -0.29 to -0.4 for Poisson's ratios of 0.3 to 0.5
HEIGHT_RANGE = 0.05, 8.0  # height over width
POISSON_RANGE = 0.0, 0.5
WALL_RANGE = 0.015, 0.95  # width over outer radius, of tubes


@dataclass(frozen=True, eq=False)  # compared, and hashed, as one of ``ENDS``
class EndFunctions:
    """The functions of a film end's displacements (eq. CF.24).

    Attributes
    ----------
    solid
        Whether the block is a disc.
    u_recurrence, w_recurrence
        Coefficients of the polynomials' three-term recurrences, shape (functions, 3).
    """

    solid: bool
    u_recurrence: Any
    w_recurrence: Any

    @property
    def count(self) -> int:
        """Number of functions of u, and of w."""
        return len(self.u_recurrence)

    @property
    def loads(self) -> Loads:
        """Functions of the tissue end's tractions."""
        return LOADS.loads[0 if self.solid else 1]

    def evaluate(self, y: Array) -> tuple[Array, Array]:
        """Return u_k and w_k at fractions y of the width, shapes (*y.shape, functions)."""
        x = y * y if self.solid else y
        J, w = (_evaluate_recurrence(part, x) for part in (self.u_recurrence, self.w_recurrence))
        return (y[..., None] * J if self.solid else J), w


def _evaluate_recurrence(recurrence: Any, x: Array) -> Array:
    """Return polynomials J_k = (a_k x + b_k) J_(k-1) - c_k J_(k-2), J_0 = a_0, at x; shape (*x.shape, polynomials)."""
    values = [0 * x + recurrence[0, 0]]
    before: Array = 0.0
    for a, b, c in recurrence[1:]:
        values.append((a * x + b) * values[-1] - c * before)
        before = values[-2]
    return np.stack(values, axis=-1)


def _build_recurrence(count: int, left: float, right: float) -> Any:
    """Return the recurrence of polynomials orthonormal on (0, 1) with the weight x^left (1 - x)^right."""
    # Stieltjes's procedure with a rule in which the weight's singularities vanish: x = (1 - cos) / 2 of a fine grid of angles
    angle = (np.arange(4000) + 0.5) * np.pi / 4000
    x = np.sin(angle / 2) ** 2
    weight = x ** (left + 0.5) * (1 - x) ** (right + 0.5)
    weight *= np.pi / 4000
    before, value = np.zeros_like(x), np.full_like(x, weight.sum() ** -0.5)
    rows, last = [(value[0], 0.0, 0.0)], 0.0
    for _ in range(count - 1):
        middle = (weight * x * value**2).sum()
        raised = (x - middle) * value - last * before
        norm = np.sqrt((weight * raised**2).sum())
        rows.append((1 / norm, -middle / norm, last / norm))
        before, value, last = value, raised / norm, norm
    return np.array(rows)


DISC = EndFunctions(True, _build_recurrence(5, 1.0, EDGE_EXPONENT), _build_recurrence(5, 0.0, EDGE_EXPONENT))
TUBE = EndFunctions(False, *[_build_recurrence(6, EDGE_EXPONENT, EDGE_EXPONENT)] * 2)
ENDS = DISC, TUBE


@dataclass(frozen=True)
class BlockTable:
    """Polynomials of a kind of block: products of Chebyshev's of each parameter.

    Attributes
    ----------
    degrees
        Which polynomial of each parameter each product has, shape (products, parameters).
    coefficients
        Of the products, shape (products, numbers): first the upper triangle of K, row by row, then B.
    """

    degrees: Ints
    coefficients: Any


@cache
def load_table(solid: bool) -> BlockTable:
    """Load the table of discs or of tubes."""
    name = "disc" if solid else "tube"
    with np.load(TABLE_FILE) as stored:
        return BlockTable(stored[f"{name}_degrees"], stored[f"{name}_coefficients"])


def scale_parameters(slender: Array, nu: Array, wall: Array | None) -> list[Array]:
    """Return height / width, Poisson's ratio and, of tubes, width / outer radius as numbers from -1 to 1, shape (n,) each."""
    pairs: list[tuple[Array, Any]] = [(np.log(slender), np.log(HEIGHT_RANGE)), (nu, POISSON_RANGE)]
    if wall is not None:
        pairs.append((np.log(wall), np.log(WALL_RANGE)))
    return [_clip((2 * x - low - high) / (high - low)) for x, (low, high) in pairs]


def _clip(x: Array) -> Array:
    """Return the numbers, those beyond -1 and 1 replaced by these."""
    return np.where(abs(x.real) <= 1, x, np.sign(x.real))


def evaluate_products(degrees: Ints, parameters: list[Array]) -> Array:
    """Return the products of Chebyshev's polynomials of the parameters (n,), shape (n, products)."""
    products: Array = 1.0
    for x, degree in zip(parameters, degrees.T, strict=True):
        T = [np.ones_like(x), x]
        while len(T) <= degree.max():
            T.append(2 * x * T[-1] - T[-2])
        products = products * np.stack(T, axis=1)[:, degree]
    return products


def interpolate_block(block: ElasticBlocks) -> tuple[Array, Array]:
    """Return K, N/m, shape (n, functions, functions), and B, m^2, shape (n, functions, loads), of n blocks; u before w."""
    solid = block.hole is None
    end = ENDS[0 if solid else 1]
    table = load_table(solid)
    wall = None if solid else block.width / block.radius
    values = evaluate_products(table.degrees, scale_parameters(block.height / block.width, block.nu, wall)) @ table.coefficients
    functions = 2 * end.count
    row, column = np.triu_indices(functions)
    K = np.empty((len(values), functions, functions), dtype=values.dtype)
    K[:, row, column] = K[:, column, row] = values[:, : len(row)]
    mu = block.E / (2 * (1 + block.nu))
    B = values[:, len(row) :].reshape(len(values), functions, -1)
    return K * (2 * np.pi * mu * block.radius)[:, None, None], B * (2 * np.pi * block.radius * block.width)[:, None, None]
