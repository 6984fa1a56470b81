"""Free sides of the tissue: what a cylinder gives way more than the endless layer that it is cut from.

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
from solver.closed_form.block_compliance import RADIAL, ElasticBlocks, column, radial
from solver.closed_form.block_functions import AXIAL, Along
from solver.closed_form.layer import Waves, fields

BLUR = 0.35  # of the way from the probe to the cut
LEAST_BLUR = 0.08  # of the cut's radius
REACH = 5.0  # wave numbers times blur
NODES_PER_WAVE = 0.4  # times wave number and the cut's radius, beyond eight
NEAR, SLENDER = 4.0, 0.2  # sides farther than so many outer radii matter where depth x outer radius / radius^2 is larger


def side_radius(tissue: CylinderTissue | BlockTissue) -> float:
    """Radius of the cylinder of equal cross-section, m."""
    return tissue.radius if tissue.shape == "cylinder" else math.sqrt(tissue.length * tissue.breadth / math.pi)


def side_nodes(outer: float, depth: float, radius: float) -> int:
    """Waves that serve, in steps so that few functions are built; none where sides change the totals by less than about 6 %."""
    if radius > NEAR * outer and depth * outer < SLENDER * radius**2:
        return 0
    return 4 * math.ceil((8 + NODES_PER_WAVE * REACH / max(BLUR * (1 - outer / radius), LEAST_BLUR)) / 4)


def cut_waves(radius: Array, outer: Array, nodes: int) -> tuple[Array, Array]:
    """Wave numbers and the weights k dk with the smoothing, shapes (n, nodes)."""
    way, least = BLUR * (radius - outer), LEAST_BLUR * radius
    width = np.where(way.real > least.real, way, least)[:, None]
    share, weight = _shares(nodes)
    reach = REACH / width
    k = reach * share
    return k, k * (reach * weight)


@lru_cache(maxsize=16)
def _shares(nodes: int) -> tuple[Any, Any]:
    """Shares of the reach of wave numbers and their weights, the smoothing included."""
    s, weight = legendre.leggauss(nodes)
    return (s + 1) / 2, weight / 2 * np.exp(-((REACH * (s + 1) / 4) ** 2))


@dataclass(frozen=True)
class Sides:
    """What free sides add.

    Attributes:
        work: to the works of the loads, eq. CF.11, shape (n, m, m).
        tissue, along: the cylinder and its functions along the height.
        answer: their amounts under unit works on the functions ``ON_SIDE``, shape (n, functions, works).
        taken: those works under each load, shape (n, works, m).
    """

    work: Array
    tissue: ElasticBlocks
    along: Along
    answer: Array
    taken: Array

    def strain(self, r: Array, z: Array) -> Array:
        """Strains rr + hoop, rr - hoop, zz, rz under unit works at places r (n, k), as many at each depth z; (n, 4 k, works)."""
        P, slope, over = radial(self.tissue.radius, r)
        each = r.shape[1] // z.shape[1]
        g, dg, f, df = (np.repeat(values, each, axis=2) for values in self.along.at(z / self.tissue.height[:, None]))
        U, W = self.answer[:, -RADIAL * AXIAL :], self.answer[:, : -RADIAL * AXIAL]
        widening, turn = (_products(across, g) @ U for across in (P, P - 2 * over / r[:, None]))
        sinking, slide = -_products(P, df) @ W, (_products(over, dg) @ U - _products(slope, f) @ W) / 2
        return np.concatenate([widening, turn, sinking, slide], axis=1)


def _products(across: Array, along: Array) -> Array:
    """Products of all functions of the radius with all of the height, shape (n, k, functions)."""
    return np.swapaxes((across[:, :, None] * along[:, None]).reshape(len(across), -1, across.shape[2]), 1, 2)


def free_sides(field: Waves, loads: tuple[Array, Array], weights: Array, tissue: ElasticBlocks) -> Sides:
    """Solve eq. CF.11.

    Args:
        field: waves on the layer.
        loads: transforms of pressures and of shears, shapes (n, q, .); m loads in all.
        weights: k dk of the waves, the smoothing included, shape (n, q).
        tissue: the cylinder, as a disc.
    """
    K, along = column(tissue)
    R, dz = tissue.radius[:, None, None], along.weight.T[:, :, None]
    push, drag, out, sink = _at_cut(field, loads, weights, tissue, along.zeta.T)
    ring = 2 * np.pi * R * dz
    lost = -(np.swapaxes(push, 1, 2) @ (ring * out) + np.swapaxes(drag, 1, 2) @ (ring * sink))
    taken = np.concatenate(
        [np.moveaxis(along.f, 2, 0) @ (ring * drag), -R / 2 * (np.moveaxis(along.g, 2, 0) @ (ring * push))], axis=1
    )
    answer = np.linalg.solve(K, np.broadcast_to(ON_SIDE, (len(K), *ON_SIDE.shape)))
    added = np.swapaxes(taken, 1, 2) @ ((ON_SIDE.T @ answer) @ taken)
    return Sides((lost + np.swapaxes(lost, 1, 2)) / 2 + added, tissue, along, answer, taken)


def _on_side() -> Any:
    """Which of a disc's functions are how much at its side: every P_i is 1 there, of the U_i the first alone is not 0."""
    rows = np.zeros((RADIAL * (2 * AXIAL + 1), 2 * AXIAL + 1))
    rows[: RADIAL * (AXIAL + 1), : AXIAL + 1] = np.tile(np.eye(AXIAL + 1), (RADIAL, 1))
    rows[RADIAL * (AXIAL + 1) :][:AXIAL, AXIAL + 1 :] = np.eye(AXIAL)
    return rows


ON_SIDE = _on_side()


def _at_cut(field: Waves, loads: tuple[Array, Array], weights: Array, tissue: ElasticBlocks, z: Array) -> tuple[Array, ...]:
    """The stresses rr and rz and the displacements outwards and downwards at the cut, at depths z; shapes (n, k, m)."""
    nu, mu, R = (part[:, None] for part in (tissue.nu, tissue.E / (2 * (1 + tissue.nu)), tissue.radius))
    zero, one = bessel(field.k * R)
    over, wide = one / (field.k * R), nu / (1 - 2 * nu) * zero
    shares = (zero - over + wide, wide, one, over * R / (2 * mu), zero / (2 * mu))
    parts = [weights * share for share in shares]
    kinds = []
    for load, (a, zz, rz, w) in zip(loads, fields(field, z, mirrored=True), strict=True):
        pushed, widened, dragged, out, sunk = (part[:, :, None] * load for part in parts)
        kinds.append((a @ pushed + zz @ widened, rz @ dragged, a @ out, w @ sunk))
    return tuple(np.concatenate(both, axis=2) for both in zip(*kinds, strict=True))
