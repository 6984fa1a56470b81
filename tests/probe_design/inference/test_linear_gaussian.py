"""The linear-Gaussian model against dense covariances, closed forms, limits of priors, and complex steps."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import multivariate_normal

from geometry.common.arrays import Floats
from geometry.common.errors import InputError
from probe_design.inference.linear_gaussian import LinearGaussian

EXTREMES = (1e-12, 1e-6, 1.0, 1e6, 1e12)


def draw_model(seed: int, m: int = 6, q: int = 3, batch: tuple[int, ...] = ()) -> LinearGaussian:
    rng = np.random.default_rng(seed)
    return LinearGaussian(rng.normal(size=(*batch, m, q)), rng.uniform(0.1, 2.0, (*batch, m)), rng.uniform(0.2, 3.0, (*batch, q)))


def compute_dense_posterior(model: LinearGaussian) -> Floats:
    with np.errstate(divide="ignore"):
        precision = np.diag(model.prior_sd**-2.0)
    return np.asarray(np.linalg.inv(model.derivatives.T @ (model.derivatives / model.variance[:, None]) + precision))


def test_the_covariance_is_that_of_simulated_readings() -> None:
    model, rng = draw_model(0), np.random.default_rng(1)
    x = model.prior_sd * rng.standard_normal((200_000, 3))
    y = x @ model.derivatives.T + np.sqrt(model.variance) * rng.standard_normal((200_000, 6))
    assert np.abs(np.cov(y.T) - model.covariance).max() < 0.02 * model.covariance.max()


def test_results_are_those_of_the_dense_covariance() -> None:
    model, rng = draw_model(0), np.random.default_rng(2)
    y, other = rng.normal(size=6), rng.normal(size=(6, 2))
    weight = np.linalg.inv(model.covariance)
    assert model.compute_chi_square(y) == pytest.approx(y @ weight @ y, rel=1e-12)
    assert model.weigh(y) == pytest.approx(weight @ y, rel=1e-12)
    assert model.compute_information(other) == pytest.approx(other.T @ weight @ other, rel=1e-12)
    assert model.whiten(other).T @ model.whiten(other) == pytest.approx(other.T @ weight @ other, rel=1e-12)
    assert model.compute_log_likelihood(y) == pytest.approx(multivariate_normal.logpdf(y, np.zeros(6), model.covariance))


def test_the_posterior_is_that_of_the_normal_equations() -> None:
    model, y = draw_model(3), np.random.default_rng(4).normal(size=6)
    dense = compute_dense_posterior(model)
    assert model.compute_posterior_covariance() == pytest.approx(dense, rel=1e-12)
    assert model.compute_posterior_mean(y) == pytest.approx(dense @ model.derivatives.T @ (y / model.variance), rel=1e-12)
    c = np.array([1.0, -1.0])
    assert model.compute_posterior_sd(c) == pytest.approx(np.sqrt(c @ dense[:2, :2] @ c), rel=1e-12)


def test_a_posterior_is_what_simulated_unknowns_have_given_their_readings() -> None:
    model, rng = draw_model(5), np.random.default_rng(6)
    x = model.prior_sd * rng.standard_normal((100_000, 3))
    y = x @ model.derivatives.T + np.sqrt(model.variance) * rng.standard_normal((100_000, 6))
    error = x - model.compute_posterior_mean(y)
    assert np.cov(error.T) == pytest.approx(model.compute_posterior_covariance(), abs=0.02 * model.prior_sd.max() ** 2)


def test_one_reading_of_one_unknown_is_the_closed_form() -> None:
    model = LinearGaussian(np.array([[2.0]]), np.array([0.25]), np.array([3.0]))
    assert model.compute_posterior_sd(np.ones(1)) == pytest.approx((4 / 0.25 + 1 / 9) ** -0.5, rel=1e-15)
    assert model.compute_chi_square(np.array([5.0])) == pytest.approx(25 / (0.25 + 36), rel=1e-15)


def test_batches_broadcast() -> None:
    model, rng = draw_model(7, batch=(4, 5)), np.random.default_rng(8)
    y, columns, c = rng.normal(size=(4, 5, 6)), rng.normal(size=(4, 5, 6, 2)), rng.normal(size=(4, 5, 3))
    for index in np.ndindex(4, 5):
        single = LinearGaussian(model.derivatives[index], model.variance[index], model.prior_sd[index])
        assert model.compute_chi_square(y)[index] == pytest.approx(single.compute_chi_square(y[index]), rel=1e-12)
        assert model.compute_information(columns)[index] == pytest.approx(single.compute_information(columns[index]), rel=1e-12)
        assert model.compute_posterior_mean(y)[index] == pytest.approx(single.compute_posterior_mean(y[index]), rel=1e-12)
        assert model.compute_posterior_sd(c)[index] == pytest.approx(single.compute_posterior_sd(c[index]), rel=1e-12)
        assert model.compute_log_likelihood(y)[index] == pytest.approx(single.compute_log_likelihood(y[index]), rel=1e-12)
        assert model.weigh(y)[index] == pytest.approx(single.weigh(y[index]), rel=1e-12)
        assert model.compute_posterior_covariance()[index] == pytest.approx(single.compute_posterior_covariance(), rel=1e-12)
    single = draw_model(9)
    assert single.compute_chi_square(y)[3, 4] == pytest.approx(single.compute_chi_square(y[3, 4]), rel=1e-12)
    assert single.compute_posterior_sd(c)[3, 4] == pytest.approx(single.compute_posterior_sd(c[3, 4]), rel=1e-12)
    assert single.compute_posterior_mean(y)[3, 4] == pytest.approx(single.compute_posterior_mean(y[3, 4]), rel=1e-12)
    assert model.compute_chi_square(y[0, 0])[3, 4] == pytest.approx(model.compute_chi_square(np.tile(y[0, 0], (4, 5, 1)))[3, 4])


def test_further_unknowns_come_first_and_marginalise() -> None:
    noise, J = draw_model(10), np.random.default_rng(11).normal(size=(7, 6, 2))
    prior_sd = np.array([0.5, 2.0])
    posterior = noise.add_unknowns(J, prior_sd).compute_posterior_covariance()
    assert posterior.shape == (7, 5, 5)
    expected = np.linalg.inv(noise.compute_information(J) + np.diag(prior_sd**-2.0))
    assert posterior[:, :2, :2] == pytest.approx(expected, rel=1e-12)


def test_an_infinite_prior_is_the_limit_of_wide_ones_and_no_prior() -> None:
    model, y = draw_model(12), np.random.default_rng(13).normal(size=6)
    flat = LinearGaussian(model.derivatives, model.variance, np.full(3, np.inf))
    wide = LinearGaussian(model.derivatives, model.variance, np.full(3, 1e7))
    assert wide.compute_posterior_covariance() == pytest.approx(flat.compute_posterior_covariance(), rel=1e-10)
    root = np.sqrt(model.variance)
    least_squares, misfit = np.linalg.lstsq(model.derivatives / root[:, None], y / root)[:2]
    assert flat.compute_posterior_mean(y) == pytest.approx(least_squares, rel=1e-12)
    assert flat.compute_chi_square(y) == pytest.approx(misfit[0], rel=1e-12)


def test_an_unknown_with_a_zero_prior_is_none() -> None:
    model, y = draw_model(14), np.random.default_rng(15).normal(size=6)
    fixed = LinearGaussian(model.derivatives, model.variance, np.array([*model.prior_sd[:2], 0.0]))
    fewer = LinearGaussian(model.derivatives[:, :2], model.variance, model.prior_sd[:2])
    assert fixed.compute_chi_square(y) == pytest.approx(fewer.compute_chi_square(y), rel=1e-13)
    assert fixed.compute_posterior_covariance()[2].tolist() == [0.0, 0.0, 0.0]
    assert fixed.compute_posterior_covariance()[:2, :2] == pytest.approx(fewer.compute_posterior_covariance(), rel=1e-13)
    assert fixed.compute_posterior_mean(y)[2] == 0.0
    assert fixed.compute_log_likelihood(y) == pytest.approx(fewer.compute_log_likelihood(y), rel=1e-13)


def test_what_is_not_determined_has_an_infinite_deviation() -> None:
    J = np.array([[1.0, 1.0, 0.0], [2.0, 2.0, 0.0], [3.0, 3.0, 0.0]])  # the sum of the first two, and nothing of the third
    model = LinearGaussian(J, np.full(3, 0.5), np.full(3, np.inf))
    assert model.compute_posterior_sd(np.array([0.5, 0.5])) == pytest.approx(np.sqrt(0.5 / 14) / 2, rel=1e-12)
    assert np.isinf([model.compute_posterior_sd(row) for row in np.eye(3)]).all()
    covariance = model.compute_posterior_covariance()
    assert np.isinf(np.diag(covariance)).all()
    assert np.isnan(covariance[0, 1])
    assert model.compute_posterior_mean(np.ones(3))[2] == 0.0
    with_priors = LinearGaussian(J, np.full(3, 0.5), np.array([1.0, np.inf, 2.0]))
    assert with_priors.compute_posterior_sd(np.array([0.0, 0.0, 1.0])) == pytest.approx(2.0)
    assert with_priors.compute_posterior_sd(np.array([1.0])) == pytest.approx(1.0)


def test_no_unknowns_are_white_noise() -> None:
    model = LinearGaussian.from_shared_errors(np.zeros((2, 0)), np.array([4.0, 1.0]))
    assert model.compute_chi_square(np.array([2.0, 3.0])) == pytest.approx(10.0)
    assert model.compute_posterior_covariance().shape == (0, 0)
    assert model.covariance.tolist() == [[4.0, 0.0], [0.0, 1.0]]


@pytest.mark.parametrize("variance", [0.0, -1.0])
def test_readings_without_noise_are_refused(variance: float) -> None:
    with pytest.raises(InputError, match="variance"):
        LinearGaussian(np.ones((2, 1)), np.array([1.0, variance]), np.ones(1))
    with pytest.raises(InputError, match="prior_sd"):
        LinearGaussian(np.ones((2, 1)), np.ones(2), -np.ones(1))


def test_what_is_not_a_number_stays_so_and_spoils_no_neighbour() -> None:
    variance = np.array([[1.0, np.nan], [1.0, 1.0]])
    model = LinearGaussian(np.ones((2, 2, 1)), variance, np.ones(1))
    sds = model.compute_posterior_sd(np.ones(1))
    assert np.isnan(sds[0])
    assert sds[1] == pytest.approx(3**-0.5)
    assert np.isnan(model.compute_chi_square(np.ones(2))).tolist() == [True, False]


@pytest.mark.parametrize("prior", [0.0, *EXTREMES, np.inf])
@pytest.mark.parametrize("noise", EXTREMES)
@pytest.mark.parametrize("derivative", EXTREMES)
def test_extremes_give_the_closed_form_without_warnings(prior: float, noise: float, derivative: float) -> None:
    """A common offset with a prior, and a signal that alternates: both are orthogonal."""
    alternating = np.array([1.0, -1.0, 1.0, -1.0])
    with np.errstate(all="raise", under="ignore"):
        model = LinearGaussian(derivative * np.ones((4, 1)), np.full(4, noise**2), np.array([prior]))
        sd = float(model.compute_posterior_sd(np.ones(1)))
        deflection = float(model.compute_chi_square(derivative * alternating))
        offset = float(model.compute_chi_square(derivative * np.ones(4)))
    information = 4 * (derivative / noise) ** 2
    assert deflection == pytest.approx(information, rel=1e-12)
    if prior == 0.0:
        assert sd == 0.0
        assert offset == pytest.approx(information, rel=1e-12)
    else:
        assert sd == pytest.approx((information + prior**-2.0) ** -0.5, rel=1e-12)
        assert offset == pytest.approx(1 / (1 / information + prior**2), rel=1e-9, abs=1e-30 * information)


def test_a_wide_common_error_leaves_small_differences() -> None:
    """The offset's prior is 1e12 times the noise: the normal equations would lose all digits of what is left."""
    model = LinearGaussian.from_shared_errors(np.full((3, 1), 1e12), np.ones(3))
    assert model.compute_chi_square(np.array([1.0, 0.0, -1.0])) == pytest.approx(2.0, rel=1e-12)
    line = LinearGaussian(np.array([[1.0, 0.0], [1.0, 1e-6], [1.0, 2e-6]]), np.ones(3), np.full(2, np.inf))
    assert line.compute_posterior_sd(np.array([0.0, 1.0])) == pytest.approx(1e6 / np.sqrt(2), rel=1e-9)


