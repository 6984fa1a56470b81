"""The paper's equations against the figures that follow from them by hand (PHYSICS section 1)."""

from __future__ import annotations

import inspect
import math

import pytest

from geometry import InputError, Refusal
from solver import evaluate
from solver.published import equations as printed
from tests.support.references import named

# E_object = 1e5 Pa, nu = 0.4, d = 10 mm, D = 8 mm, a = 5.72 mm, in a 1000 Pa matrix
SIZES = {"a": 5.72e-3, "d": 10e-3, "D": 8e-3}
CASE = {**SIZES, "nu": 0.4}


def test_equation_7_makes_a_rigid_tumour_soften_the_tissue() -> None:
    assert printed.compute_modulus_from_compatibility(**CASE, E_matrix=1e3, E_object=1e5) == pytest.approx(742, abs=0.6)


def test_equation_7_does_not_vanish_for_matrix_stiffness() -> None:
    assert printed.compute_modulus_from_compatibility(**CASE, E_matrix=1e3, E_object=1e3) == pytest.approx(571, abs=0.6)


def test_equation_8_as_printed() -> None:
    assert printed.compute_modulus_printed(**CASE, E_matrix=1e3, E_object=1e5) == pytest.approx(1725, abs=0.6)


def test_equations_1_to_6_by_hand() -> None:
    # sigma = 2, a = 1, d = 3, D = 0.5, nu = 0, E_matrix = 4, E_object = 8
    assert printed.compute_stress_at_depth(2, 1, 1) == 3  # 1.50 sigma at d = a
    assert printed.compute_stress_at_depth(2, 1, 3) == pytest.approx(1 / 3)
    assert printed.compute_displacement_matrix(2, 1, 0, 4) == 1
    assert printed.compute_displacement_object(2, 1, 3, 0.5, 8) == pytest.approx(1 / 48)
    assert printed.compute_displacement_below(2, 1, 3, 0.5, nu=0, E_matrix=4) == pytest.approx(1 / 24)
    assert printed.compute_displacement_equivalent(2, 1, 0, 4) == 1
    assert printed.compute_displacement_total(2, 1, 3, 0.5, nu=0, E_matrix=4, E_object=8) == pytest.approx(1 + 1 / 48 + 1 / 24)


def test_poissons_ratio_in_equations_2_to_8_by_hand() -> None:
    # nu = 1/2: 1-nu^2 = 3/4, (1-nu)^2 = 1/4; sigma = 2, a = 1, d = 1, D = 1, E_matrix = 4, E_object = 8
    assert printed.compute_displacement_matrix(2, 1, 0.5, 4) == 0.75
    assert printed.compute_displacement_below(2, 1, 1, 1, nu=0.5, E_matrix=4) == pytest.approx(9 / 16)
    assert printed.compute_displacement_equivalent(2, 1, 0.5, 4) == 0.75
    # eq. (7): 3/E_eq = 3/4 + 3/8 + 9/16; eq. (8): 4*4*8*3/4 / (8/4 * 7 + 3*4)
    assert printed.compute_modulus_from_compatibility(1, 1, 1, nu=0.5, E_matrix=4, E_object=8) == pytest.approx(16 / 9)
    assert printed.compute_modulus_printed(1, 1, 1, nu=0.5, E_matrix=4, E_object=8) == pytest.approx(96 / 26)


def test_equations_9_to_11_give_a_homogeneous_block_a_third() -> None:
    shortenings = printed.compute_layer_shortenings(2.0, 0.01, 0.4, 0.4, 1e3)
    assert shortenings == pytest.approx((3.36e-5,) * 3)  # 2 * 0.84 * 2 * 0.01 / 1e3, whatever the tumour's modulus
    assert printed.compute_modulus_from_shortenings(2.0, 0.01, 0.4, shortenings) == pytest.approx(1e3 / 3)
    assert printed.compute_modulus_of_layers(1e3, 1e3, 1e3) == pytest.approx(1e3 / 3)


def test_equation_12_with_table_1() -> None:
    # psi = 1: Table 1 sums to 20 + 2 - 20 = +2 pC/N
    assert printed.compute_film_force(2e-12, 1, 1, d31=20e-12, d32=2e-12, d33=-20e-12) == pytest.approx(1.0)
    with pytest.raises(InputError, match="other than 0"):
        printed.compute_film_force(2e-12, 0, 0, d31=20e-12, d32=2e-12, d33=0.0)


def test_every_equation_has_its_number() -> None:
    assert list(printed.EQUATIONS) == list(range(1, 13))
    for number, equation in printed.EQUATIONS.items():
        assert f"eq. ({number})" in inspect.getdoc(equation).lower()


def test_equation_11_inverted() -> None:
    assert printed.compute_object_modulus(printed.compute_modulus_of_layers(1e3, 7e4, 1e3), 1e3) == pytest.approx(7e4, rel=1e-12)
    for E_eq in (500 * (1 + 1e-9), 5000.0):
        with pytest.raises(InputError, match=r"E_eq = .* below E_1 / 2 = 500 Pa") as refused:
            printed.compute_object_modulus(E_eq, 1e3)
        assert "\n" not in str(refused.value)


def test_equation_11_cannot_take_the_paper_s_own_modulus() -> None:
    """Eq. (8) gives its case 1725 Pa, and eq. (11) knows nothing above 500 Pa in a matrix of 1000 Pa."""
    with pytest.raises(InputError, match="below E_1 / 2 = 500 Pa"):
        printed.compute_object_modulus(printed.compute_modulus_printed(**CASE, E_matrix=1e3, E_object=1e5), 1e3)


