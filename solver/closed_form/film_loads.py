"""What the films' charges are of the tractions under the blocks: the work of each load on a film state.

With tau and p the shear and the pressure of a block on the stack of film and bonds, the toolkit's charge of the film is

    Q = d33 Int p chi dA - (d_p / t) {(1 + k t / (6 G)) Int tau v dA + Int p [(s_f + s_a) e - 2 s_f chi] dA}            (CF.27)

with v, e and chi of ``film_membrane``, d_p = (d31 + d32) / 2, s_f = t nu / (1 - nu) for the film, which widens as it is squeezed,
and s_a = t_a nu_a / (2 (1 - nu_a)), summed over both bonds, for tape squeezed out. The tractions follow from the loads t of the
tissue end (``tractions``) by the block's energy (``film_blocks``) with the stack's: normal springs 1 / sum(thickness / oedometric
modulus), shear springs between block, film and base, and the film's as a membrane. With g the factors of the functions of the
film end in CF.27, A the stiffness of block, springs and membrane, and K the block's,

    Q = m . t,   m = B^T (g - A^-1 K g),   C = C_rigid + B^T A^-1 B                                                      (CF.28)

so that Q is to the loads m what a film's force is to its areas: eq. CF.12 then holds for charges, too. The stack adds to the
works C what it gives way under the block.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.polynomial import legendre

from solver.closed_form.bessel import Array
from solver.closed_form.film_blocks import EDGE_EXPONENT, ENDS, EndFunctions, interpolate_block
from solver.closed_form.film_membrane import FilmArray, compute_actuator
from solver.closed_form.tractions import ElasticBlocks

MEMBRANE_FUNCTIONS = 3  # of the u_k, for the film's displacement by the block
NODES_PER_PIECE = 8  # of quadrature between the axis or the middle of a wall, the electrode's edge and the free edge
STRETCH = 1 / (1 + EDGE_EXPONENT)  # distance from an edge = (coordinate of quadrature)^STRETCH: then the weight is constant


@dataclass(frozen=True)
class FilmLoads:
    """What the film of a block adds to eq. CF.12; loads are those of the block, pressures before shears.

    Attributes
    ----------
    charge
        m of eq. CF.28, C m^2 / N, shape (n, loads).
    compliance
        What the stack adds to the works of the block's loads, m^5 / N, shape (n, loads, loads).
    """

    charge: Array
    compliance: Array


def compute_film_loads(block: ElasticBlocks, film: FilmArray, insets: bool) -> FilmLoads:
    """Compute charges and compliances of the films of n blocks; ``insets`` is whether an electrode ends within a film's edges."""
    end = ENDS[0 if block.hole is None else 1]
    K, B = interpolate_block(block)
    g = _compute_factors(block, film, end, insets)
    count = 2 * end.count
    A = np.zeros((len(K), count + MEMBRANE_FUNCTIONS, count + MEMBRANE_FUNCTIONS), dtype=np.result_type(K, g))
    A[:, :count, :count] = K
    _add_stack(A, block, film, end)
    right = np.zeros((*A.shape[:2], 1 + B.shape[2]), dtype=A.dtype)
    right[:, :count, 0] = (K @ g[:, :, None])[:, :, 0]
    right[:, :count, 1:] = B
    solved = np.linalg.solve(A, right)[:, :count]
    charge = ((g - solved[:, :, 0])[:, None] @ B)[:, 0]
    return FilmLoads(charge, B.swapaxes(1, 2) @ solved[:, :, 1:])


