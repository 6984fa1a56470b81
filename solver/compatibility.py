"""The closed form's mechanics in casadi: two blocks cut into rings, pressed on a layer with inclusions.

Unknown are the forces on the rings; every ring follows the base (PHYSICS: compatibility),

    sum_j C_ij f_j + f_i h_i / (E_app,i A_i) = displacement of ring i's base      (C1)

with C_ij = W_ij / (A_i A_j) the tissue's compliance from ``half_space``, rings being differences of
discs. An inclusion adds, by Betti and Eshelby, with eps_i the strain under ring i's unit force,

    dC_ij = -Int [k_v tr(eps_i) tr(eps_j) + k_d e_i : e_j] dV                     (C2)
    k_v = dK / (1 + alpha dK/K),  k_d = 2 dmu / (1 + beta dmu/mu)

    alpha = (1+nu) / (3 (1-nu)),  beta = 2 (4-5nu) / (15 (1-nu)).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from solver import half_space

SX = half_space.SX


@dataclass(frozen=True)
class Block:
    """A block as a ring (a disc if ``hole`` is 0): radii, height, modulus, Poisson's ratio; casadi scalars."""

    hole: SX
    radius: SX
    height: SX
    E: SX
    nu: SX

    @property
    def area(self) -> SX:
        """End area."""
        return np.pi * (self.radius**2 - self.hole**2)

    @property
    def apparent_modulus(self) -> SX:
        """Modulus of the block as a spring, one end bonded and the other free to widen.

        Eq. (C3): between E and the constrained modulus M, E_app = E + (M - E) x / (1 + x) with
        x (M/E - 1) = 8 nu^2 S^2 and the shape factor S of a block of twice the height, bonded at
        both ends (mirror symmetry). Within 12 % of the bonded-cylinder values of PHYSICS section 7.
        """
        shape = (self.radius - self.hole) / (4 * self.height)
        stiffening = 2 * self.nu**2 / ((1 + self.nu) * (1 - 2 * self.nu))
        x = 4 * (1 + self.nu) * (1 - 2 * self.nu) * shape**2
        return self.E * (1 + stiffening * x / (1 + x))

    def circles(self, rings: int) -> list[SX]:
        """Radii of the circles that cut the block into rings, narrow where pressure peaks: at its edges."""
        solid = isinstance(self.hole, float) and self.hole == 0.0
        steps = np.arange(0 if not solid else 1, rings + 1)
        share = np.sin(steps * np.pi / (2 * rings)) if solid else (1 - np.cos(steps * np.pi / rings)) / 2
        return [self.hole + float(fraction) * (self.radius - self.hole) for fraction in share]


@dataclass(frozen=True)
class Layer:
    """The tissue: depth (None for a half-space), modulus, Poisson's ratio; ``nodes`` of its depth's quadrature."""

    depth: SX | None
    E: SX
    nu: SX
    nodes: int = 24


@dataclass(frozen=True)
class Ball:
    """A spherical inclusion: radius, depth of the centre, distance of the centre from the probe's axis."""

    radius: SX
    depth: SX
    offset: SX
    E: SX
    nu: SX
    on_axis: bool = True


def film_forces(inner: Block, outer: Block, layer: Layer, balls: Sequence[Ball], rings: int) -> SX:
    """Return F_ij, force on block i per unit displacement of base j, N/m; a 2 x 2 casadi matrix.

    Each block is cut into ``rings`` rings of uniform pressure; with one the blocks press evenly.
    """
    circles = inner.circles(rings) + outer.circles(rings)
    cut = _from_discs_to_rings(rings)
    areas = np.pi * ca.mtimes(cut.T, ca.vertcat(*circles) ** 2)
    work = ca.mtimes([cut.T, _disc_work(circles, layer), cut])
    for ball in balls:
        work += _inclusion_work(circles, cut, layer, ball)
    give = [block.height / block.apparent_modulus for block in (inner, outer) for _ in range(rings)]
    compliance = work / ca.mtimes(areas, areas.T) + ca.diag(ca.vertcat(*give) / areas)
    bases = ca.SX(np.kron(np.eye(2), np.ones((rings, 1))))
    return ca.mtimes(bases.T, ca.ldl_solve(bases, *ca.ldl(compliance)))


