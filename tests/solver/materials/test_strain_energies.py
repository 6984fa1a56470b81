"""Yeoh's law: closed forms of stretched and sheared bodies, automatic derivatives, and where the law stops being stable."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np
import pytest

from geometry.scenes.probe import Material
from solver.materials.hyperelastic import RR, RZ, ZZ, Hyperelastic, compute_cofactor, compute_volume_change
from solver.materials.strain_energies import StableRange, Yeoh, build_strain_energy

SHEAR, C2, C3 = 2e3, 0.4, -0.03  # Pa, and over C1
C = SHEAR / 2 * np.array([1.0, C2, C3])  # C1, C2, C3, Pa


def law_of(c2: float = C2, c3: float = C3, poisson_ratio: float = 0.49) -> Hyperelastic:
    modulus = 2 * (1 + poisson_ratio) * SHEAR
    material = Material(youngs_modulus=modulus, poisson_ratio=poisson_ratio, law="yeoh", c2_over_c1=c2, c3_over_c1=c3)
    return Hyperelastic.from_materials([material])


def stress(law: Hyperelastic, rr: float, rz: float, zz: float, tt: float) -> np.ndarray:
    """First Piola-Kirchhoff stress without the pressure's share, which does not matter where the volume stays."""
    h = np.array([rr - 1, rz, 0.0, zz - 1, tt - 1])[:, None, None]
    assert compute_volume_change(h)[0, 0] == pytest.approx(0, abs=1e-14)
    return np.asarray(law.compute_stress(h).first_piola[:, 0, 0])


def derivative(first_invariant: float) -> float:
    """dW/dI1 = C1 + 2 C2 (I1 - 3) + 3 C3 (I1 - 3)^2."""
    x = first_invariant - 3
    return float(C @ [1, 2 * x, 3 * x**2])


@pytest.mark.parametrize("s", [0.5, 0.9, 1.3, 2.0])
def test_a_body_pulled_one_way(s: float) -> None:
    """Nominal stress 2 (s - 1/s^2) dW/dI1, the sides being free (Yeoh 1993)."""
    P = stress(law_of(), s**-0.5, 0.0, s, s**-0.5)
    free = P[ZZ] - P[RR] * s**-0.5 / s  # what is left after the pressure that frees the sides
    assert free == pytest.approx(2 * (s - s**-2) * derivative(s**2 + 2 / s), rel=1e-12)


@pytest.mark.parametrize("s", [0.7, 1.2, 1.6])
def test_a_body_pulled_two_ways(s: float) -> None:
    """Nominal stress 2 (s - 1/s^5) dW/dI1."""
    P = stress(law_of(), s, 0.0, s**-2, s)
    assert P[RR] - P[ZZ] * s**-2 / s == pytest.approx(2 * (s - s**-5) * derivative(2 * s**2 + s**-4), rel=1e-12)


@pytest.mark.parametrize("k", [0.1, 0.8, 1.5])
def test_a_sheared_body(k: float) -> None:
    """Shear stress 2 k dW/dI1, I1 = 3 + k^2."""
    assert stress(law_of(), 1.0, k, 1.0, 1.0)[RZ] == pytest.approx(2 * k * derivative(3 + k**2), rel=1e-12)


def test_stress_and_tangent_are_automatic_derivatives_of_the_energy() -> None:
    """The law as a formula of F, differentiated by casadi, at a pressure that is held."""
    law, p = law_of(poisson_ratio=0.3), 150.0
    F = ca.SX.sym("F", 5)
    J = (F[0] * F[3] - F[1] * F[2]) * F[4]
    over = J ** (-2 / 3) * ca.sumsqr(F) - 3
    W = C[0] * over + C[1] * over**2 + C[2] * over**3 + float(law.bulk[0]) / 4 * (J**2 - 1 - 2 * ca.log(J)) + p * J
    energy = ca.Function("W", [F], [ca.gradient(W, F), ca.hessian(W, F)[0]])
    h = 0.25 * np.random.default_rng(8).standard_normal(5)[:, None, None]
    state = law.compute_stress(h)
    cof = state.cofactor[:, 0, 0]
    first, second = (np.array(part) for part in energy(h[:, 0, 0] + [1, 0, 0, 1, 1]))
    np.testing.assert_allclose(state.first_piola[:, 0, 0] + p * cof, first[:, 0], rtol=1e-10)
    half, curve = state.cofactor_coefficient[:, 0, 0], np.zeros((5, 5))
    for k, unit in enumerate(np.eye(5)[..., None, None]):
        curve[k] = (compute_cofactor(state.F + unit) - compute_cofactor(state.F - unit))[:, 0, 0] / 2
    tangent = float(state.identity_coefficient[0, 0]) * np.eye(5) + np.outer(cof, half) + np.outer(half, cof)
    tangent += (float(state.hessian_coefficient[0, 0]) + p) * curve
    assert state.bend is not None
    x = state.distortion[:, 0, 0]
    tangent += float(state.bend[0, 0]) * np.outer(x, x)
    np.testing.assert_allclose(tangent, second, rtol=1e-9, atol=1e-9 * np.abs(second).max())


def test_without_constants_it_is_neo_hookean() -> None:
    material = Material(youngs_modulus=6e3, poisson_ratio=0.45, law="yeoh")
    assert build_strain_energy(material) is None
    x = np.linspace(0, 3, 7)
    np.testing.assert_array_equal(Yeoh(0.0, 0.0).evaluate(x), (x / 2, np.full(7, 0.5), np.zeros(7)))


MODES: dict[str, tuple[Callable[[np.ndarray], np.ndarray], Callable[[np.ndarray], np.ndarray]]] = {
    "one way": (lambda s: s**2 + 2 / s, lambda s: s - s**-2),
    "two ways": (lambda s: 2 * s**2 + s**-4, lambda s: s - s**-5),
    "one plane": (lambda s: s**2 + s**-2 + 1, lambda s: s - s**-3),
}


@pytest.mark.parametrize(("c2", "c3"), [(-0.1, 0.0), (0.0, -0.01), (-0.2, 0.015), (2.0, -0.5)])
def test_a_law_is_stable_up_to_the_first_stress_that_no_longer_rises(c2: float, c3: float) -> None:
    first = []
    for invariant, factor in MODES.values():
        for s in (np.linspace(1, 8, 70001), np.geomspace(1, 0.1, 70001)):
            x = invariant(s) - 3
            nominal = np.abs(factor(s) * (1 + 2 * c2 * x + 3 * c3 * x**2))
            falls = np.flatnonzero(np.diff(nominal) < 0)
            first += [x[falls[0]]] if falls.size else []
    assert StableRange.from_law(Yeoh(c2, c3)).x == pytest.approx(min(first), rel=2e-2)


@pytest.mark.parametrize(("c2", "c3"), [(0.0, 0.0), (3.0, 0.2), (-0.1, 0.02)])
def test_a_law_that_stiffens_is_stable_throughout(c2: float, c3: float) -> None:
    assert StableRange.from_law(Yeoh(c2, c3)).x == np.inf
