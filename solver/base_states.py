"""The two base states of a scene: the base of one block moved down by one unit, the other held.

Film forces are energies of pairs of states, F_ij = u_i^T K u_j: consistent reactions, which
converge at twice the rate of the displacements. K is affine in every Young's modulus, so the
derivative of F_ij by the modulus of a body is the part of that energy inside it (the states are
their own adjoints).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from geometry.grading import Floats
from geometry.meridian import Body, Section
from geometry.probe import Material
from solver.parts import Parts
from solver.quadrilateral import Elements, Ints, lame

NDArrayBool = NDArray[np.bool_]


@dataclass(frozen=True)
class BaseStates:
    """Film forces per unit displacement of the blocks' bases.

    Attributes:
        forces: F_ij, force on block i (0 inner, 1 outer) per unit displacement of base j, N/m, shape (2, 2).
        slope: dF_ij / d ln E of the inclusion, shape (2, 2); zero without one.
        rounding: bound on what rounding changes in ``forces``, shape (2, 2).
        unknowns: number of unknowns solved for.
    """

    forces: Floats
    slope: Floats
    rounding: Floats
    unknowns: int


def base_states(
    grid: Elements, section: Section, materials: Mapping[Body, Material], interface: Literal["bonded", "frictionless"]
) -> BaseStates:
    """Solve both base states on one factorisation.

    Raises:
        SolveError: the residual of the solution is too large to be trusted.
    """
    stiffness = _element_stiffness(grid, materials)
    condensed, recovery = _condensed(stiffness, 2 * grid.skeleton)
    number = _numbering(grid, interface)
    dofs = number[grid.functions[:, : grid.skeleton]].reshape(len(condensed), -1)
    fixed, lift = _supports(grid, number, section)
    inside = grid.body == Body.INCLUSION
    corners = np.unique(dofs[inside, 1:8:2])
    blocks = (grid.body == Body.INNER) | (grid.body == Body.OUTER)
    tissue, block, ball = (_assemble(condensed[group], dofs[group], len(lift)) for group in (~inside & ~blocks, blocks, inside))
    parts = Parts(tissue, block, ball, lift, corners)
    v, hidden = parts.solve(fixed)
    edge = parts.strained_inclusion(v)[dofs[inside]]  # (elements, dofs, 2)
    local = np.concatenate([edge, recovery[inside] @ edge], axis=1)
    slope = np.einsum("eai,eab,ebj->ij", local, stiffness[inside], local, optimize=True)
    return BaseStates(parts.energy(v), slope, parts.rounding(v) + hidden, int((~fixed).sum()))


def _condensed(stiffness: Floats, edge: int) -> tuple[Floats, Floats]:
    """Eliminate each element's inside, whose dofs come after its first ``edge``.

    Returns the condensed matrices and what gives the inside from the edge: inside = recovery @ edge.
    """
    inside = stiffness[:, edge:, edge:]
    recovery = np.asarray(np.linalg.solve(inside, -stiffness[:, edge:, :edge]), dtype=float)
    condensed = stiffness[:, :edge, :edge] + stiffness[:, :edge, edge:] @ recovery
    return (condensed + condensed.transpose(0, 2, 1)) / 2, recovery


def _element_stiffness(grid: Elements, materials: Mapping[Body, Material]) -> Floats:
    moduli, ratios = np.zeros(len(Body)), np.zeros(len(Body))
    for body, material in materials.items():
        moduli[body], ratios[body] = material.youngs_modulus, material.poisson_ratio
    two_mu, lam = lame(moduli[grid.body], ratios[grid.body])
    return two_mu[:, None, None] * grid.shear + lam[:, None, None] * grid.volume


def _numbering(grid: Elements, interface: str) -> Ints:
    """Number the u_r and u_z of each shape function on corners and edges, shape (functions, 2).

    Those that meet on z = 0 share u_z, and u_r where bonded.

    Functions of elements' insides, which are eliminated, have none.
    """
    on_block = np.zeros(len(grid.degree), dtype=bool)
    on_block[grid.functions[(grid.body == Body.INNER) | (grid.body == Body.OUTER), : grid.skeleton]] = True
    surface = _on(grid, z=0.0)

    def places(functions: NDArrayBool) -> dict[tuple[float, ...], int]:
        return {(float(grid.degree[k]), *np.sort(grid.ends[k, :, 0]).tolist()): int(k) for k in np.flatnonzero(functions)}

    tissue, owner = places(surface & ~on_block), np.arange(2 * len(on_block)).reshape(-1, 2)
    for place, k in places(surface & on_block).items():
        partner = tissue[place]
        owner[k, 1] = owner[partner, 1]
        if interface == "bonded":
            owner[k, 0] = owner[partner, 0]
    return np.unique(owner, return_inverse=True)[1].reshape(-1, 2)


def _on(grid: Elements, z: float | None = None, r: float | None = None) -> NDArrayBool:
    """The shape functions that do not vanish on a line of constant z or r."""
    axis, value = (1, z) if r is None else (0, r)
    return np.asarray(np.all(grid.ends[:, :, axis] == value, axis=1))


def _assemble(stiffness: Floats, dofs: Ints, size: int) -> sp.csc_array:
    width = dofs.shape[1]
    rows, columns = np.repeat(dofs, width, axis=1).ravel(), np.tile(dofs, (1, width)).ravel()
    return sp.coo_array((stiffness.ravel(), (rows, columns)), shape=(size, size)).tocsc()


def _supports(grid: Elements, number: Ints, section: Section) -> tuple[NDArrayBool, Floats]:
    """Which dofs are prescribed, shape (dofs,), and each state's block moved rigidly with its base, shape (dofs, 2)."""
    fixed, lift = np.zeros(number.max() + 1, dtype=bool), np.zeros((number.max() + 1, 2))
    fixed[number[_on(grid, r=0.0), 0]] = True
    fixed[number[_on(grid, z=-section.tissue_depth)]] = True
    for state, (body, top) in enumerate(((Body.INNER, section.inner_height), (Body.OUTER, section.outer_height))):
        of_block = np.zeros(len(grid.degree), dtype=bool)
        of_block[grid.functions[grid.body == body, : grid.skeleton]] = True
        fixed[number[of_block & _on(grid, z=top)]] = True
        lift[number[of_block & (grid.degree == 1), 1], state] = -1.0  # the edges' own functions add nothing to a constant
    return fixed, lift
