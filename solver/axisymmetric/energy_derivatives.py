"""Exact derivatives of discrete energies by every length, modulus and Poisson's ratio of a section.

Nodes are smooth functions of the lengths and polynomial coefficients stay put, so that with the nodes' velocity V,
L = grad V and tau = div V + V_r / r an energy a(u, v) = int w (2 mu eps:eps + lambda P_u P_v), w = 2 pi r dA, changes by

    grad u:  -grad u L,      u_r / r:  -(u_r / r) V_r / r,      w:  w tau                                            (AX.5)
    d int w P_u P_v = int w [dD_u P_v + P_u dD_v + tau (D_u P_v + P_u D_v - P_u P_v)],  D = div u, P its projection  (AX.6)

Base states minimise the energy, so that nothing else changes their forces: no adjoint solve is needed. Node
velocities are derivatives by complex steps of the map from lengths to nodes.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from geometry.common.arrays import Bools, Floats, Ints
from geometry.meridian.mesh import nodes
from geometry.meridian.section import Body
from solver.axisymmetric.base_states import MeridianModel
from solver.elements.quadrilateral import Geometry, gradients, lame, projected
from solver.elements.shape_functions import Shapes

BLOCK = 16  # elements worked on at once: few enough for the processor's cache
STEP = 1e-30  # of the complex step, relative: nothing is subtracted, so that it can be this small


def variables(model: MeridianModel) -> tuple[str, ...]:
    """Names of what energies can be differentiated by: by ln of a length or modulus, and by a Poisson's ratio itself."""
    bodies = [body.name.lower() for body in model.materials]
    return (
        *model.section.lengths,
        *(f"{body}_youngs_modulus" for body in bodies),
        *(f"{body}_poisson_ratio" for body in bodies),
    )


def energy_derivatives(model: MeridianModel, whole: Floats, inside: Body) -> tuple[Floats, Floats]:
    """Return d(u_i^T K u_j) for all columns u_i of ``whole``, shape (n, 2 s, m), by all ``variables``.

    Two arrays of shape (variables, m, m): the part of all bodies but ``inside``, and its part.
    """
    mask = model.mesh.body == inside
    lengths = _by_lengths(model, whole, mask)
    materials = (_by_materials(model, whole, np.flatnonzero(part)) for part in (~mask, mask))
    rest, within = (np.concatenate([one, *other]) for one, other in zip(lengths, materials, strict=True))
    return rest, within


def velocities(model: MeridianModel) -> tuple[Floats, Floats]:
    """Derivatives of the nodes by ln of each given length with the mesh's corner size held, and last by ln of that size.

    Returns them, shape (lengths + 1, n, s, 2), and the derivatives of ln of the corner size by ln of each length, (lengths,):
    most lengths then move few elements, and the corner size, on which all depend, is dealt with once.
    """
    names, section = model.section.lengths, model.section
    steps = 1 + 1j * STEP * np.eye(len(names) + 1)
    moved = {name: getattr(section, name) * steps[k] for k, name in enumerate(names)}
    displaced = replace(section, **moved, mesh_size=section.corner_size * steps[-1])
    free = replace(section, **{name: lengths[:-1] for name, lengths in moved.items()})
    by_lengths = nodes(displaced, model.mesh, model.shapes.places).imag / STEP
    return by_lengths, free.corner_size.imag / STEP / section.corner_size


def _by_lengths(model: MeridianModel, whole: Floats, inside: Bools) -> tuple[Floats, Floats]:
    """Derivatives by ln of every length of the energies outside and inside a body, shape (lengths, m, m) each."""
    every, shares = velocities(model)
    fields, stresses = _fields(model, whole)
    out: list[list[Floats]] = []
    for velocity in every:
        motion = _motion(model.at, model.shapes, velocity)
        moving = np.any(velocity != 0, axis=(1, 2))
        halves = [_work(motion, fields, stresses, np.flatnonzero(moving & part)) for part in (~inside, inside)]
        out.append([half + half.T for half in halves])
    rest, within = (np.array(part[:-1]) + shares[:, None, None] * part[-1] for part in zip(*out, strict=True))
    return rest, within


