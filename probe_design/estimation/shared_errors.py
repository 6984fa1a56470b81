"""Compute the misfit of data that share errors by uncertain numbers of the scene, eq. ES.7.

If these numbers deviate by eta_j standard deviations, k data change by d(eta), the polynomial of eq. ES.7. The misfit of data y
to predictions m is the minimum over all eta, which are standard normal:

    chi2 = min over eta of sum_i ((y_i - m_i - d_i(eta)) / s_i)^2 + sum_j eta_j^2                  (ES.8)

Here s_i is the noise of datum i. For d = J eta it is r^T W r with r = (y - m) / s, W = (I + A A^T)^-1 and A = J / s.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Floats, Ints
from probe_design.inference.linear_gaussian import LinearGaussian

GAUSS_NEWTON_STEPS = 8  # Gauss-Newton steps for eta
MAX_STEP_SDS = 1.0  # standard deviations: largest change of eta in one step


@dataclass(frozen=True)
class SharedErrors:
    """Coefficients of the polynomial of eq. ES.7 for q numbers; q = 0 without nuisances.

    Attributes
    ----------
    linear
        J, shape (..., k, q).
    quadratic
        C, likewise.
    products
        Coefficients of other products of powers of eta, shape (..., k, n); None where there are none.
    powers
        Exponent of each eta in these products, shape (n, q).
    """

    linear: Floats
    quadratic: Floats
    products: Floats | None = None
    powers: tuple[tuple[int, ...], ...] = ()

    @classmethod
    def empty(cls, k: int) -> SharedErrors:
        """Return the coefficients for k data that share no errors."""
        return cls(np.zeros((k, 0)), np.zeros((k, 0)))

    def divide_by_noise(self, noise: Floats) -> SharedErrors:
        """Return the coefficients divided by the noise of shape (k,)."""
        return self.transform(lambda part: part / noise[:, None])

    def transform(self, function: Callable[[Floats], Floats]) -> SharedErrors:
        """Return the errors with a function applied to each array of coefficients."""
        products = None if self.products is None else function(self.products)
        return SharedErrors(function(self.linear), function(self.quadratic), products, self.powers)

    def evaluate(self, eta: Floats) -> Floats:
        """Return the change d of the data, eq. ES.7, shape (..., k), at eta of shape (..., q)."""
        shift = _multiply(self.linear, eta) + _multiply(self.quadratic, eta**2)
        return shift if self.products is None else shift + _multiply(self.products, _compute_products(eta, self._power_array))

    def differentiate(self, eta: Floats) -> Floats:
        """Return the derivatives of d by eta, shape (..., k, q)."""
        derivative = self.linear + 2 * self.quadratic * eta[..., None, :]
        if self.products is None:
            return np.asarray(derivative)
        parts = []
        for j, power in enumerate(self._power_array.T):
            lower = np.maximum(self._power_array - np.eye(self.linear.shape[-1], dtype=int)[j], 0)
            parts.append(_multiply(self.products, power * _compute_products(eta, lower)))
        return np.asarray(derivative + np.stack(parts, axis=-1))

    @property
    def _power_array(self) -> Ints:
        return np.array(self.powers, dtype=int)

    def decorrelate(self, values: Floats) -> Floats:
        """Return W v, with W of eq. ES.8, for values v divided by the noise, shape (..., k)."""
        return _build_unit_noise(self.linear).weigh(values)

    def compute_misfit(self, residual: Floats) -> Floats:
        """Return chi2 of eq. ES.8 for differences y - m divided by the noise, shape (..., k)."""
        if not self.linear.shape[-1]:
            return np.asarray((residual**2).sum(axis=-1))
        eta = _build_unit_noise(self.linear).compute_posterior_mean(residual)
        min_chi2 = self._evaluate_misfit(residual, eta)
        for _ in range(GAUSS_NEWTON_STEPS):
            tangent = self.differentiate(eta)
            linearised_residual = residual - self.evaluate(eta) + _multiply(tangent, eta)
            step = _build_unit_noise(tangent).compute_posterior_mean(linearised_residual) - eta
            eta = eta + step / np.maximum(1.0, np.abs(step).max(axis=-1, keepdims=True) / MAX_STEP_SDS)
            min_chi2 = np.minimum(min_chi2, self._evaluate_misfit(residual, eta))
        return min_chi2

    def _evaluate_misfit(self, residual: Floats, eta: Floats) -> Floats:
        """Return the sum of eq. ES.8 at given eta, which the misfit minimises."""
        return np.asarray(((residual - self.evaluate(eta)) ** 2).sum(axis=-1) + (eta**2).sum(axis=-1))


def _build_unit_noise(linear: Floats) -> LinearGaussian:
    """Return data of unit noise that share standard normal errors with coefficients A of shape (..., k, q)."""
    return LinearGaussian.from_shared_errors(linear, np.ones(linear.shape[-2]))


def _multiply(matrix: Floats, vector: Floats) -> Floats:
    return np.asarray((matrix @ vector[..., None])[..., 0])


def _compute_products(eta: Floats, powers: Ints) -> Floats:
    """Return products of powers of eta, shape (..., n)."""
    return np.asarray(np.prod(eta[..., None, :] ** powers, axis=-1))
