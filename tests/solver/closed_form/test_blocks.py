"""How blocks give way: the reduced system with its tables against all functions at once, with integrals by quadrature."""

from __future__ import annotations

import numpy as np
import pytest

from geometry.common.arrays import Floats
from solver.closed_form.block_compliance import _correct_modulus, compute_end_compliance
from solver.closed_form.block_functions import (
    HEIGHT_NODES,
    TABLE_HEIGHT_NODES,
    WALL_NODES,
    _build_gauss_rule,
    _evaluate_functions,
    _integrate_loads,
    build_axial_functions,
    compute_axial_integrals,
)
from solver.closed_form.tractions import LOADS, ElasticBlocks
from solver.linalg.piecewise import PiecewisePolynomials


def whole(block: ElasticBlocks, bonded: bool, nodes: int = TABLE_HEIGHT_NODES) -> Floats:
    """B K^-1 B^T of one block, K of all products P_i f_j and U_i g_j of eq. CF.8, lambda in every term that it is in."""
    slender = float(block.height[0] / block.width[0])
    wall, solid = block.width / block.radius, block.hole is None
    y, weight = _build_gauss_rule((0.0, 1.0), WALL_NODES)
    P, derivative, r, u = (part[0] for part in _evaluate_functions(y, 1 / wall - 1, solid))
    ring = 2 * np.pi * wall * r * weight
    spreading, hoop = np.concatenate([P[:0] if solid else 0 * P[:1], P]), u / r
    lift, tilt, spread, mixed = (
        (ring * left) @ right.T for left, right in ((P, P), (derivative, derivative), (spreading, spreading), (spreading, P))
    )
    turn, slide = (ring * u) @ derivative.T, (ring * u) @ u.T
    pure = 2 * (ring * (spreading - hoop)) @ (spreading - hoop).T + 2 * (ring * hoop) @ hoop.T
    pressed, sheared = (part[0] for part in _integrate_loads(1 / wall - 1, wall, LOADS.loads[0 if solid else 1]))
    axial_values = build_axial_functions(np.ones(1), block.steepness, nodes)
    g, dg, f, df = (part[:, :, 0] for part in (axial_values.g, axial_values.dg, axial_values.f, axial_values.df))
    weight = axial_values.weight[:, 0]

    def products(across: Floats, left: Floats, right: Floats, power: int) -> Floats:
        return np.kron(across, slender**power * (left * weight) @ right.T)

    nu = float(block.nu[0])
    k = 2 * nu / (1 - 2 * nu)
    ww = (k + 2) * products(lift, df, df, -1) + products(tilt, f, f, 1)
    uu = k * products(spread, g, g, 1) + products(pure, g, g, 1) + products(slide, dg, dg, -1)
    uw = -k * products(mixed, g, df, 0) - products(turn, dg, f, 0)
    K = np.block([[ww, uw.T], [uw, uu]])
    end = -(weight * df).sum(axis=1)
    B = np.zeros((len(pressed) + len(sheared), len(K)))
    B[: len(pressed), : len(ww)] = np.kron(pressed, end)
    B[len(pressed) :, len(ww) :] = np.kron(sheared, np.ones(len(g)))
    size = block.width[0] ** 2 * block.radius[0] * 2 * (1 + nu) / _correct_modulus(block, bonded)[0]
    return np.asarray(size * B @ np.linalg.solve(K, B.T))


@pytest.mark.parametrize("bonded", [True, False])
@pytest.mark.parametrize("nu", [0.0, 0.3, 0.4999])
@pytest.mark.parametrize(
    ("hole", "height"), [(None, 0.05), (None, 1.0), (None, 30.0), (0.02, 1.0), (0.5, 0.1), (0.5, 5.0), (0.97, 1.0), (0.999, 20.0)]
)
def test_few_unknowns_are_all_of_them(hole: float | None, height: float, nu: float, bonded: bool) -> None:
    """To a billionth of what each load gives way under itself, whatever the shape."""
    ones = np.ones(1)
    block = ElasticBlocks(None if hole is None else hole * ones, ones, height * ones, 2 * ones, nu * ones)
    expected = whole(block, bonded)
    scale = np.sqrt(np.diag(expected))
    assert compute_end_compliance(block, bonded)[0] / np.outer(scale, scale) == pytest.approx(
        expected / np.outer(scale, scale), abs=1e-9
    )


