"""Exact derivatives of discrete energies by every length, modulus and Poisson's ratio of a section.

Nodes are smooth functions of the lengths and polynomial coefficients stay put, so that with the nodes' velocity V,
L = grad V and tau = div V + V_r / r an energy a(u, v) = int w (2 mu eps:eps + lambda P_u P_v), w = 2 pi r dA, changes by

    grad u:  -grad u L,      u_r / r:  -(u_r / r) V_r / r,      w:  w tau                                            (G1)
    d int w P_u P_v = int w [dD_u P_v + P_u dD_v + tau (D_u P_v + P_u D_v - P_u P_v)],  D = div u, P its projection  (G2)

Base states minimise the energy, so that nothing else changes their forces: no adjoint solve is needed. Node
velocities are derivatives by complex steps of the map from lengths to nodes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from geometry.grading import Floats
from geometry.meridian import nodes
from geometry.section import Body
from solver.base_states import Model
from solver.numbering import Ints
from solver.quadrilateral import Geometry, gradients, lame, projected
from solver.shapes import Shapes

STEP = 1e-30  # of the complex step, relative: nothing is subtracted, so that it can be this small


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


def velocities(model: Model, chosen: Ints) -> Floats:
    """Derivatives of the chosen elements' nodes by ln of each given length, shape (lengths, elements, s, 2)."""
    given, section = model.section.given, model.section
    steps = np.eye(len(given)) * STEP
    moved = {name: getattr(section, name) * (1 + 1j * steps[k]) for k, name in enumerate(given)}
    return np.asarray(nodes(replace(section, **moved), model.mesh, model.shapes.places, chosen).imag / STEP)


@dataclass(frozen=True)
class _Fields:
    """Displacement gradients of m fields at the Gauss points, and what works on them; (n, q, m) each.

    Attributes:
        slopes: u_r,r, u_r,z, u_z,r, u_z,z.
        hoop: u_r / r.
        dilation, pressure: D = div u and its projection P.
        stresses: conjugate to the slopes and to the hoop strain, with lambda P in place of lambda D, times w.
    """

    slopes: tuple[Floats, ...]
    hoop: Floats
    dilation: Floats
    pressure: Floats
    stresses: tuple[Floats, ...]


def _fields(model: Model, whole: Floats, chosen: Ints) -> _Fields:
    at, shapes, m = model.at.of(chosen), model.shapes, whole.shape[-1]
    u = whole[chosen].reshape(len(chosen), 2, -1, m)
    slopes, hoop = gradients(at, shapes, u)
    rr, rz, zr, zz = slopes
    dilation = rr + zz + hoop
    pressure = projected(at, shapes, dilation)
    two_mu, lam = (at.weight[..., None] * modulus[chosen, None, None] for modulus in (model.two_mu, model.lam))
    shear, pushed = two_mu / 2 * (rz + zr), lam * pressure
    stresses = two_mu * rr + pushed, shear, shear, two_mu * zz + pushed, two_mu * hoop + pushed
    return _Fields(slopes, hoop, dilation, pressure, (*stresses, pushed))


def _by_lengths(model: Model, whole: Floats, chosen: Ints) -> Floats:
    """Derivatives by ln of every length, shape (lengths, m, m)."""
    at, found = model.at.of(chosen), _fields(model, whole, chosen)
    stresses = np.concatenate([stress.reshape(-1, whole.shape[-1]) for stress in found.stresses], axis=0)
    out = []
    for velocity in velocities(model, chosen):
        half = stresses.T @ np.concatenate(_moved(at, model.shapes, velocity, found))
        out.append(half + half.T)
    return np.array(out)


def _moved(at: Geometry, shapes: Shapes, velocity: Floats, found: _Fields) -> list[Floats]:
    """What each stress works on when the nodes move: half the energy's change, eqs. (G1), (G2); six arrays (n q, m)."""
    along = [velocity[..., k] @ slope.T for k in (0, 1) for slope in shapes.tangents]  # dV_k / du, dV_k / dv
    (Vrr, Vrz), (Vzr, Vzz) = (
        [at.inverse[..., 0, j] * u + at.inverse[..., 1, j] * v for j in (0, 1)] for u, v in (along[:2], along[2:])
    )
    turn = (velocity[..., 0] @ shapes.geometry.T) / at.radius
    half = (Vrr + Vzz + turn)[..., None] / 2  # tau / 2
    rr, rz, zr, zz, turn = (x[..., None] for x in (Vrr, Vrz, Vzr, Vzz, turn))
    (ur, uz, wr, wz), hoop = found.slopes, found.hoop
    moved = [
        (half - rr) * ur - zr * uz,
        (half - zz) * uz - rz * ur,
        (half - rr) * wr - zr * wz,
        (half - zz) * wz - rz * wr,
        (half - turn) * hoop,
        # lambda P works on tau (D - P / 2) where the five stresses give it tau D / 2
        half * (found.dilation - found.pressure),
    ]
    return [x.reshape(-1, x.shape[-1]) for x in moved]


def _by_materials(model: Model, whole: Floats, chosen: Ints) -> tuple[Floats, Floats]:
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
