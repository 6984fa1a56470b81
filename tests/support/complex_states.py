"""The meridian model's equations with complex moduli, solved as they stand: what phases are checked against."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from geometry import Scene
from geometry.meridian.mesh_lines import MeridianFineness
from geometry.meridian.section import Body
from solver.axisymmetric.base_states import build_model
from solver.axisymmetric.sections import add_details, build_sections
from solver.elements.quadrilateral import Blocks, integrate_matrices


def complex_ratio(scene: Scene, fineness: MeridianFineness, frequency: float = 0.0, density: float = 0.0) -> complex:
    """The ratio with every modulus E (1 + j tan delta): the real mesh's matrices, assembled anew, and scipy's sparse LU.

    K is complex symmetric; the films' forces are bilinear in the states, without conjugation. With a frequency (Hz) and a
    density (kg/m^3, of all bodies) K is less (2 pi f)^2 M, and the base is shaken as a whole.
    """
    scene_sections = add_details(scene, build_sections(scene))
    real = build_model(scene_sections.section, dict(scene_sections.materials), scene.contact.interface, fineness)  # type: ignore[arg-type]
    losses = np.zeros(len(Body))
    for body, material in scene_sections.materials.items():
        losses[body] = material.loss_factor
    turn = 1 + 1j * losses[real.mesh.body]
    n, s = len(turn), len(real.shapes.degrees)
    shear, volume = (matrix.reshape(n, 2 * s, 2 * s) for matrix in integrate_matrices(real.geometry, real.shapes))
    whole = (real.law.two_mu * turn)[:, None, None] * shear + (real.law.dilation_modulus * turn)[:, None, None] * volume
    mass = density * np.einsum("nq,qs,qt->nst", real.geometry.weight, real.shapes.value, real.shapes.value)
    whole = whole - (2 * np.pi * frequency) ** 2 * np.einsum("cd,nst->ncsdt", np.eye(2), mass).reshape(whole.shape)
    parts = Blocks.from_matrices(whole.reshape(n, 2, s, 2, s), real.shapes.skeleton)
    stiffness = parts.outside - parts.across.transpose(0, 2, 1) @ np.linalg.solve(parts.inside, parts.across)
    gather, lift = real.system.numbering.gather, real.system.numbering.lift
    size = stiffness.shape[1]
    blocks = sparse.bsr_matrix((stiffness, np.arange(n), np.arange(n + 1)), shape=(n * size, n * size))
    pushed = np.broadcast_to(lift, (n, size, 2)).reshape(n * size, 2)
    inner = splu((gather.T @ blocks @ gather).tocsc())
    states = gather @ inner.solve(-(gather.T @ (blocks @ pushed))) + pushed
    totals = (states.T @ (blocks @ states)).sum(axis=1)
    return complex(totals[0] / totals[1] * scene.probe.outer_area / scene.probe.inner_area)