def _fields(model: MeridianModel, whole: Floats) -> tuple[Floats, Floats]:
    """Displacement gradients of m fields at the q Gauss points, and what works on them, each of shape (n, 6, m, q).

    The former are u_r,r, u_r,z, u_z,r, u_z,z, u_r / r and D - P; the latter the stresses times w conjugate to the first five,
    with lambda P in place of lambda D, and lambda P w.
    """
    at, shapes, m = model.at, model.shapes, whole.shape[-1]
    slopes, hoop = gradients(at, shapes, whole.reshape(len(whole), 2, -1, m))
    dilation = slopes[0] + slopes[3] + hoop
    pressure = projected(at, shapes, dilation)
    two_mu, lam = ((at.weight * modulus[:, None])[:, None] for modulus in (model.two_mu, model.lam))
    fields = np.stack([array.transpose(0, 2, 1) for array in (*slopes, hoop, dilation - pressure)], axis=1)
    rr, rz, zr, zz, turn, _ = fields.transpose(1, 0, 2, 3)
    pushed, shear = lam * pressure.transpose(0, 2, 1), two_mu / 2 * (rz + zr)
    stresses = two_mu * rr + pushed, shear, shear, two_mu * zz + pushed, two_mu * turn + pushed, pushed
    return fields, np.stack(stresses, axis=1)


def _motion(at: Geometry, shapes: Shapes, velocity: Floats) -> Floats:
    """V_r,r, V_r,z, V_z,r, V_z,z and V_r / r at all points, shape (n, 5, q)."""
    along = [velocity[..., k] @ slope.T for k in (0, 1) for slope in shapes.tangents]  # dV_k / du, dV_k / dv
    slopes = [at.inverse[..., 0, j] * u + at.inverse[..., 1, j] * v for u, v in (along[:2], along[2:]) for j in (0, 1)]
    return np.stack([*slopes, (velocity[..., 0] @ shapes.geometry.T) / at.radius], axis=1)


def _work(motion: Floats, fields: Floats, stresses: Floats, chosen: Ints) -> Floats:
    """Half of the change of the chosen elements' energies when the points move, eqs. AX.5, AX.6: shape (m, m).

    lambda P works on tau (D - P / 2) in all; of this the five stresses give it tau D / 2, and the sixth the rest.
    """
    m = fields.shape[2]
    out = np.zeros((m, m))
    for low in range(0, len(chosen), BLOCK):
        block = chosen[low : low + BLOCK]
        moved = _moved(motion[block], fields[block])
        out += (stresses[block] @ moved.swapaxes(2, 3)).sum(axis=(0, 1))
    return out


def _moved(motion: Floats, fields: Floats) -> Floats:
    """What the stresses work on, of the shape of ``fields``."""
    rr, rz, zr, zz, turn = motion.transpose(1, 0, 2)[:, :, None]
    half = (rr + zz + turn) / 2  # tau / 2
    moved = np.empty_like(fields)
    for first in (0, 2):  # the slopes of u_r and of u_z
        by_r, by_z = fields[:, first], fields[:, first + 1]
        np.multiply(half - rr, by_r, out=moved[:, first])
        moved[:, first] -= zr * by_z
        np.multiply(half - zz, by_z, out=moved[:, first + 1])
        moved[:, first + 1] -= rz * by_r
    np.multiply(half - turn, fields[:, 4], out=moved[:, 4])
    np.multiply(half, fields[:, 5], out=moved[:, 5])
    return moved


def _by_materials(model: MeridianModel, whole: Floats, chosen: Ints) -> tuple[Floats, Floats]:
    """Derivatives by ln E and by nu of every body, (bodies, m, m) each; 2 mu = E / (1 + nu), lambda = 2 mu nu / (1 - 2 nu)."""
    moduli, ratios = [], []
    for body, material in model.materials.items():
        mine = chosen[model.mesh.body[chosen] == body]
        u, nu = whole[mine], material.poisson_ratio
        flat = u.reshape(-1, u.shape[-1])
        shear, volume = (flat.T @ (part @ u).reshape(flat.shape) for part in model.parts(mine))
        two_mu, lam = lame(material.youngs_modulus, nu)
        moduli.append(two_mu * shear + lam * volume)
        lam_by_nu = two_mu * (1 + 2 * nu**2) / ((1 + nu) * (1 - 2 * nu) ** 2)
        ratios.append(-two_mu / (1 + nu) * shear + lam_by_nu * volume)
    return np.array(moduli), np.array(ratios)
