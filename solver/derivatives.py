"""Exact derivatives of discrete energies by every length, modulus and Poisson's ratio of a section.

Nodes are smooth functions of the lengths and polynomial coefficients stay put, so that with the nodes' velocity V,
L = grad V and tau = div V + V_r / r an energy a(u, v) = int w (2 mu eps:eps + lambda P_u P_v), w = 2 pi r dA, changes by

    grad u:  -grad u L,      u_r / r:  -(u_r / r) V_r / r,      w:  w tau                                            (G1)
    d int w P_u P_v = int w [dD_u P_v + P_u dD_v + tau (D_u P_v + P_u D_v - P_u P_v)],  D = div u, P its projection  (G2)

Base states minimise the energy, so that nothing else changes their forces: no adjoint solve is needed. Node
velocities are derivatives by complex steps of the map from lengths to nodes.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from geometry.grading import Floats
from geometry.meridian import nodes
from geometry.section import Body
from solver.base_states import Model
from solver.quadrilateral import Geometry, gradients, lame, projected
from solver.shapes import Shapes

STEP = 1e-30  # of the complex step, relative: nothing is subtracted, so that it can be this small
SHEAR = np.diag([1.0, 0.5, 0.5, 1.0, 1.0, 0.0])  # eps:eps of the strains below
SHEAR[1, 2] = SHEAR[2, 1] = 0.5
DILATION = np.array([1.0, 0.0, 0.0, 1.0, 1.0, 0.0])
PROJECTED = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0])


def variables(model: Model) -> tuple[str, ...]:
    """Names of what energies can be differentiated by: by ln of a length or modulus, and by a Poisson's ratio itself."""
    bodies = [body.name.lower() for body in model.materials]
    return (
        *model.section.given,
        *(f"{body}_youngs_modulus" for body in bodies),
        *(f"{body}_poisson_ratio" for body in bodies),
    )


def energy_derivatives(model: Model, whole: Floats, inside: Body) -> tuple[Floats, Floats]:
    """Return d(u_i^T K u_j) for all columns u_i of ``whole``, shape (n, 2 s, m), by all ``variables``.

    Two arrays of shape (variables, m, m): the part of all bodies but ``inside``, and its part.
    """
    mask = model.mesh.body == inside
    parts = []
    for chosen in (np.flatnonzero(~mask), np.flatnonzero(mask)):
        lengths = _by_lengths(model, whole, chosen)
        moduli, ratios = _by_materials(model, whole, chosen)
        parts.append(np.concatenate([lengths, moduli, ratios]))
    return parts[0], parts[1]


def velocities(model: Model) -> Floats:
    """Derivatives of all nodes by ln of each given length, shape (lengths, n, s, 2)."""
    given, section = model.section.given, model.section
    steps = np.eye(len(given)) * STEP
    moved = {name: getattr(section, name) * (1 + 1j * steps[k]) for k, name in enumerate(given)}
    return np.asarray(nodes(replace(section, **moved), model.mesh, model.shapes.places).imag / STEP)


def strains(at: Geometry, shapes: Shapes, whole: Floats) -> Floats:
    """u_r,r, u_r,z, u_z,r, u_z,z, u_r / r and the projected dilation at the Gauss points, shape (n, q, 6, m)."""
    n, s, m = len(whole), len(shapes.degrees), whole.shape[-1]
    u = whole.reshape(n, 2, s, m)
    by_r, by_z, hoop = gradients(at, shapes)
    out = np.empty((n, by_r.shape[1], 6, m))
    for k, (slope, component) in enumerate(((by_r, 0), (by_z, 0), (by_r, 1), (by_z, 1), (hoop, 0))):
        np.matmul(slope, u[:, component], out=out[:, :, k])
    out[:, :, 5] = projected(at, shapes, out[:, :, 0] + out[:, :, 3] + out[:, :, 4])
    return out


def _by_lengths(model: Model, whole: Floats, chosen: np.ndarray) -> Floats:
    at = Geometry(model.at.radius[chosen], model.at.weight[chosen], model.at.inverse[chosen])
    shapes, m = model.shapes, whole.shape[-1]
    found = strains(at, shapes, whole[chosen])
    flat = found.reshape(-1, m)
    out = []
    for velocity in velocities(model)[:, chosen]:
        form = _forms(at, shapes, velocity, model.two_mu[chosen], model.lam[chosen])
        out.append(flat.T @ (form @ found).reshape(-1, m))
    return np.array(out)


def _forms(at: Geometry, shapes: Shapes, velocity: Floats, two_mu: Floats, lam: Floats) -> Floats:
    """The quadratic forms of the strains whose sum is the energy's change, eqs. (G1), (G2); shape (n, q, 6, 6)."""
    along = np.stack([velocity.transpose(0, 2, 1) @ slope.T for slope in shapes.tangents], axis=-1)  # (n, 2, q, 2): dV / d(u, v)
    L = np.einsum("naqk,nqkj->nqaj", along, at.inverse)
    turn = (velocity[..., 0] @ shapes.geometry.T) / at.radius
    tau = (L[..., 0, 0] + L[..., 1, 1] + turn)[..., None, None]
    B = np.zeros((*turn.shape, 6, 6))
    B[..., 0:2, 0:2] = B[..., 2:4, 2:4] = L.swapaxes(-1, -2)
    B[..., 4, 4] = turn
    shear = -SHEAR @ B
    volume = -np.einsum("...k,j->...kj", DILATION @ B, PROJECTED)
    both = np.outer(DILATION, PROJECTED)
    shear = shear + shear.swapaxes(-1, -2) + tau * SHEAR
    volume = volume + volume.swapaxes(-1, -2) + tau * (both + both.T - np.outer(PROJECTED, PROJECTED))
    return np.asarray(at.weight[..., None, None] * (two_mu[:, None, None, None] * shear + lam[:, None, None, None] * volume))


def _by_materials(model: Model, whole: Floats, chosen: np.ndarray) -> tuple[Floats, Floats]:
    """Derivatives by ln E and by nu of every body, (bodies, m, m) each; 2 mu = E / (1 + nu), lambda = 2 mu nu / (1 - 2 nu)."""
    moduli, ratios = [], []
    for body, material in model.materials.items():
        mine = chosen[model.mesh.body[chosen] == body]
        u, nu = whole[mine], material.poisson_ratio
        flat = u.reshape(-1, u.shape[-1])
        shear, volume = (flat.T @ (part[mine] @ u).reshape(flat.shape) for part in (model.shear, model.volume))
        two_mu, lam = lame(material.youngs_modulus, nu)
        moduli.append(two_mu * shear + lam * volume)
        lam_by_nu = two_mu * (1 + 2 * nu**2) / ((1 + nu) * (1 - 2 * nu) ** 2)
        ratios.append(-two_mu / (1 + nu) * shear + lam_by_nu * volume)
    return np.array(moduli), np.array(ratios)
