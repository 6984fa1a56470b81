"""The meridian model's equations with complex moduli, solved as they stand: what phases are checked against."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from geometry import Scene
from geometry.meridian.mesh_lines import MeridianFineness
from geometry.meridian.section import Body
from geometry.scenes.variables import find_film_part, list_bonds
from solver.axisymmetric.base_states import build_model
from solver.axisymmetric.sections import add_details, build_sections
from solver.elements.quadrilateral import Blocks, integrate_matrices


def complex_ratio(scene: Scene, fineness: MeridianFineness, frequency: float = 0.0, density: float = 0.0) -> complex:
    """The ratio that the scene reads, with every modulus E (1 + j tan delta).

    The real mesh's matrices, assembled anew, and scipy's sparse LU.

    K is complex symmetric; forces and charges are bilinear in the states, without conjugation. With a frequency (Hz) and a
    density (kg/m^3, of all bodies) K is less (2 pi f)^2 M, and the base is shaken as a whole.
    """
    scene_sections = add_details(scene, build_sections(scene))
    actuators = scene.probe.film.by_block if scene.observable == "charge" and scene.probe.film else None
    real = build_model(
        scene_sections.section,
        dict(scene_sections.materials),
        scene.contact.interface,
        fineness,
        films=actuators,  # type: ignore[arg-type]
    )
    losses = np.zeros(len(Body))
    for body, material in scene_sections.materials.items():
        losses[body] = material.loss_factor
    for name, bond in list_bonds(scene).items():
        part, blocks = find_film_part(scene.probe.film, f"{name}.loss_factor")
        losses[[Body[f"{block}_{part}".upper()] for block in blocks]] = bond.loss_factor
    turn = 1 + 1j * losses[real.mesh.body]
    n, s = len(turn), len(real.shapes.degrees)
    shear, volume = (matrix.reshape(n, 2 * s, 2 * s) for matrix in integrate_matrices(real.geometry, real.shapes))
    whole = (real.law.two_mu * turn)[:, None, None] * shear + (real.law.dilation_modulus * turn)[:, None, None] * volume
    mass = density * np.einsum("nq,qs,qt->nst", real.geometry.weight, real.shapes.value, real.shapes.value)
    whole = whole - (2 * np.pi * frequency) ** 2 * np.einsum("cd,nst->ncsdt", np.eye(2), mass).reshape(whole.shape)
    parts = Blocks.from_matrices(whole.reshape(n, 2, s, 2, s), real.shapes.skeleton)
    stiffness = parts.outside - parts.across.transpose(0, 2, 1) @ np.linalg.solve(parts.inside, parts.across)
    gather, lift = real.system.numbering.gather, real.lift
    size = stiffness.shape[1]
    blocks = sparse.bsr_matrix((stiffness, np.arange(n), np.arange(n + 1)), shape=(n * size, n * size))
    pushed = np.broadcast_to(lift, (n, size, lift.shape[2])).reshape(n * size, -1)
    inner = splu((gather.T @ blocks @ gather).tocsc())
    states = gather @ inner.solve(-(gather.T @ (blocks @ pushed))) + pushed
    totals = (states.T @ (blocks @ states[:, :2])).sum(axis=1)[-2:]  # the charges come last
    return complex(totals[0] / totals[1] * scene.probe.outer_area / scene.probe.inner_area)
