"""Compute what the films' charges need of a block, by finite elements, and store it as polynomials of its shape and material.

Usage: ``python -m benchmarks.closed_form.film_blocks``. Writes ``solver/closed_form/film_blocks.npz``, see
``solver.closed_form.film_blocks``, and prints how far the polynomials are from blocks that were not used.

The elements are rectangles of degree ``DEGREE``, narrow at the block's corners. As the block's section is a rectangle, every
integral is a product of one along the radius and one along the height.

Duration: 3 minutes.
"""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
from numpy.polynomial import legendre
from scipy import sparse
from scipy.sparse.linalg import splu
from scipy.stats.qmc import Halton

from geometry.common.arrays import Floats
from solver.closed_form.film_blocks import (
    ENDS,
    HEIGHT_RANGE,
    POISSON_RANGE,
    TABLE_FILE,
    WALL_RANGE,
    EndFunctions,
    evaluate_products,
)

DEGREE = 6  # of the elements
CORNER_RATIO, CORNER_ELEMENTS = 0.2, 4  # each element at a corner is this fraction of its neighbour; so many of them
DEGREES = 20, 5, 14  # of the polynomials of height, of Poisson's ratio and of a tube's wall
SAMPLES_PER_PRODUCT = 2.5  # blocks to which each product of polynomials is fitted
TESTS = 20  # blocks that were not used, with which the polynomials are compared


def build_line(cuts: Floats) -> tuple[Floats, Floats, Floats, Any, Any]:
    """Return the nodes of elements between ``cuts``, Gauss's points and weights, and the functions and their derivatives there.

    The functions are matrices (points, nodes).
    """
    inner = legendre.Legendre.basis(DEGREE).deriv().roots()
    local = np.concatenate([[-1.0], inner, [1.0]])
    x, weight = legendre.leggauss(DEGREE + 3)
    series = np.linalg.inv(legendre.legvander(local, DEGREE))
    values = legendre.legvander(x, DEGREE) @ series
    derivatives = np.column_stack([legendre.legval(x, legendre.legder(column)) for column in series.T])
    elements = len(cuts) - 1
    rows, columns, parts, slopes = [], [], [], []
    points, weights, nodes = [], [], np.empty(elements * DEGREE + 1)
    for number, (low, high) in enumerate(itertools.pairwise(cuts)):
        half = (high - low) / 2
        nodes[number * DEGREE : (number + 1) * DEGREE + 1] = low + half * (local + 1)
        points.append(low + half * (x + 1))
        weights.append(half * weight)
        row, column = np.meshgrid(np.arange(len(x)) + number * len(x), np.arange(DEGREE + 1) + number * DEGREE, indexing="ij")
        rows.append(row.ravel())
        columns.append(column.ravel())
        parts.append(values.ravel())
        slopes.append(derivatives.ravel() / half)
    shape = elements * len(x), len(nodes)
    places = np.concatenate(rows), np.concatenate(columns)
    matrices: list[Any] = [sparse.csr_array((np.concatenate(part), places), shape=shape) for part in (parts, slopes)]
    return nodes, np.concatenate(points), np.concatenate(weights), matrices[0], matrices[1]


def cut_corners(length: float, both: bool, scale: float) -> Floats:
    """Return where elements of a side meet: narrow at its end, or at both ends; ``scale`` is the other side's length."""
    size = min(length / (2 if both else 1), scale / 2)
    corner = size * CORNER_RATIO ** np.arange(CORNER_ELEMENTS)[::-1]
    distances = [0.0, *corner]
    end = length / 2 if both else length
    while distances[-1] < 0.999 * end:  # wider elements in the middle of a long side
        distances.append(min(3 * distances[-1], end) if 4 * distances[-1] < end else end)
    from_end = np.array(distances)
    return np.unique(np.round(np.concatenate([from_end, length - from_end]), 12)) if both else length - from_end[::-1]


