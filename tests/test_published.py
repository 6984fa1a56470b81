"""The paper's equations against the figures that follow from them by hand (PHYSICS section 1)."""

from __future__ import annotations

import pytest
from scenes import named

from geometry import InputError, Refusal
from solver import evaluate, published

# E_object = 1e5 Pa, nu = 0.4, d = 10 mm, D = 8 mm, a = 5.72 mm, in a 1000 Pa matrix
CASE = {"a": 5.72e-3, "d": 10e-3, "D": 8e-3, "nu": 0.4}


def test_equation_7_makes_a_rigid_tumour_soften_the_tissue() -> None:
    assert published.modulus_from_compatibility(**CASE, E_matrix=1e3, E_object=1e5) == pytest.approx(742, abs=0.6)


def test_equation_7_does_not_vanish_for_matrix_stiffness() -> None:
    assert published.modulus_from_compatibility(**CASE, E_matrix=1e3, E_object=1e3) == pytest.approx(571, abs=0.6)


def test_equation_8_as_printed() -> None:
    assert published.modulus_printed(**CASE, E_matrix=1e3, E_object=1e5) == pytest.approx(1725, abs=0.6)


def test_equations_1_to_6_by_hand() -> None:
    # sigma = 2, a = 1, d = 3, D = 0.5, nu = 0, E_matrix = 4, E_object = 8
    assert published.stress_at_depth(2, 1, 1) == 3  # 1.50 sigma at d = a
    assert published.stress_at_depth(2, 1, 3) == pytest.approx(1 / 3)
    assert published.displacement_matrix(2, 1, 0, 4) == 1
    assert published.displacement_object(2, 1, 3, 0.5, 8) == pytest.approx(1 / 48)
    assert published.displacement_below(2, 1, 3, 0.5, 0, 4) == pytest.approx(1 / 24)
    assert published.displacement_equivalent(2, 1, 0, 4) == 1
    assert published.displacement_total(2, 1, 3, 0.5, 0, 4, 8) == pytest.approx(1 + 1 / 48 + 1 / 24)


def test_equations_9_to_11_give_a_homogeneous_block_a_third() -> None:
    shortenings = published.layer_shortenings(2.0, 0.01, 0.4, 0.4, 1e3)
    assert published.modulus_from_shortenings(2.0, 0.01, 0.4, shortenings) == pytest.approx(1e3 / 3)
    assert published.modulus_of_layers(1e3, 1e3, 1e3) == pytest.approx(1e3 / 3)


def test_equation_11_inverted() -> None:
    assert published.object_modulus_from_layers(published.modulus_of_layers(1e3, 5e4, 1e3), 1e3) == pytest.approx(5e4)
    with pytest.raises(InputError, match="below E_1 / 2"):
        published.object_modulus_from_layers(500.0, 1e3)


def test_equation_12_with_table_1() -> None:
    # psi = 1: Table 1 sums to 20 + 2 - 20 = +2 pC/N
    assert published.film_force(2e-12, 1, 1, 20e-12, 2e-12, -20e-12) == pytest.approx(1.0)
    with pytest.raises(InputError):
        published.film_force(2e-12, 0, 0, 20e-12, 2e-12, 0.0)


def test_evaluator_returns_the_printed_modulus_and_names_the_defects() -> None:
    scene = named("axisymmetric", "published-materials").scene
    result = evaluate(scene, "published")
    # by hand: a = Ro = sqrt(5.1^2 + 25/3.7) mm = 5.7242 mm, d = 10 mm, D = 8 mm
    a = (5.1e-3**2 + 25e-6 / 3.7) ** 0.5
    by_hand = 4 * 1e3 * 1e5 * 0.84 * 1e-4 / (1e5 * 0.36 * (4e-4 + 3 * a * 8e-3) + 3 * a * 8e-3 * 1e3)
    assert result.equivalent_modulus == pytest.approx(by_hand, rel=1e-12)
    assert result.stress_inner is result.ratio is result.error_estimate is None
    assert any("eq. (8)" in warning for warning in result.warnings)


def test_evaluator_refuses_what_has_no_symbol() -> None:
    with pytest.raises(Refusal, match="published"):
        evaluate(named("axisymmetric", "homogeneous").scene, "published")
    with pytest.raises(Refusal, match="published"):
        evaluate(named("solid", "flank").scene, "published")
