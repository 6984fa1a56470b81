"""Linear laws: Hooke's law by its compliance, and elements that take any stiffness matrix."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from geometry.common.arrays import Floats
from geometry.tetra.tet_mesh import EDGE_CORNERS
from solver.materials.linear import VOIGT_PAIRS, Isotropic
from solver.solid.body_stiffness import integrate_part
from solver.solid.cached_mesh import compute_modulus_spread


@dataclass(frozen=True)
class TransverselyIsotropic:
    """Stiff along z: what a layer of fibres would be."""

    dilation_modulus: float

    def build_stiffness(self) -> Floats:
        """The inverse of the compliance of E = 1, E_z = 4, nu = 0.3, nu_zx = 0.4, G = 0.7."""
        compliance = np.diag([1.0, 1.0, 1 / 4.0, 1 / 0.7, 1 / 0.7, 2 * 1.3])
        compliance[[0, 1], [1, 0]] = -0.3
        compliance[[0, 1, 2, 2], [2, 2, 0, 1]] = -0.4 / 4
        return np.asarray(np.linalg.inv(compliance))


@pytest.mark.parametrize(("modulus", "poisson"), [(1.0, 0.0), (6e3, 0.45), (1e6, 0.4999)])
def test_the_stiffness_inverts_hookes_law(modulus: float, poisson: float) -> None:
    compliance = np.diag([1.0, 1.0, 1.0, *[2 * (1 + poisson)] * 3])
    compliance[:3, :3] -= poisson * (1 - np.eye(3))
    np.testing.assert_allclose(Isotropic(modulus, poisson).build_stiffness() @ compliance / modulus, np.eye(6), atol=1e-11)


def test_moduli_of_each_other() -> None:
    law = Isotropic(np.array([1.0, 6e3]), np.array([0.3, 0.499]))
    np.testing.assert_allclose(law.dilation_modulus + law.two_mu / 3, law.bulk_modulus, rtol=1e-13)
    np.testing.assert_allclose(2 * law.shear_modulus, law.two_mu, rtol=1e-15)
    ahead, behind = (Isotropic(1.0, 0.3 + h).dilation_modulus for h in (1e-6, -1e-6))
    assert Isotropic(1.0, 0.3).dilation_modulus_by_poisson == pytest.approx((ahead - behind) / 2e-6, rel=1e-8)


@pytest.mark.parametrize("averaged", [False, True])
@pytest.mark.parametrize("pressed", [0.0, 0.8])
def test_solid_elements_take_any_stiffness(averaged: bool, pressed: float) -> None:
    """Under uniform strain an element's energy is V eps:C:eps, whatever part of C its averaged dilation carries."""
    corners = np.array([[0.1, 0.0, 0.0], [1.2, 0.1, 0.0], [0.0, 0.9, 0.2], [0.2, 0.1, 1.1]])
    nodes = np.vstack([corners, corners[EDGE_CORNERS].mean(axis=1)])
    volume = np.linalg.det(corners[1:] - corners[0]) / 6
    gradient, law = np.random.default_rng(3).standard_normal((3, 3)), TransverselyIsotropic(pressed)
    u = (nodes @ gradient.T).reshape(-1, 1)
    forces = integrate_part(nodes, np.arange(10)[None], averaged).compute_forces(law, u)
    strain = np.array([gradient[i, i] if i == j else gradient[i, j] + gradient[j, i] for i, j in VOIGT_PAIRS])
    assert float((u.T @ forces).item()) == pytest.approx(volume * strain @ law.build_stiffness() @ strain, rel=1e-12)


def test_the_spread_of_moduli_is_that_of_bulk_and_shear() -> None:
    old, new = {0: Isotropic(1.0, 0.3), 1: Isotropic(1.0, 0.3)}, {0: Isotropic(1.0, 0.49), 1: Isotropic(5.0, 0.3)}
    bulk, shear = new[0].bulk_modulus / old[0].bulk_modulus, new[0].shear_modulus / old[0].shear_modulus
    assert compute_modulus_spread(old, new) == pytest.approx(max(bulk, 5.0) / shear, rel=1e-9)
