"""Free sides of the tissue: how much more compliant a cylinder is than the endless layer that it is cut from.

Cut a layer at r = R. Its loads' fields u leave tractions s on the cut; a field v of the cylinder, fixed to the floor, takes them
off. By Betti's theorem, inside the cut and outside, the loads' works on each other grow by

    dC_ij = -Int_cut s_i . u_j dA + b_i K^-1 b_j,     b_i = -Int_cut s_i . v dA                      (CF.11)

where the first term is the energy of what is cut off, and the second what the cylinder adds once it is free: v are the
displacements of eq. CF.8 for a disc of tissue, of stiffness K. A tall cylinder becomes a column under uniaxial stress, a wide
one remains a layer. Fields at the cut are those of the loads smoothed by a Gaussian narrower than the way to the cut, so that few
waves serve. A block of tissue is taken as the cylinder of equal cross-section about the probe's axis.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.polynomial import legendre

from geometry.scenes.scene import BlockTissue, CylinderTissue
from solver.closed_form.bessel import Array, bessel
from solver.closed_form.block_compliance import ElasticBlocks, radial, reduced
from solver.closed_form.block_functions import AXIAL, RADIAL, Along, along_height, axial_integrals, radial_integrals
from solver.closed_form.layer import Waves, fields

BLUR = 0.35  # of the distance from the probe to the cut
LEAST_BLUR = 0.08  # of the cut's radius
REACH = 5.0  # wave numbers times blur
NODES_PER_WAVE = 0.4  # times wave number and the cut's radius, beyond eight
NEAR, SLENDER = 4.0, 0.2  # sides farther than so many outer radii matter where depth x outer radius / radius^2 is larger


def side_radius(tissue: CylinderTissue | BlockTissue) -> float:
    """Return the radius of the cylinder of equal cross-section, m."""
    return tissue.radius if tissue.shape == "cylinder" else math.sqrt(tissue.length * tissue.breadth / math.pi)


def side_nodes(outer: float, depth: float, radius: float) -> int:
    """Return how many waves to use, in steps of 4; 0 where sides change the totals by less than about 6 %."""
    if radius > NEAR * outer and depth * outer < SLENDER * radius**2:
        return 0
    return 4 * math.ceil((8 + NODES_PER_WAVE * REACH / max(BLUR * (1 - outer / radius), LEAST_BLUR)) / 4)


def cut_waves(radius: Array, outer: Array, nodes: int) -> tuple[Array, Array]:
    """Return wave numbers, 1/m, and the weights k dk with the smoothing, shapes (n, nodes)."""
    way, least = BLUR * (radius - outer), LEAST_BLUR * radius
    width = np.where(way.real > least.real, way, least)[:, None]
    share, weight = _shares(nodes)
    reach = REACH / width
    k = reach * share
    return k, k * (reach * weight)


@lru_cache(maxsize=16)
def _shares(nodes: int) -> tuple[Any, Any]:
    """Return wave numbers as fractions of their maximum, and their weights with the smoothing."""
    s, weight = legendre.leggauss(nodes)
    return (s + 1) / 2, weight / 2 * np.exp(-((REACH * (s + 1) / 4) ** 2))


@dataclass(frozen=True)
class Sides:
    """Effect of the tissue's free sides.

    Attributes:
        work: to the works of the loads, eq. CF.11, shape (n, m, m).
        tissue, axial_functions: the cylinder and its functions along the height.
        sink, widen: amounts of the P_i f_j and of the U_i g_j under unit works at the side, ``TissueColumn``.
        side_works: those works under each load, shape (n, works, m).
    """

    work: Array
    tissue: ElasticBlocks
    along: Along
    sink: Array
    widen: Array
    taken: Array

    def take(self, which: Any) -> Sides:
        """Return the sides of the designs with indices ``which``."""
        tissue, along = self.tissue.take(which), self.along.take(which)
        return Sides(self.work[which], tissue, along, self.sink[which], self.widen[which], self.taken[which])

    def strain(self, r: Array, z: Array) -> Array:
        """Return strains rr + hoop, rr - hoop, zz, rz under unit works at r (n, k), equally many per depth z; (n, 4 k, works)."""
        P, slope, over = radial(self.tissue.radius, r)
        each = r.shape[1] // z.shape[1]
        g, dg, f, df = (np.repeat(values, each, axis=2) for values in self.along.at(z / self.tissue.height[:, None]))
        h = self.tissue.height[:, None, None]
        widening, turn = (_products(across, g) @ self.widen for across in (P, P - 2 * over / r[:, None]))
        sinking = -_products(P, df / h) @ self.sink
        slide = (_products(over, dg / h) @ self.widen - _products(slope, f) @ self.sink) / 2
        return np.concatenate([widening, turn, sinking, slide], axis=1)


def _products(across: Array, along: Array) -> Array:
    """Return products of all functions of the radius with all functions of the height, shape (n, k, functions)."""
    return (across[:, :, None] * along[:, None]).reshape(len(across), -1, across.shape[2]).swapaxes(1, 2)


def free_sides(field: Waves, loads: tuple[Array, Array], weights: Array, tissue: ElasticBlocks) -> Sides:
    """Compute the effect of free sides, eq. CF.11.

    Args:
        field: waves on the layer.
        loads: transforms of pressures and of shears, shapes (n, q, .); m loads in all.
        weights: k dk of the waves, the smoothing included, shape (n, q).
        tissue: the cylinder, as a disc.
    """
    column, along = _column(tissue), along_height(tissue.height, tissue.steepness, AXIAL)
    R, dz = tissue.radius[:, None, None], along.weight.T[:, :, None]
    at_cut, heights = _at_cut(field, loads, weights, tissue, along.zeta.T), along.zeta.shape[0]
    ringed = at_cut[:, : 2 * heights] * np.concatenate([2 * np.pi * R * dz] * 2, axis=1)
    lost = -(ringed.swapaxes(1, 2) @ at_cut[:, 2 * heights :])
    taken = np.concatenate(
        [along.f.transpose(2, 0, 1) @ ringed[:, heights:], -R / 2 * (along.g.transpose(2, 0, 1) @ ringed[:, :heights])], axis=1
    )
    added = taken.swapaxes(1, 2) @ (column.work @ taken)
    return Sides((lost + lost.swapaxes(1, 2)) / 2 + added, tissue, along, column.sink, column.widen, taken)


@dataclass(frozen=True)
class TissueColumn:
    """Response of a cylinder of tissue to unit works at its side, on the f_j and, divided by half the radius, on the g_j.

    Every P_i is 1 at the side, and of the U_i the first alone is not 0.

    Attributes:
        work: of these on each other, shape (n, works, works).
        sink, widen: amounts of the P_i f_j and of the U_i g_j of eq. CF.8, shapes (n, functions, works).
    """

    work: Array
    sink: Array
    widen: Array


def _column(tissue: ElasticBlocks) -> TissueColumn:
    across, along, slender = (
        radial_integrals(None, False),
        axial_integrals(tissue.steepness, AXIAL),
        tissue.height / tissue.radius,
    )
    n, works = len(slender), 2 * AXIAL + 1
    on_u = np.zeros((works, RADIAL, AXIAL, n), dtype=slender.dtype)
    on_modes = np.zeros((works, RADIAL, AXIAL + 1, n), dtype=slender.dtype)
    for j in range(AXIAL):
        on_u[AXIAL + 1 + j, 0, j] = 1.0
    on_modes[: AXIAL + 1] = across.modes.sum(axis=0)[:, None] * along.modes[:, None]
    system = reduced(tissue.nu, slender, (across, along), (on_u, on_modes))
    size = tissue.radius[:, None, None]
    unit = np.concatenate([1 + 0 * size] * (AXIAL + 1) + [1 / size] * AXIAL, axis=2)
    answer, scale = system.answer, unit / (size * (tissue.E / (2 * (1 + tissue.nu)))[:, None, None])
    modes = system.modes(answer).reshape(n, RADIAL, AXIAL + 1, works)
    by_height = along.modes.transpose(2, 0, 1)[:, None] @ modes
    sink = (across.modes[:, :, 0] @ by_height.reshape(n, RADIAL, -1)).reshape(modes.shape)
    work = system.compliance(answer) * scale * unit.swapaxes(1, 2)
    return TissueColumn(work, sink.reshape(n, -1, works) * scale, answer * (scale / size))


def _at_cut(field: Waves, loads: tuple[Array, Array], weights: Array, tissue: ElasticBlocks, z: Array) -> Array:
    """Return stresses rr and rz, outward and downward displacements at the cut at depths z (n, p), shape (n, 4 p, m)."""
    nu, mu, R, k, weight = tissue.nu, tissue.E / (2 * (1 + tissue.nu)), tissue.radius, field.k.T.copy(), weights.T.copy()
    zero, one = bessel(k * R) * weight
    over = one / (k * R)
    shares = zero - over, -2 * nu * zero, over * (R / (2 * mu)), zero / (2 * mu * k)
    kinds = []
    for load, (outwards, both, across, downwards) in zip(loads, fields(field, z, mirrored=True), strict=True):
        rows = np.empty((4, *across.shape), dtype=across.dtype)
        np.multiply(outwards, shares[0], out=rows[0])
        rows[0] += both * shares[1]
        for row, part, share in zip(rows[1:], (across, outwards, downwards), (one, *shares[2:]), strict=True):
            np.multiply(part, share, out=row)
        rows = rows.reshape(-1, *across.shape[1:])
        kinds.append(np.ascontiguousarray(rows.transpose(2, 0, 1)) @ load)
    return np.concatenate(kinds, axis=2)
