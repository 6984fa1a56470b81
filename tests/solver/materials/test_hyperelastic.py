"""The law of materials at finite strain: a closed form, derivatives, the small-strain limit."""

import numpy as np
import pytest
from scipy.optimize import brentq

from solver.materials.hyperelastic import Hyperelastic, Stress, compute_volume_change
from solver.materials.linear import Isotropic
from solver.materials.strain_energies import Yeoh

RNG = np.random.default_rng(5)


def material(poisson_ratio: float, yeoh: tuple[float, float] = (0.0, 0.0)) -> Hyperelastic:
    laws = ((np.array([0]), Yeoh(*yeoh)),) if any(yeoh) else ()
    return Hyperelastic.from_moduli(Isotropic(np.array([1.0]), np.array([poisson_ratio])), laws)


def pressure(law: Hyperelastic, change: float) -> float:
    """p of eq. LW.3 at a change of volume."""
    return float(law.lam[0] / 2 * (1 + change - 1 / (1 + change)))


def stresses(law: Hyperelastic, across: float, stretch: float) -> np.ndarray:
    """Nominal stresses of a cylinder stretched so much."""
    stress = law.compute_stress(np.array([across - 1, 0.0, 0.0, stretch - 1, across - 1])[:, None, None])
    return np.asarray(stress.first_piola + pressure(law, float(stress.change[0, 0])) * stress.cofactor)[:, 0, 0]


def tangent(law: Hyperelastic, stress: Stress, held: float) -> np.ndarray:
    """Of the stress at a pressure that is held, as ``Stress`` says; d2J/dh2 by differences, which are exact."""
    cof, half, x = (part[:, 0, 0] for part in (stress.cofactor, stress.cofactor_coefficient, stress.distortion))
    h = stress.F - np.array([1.0, 0.0, 0.0, 1.0, 1.0])[:, None, None]
    steps = np.eye(5)[..., None, None]
    twice = [
        (law.compute_stress(h + step).cofactor - law.compute_stress(h - step).cofactor)[:, 0, 0] / 2 for step in 1e-2 * steps
    ]
    A = float(stress.identity_coefficient[0, 0]) * np.eye(5) + np.outer(cof, half) + np.outer(half, cof)
    bend = 0.0 if stress.bend is None else float(stress.bend[0, 0])
    return A + (float(stress.hessian_coefficient[0, 0]) + held) * 1e2 * np.array(twice) + bend * np.outer(x, x)


@pytest.mark.parametrize(("poisson_ratio", "force"), [(0.45, 3.679574008), (0.4999, 3.665232132)])
def test_lubricated_cylinder_at_half_its_height(poisson_ratio: float, force: float) -> None:
    """Radius 1, Young's modulus 1, free sides: values of the axial equilibrium in closed form, from two codes."""
    law = material(poisson_ratio)
    across = brentq(lambda x: stresses(law, x, 0.5)[0], 1.0, 2.0, xtol=1e-15)
    assert -np.pi * stresses(law, across, 0.5)[3] == pytest.approx(force, rel=2e-10)


@pytest.mark.parametrize("yeoh", [(0.0, 0.0), (-0.06, 0.004)])
@pytest.mark.parametrize("poisson_ratio", [0.0, 0.3, 0.4999])
def test_stress_is_the_energy_s_derivative_and_the_tangent_the_stress_s(poisson_ratio: float, yeoh: tuple[float, float]) -> None:
    law, step = material(poisson_ratio, yeoh), 1e-6
    h = 0.3 * RNG.standard_normal(5)[:, None, None]
    stress_state = law.compute_stress(h)
    assert compute_volume_change(h)[0, 0] > -0.9
    p = pressure(law, float(stress_state.change[0, 0]))
    A, held = tangent(law, stress_state, p), np.array([[p]])
    for k in range(5):
        ahead, behind = (h + sign * step * np.eye(5)[k][:, None, None] for sign in (1, -1))
        derivative = float(law.compute_energy_density(ahead, held)[0, 0] - law.compute_energy_density(behind, held)[0, 0]) / (
            2 * step
        )
        assert derivative == pytest.approx(
            float(stress_state.first_piola[k, 0, 0] + p * stress_state.cofactor[k, 0, 0]), rel=1e-6, abs=1e-8
        )
        ends = [
            end_stress.first_piola + p * end_stress.cofactor
            for end_stress in (law.compute_stress(ahead), law.compute_stress(behind))
        ]
        np.testing.assert_allclose((ends[0] - ends[1])[:, 0, 0] / (2 * step), A[k], rtol=1e-6, atol=1e-8)


def test_the_pressure_s_conjugate_inverts_the_volume_s_energy() -> None:
    law, change = material(0.49), 0.37
    p = np.array([[pressure(law, change)]])
    value, derivative = law.compute_dilation(p)
    assert float(value[0, 0]) == pytest.approx(change, rel=1e-12)
    ahead, behind = (law.compute_dilation(p + sign * 1e-5)[0] for sign in (1, -1))
    assert float((ahead - behind)[0, 0]) / 2e-5 == pytest.approx(float(derivative[0, 0]), rel=1e-7)


@pytest.mark.parametrize("poisson_ratio", [-0.2, 0.0, 0.3, 0.4999])
def test_small_strains_obey_hooke(poisson_ratio: float) -> None:
    law, E = material(poisson_ratio), 1.0
    strain = 1e-7 * np.array([1.0, 0.4, 0.4, -0.7, 0.2])
    at_rest = law.compute_stress(np.zeros((5, 1, 1)))
    cof = at_rest.cofactor[:, 0, 0]
    whole = tangent(law, at_rest, 0.0) + law.lam[0] * np.outer(cof, cof)
    lam = E * poisson_ratio / ((1 + poisson_ratio) * (1 - 2 * poisson_ratio))
    hooke = lam * strain[[0, 3, 4]].sum() * np.array([1, 0, 0, 1, 1]) + E / (1 + poisson_ratio) * strain
    np.testing.assert_allclose(whole @ strain, hooke, rtol=1e-9, atol=1e-18)