@pytest.mark.parametrize(("steepness", "places"), [(2.0, 8), (200.0, 6), (2e4, 5)])
def test_integrals_along_tall_blocks_need_the_nodes_that_they_have(steepness: float, places: int) -> None:
    """Against what the functions' exponentials integrate to in closed form."""
    axial_values = build_axial_functions(np.ones(1), np.array([steepness]), TABLE_HEIGHT_NODES)
    g, weight, b = axial_values.g[:, :, 0], axial_values.weight[:, 0], steepness
    loss = -np.expm1(-b)
    column = 1 / loss - 1 / b  # Int g_0
    square = (1 - 2 * loss / b + (1 - np.exp(-2 * b)) / (2 * b)) / loss**2
    assert weight @ g[0] == pytest.approx(column, rel=10.0**-places)
    assert weight @ g[0] ** 2 == pytest.approx(square, rel=10.0**-places)
    inner = ((1 - np.exp(-b)) / b - np.exp(-b)) / loss  # Int of the fading part
    both_ends = (np.exp(-b) - np.exp(-b) * (1 - np.exp(-b)) / b) / loss  # and of the base's times it
    assert weight @ g[1] == pytest.approx((inner - both_ends) / loss, rel=10.0**-places)


def test_ten_heights_would_not_do_in_a_tube_ninety_times_as_tall_as_its_wall() -> None:
    ones = np.ones(1)
    tube = ElasticBlocks(0.99 * ones, ones, 0.9 * ones, 2 * ones, 0.49 * ones)
    coarse, fine = (np.diag(whole(tube, True, nodes)) for nodes in (HEIGHT_NODES, TABLE_HEIGHT_NODES))
    assert np.abs(coarse / fine - 1).max() > 5e-3


def test_beyond_the_tables_it_says_so() -> None:
    ones = np.ones(1)
    assert np.all(np.isnan(compute_end_compliance(ElasticBlocks(None, ones, 1e8 * ones, ones, 0.3 * ones), True)))


def test_modes_are_normal() -> None:
    """The integrals of their squares are one, those of two of them none: along a block and across it."""
    *_, derivative, end, modes = (part[0] for part in compute_axial_integrals(np.array([3.0])))
    axial_values = build_axial_functions(np.ones(1), np.array([3.0]), TABLE_HEIGHT_NODES)
    f, df = (modes.T @ part[:, :, 0] for part in (axial_values.f, axial_values.df))
    weight = axial_values.weight[:, 0]
    assert -(df @ weight) == pytest.approx(end, rel=1e-12)
    assert (f * weight) @ f.T == pytest.approx(np.eye(3), abs=1e-12)
    assert (df * weight) @ df.T == pytest.approx(np.diag(derivative), abs=1e-11)


def test_polynomials_between_steps_meet_a_function_and_its_slope() -> None:
    table = PiecewisePolynomials(lambda x: [np.sin(x), np.stack([np.cos(x), np.exp(x)], axis=1)], 1.0, 0.25, 8, 10)
    x = np.linspace(1.0, 3.0, 200)
    sine, derivatives = table(x + 1e-30j)
    assert sine.real == pytest.approx(np.sin(x), abs=1e-13)
    assert derivatives.real == pytest.approx(np.array([np.cos(x), np.exp(x)]), rel=1e-12, abs=1e-12)
    assert sine.imag / 1e-30 == pytest.approx(np.cos(x), abs=1e-11)
    assert np.isnan(table(np.array([0.99, 3.01]))[0]).all()