def _compute_factors(block: ElasticBlocks, film: FilmArray, end: EndFunctions, insets: bool) -> Array:
    """Return g: the charge per moment of tau with each u_k and of p with each w_k, C/N times m or 1, shape (n, 2 functions).

    A traction with these moments is taken as the sum of functions orthogonal to all others.
    """
    rule = _build_rule(block, film, end, insets)
    start = None if end.solid else block.start
    v, e = compute_actuator(film, start, block.radius, block.start[:, None] + block.width[:, None] * rule.y)
    t, nu = film.thickness, film.poisson
    squeeze = t * nu / (1 - nu)  # s_f
    bonds = [
        (film.base_bond_thickness, film.base_bond_poisson),
        (film.block_bond_thickness, film.block_bond_poisson),
    ]
    dilation = squeeze + sum(thickness * ratio / (2 * (1 - ratio)) for thickness, ratio in bonds)  # s_f + s_a
    per_shear = -film.lateral_charge / t * (1 + film.own_slip / (6 * film.base_slip))
    per_pressure = film.normal_charge + film.lateral_charge / t * 2 * squeeze
    by_u = per_shear[:, None] * v
    by_w = per_pressure[:, None] * rule.covered - (film.lateral_charge / t * dilation)[:, None] * e
    return np.concatenate([_project(by_u, rule.u), _project(by_w, rule.w)], axis=1)


def _project(values: Array, weights: Array) -> Array:
    """Return sums of values (n, points) times weights (points, functions) or (n, points, functions)."""
    return values @ weights if weights.ndim == 2 else (values[:, None] @ weights)[:, 0]


@dataclass(frozen=True)
class ProjectionRule:
    """Quadrature that expands functions of r in the u_k and w_k.

    Attributes
    ----------
    y
        Fractions of the width, shape (points,) or (n, points).
    covered
        1 where the electrode is, else 0, shape (points,).
    u, w
        Weights by which values become coefficients of the u_k and of the w_k, shape (..., points, functions).
    """

    y: Array
    covered: Any
    u: Array
    w: Array


def _build_rule(block: ElasticBlocks, film: FilmArray, end: EndFunctions, insets: bool) -> ProjectionRule:
    """Build the rule; the same for all designs without insets."""
    return _build_inset_rule(end, film.inset / block.width) if insets else _build_plain_rule(end)


@lru_cache(maxsize=2)
def _build_plain_rule(end: EndFunctions) -> ProjectionRule:
    """Build the rule of electrodes without inset."""
    rule = _build_inset_rule(end, np.zeros(1))
    used = rule.covered > 0
    return ProjectionRule(rule.y[0, used], rule.covered[used], rule.u[0, used], rule.w[0, used])


def _build_inset_rule(end: EndFunctions, inset: Array) -> ProjectionRule:
    """Build the rule of electrodes with insets, in widths, shape (n,).

    The coordinate z = d^(2/3), with d the distance from an edge, or 1 - y^2 of a disc, makes the weight d^(-1/3) constant.
    """
    x, weight = legendre.leggauss(NODES_PER_PIECE)
    x, weight = (x + 1) / 2, weight / 2
    stop = 1.0 if end.solid else 0.5 ** (1 / STRETCH)
    edge_distance = inset * (2 - inset) if end.solid else inset
    cut = np.where(edge_distance.real > 0, np.where(edge_distance.real > 0, edge_distance, 1.0) ** (1 / STRETCH), 0.0)
    cut = np.where(cut.real < stop, cut, stop)[:, None]
    z = np.concatenate([cut * x, cut + (stop - cut) * x], axis=1)
    amount = STRETCH * np.concatenate([cut * weight, (stop - cut) * weight], axis=1)
    covered = np.repeat([0.0, 1.0], NODES_PER_PIECE)
    d = z**STRETCH
    if end.solid:
        y = np.sqrt(1 - d)
        # the weight of u_k is y^2 times that of w_k, and u_k = y J_k
        u_weight = w_weight = amount
    else:
        amount = amount * (1 - d) ** EDGE_EXPONENT  # of the other edge
        y, covered = np.concatenate([d, 1 - d], axis=1), np.tile(covered, 2)
        u_weight = w_weight = np.concatenate([amount, amount], axis=1)
    u, w = end.evaluate(y)
    return ProjectionRule(y, covered, u * u_weight[..., None], w * w_weight[..., None])