@given(
    seed=st.integers(0, 2**32 - 1), exponents=st.lists(st.integers(-12, 12), min_size=3, max_size=3), unit=st.integers(-12, 12)
)
def test_units_of_unknowns_and_readings_do_not_matter(seed: int, exponents: list[int], unit: int) -> None:
    model, y = draw_model(seed), np.random.default_rng(seed).normal(size=6)
    factors, factor = 10.0 ** np.array(exponents), 10.0**unit
    scaled = LinearGaussian(factor * model.derivatives / factors, factor**2 * model.variance, factors * model.prior_sd)
    assert scaled.compute_chi_square(factor * y) == pytest.approx(model.compute_chi_square(y), rel=1e-9)
    assert scaled.compute_posterior_mean(factor * y) / factors == pytest.approx(
        model.compute_posterior_mean(y), rel=1e-8, abs=1e-12
    )
    covariance = scaled.compute_posterior_covariance() / np.outer(factors, factors)
    assert covariance == pytest.approx(model.compute_posterior_covariance(), rel=1e-9, abs=1e-12)


@given(seed=st.integers(0, 2**32 - 1), more=st.integers(1, 4))
def test_readings_add_information_and_wider_priors_take_it_away(seed: int, more: int) -> None:
    model, rng = draw_model(seed, m=2), np.random.default_rng(seed)
    sd = model.compute_posterior_sd(np.ones(3))
    longer = LinearGaussian(
        np.vstack([model.derivatives, rng.normal(size=(more, 3))]), np.append(model.variance, np.ones(more)), model.prior_sd
    )
    wider = LinearGaussian(model.derivatives, model.variance, model.prior_sd * rng.uniform(1, 10, 3))
    assert longer.compute_posterior_sd(np.ones(3)) <= sd * (1 + 1e-12)
    assert wider.compute_posterior_sd(np.ones(3)) >= sd * (1 - 1e-12)
    assert sd <= np.linalg.norm(model.prior_sd) * (1 + 1e-12)
    y = rng.normal(size=2)
    assert wider.compute_chi_square(y) <= model.compute_chi_square(y) * (1 + 1e-12)


def test_complex_steps_differentiate_all_results() -> None:
    model, rng = draw_model(16), np.random.default_rng(17)
    y, direction, step = rng.normal(size=6), rng.normal(size=(6, 3)), 1e-6

    def compute_results(size: complex) -> list[complex]:
        moved = LinearGaussian(model.derivatives + size * direction, model.variance * (1 + size), model.prior_sd)
        return [
            complex(moved.compute_chi_square(y)),
            complex(moved.compute_posterior_sd(np.array([1.0, 2.0]))),
            complex(moved.compute_posterior_mean(y)[1]),
            complex(moved.compute_log_likelihood(y)),
        ]

    by_complex_step = np.imag(compute_results(1e-30j)) / 1e-30
    by_difference = np.real(np.array(compute_results(step)) - compute_results(-step)) / (2 * step)
    assert by_complex_step == pytest.approx(by_difference, rel=1e-6)