def solve_block(end: EndFunctions, height: float, nu: float, hole: float) -> tuple[Floats, Floats]:
    """Return stiffness and load works of a block of width 1 and shear modulus 1, both over 2 pi times its outer radius.

    Parameters
    ----------
    end
        The functions of a disc or a tube.
    height
        Over the width.
    nu
        Poisson's ratio.
    hole
        Inner over outer radius; 0 for a disc.

    Returns
    -------
    tuple[Floats, Floats]
        Stiffness of the functions of the film end, shape (f, f), and the work of the loads of the tissue end on the displacements
        that extend each of these functions with the rest of the block free, shape (f, loads).
    """
    radius = 1 / (1 - hole)
    start = radius - 1
    solid = end.solid
    r_nodes, r, r_weight, N, dN = build_line(start + cut_corners(1.0, not solid, height))
    z_nodes, _, z_weight, Z, dZ = build_line(cut_corners(height, True, 1.0))

    def across(left: Any, weight: Floats, right: Any) -> Any:
        return left.T @ sparse.diags_array(weight) @ right

    ring = r_weight * r
    stretch, mass, hoop = across(dN, ring, dN), across(N, ring, N), across(N, r_weight / r, N)
    both, mixed = across(dN, r_weight, N), across(dN, ring, N)
    z_mass, z_stretch, z_mixed = across(Z, z_weight, Z), across(dZ, z_weight, dZ), across(Z, z_weight, dZ)
    lame = 2 * nu / (1 - 2 * nu)  # over the shear modulus
    kron = sparse.kron
    uu = kron((2 + lame) * (stretch + hoop) + lame * (both + both.T), z_mass) + kron(mass, z_stretch)
    ww = kron((2 + lame) * mass, z_stretch) + kron(stretch, z_mass)
    uw = lame * kron(mixed + across(N, r_weight, N), z_mixed) + kron(mixed.T, z_mixed.T)
    K: Any = sparse.bmat([[uu, uw], [uw.T, ww]], format="csr")

    columns, rows = len(r_nodes), len(z_nodes)
    count = columns * rows
    top = np.arange(columns) * rows + rows - 1
    on_axis = np.arange(rows) if solid else np.array([], dtype=int)
    held = np.concatenate([top, top + count, on_axis])
    free = np.setdiff1d(np.arange(2 * count), held)
    y = r_nodes - start
    u_basis, w_basis = end.evaluate(y)
    functions = u_basis.shape[1] + w_basis.shape[1]
    fields = np.zeros((2 * count, functions))
    fields[top, : u_basis.shape[1]] = u_basis
    fields[top + count, u_basis.shape[1] :] = w_basis
    fields[free] = splu(K[free][:, free].tocsc()).solve(-(K[free] @ fields))
    stiffness = fields.T @ (K @ fields)
    loads = np.zeros((2 * count, end.loads.pressure.shape[1] + end.loads.shear.shape[1]))
    bottom = np.arange(columns) * rows
    pressures = end.loads.pressure.shape[1]
    loads[bottom + count, :pressures] = integrate_rings(end, start, r_nodes, 0)
    # the tissue's outward shear is the block's inward one
    loads[bottom, pressures:] = -integrate_rings(end, start, r_nodes, 1) / radius
    return stiffness / radius, fields.T @ loads / radius