@pytest.mark.parametrize("wrong", [0.0, -1.0, math.nan, math.inf])
@pytest.mark.parametrize("name", [*CASE, "E_matrix", "E_object"])
def test_arguments_that_are_no_sizes_or_moduli_are_refused(name: str, wrong: float) -> None:
    arguments = {**CASE, "E_matrix": 1e3, "E_object": 1e5, name: wrong}
    if name == "nu" and wrong == 0.0:
        assert printed.compute_modulus_printed(**arguments) > 0
        return
    for equation in (printed.compute_modulus_printed, printed.compute_modulus_from_compatibility):
        with pytest.raises(InputError, match=f"^{name} = "):
            equation(**arguments)


def test_other_arguments_are_refused() -> None:
    with pytest.raises(InputError, match=r"nu = 0\.6: allowed: from 0 to 0.5"):
        printed.compute_displacement_matrix(1.0, 1.0, 0.6, 1.0)
    with pytest.raises(InputError, match="shortenings = -1"):
        printed.compute_modulus_from_shortenings(1.0, 1.0, 0.4, (1.0, -1.0, 1.0))
    with pytest.raises(InputError, match="Q = nan"):
        printed.compute_film_force(math.nan, 0, 0, d31=0, d32=0, d33=1)


@pytest.mark.parametrize("d", [1e-200, 1e200])
def test_results_beyond_double_precision_are_refused(d: float) -> None:
    with pytest.raises(InputError, match="out of range"):
        printed.compute_displacement_object(1.0, 1e-3, d, 1e-3, 1e3)


def test_corrected_formula_has_both_limits() -> None:
    # PHYSICS section 1: a tumour of matrix stiffness vanishes; a stiffer one stiffens, 3 a D / (4 d^2) = 0.3432
    assert printed.compute_modulus_corrected(**SIZES, E_matrix=1e3, E_object=1e3) == pytest.approx(1e3, rel=1e-14)
    assert printed.compute_modulus_corrected(**SIZES, E_matrix=1e3, E_object=1e12) == pytest.approx(1e3 / (1 - 0.3432), rel=1e-6)
    assert printed.compute_modulus_corrected(**SIZES, E_matrix=1e3, E_object=1e5) == pytest.approx(
        1 / (0.6568e-3 + 0.3432e-5), rel=1e-12
    )


def test_corrected_formula_is_equation_7_with_its_two_defects_mended() -> None:
    """DIS_B with (1-nu^2), and DIS_C subtracted, both from the printed equations."""
    a, d, D, nu, E_matrix, E_object = 2e-3, 9e-3, 5e-3, 0.3, 2e3, 7e4
    shortening = (
        printed.compute_displacement_matrix(1.0, a, nu, E_matrix)
        + (1 - nu**2) * printed.compute_displacement_object(1.0, a, d, D, E_object)
        - printed.compute_displacement_below(1.0, a, d, D, nu=nu, E_matrix=E_matrix)
    )
    E_eq = printed.compute_modulus_corrected(a, d, D, E_matrix=E_matrix, E_object=E_object)
    assert printed.compute_displacement_equivalent(1.0, a, nu, E_eq) == pytest.approx(shortening, rel=1e-12)


def test_corrected_formula_refuses() -> None:
    with pytest.raises(InputError, match="below 1: a smaller or deeper object"):
        printed.compute_modulus_corrected(a=5e-3, d=3e-3, D=4e-3, E_matrix=1e3, E_object=1e5)


def test_evaluator_returns_the_printed_modulus_and_names_the_defects() -> None:
    scene = named("axisymmetric", "published-materials").scene
    result = evaluate(scene, "published")
    # by hand: a = Ro = sqrt(5.1^2 + 25/3.7) mm = 5.7242 mm, d = 10 mm, D = 8 mm
    a = (5.1e-3**2 + 25e-6 / 3.7) ** 0.5
    by_hand = 4 * 1e3 * 1e5 * 0.84 * 1e-4 / (1e5 * 0.36 * (4e-4 + 3 * a * 8e-3) + 3 * a * 8e-3 * 1e3)
    assert result.equivalent_modulus == pytest.approx(by_hand, rel=1e-12)
    assert result.stress_inner is result.ratio is result.error_estimate is None
    text = "\n".join(result.warnings)
    for row in ("eq. (1)", "(4), (6), (7)", "eq. (8)", "(9) to (11)", "2.4", "2.1, 2.2", "no radii", "psi_1", "Table 3"):
        assert row in text  # PHYSICS section 1, row by row
    assert "1725 Pa by eq. (8), 742.1 Pa by eq. (7), 1515 Pa without" in text


def test_evaluator_answers_where_the_corrected_formula_cannot() -> None:
    scene = named("axisymmetric", "published-materials").scene
    shallow = scene.inclusion[0].model_copy(update={"depth": 4.5e-3})
    result = evaluate(scene.model_copy(update={"inclusion": (shallow,)}), "published")
    assert result.equivalent_modulus > 0
    assert any("none without their defects (3 a D / (4 d^2) =" in warning for warning in result.warnings)


def test_evaluator_refuses_what_has_no_symbol() -> None:
    with pytest.raises(Refusal, match="published"):
        evaluate(named("axisymmetric", "homogeneous").scene, "published")
    with pytest.raises(Refusal, match="published"):
        evaluate(named("solid", "flank").scene, "published")
