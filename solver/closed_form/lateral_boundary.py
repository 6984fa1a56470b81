"""Free sides of the tissue: how much more compliant a cylinder is than the endless layer that it is cut from.

Cut a layer at r = R. Its loads' fields u leave tractions s on the cut; a field v of the cylinder, fixed to the bottom, takes them
off. By Betti's theorem, inside the cut and outside, the loads' works on each other grow by

    dC_ij = -Int_cut s_i . u_j dA + b_i K^-1 b_j,     b_i = -Int_cut s_i . v dA                      (CF.11)

where the first term is the energy of what is cut off, and the second what the cylinder adds once it is free: v are the
displacements of eq. CF.8 for a disc of tissue, of stiffness K. A tall cylinder becomes a column under uniaxial stress, a wide one
remains a layer. Fields at the cut are those of the loads smoothed by a Gaussian narrower than the distance to the cut, so that
few waves serve. A block of tissue is taken as the cylinder of equal cross-section about the probe's axis.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.polynomial import legendre

from solver.closed_form.bessel import Array, bessel
from solver.closed_form.block_compliance import build_ritz_system, evaluate_radial_functions
from solver.closed_form.block_functions import (
    AXIAL_FUNCTIONS,
    RADIAL_FUNCTIONS,
    AxialFunctions,
    build_axial_functions,
    interpolate_axial_integrals,
    interpolate_radial_integrals,
)
from solver.closed_form.layer import Waves, compute_fields
from solver.closed_form.tractions import ElasticBlocks

BLUR_RELATIVE = 0.35  # of the distance from the probe to the cut
MIN_BLUR_RELATIVE = 0.08  # of the cut's radius
WAVE_REACH = 5.0  # wave numbers times blur
NODES_PER_WAVE = 0.4  # times wave number and the cut's radius, beyond eight
NEAR_SIDE_RADII = 4.0  # in outer radii: sides farther away matter only in slender tissue
MAX_SLENDERNESS = 0.2  # depth x outer radius / radius^2 up to which it is not slender


def count_side_nodes(outer: float, depth: float, radius: float) -> int:
    """Return how many waves to use, a multiple of 4; 0 where sides change the totals by less than about 6 %.

    Arguments are the probe's outer radius, the tissue's depth and the radius of its sides, m.
    """
    if radius > NEAR_SIDE_RADII * outer and depth * outer < MAX_SLENDERNESS * radius**2:
        return 0
    return 4 * math.ceil((8 + NODES_PER_WAVE * WAVE_REACH / max(BLUR_RELATIVE * (1 - outer / radius), MIN_BLUR_RELATIVE)) / 4)


def build_cut_waves(radius: Array, outer: Array, nodes: int) -> tuple[Array, Array]:
    """Return wave numbers, 1/m, and the weights k dk times the Gaussian smoothing, shapes (n, nodes).

    ``radius`` is that of the tissue's sides, ``outer`` the probe's outer radius, m, shape (n,).
    """
    gap_width, min_width = BLUR_RELATIVE * (radius - outer), MIN_BLUR_RELATIVE * radius
    width = np.where(gap_width.real > min_width.real, gap_width, min_width)[:, None]
    fractions, weight = _build_wave_rule(nodes)
    reach = WAVE_REACH / width
    k = reach * fractions
    return k, k * (reach * weight)


@lru_cache(maxsize=16)
def _build_wave_rule(nodes: int) -> tuple[Any, Any]:
    """Return wave numbers as fractions of their maximum, and their weights times the Gaussian smoothing, shapes (nodes,)."""
    s, weight = legendre.leggauss(nodes)
    return (s + 1) / 2, weight / 2 * np.exp(-((WAVE_REACH * (s + 1) / 4) ** 2))


@dataclass(frozen=True)
class Sides:
    """Effect of the tissue's free sides.

    Attributes
    ----------
    work
        What the sides add to the works of the loads, eq. CF.11, shape (n, m, m).
    tissue, axial_functions
        The cylinder and its functions along the height.
    sink, widen
        Amplitudes of the P_i f_j and of the U_i g_j of eq. CF.8 under unit works at the side, see ``_solve_column``.
    side_works
        The works at the side under each of m loads, shape (n, works, m).
    """

    work: Array
    tissue: ElasticBlocks
    axial_functions: AxialFunctions
    sink: Array
    widen: Array
    side_works: Array

    def take(self, which: Any) -> Sides:
        """Return the sides of the designs with indices ``which``."""
        tissue, axial_functions = self.tissue.take(which), self.axial_functions.take(which)
        return Sides(self.work[which], tissue, axial_functions, self.sink[which], self.widen[which], self.side_works[which])

    def compute_strain(self, r: Array, z: Array) -> Array:
        """Return the strains rr + hoop, rr - hoop, zz and rz under unit works at the side, shape (n, 4 k, works).

        Parameters
        ----------
        r
            Distances of k points from the axis, m, shape (n, k): equally many for each depth, those of the first depth first.
        z
            Depths, m, shape (n, depths).
        """
        P, derivative, u_over_r = evaluate_radial_functions(self.tissue.radius, r)
        points_per_depth = r.shape[1] // z.shape[1]
        g, dg, f, df = (
            np.repeat(values, points_per_depth, axis=2)
            for values in self.axial_functions.interpolate(z / self.tissue.height[:, None])
        )
        h = self.tissue.height[:, None, None]
        widening, difference = (
            _multiply_functions(radial_part, g) @ self.widen for radial_part in (P, P - 2 * u_over_r / r[:, None])
        )
        sinking = -_multiply_functions(P, df / h) @ self.sink
        shear = (_multiply_functions(u_over_r, dg / h) @ self.widen - _multiply_functions(derivative, f) @ self.sink) / 2
        return np.concatenate([widening, difference, sinking, shear], axis=1)


def _multiply_functions(radial_part: Array, axial: Array) -> Array:
    """Return the products of all functions of the radius, (n, i, k), with all of the height, (n, j, k), shape (n, k, i j)."""
    return (radial_part[:, :, None] * axial[:, None]).reshape(len(radial_part), -1, radial_part.shape[2]).swapaxes(1, 2)


def solve_free_sides(field: Waves, loads: tuple[Array, Array], weights: Array, tissue: ElasticBlocks) -> Sides:
    """Compute the effect of free sides, eq. CF.11.

    Parameters
    ----------
    field
        Waves on the layer.
    loads
        Transforms of pressures and of shears, shapes (n, q, .); m loads in all.
    weights
        k dk of the waves, the smoothing included, shape (n, q).
    tissue
        The cylinder, as a disc.
    """
    (work, sink, widen), axial_functions = _solve_column(tissue), build_axial_functions(tissue.height, tissue.steepness)
    R, dz = tissue.radius[:, None, None], axial_functions.weight.T[:, :, None]
    at_cut, heights = _compute_cut_fields(field, loads, weights, tissue, axial_functions.zeta.T), axial_functions.zeta.shape[0]
    # stresses times the area of the cut at each depth
    ringed = at_cut[:, : 2 * heights] * np.concatenate([2 * np.pi * R * dz] * 2, axis=1)
    lost = -(ringed.swapaxes(1, 2) @ at_cut[:, 2 * heights :])
    side_works = np.concatenate(
        [
            axial_functions.f.transpose(2, 0, 1) @ ringed[:, heights:],
            -R / 2 * (axial_functions.g.transpose(2, 0, 1) @ ringed[:, :heights]),
        ],
        axis=1,
    )
    # the two terms of eq. CF.11: ``lost`` is cut off, ``added`` by the cylinder; rounding of the first is made symmetric
    added = side_works.swapaxes(1, 2) @ (work @ side_works)
    return Sides((lost + lost.swapaxes(1, 2)) / 2 + added, tissue, axial_functions, sink, widen, side_works)


def _solve_column(tissue: ElasticBlocks) -> tuple[Array, Array, Array]:
    """Return the response of a cylinder of tissue to unit works at its side.

    The works are those of tractions on the f_j and, divided by half the radius, on the g_j: every P_i is 1 at the side, and of
    the U_i the first alone is not 0. ``tissue`` is the cylinder, as a disc fixed to the bottom.

    Returns
    -------
    tuple[Array, Array, Array]
        The works of these on each other, shape (n, works, works), and the amplitudes of the P_i f_j and of the U_i g_j of
        eq. CF.8, shapes (n, functions, works).
    """
    transverse, axial, slender = (
        interpolate_radial_integrals(None),
        interpolate_axial_integrals(tissue.steepness),
        tissue.height / tissue.radius,
    )
    n, works = len(slender), 2 * AXIAL_FUNCTIONS + 1
    on_u = np.zeros((works, RADIAL_FUNCTIONS, AXIAL_FUNCTIONS, n), dtype=slender.dtype)
    on_modes = np.zeros((works, RADIAL_FUNCTIONS, AXIAL_FUNCTIONS + 1, n), dtype=slender.dtype)
    for j in range(AXIAL_FUNCTIONS):
        on_u[AXIAL_FUNCTIONS + 1 + j, 0, j] = 1.0
    on_modes[: AXIAL_FUNCTIONS + 1] = transverse.modes.sum(axis=0)[:, None] * axial.modes[:, None]
    system = build_ritz_system(tissue.nu, slender, (transverse, axial), (on_u, on_modes))
    size = tissue.radius[:, None, None]
    unit = np.concatenate([1 + 0 * size] * (AXIAL_FUNCTIONS + 1) + [1 / size] * AXIAL_FUNCTIONS, axis=2)
    amplitudes, scale = system.amplitudes, unit / (size * (tissue.E / (2 * (1 + tissue.nu)))[:, None, None])
    modes = system.compute_mode_amplitudes(amplitudes).reshape(n, RADIAL_FUNCTIONS, AXIAL_FUNCTIONS + 1, works)
    by_height = axial.modes.transpose(2, 0, 1)[:, None] @ modes
    sink = (transverse.modes[:, :, 0] @ by_height.reshape(n, RADIAL_FUNCTIONS, -1)).reshape(modes.shape)
    work = system.compute_compliance(amplitudes) * scale * unit.swapaxes(1, 2)
    return work, sink.reshape(n, -1, works) * scale, amplitudes * (scale / size)


def _compute_cut_fields(field: Waves, loads: tuple[Array, Array], weights: Array, tissue: ElasticBlocks, z: Array) -> Array:
    """Return the fields of m loads at the cut: stresses rr and rz, displacements outwards and downwards, shape (n, 4 p, m).

    ``z`` are depths of p points, m, shape (n, p), symmetric about the layer's middle; see ``solve_free_sides`` for the others.
    """
    nu, mu, R, k, weight = tissue.nu, tissue.E / (2 * (1 + tissue.nu)), tissue.radius, field.k.T.copy(), weights.T.copy()
    J0, J1 = bessel(k * R) * weight
    J1_over_kR = J1 / (k * R)
    factors = J0 - J1_over_kR, -2 * nu * J0, J1_over_kR * (R / (2 * mu)), J0 / (2 * mu * k)
    kinds = []
    for load, (outwards, b_sum, shear_strain, downwards) in zip(loads, compute_fields(field, z, mirrored=True), strict=True):
        rows = np.empty((4, *shear_strain.shape), dtype=shear_strain.dtype)
        np.multiply(outwards, factors[0], out=rows[0])
        rows[0] += b_sum * factors[1]
        for row, part, factor in zip(rows[1:], (shear_strain, outwards, downwards), (J1, *factors[2:]), strict=True):
            np.multiply(part, factor, out=row)
        rows = rows.reshape(-1, *shear_strain.shape[1:])
        kinds.append(np.ascontiguousarray(rows.transpose(2, 0, 1)) @ load)
    return np.concatenate(kinds, axis=2)
