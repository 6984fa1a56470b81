"""A wave on layers of tissue by Navier's equation itself, step by step downwards, in so many digits that growth does no harm.

Displacements u = U(z) J1(kr), w = W(z) J0(kr), w downwards, and stresses s of rz and zz follow, by Hooke's law and equilibrium,

    U' = k W + s_rz / mu,  W' = (s_zz - lam k U) / (lam + 2 mu),  s_rz' = k^2 (lam + 2 mu) U + k lam W',  s_zz' = -k s_rz

on a rigid bottom under a unit pressure or a unit shear; a half-space is a bottom that is far away.
"""

from __future__ import annotations

from collections.abc import Sequence
from decimal import Decimal, localcontext

import numpy as np

from geometry.common.arrays import Floats

DIGITS = 240
TERMS = 90


def propagator(k: float, height: float, E: float, nu: float) -> np.ndarray:
    """Matrix from (U, W, s_rz, s_zz) at the top of a layer to its bottom."""
    K, E_, n = Decimal(k), Decimal(E), Decimal(nu)
    mu = E_ / (2 * (1 + n))
    lam, zero = 2 * mu * n / (1 - 2 * n), Decimal(0)
    firm = lam + 2 * mu
    A = np.array(
        [
            [zero, K, 1 / mu, zero],
            [-lam * K / firm, zero, zero, 1 / firm],
            [K**2 * (firm - lam**2 / firm), zero, zero, K * lam / firm],
            [zero, zero, -K, zero],
        ]
    )
    halvings = max(0, int(np.ceil(np.log2(k * height + 1)))) + 3
    step = A * (Decimal(height) / 2**halvings)
    whole = term = np.array([[Decimal(int(i == j)) for j in range(4)] for i in range(4)])
    for n_term in range(1, TERMS):
        term = term @ step / n_term
        whole = whole + term
    for _ in range(halvings):
        whole = whole @ whole
    return whole


def states(k: float, layers: Sequence[tuple[float, float, float]], depths: Sequence[float]) -> tuple[Floats, Floats]:
    """Return (U, W, s_rz, s_zz) at depths under unit pressure and under unit shear, shapes (depths, 4).

    Parameters
    ----------
    k
        Wave number.
    layers
        Thickness, Young's modulus, Poisson's ratio, from the surface down to the bottom.
    depths
        Where, none at or below the bottom.
    """
    with localcontext() as context:
        context.prec = DIGITS
        whole = np.array([[Decimal(int(i == j)) for j in range(4)] for i in range(4)])
        for layer in layers:
            whole = propagator(k, *layer) @ whole
        answers = []
        for load in (np.array([Decimal(0), Decimal(-1)]), np.array([Decimal(-1), Decimal(0)])):
            a, b, c, d = whole[:2, :2].ravel()
            right = -(whole[:2, 2:] @ load)
            surface = np.array([d * right[0] - b * right[1], a * right[1] - c * right[0]]) / (a * d - b * c)
            answers.append([_propagate_layers(k, layers, depth, np.concatenate([surface, load])) for depth in depths])
        return np.array(answers[0], dtype=float), np.array(answers[1], dtype=float)


def _propagate_layers(k: float, layers: Sequence[tuple[float, float, float]], depth: float, state: np.ndarray) -> np.ndarray:
    for height, E, nu in layers:
        if depth <= height:
            return propagator(k, depth, E, nu) @ state
        state, depth = propagator(k, height, E, nu) @ state, depth - height
    return state