def _add_stack(A: Array, block: ElasticBlocks, film: FilmArray, end: EndFunctions) -> None:
    """Add the stiffness of springs and membrane to A, in place; the film's displacements are the last unknowns."""
    count, film_count = end.count, MEMBRANE_FUNCTIONS
    u_mass, w_mass = _compute_masses(block, end)
    # stiffness of the springs from block to film and from film to base, and between both slips
    film_slip = film.own_slip / 6
    determinant = film.block_slip * film.base_slip - film_slip**2
    upper, lower, mixed = film.base_slip / determinant, film.block_slip / determinant, -film_slip / determinant
    u, w, f = slice(count), slice(count, 2 * count), slice(2 * count, 2 * count + film_count)
    A[:, u, u] += upper[:, None, None] * u_mass
    coupling = (mixed - upper)[:, None, None] * u_mass[:, :, :film_count]
    A[:, u, f] += coupling
    A[:, f, u] += coupling.swapaxes(1, 2)
    A[:, f, f] += (upper - 2 * mixed + lower)[:, None, None] * u_mass[:, :film_count, :film_count]
    A[:, f, f] += film.membrane_stiffness[:, None, None] * _compute_membrane_form(block, film.poisson, end)
    layers = [
        (film.thickness, film.modulus, film.poisson),
        (film.base_bond_thickness, film.base_bond_modulus, film.base_bond_poisson),
        (film.block_bond_thickness, film.block_bond_modulus, film.block_bond_poisson),
    ]
    A[:, w, w] += w_mass / sum(t * (1 + nu) * (1 - 2 * nu) / ((1 - nu) * E) for t, E, nu in layers)[:, None, None]


def _compute_masses(block: ElasticBlocks, end: EndFunctions) -> tuple[Array, Array]:
    """Return the integrals over the end of u_k u_l and of w_k w_l, m^2, shape (n, functions, functions)."""
    constant, linear = _compute_mass_numbers(end)
    start, width = ((2 * np.pi * block.width * part)[:, None, None] for part in (block.start, block.width))
    u, w = (start * first + width * second for first, second in zip(constant, linear, strict=True))
    return u, w


@lru_cache(maxsize=2)
def _compute_mass_numbers(end: EndFunctions) -> Any:
    """Return the integrals over y of u_k u_l and w_k w_l without and with a factor y, shape (2, 2, functions, functions)."""
    y, weight = legendre.leggauss(16)
    y, weight = (y + 1) / 2, weight / 2
    kinds = end.evaluate(y)
    return np.array([[kind.T @ (amount[:, None] * kind) for kind in kinds] for amount in (weight, weight * y)])


def _compute_membrane_form(block: ElasticBlocks, nu: Array, end: EndFunctions) -> Array:
    """Return 2 pi times the integrals of (u' u' + u u / r^2 + nu (u u)' / r) r over r, shape (n, functions, functions)."""
    u, slope, edges, y, weight = _sample_membrane_functions(end)
    r = block.start[:, None] + block.width[:, None] * y
    stretch = slope.T @ ((weight * r / block.width[:, None])[:, :, None] * slope)
    hoop = u.T @ ((weight * block.width[:, None] / r)[:, :, None] * u)
    return 2 * np.pi * (stretch + hoop + nu[:, None, None] * edges)


@lru_cache(maxsize=2)
def _sample_membrane_functions(end: EndFunctions) -> tuple[Any, ...]:
    """Return u_k and their derivatives by y at points y, the difference of u_k u_l between the edges, points and weights."""
    y, weight = legendre.leggauss(10)
    y, weight = (y + 1) / 2, weight / 2
    step = 1e-30
    u, raised, edges = (end.evaluate(x)[0][:, :MEMBRANE_FUNCTIONS] for x in (y, y + 1j * step, np.array([0.0, 1.0])))
    return u, raised.imag / step, np.outer(edges[1], edges[1]) - np.outer(edges[0], edges[0]), y, weight
