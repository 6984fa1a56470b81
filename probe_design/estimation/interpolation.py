"""Interpolation as weights of values at nodes: what is smooth at the nodes is evaluated anywhere by a product of matrices."""

from __future__ import annotations

import numpy as np

from geometry.common.arrays import Floats


def place(nodes: Floats, points: Floats) -> Floats:
    """Return where points lie between even nodes, in steps from the first."""
    return np.asarray((points - nodes[0]) / (nodes[1] - nodes[0]))


def lagrange(nodes: Floats, points: Floats) -> Floats:
    """Return weights of four even nodes around each point, shape (m, nodes)."""
    at = place(nodes, points)
    first = np.clip(np.floor(at).astype(int) - 1, 0, len(nodes) - 4)
    x = at - first
    out = np.zeros((len(points), len(nodes)))
    for k in range(4):
        rest = [j for j in range(4) if j != k]
        weight = np.prod([(x - j) / (k - j) for j in rest], axis=0)
        out[np.arange(len(points)), first + k] = np.where(np.abs(weight) < 1e-12, 0.0, weight)
    return out


def hermite(nodes: Floats, points: Floats) -> tuple[Floats, Floats]:
    """Return weights of the values and of the derivatives at even nodes, each of shape (m, nodes)."""
    at, step = place(nodes, points), nodes[1] - nodes[0]
    first = np.clip(np.floor(at).astype(int), 0, len(nodes) - 2)
    x, rows = at - first, np.arange(len(points))
    whole, half = np.zeros((2, len(points), len(nodes)))
    whole[rows, first], whole[rows, first + 1] = (1 + 2 * x) * (1 - x) ** 2, x**2 * (3 - 2 * x)
    half[rows, first], half[rows, first + 1] = step * x * (1 - x) ** 2, step * x**2 * (x - 1)
    return whole, half


def parabola(nodes: Floats, points: Floats) -> Floats:
    """Return weights of three nodes, shape (m, 3); beyond them those of the nearest."""
    x = np.clip(points, nodes[0], nodes[-1])
    rest = [[j for j in range(3) if j != k] for k in range(3)]
    return np.stack([np.prod([(x - nodes[j]) / (nodes[k] - nodes[j]) for j in rest[k]], axis=0) for k in range(3)], axis=1)