def _from_discs_to_rings(rings: int) -> Any:
    """The matrix that makes rings as differences of discs, shape (2 rings + 1, 2 rings)."""
    solid, tube = np.eye(rings) - np.eye(rings, k=1), np.zeros((rings + 1, rings))
    tube[1:] = np.eye(rings)
    tube[:-1] -= np.eye(rings)
    cut = np.zeros((2 * rings + 1, 2 * rings))
    cut[:rings, :rings], cut[rings:, rings:] = solid, tube
    return ca.DM(cut)


def _disc_work(circles: list[SX], layer: Layer) -> SX:
    """W between all pairs of discs, eqs. (H1) and (H2); the circles increase."""
    size = len(circles)
    W = ca.SX.zeros(size, size)
    for i in range(size):
        for j in range(i, size):
            a, b = circles[i], circles[j]
            W[i, j] = W[j, i] = half_space.work_same(a, layer.E, layer.nu) if i == j else half_space.work(a, b, layer.E, layer.nu)
    if layer.depth is not None:
        W += half_space.layer_correction(circles, layer.depth, layer.E, layer.nu, layer.nodes)
    return W


def _inclusion_work(circles: list[SX], cut: Any, layer: Layer, ball: Ball) -> SX:
    """Eq. (C2) for unit pressures on the rings, integrated point by point over the ball."""
    k_v, k_d = polarisabilities(layer, ball)
    total = ca.SX.zeros(cut.shape[1], cut.shape[1])
    for r, z, volume in _points(ball):
        discs = ca.vertcat(*half_space.strain(circles, r, z, layer.E, layer.nu))
        rr, hoop, zz, rz = ca.vertsplit(ca.mtimes(discs, cut))
        trace = rr + hoop + zz
        total += volume * (k_v - k_d / 3) * ca.mtimes(trace.T, trace)
        for part, times in ((rr, 1), (hoop, 1), (zz, 1), (rz, 2)):
            total += volume * k_d * times * ca.mtimes(part.T, part)
    return -total


def polarisabilities(layer: Layer, ball: Ball) -> tuple[SX, SX]:
    """Return k_v and k_d of eq. (C2), Pa."""
    K, mu = layer.E / (3 * (1 - 2 * layer.nu)), layer.E / (2 * (1 + layer.nu))
    dK, dmu = ball.E / (3 * (1 - 2 * ball.nu)) - K, ball.E / (2 * (1 + ball.nu)) - mu
    alpha, beta = (1 + layer.nu) / (3 * (1 - layer.nu)), 2 * (4 - 5 * layer.nu) / (15 * (1 - layer.nu))
    return dK / (1 + alpha * dK / K), 2 * dmu / (1 + beta * dmu / mu)


def _points(ball: Ball) -> list[tuple[SX, SX, SX]]:
    """Quadrature of the ball: distance from the probe's axis, depth and volume of each point.

    Gauss in the cube of the radius and the cosine of the polar angle, midpoints in the azimuth.
    """
    cubes, cube_weights = np.polynomial.legendre.leggauss(2)
    cosines, cosine_weights = np.polynomial.legendre.leggauss(5)
    turns = np.array([0.5 * np.pi]) if ball.on_axis else (np.arange(5) + 0.5) * np.pi / 5
    points = []
    for u, wu in zip((cubes + 1) / 2, cube_weights / 2, strict=True):
        for c, wc in zip(cosines, cosine_weights / 2, strict=True):
            for turn in turns:
                across = ball.radius * float(np.cbrt(u) * np.sqrt(1 - c**2))
                z = ball.depth - ball.radius * float(np.cbrt(u) * c)
                r = across if ball.on_axis else ca.sqrt((ball.offset + across * np.cos(turn)) ** 2 + (across * np.sin(turn)) ** 2)
                points.append((r, z, 4 * np.pi / 3 * ball.radius**3 * float(wu * wc) / len(turns)))
    return points
