"""Elements' tangents: derivatives of their forces, and the linear level's matrices at rest."""

from __future__ import annotations

import numpy as np
import pytest

from geometry.meridian.mesh import compute_nodes
from solver.axisymmetric.sections import build_sections
from solver.contact.elements import Elements, ElementValues
from solver.contact.model import ContactModel
from solver.elements.quadrilateral import compute_geometry, integrate_matrices
from solver.elements.shape_functions import build_shapes
from solver.materials.hyperelastic import Hyperelastic
from solver.materials.linear import Isotropic
from solver.materials.strain_energies import Yeoh
from tests.support.load_paths import COARSE, scene_of

STEP = 1e-6
OF = build_sections(scene_of("example"))
MODEL = ContactModel.from_section(OF.section, OF.materials, "bonded", COARSE)
AT = compute_geometry(compute_nodes(OF.section, MODEL.mesh, build_shapes(COARSE.order).places), build_shapes(COARSE.order))


def elements(yeoh: tuple[float, float] = (0.0, 0.0)) -> Elements:
    """All of a section, of one material."""
    n = len(AT.weight)
    law = Hyperelastic.from_moduli(Isotropic(np.ones(n), np.full(n, 0.45)), ((np.arange(0, n, 2), Yeoh(*yeoh)),))
    return Elements.from_geometry(AT, build_shapes(COARSE.order), law)


def deformed(body_elements: Elements, rng: np.random.Generator) -> ElementValues:
    """A state that is out of balance everywhere."""
    at_rest = body_elements.build_rest_values()
    return ElementValues(0.2 * change(body_elements, rng), 0.1 * rng.standard_normal(at_rest.p.shape))


def change(body_elements: Elements, rng: np.random.Generator) -> np.ndarray:
    """Displacements with gradients of 1 at most in each element."""
    u = rng.standard_normal(body_elements.build_rest_values().u.shape)
    return np.asarray(u / np.abs(body_elements.square.compute_gradients(u)).max(axis=(0, 2))[:, None])


@pytest.mark.parametrize("yeoh", [(0.0, 0.0), (-0.06, 0.004)])
def test_the_tangent_is_the_derivative_of_the_condensed_forces(yeoh: tuple[float, float]) -> None:
    """Inside and pressures follow a change of corners and edges, so that the forces on these change by the stiffness."""
    body_elements, rng = elements(yeoh), np.random.default_rng(2)
    state = deformed(body_elements, rng)
    balance, stiffness, derivatives = body_elements.linearise(state)
    for _ in range(20):  # balance the inside, whose forces the elimination of another state would weigh differently
        state = body_elements.move(state, derivatives, np.zeros(stiffness.shape[:2]), balance)
        balance, stiffness, derivatives = body_elements.linearise(state)
    m = body_elements.shapes.skeleton
    edge = change(body_elements, rng).reshape(len(AT.weight), 2, -1)[:, :, :m].reshape(len(AT.weight), -1)
    ahead, behind = (
        body_elements.linearise(body_elements.move(state, derivatives, sign * STEP * edge))[0].forces for sign in (1, -1)
    )
    expected = (stiffness @ edge[..., None])[..., 0]
    np.testing.assert_allclose((ahead - behind) / (2 * STEP), expected, atol=1e-6 * np.abs(expected).max())


def test_energy_s_derivative_is_the_force() -> None:
    body_elements, rng = elements(), np.random.default_rng(4)
    state = deformed(body_elements, rng)
    step = STEP * change(body_elements, rng)
    ahead, behind = (body_elements.compute_energy(ElementValues(state.u + sign * step, state.p)) for sign in (1, -1))
    internal = body_elements.linearise(state)[0].internal
    assert (ahead - behind) / 2 == pytest.approx(float((internal * step).sum()), rel=1e-6)


def test_at_rest_stiffness_is_that_of_linear_elements() -> None:
    """By the energy of what edges move and the inside follows."""
    body_elements, functions = elements(), build_shapes(COARSE.order)
    _, stiffness, derivatives = body_elements.linearise(body_elements.build_rest_values())
    edge = np.random.default_rng(6).standard_normal(stiffness.shape[:2])
    u = body_elements.move(body_elements.build_rest_values(), derivatives, edge).u
    law = Isotropic(1.0, 0.45)
    shear, volume = (matrix.reshape(len(u), u.shape[1], -1) for matrix in integrate_matrices(AT, functions))
    energy = (u[:, None] @ (law.two_mu * shear + law.dilation_modulus * volume) @ u[..., None])[:, 0, 0]
    np.testing.assert_allclose((edge[:, None] @ stiffness @ edge[..., None])[:, 0, 0], energy, rtol=1e-9)
