"""Differentiate discrete energies exactly by every length, modulus and Poisson's ratio of a section.

Nodes are smooth functions of the lengths, and polynomial coefficients stay constant. With the nodes' velocity V, L = grad V, tau
= div V + V_r / r, w = 2 pi r dA and Lame's moduli, the energy a(u, v) = int w (2 mu eps:eps + lambda P_u P_v) of two states
changes by

    grad u:  -grad u L,      u_r / r:  -(u_r / r) V_r / r,      w:  w tau                                            (AX.5)
    d int w P_u P_v = int w [dD_u P_v + P_u dD_v + tau (D_u P_v + P_u D_v - P_u P_v)],  D = div u, P its projection  (AX.6)

Base states minimise the energy, so that nothing else changes their forces: no adjoint solve is needed. Node
velocities are derivatives by complex steps of the map from lengths to nodes.

Changes are linear in V: six numbers at each point, the energy-momentum tensor (``energy_momentum.py``), are computed once for all
lengths, and one matrix product with all velocities gives the derivatives.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from geometry.common.arrays import Floats, Ints
from geometry.meridian.mesh import compute_nodes
from geometry.meridian.section import Body
from solver.axisymmetric.base_states import MeridianModel
from solver.axisymmetric.energy_momentum import EnergyPoints
from solver.materials.linear import Isotropic

MAX_TENSOR_BYTES = 2e7  # tensors in memory at once
COMPLEX_STEP = 1e-30  # relative: a complex step subtracts nothing, so that it can be this small


def list_variables(model: MeridianModel) -> tuple[str, ...]:
    """Return the names of a section's variables: ln of each length and modulus, and each Poisson's ratio itself."""
    bodies = [body.name.lower() for body in model.materials]
    return (
        *model.section.lengths,
        *(f"{body}_youngs_modulus" for body in bodies),
        *(f"{body}_poisson_ratio" for body in bodies),
    )


def differentiate_totals(model: MeridianModel, whole: Floats, inside: Body) -> tuple[Floats, Floats]:
    """Return d(u_i^T K (u_1 + u_2)) for k pairs u_1, u_2 of states, ``whole`` of shape (n, 2 s, 2, k), by all variables.

    Two arrays of shape (variables, 2, k): the part of all bodies except ``inside``, and the part of ``inside``.
    """
    moved, mask = compute_velocities(model), model.mesh.body == inside
    outside, enclosed = (_differentiate_elements(model, whole, np.flatnonzero(part), moved) for part in (~mask, mask))
    return outside, enclosed


def compute_velocities(model: MeridianModel) -> tuple[Floats, Floats]:
    """Return derivatives of the nodes by ln of each length at a fixed corner size of the mesh, and last by ln of that size.

    Shape (lengths + 1, n, s, 2); the second array are the derivatives of ln of the corner size by ln of each length, (lengths,).
    Thus most lengths move few elements, and the corner size, on which all depend, is treated once.
    """
    names, section = model.section.lengths, model.section
    steps = 1 + 1j * COMPLEX_STEP * np.eye(len(names) + 1)
    moved = {name: getattr(section, name) * steps[k] for k, name in enumerate(names)}
    displaced = replace(section, **moved, mesh_size=section.corner_size * steps[-1])
    free = replace(section, **{name: lengths[:-1] for name, lengths in moved.items()})
    by_lengths = compute_nodes(displaced, model.mesh, model.shapes.places).imag / COMPLEX_STEP
    return by_lengths, free.corner_size.imag / COMPLEX_STEP / section.corner_size


def _differentiate_elements(model: MeridianModel, whole: Floats, chosen: Ints, moved: tuple[Floats, Floats]) -> Floats:
    """Return derivatives of some elements' totals, shape (variables, 2, k)."""
    if not chosen.size:
        return np.zeros((len(list_variables(model)), *whole.shape[2:]))
    velocity, shares = moved
    points = EnergyPoints.from_elements(model, chosen)
    motions = points.compute_motions(velocity[:, chosen]).reshape(len(velocity), -1)
    element_values = whole[chosen].reshape(len(chosen), 2, -1, *whole.shape[2:]).transpose(3, 4, 1, 0, 2)
    values = np.empty((element_values.shape[1], 2, *element_values.shape[2:]))
    np.add(element_values[0], element_values[1], out=values[:, 0])
    np.subtract(element_values[0], element_values[1], out=values[:, 1])
    at_once = max(1, int(MAX_TENSOR_BYTES / (16 * motions.shape[1])))
    parts = [_differentiate_pairs(points, motions, values[low : low + at_once]) for low in range(0, len(values), at_once)]
    lengths, energy, volume = (np.concatenate(part) for part in zip(*parts, strict=True))  # (k, 2, ...)
    lengths = lengths[..., :-1] + lengths[..., -1:] * shares
    combined = np.concatenate([lengths, *_differentiate_by_materials(model, chosen, energy, volume)], axis=-1).transpose(2, 1, 0)
    total, difference = combined[:, 0] / 2, combined[:, 1] / 4
    return np.stack([total + difference, total - difference], axis=1)


def _differentiate_pairs(points: EnergyPoints, motions: Floats, values: Floats) -> tuple[Floats, Floats, Floats]:
    """Return changes of pairs' energies by ``motions``, (lengths, 6 e q), shape (k, 2, lengths), energies and int w P^2."""
    tensors = np.empty((len(values), 2, 6, *points.weight.shape))
    volume = np.empty((len(values), 2, len(points.weight)))
    for pair, tensor, part in zip(values, tensors, volume, strict=True):
        part[:] = points.compute_tensors(pair, tensor)
    energy = (tensors[:, :, :3] @ np.ones(tensors.shape[-1])).sum(axis=2)
    lengths = tensors.reshape(2 * len(values), -1) @ motions.T  # one product for all pairs: each would read all motions again
    return lengths.reshape(len(values), 2, -1), energy, volume


def _differentiate_by_materials(model: MeridianModel, chosen: Ints, energy: Floats, volume: Floats) -> tuple[Floats, Floats]:
    """Return derivatives by ln E and nu of every body, (..., bodies) each; 2 mu and lambda by eq. LW.1.

    ``energy`` and ``volume`` are the chosen elements' energies and int w P^2, shape (..., e).
    """
    membership = (model.mesh.body[chosen][:, None] == np.array(list(model.materials))).astype(float)
    law = Isotropic.from_materials(model.materials.values())
    whole, volumetric = energy @ membership, volume @ membership
    shear = (whole - law.dilation_modulus * volumetric) / (1 + law.poisson_ratio)
    return whole, law.dilation_modulus_by_poisson * volumetric - shear