def integrate_rings(end: EndFunctions, start: float, nodes: Floats, power: int) -> Floats:
    """Return the integrals of every element function times each load times r^(power + 1), shape (nodes, loads)."""
    loads = end.loads
    values = loads.pressure if power == 0 else loads.shear
    cuts = start + loads.cuts
    x, weight = legendre.leggauss(DEGREE + 3)
    edges = np.unique(np.concatenate([cuts, nodes[::DEGREE]]))
    middle, half = (edges[1:] + edges[:-1]) / 2, np.diff(edges) / 2
    r = (middle[:, None] + half[:, None] * x).ravel()
    amount = (half[:, None] * weight).ravel() * r ** (power + 1)
    load = values[np.clip(np.searchsorted(cuts, r) - 1, 0, len(values) - 1)]
    element = np.clip(np.searchsorted(nodes[::DEGREE], r) - 1, 0, (len(nodes) - 1) // DEGREE - 1)
    low, high = nodes[element * DEGREE], nodes[(element + 1) * DEGREE]
    local = np.concatenate([[-1.0], legendre.Legendre.basis(DEGREE).deriv().roots(), [1.0]])
    shapes = legendre.legvander(2 * (r - low) / (high - low) - 1, DEGREE) @ np.linalg.inv(legendre.legvander(local, DEGREE))
    integrals = np.zeros((len(nodes), values.shape[1]))
    for place in range(DEGREE + 1):
        np.add.at(integrals, element * DEGREE + place, (amount * shapes[:, place])[:, None] * load)
    return integrals


def compute_numbers(end: EndFunctions, slender: float, nu: float, wall: float) -> Floats:
    """Return the numbers of a block of ``BlockTable.coefficients``."""
    stiffness, works = solve_block(end, slender, nu, 1 - wall)
    return np.concatenate([stiffness[np.triu_indices(len(stiffness))], works.ravel()])


def fit_table(end: EndFunctions) -> tuple[Any, Any]:
    """Return the degrees and the coefficients of ``BlockTable``."""
    count = 2 if end.solid else 3
    every = np.stack(np.meshgrid(*(np.arange(degree + 1) for degree in DEGREES[:count]), indexing="ij"), axis=-1)
    every = every.reshape(-1, count)
    # products of high degree of several parameters are small
    degrees = every[(every / np.array(DEGREES[:count])).sum(axis=1) <= 1]
    # as dense at the ends of the ranges as Chebyshev's points
    scaled = np.cos(np.pi * Halton(count, seed=1).random(math.ceil(SAMPLES_PER_PRODUCT * len(degrees))))
    values = np.array([compute_numbers(end, *unscale_parameters(point)) for point in scaled])
    return degrees, np.linalg.lstsq(evaluate_products(degrees, list(scaled.T)), values, rcond=None)[0]


def unscale_parameters(scaled: Floats) -> list[float]:
    """Return height over width, Poisson's ratio and width over outer radius for numbers from -1 to 1, two of a disc."""
    ranges = np.array([np.log(HEIGHT_RANGE), POISSON_RANGE, np.log(WALL_RANGE)])[: len(scaled)]
    height, nu, *wall = (ranges[:, 0] + (ranges[:, 1] - ranges[:, 0]) * (scaled + 1) / 2).tolist()
    return [math.exp(height), nu, math.exp(wall[0]) if wall else 1.0]


def main() -> None:
    """Write the table and print its errors."""
    tables: dict[str, Any] = {}
    for name, end in zip(("disc", "tube"), ENDS, strict=True):
        degrees, coefficients = fit_table(end)
        tables |= {f"{name}_degrees": degrees, f"{name}_coefficients": coefficients}
        errors = np.array([compare_block(end, degrees, coefficients, rng) for rng in np.random.default_rng(1).spawn(TESTS)])
        print(f"{name}: {coefficients.shape}, errors over the largest number of K and B: {errors.max(axis=0)}")
    np.savez_compressed(TABLE_FILE, **tables)


def compare_block(end: EndFunctions, degrees: Any, coefficients: Any, rng: np.random.Generator) -> list[float]:
    """Return the largest errors of K and B of a drawn block, over the largest numbers."""
    scaled = rng.uniform(-1, 1, 2 if end.solid else 3)
    exact = compute_numbers(end, *unscale_parameters(scaled))
    error = np.abs((evaluate_products(degrees, list(scaled[:, None])) @ coefficients)[0] - exact)
    split = end.count * (2 * end.count + 1)
    return [
        float(part.max() / np.abs(whole).max())
        for part, whole in ((error[:split], exact[:split]), (error[split:], exact[split:]))
    ]


if __name__ == "__main__":
    main()
