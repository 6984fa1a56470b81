"""Elements' tangents: derivatives of their forces, and the linear level's matrices at rest."""

from __future__ import annotations

import numpy as np
import pytest

from geometry.meridian.mesh import nodes
from solver.axisymmetric.sections import sections
from solver.contact.elements import Elements, ElementValues
from solver.contact.hyperelasticity import Hyperelastic
from solver.contact.model import ContactModel
from solver.elements.quadrilateral import geometry, lame, matrices
from solver.elements.shape_functions import shapes
from tests.support.load_paths import COARSE, scene_of

STEP = 1e-6
OF = sections(scene_of("example"))
MODEL = ContactModel.of(OF.section, OF.materials, "bonded", COARSE)
AT = geometry(nodes(OF.section, MODEL.mesh, shapes(COARSE.order).places), shapes(COARSE.order))


def elements(yeoh: tuple[float, float] = (0.0, 0.0)) -> Elements:
    """All of a section, of one material."""
    n = len(AT.weight)
    law = Hyperelastic.of(np.ones(n), np.full(n, 0.45), np.repeat(np.array(yeoh)[:, None], n, axis=1))
    return Elements.of(AT, shapes(COARSE.order), law)


def deformed(those: Elements, rng: np.random.Generator) -> ElementValues:
    """A state that is out of balance everywhere."""
    rest = those.at_rest()
    return ElementValues(0.2 * change(those, rng), 0.1 * rng.standard_normal(rest.p.shape))


def change(those: Elements, rng: np.random.Generator) -> np.ndarray:
    """Displacements with gradients of 1 at most in each element."""
    u = rng.standard_normal(those.at_rest().u.shape)
    return np.asarray(u / np.abs(those.square.gradients(u)).max(axis=(0, 2))[:, None])


@pytest.mark.parametrize("yeoh", [(0.0, 0.0), (-0.03, 0.002)])
def test_the_tangent_is_the_derivative_of_the_condensed_forces(yeoh: tuple[float, float]) -> None:
    """Inside and pressures follow a change of corners and edges, so that the forces on these change by the stiffness."""
    those, rng = elements(yeoh), np.random.default_rng(2)
    state = deformed(those, rng)
    _, stiffness, by = those.tangent(state)
    m = those.shapes.skeleton
    edge = change(those, rng).reshape(len(AT.weight), 2, -1)[:, :, :m].reshape(len(AT.weight), -1)
    ahead, behind = (those.balance(those.moved(state, by, sign * STEP * edge), by).forces for sign in (1, -1))
    expected = (stiffness @ edge[..., None])[..., 0]
    np.testing.assert_allclose((ahead - behind) / (2 * STEP), expected, atol=1e-6 * np.abs(expected).max())


def test_energy_s_derivative_is_the_force() -> None:
    those, rng = elements(), np.random.default_rng(4)
    state = deformed(those, rng)
    step = STEP * change(those, rng)
    ahead, behind = (those.energy(ElementValues(state.u + sign * step, state.p)) for sign in (1, -1))
    internal = those.tangent(state)[0].internal
    assert (ahead - behind) / 2 == pytest.approx(float((internal * step).sum()), rel=1e-6)


def test_at_rest_stiffness_is_that_of_linear_elements() -> None:
    """By the energy of what edges move and the inside follows."""
    those, functions = elements(), shapes(COARSE.order)
    _, stiffness, by = those.tangent(those.at_rest())
    edge = np.random.default_rng(6).standard_normal(stiffness.shape[:2])
    u = those.moved(those.at_rest(), by, edge).u
    two_mu, lam = lame(1.0, 0.45)
    shear, volume = (matrix.reshape(len(u), u.shape[1], -1) for matrix in matrices(AT, functions))
    energy = (u[:, None] @ (two_mu * shear + lam * volume) @ u[..., None])[:, 0, 0]
    np.testing.assert_allclose((edge[:, None] @ stiffness @ edge[..., None])[:, 0, 0], energy, rtol=1e-9)
