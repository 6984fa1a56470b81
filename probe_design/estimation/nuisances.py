"""Compute the errors of readings by uncertain numbers of the scene ("nuisances"), such as a skin's thickness.

The logarithm of such a number theta_j is normal about the scene's value with standard deviation t_j. If the numbers deviate by
eta_j standard deviations, the data are

    y = m(u) + d(u, eta) + noise,   d = J(u) eta + C(u) eta^2 + (cubes and fourth powers) + (products of two numbers)   (ES.7)

where m(u) are the predictions at the value u of the unknown, and J and C the coefficients of first and second order. The
polynomial d interpolates the model's predictions with one number 1 and 2 standard deviations off on either side, and with each
pair of numbers ``CORNER_SDS`` off at once, for the terms eta_i eta_j, eta_i^2 eta_j, eta_i eta_j^2 and eta_i^2 eta_j^2. Where the
scene does not allow 2 standard deviations, only 1 is used. Terms of three numbers are neglected.

Readings at several places, baseline readings included, thus share errors. The misfit of data y to predictions m is the minimum
over all eta, which are standard normal:

    chi2 = min over eta of sum_i ((y_i - m_i - d_i(eta)) / s_i)^2 + sum_j eta_j^2                  (ES.8)

Here s_i is the noise of datum i. For d = J eta it is r^T W r with r = (y - m) / s, W = (I + A A^T)^-1 and A = J / s.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from itertools import combinations, product
from types import MappingProxyType

import numpy as np
from scipy.interpolate import CubicSpline

from geometry.common.arrays import Floats, Ints
from geometry.common.errors import InputError, ProbeError, Words, describe_choices
from geometry.scenes.scene import Scene
from geometry.scenes.units import read_fraction
from geometry.scenes.variables import list_law_constants, list_loss_factors, list_values
from probe_design.estimation.model import TARGET_UNKNOWNS, TargetModel
from probe_design.estimation.predictions import Predictions
from probe_design.inference.linear_gaussian import LinearGaussian

MAX_LOG_SD = 1.0  # standard deviation of a logarithm; the polynomial is not valid beyond
FAR_SDS, CORNER_SDS = 2.0, 1.5  # standard deviations at which eq. ES.7 interpolates the model, besides 1
ALLOWED_SD = f"a relative standard deviation above 0 and up to {MAX_LOG_SD:g}, such as 0.2 or 20 %"
POWERS = np.arange(1, 5)  # of one number in eq. ES.7
PRODUCT_POWERS = np.array(list(product((1, 2), repeat=2)))  # of two numbers
GAUSS_NEWTON_STEPS = 8  # for eta
MAX_STEP_SDS = 1.0  # standard deviations: largest change of eta in one step


@dataclass(frozen=True)
class SharedErrors:
    """The polynomial of eq. ES.7 in the deviations eta of q numbers; q = 0 without nuisances.

    Attributes
    ----------
    coefficients
        Of the products of powers of eta, shape (..., k, n); the first q are J.
    powers
        Exponents of eta in the n products, shape (n, q); the first q products are the numbers eta themselves.
    """

    coefficients: Floats
    powers: Ints

    @classmethod
    def from_linear(cls, linear: Floats) -> SharedErrors:
        """Return errors linear in eta, J eta, for J of shape (..., k, q)."""
        return cls(linear, np.eye(linear.shape[-1], dtype=int))

    @property
    def linear(self) -> Floats:
        """The coefficients J, shape (..., k, q)."""
        return self.coefficients[..., : self.powers.shape[1]]

    def divide_by_noise(self, noise: Floats) -> SharedErrors:
        """Return the coefficients divided by the noise of shape (k,)."""
        return self.transform(lambda coefficients: coefficients / noise[:, None])

    def transform(self, function: Callable[[Floats], Floats]) -> SharedErrors:
        """Return the errors with a function applied to the array of coefficients."""
        return SharedErrors(function(self.coefficients), self.powers)

    def evaluate(self, eta: Floats) -> Floats:
        """Return the change d of the data, eq. ES.7, shape (..., k), at eta of shape (..., q)."""
        return _multiply(self.coefficients, _compute_products(eta, self.powers))

    def differentiate(self, eta: Floats) -> Floats:
        """Return the derivatives of d with respect to eta, shape (..., k, q)."""
        columns = []
        # d/d eta_j lowers the exponent of eta_j by one, times the exponent; where that is 0 the term vanishes
        for unit, exponents in zip(np.eye(eta.shape[-1], dtype=int), self.powers.T, strict=True):
            lowered = np.maximum(self.powers - unit, 0)
            columns.append(_multiply(self.coefficients, exponents * _compute_products(eta, lowered)))
        return np.stack(columns, axis=-1)

    def decorrelate(self, values: Floats) -> Floats:
        """Return W v, with W of eq. ES.8, for values v divided by the noise, shape (..., k)."""
        return _build_unit_noise(self.linear).weigh(values)

    def compute_misfit(self, residual: Floats) -> Floats:
        """Return chi2 of eq. ES.8, shape (...), for differences y - m divided by the noise, shape (..., k).

        The minimum over eta is found by Gauss-Newton steps from that of the linear errors.
        """
        if not self.powers.shape[1]:
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
        """Return the sum in eq. ES.8 at some eta; its minimum over eta is chi2."""
        return np.asarray(((residual - self.evaluate(eta)) ** 2).sum(axis=-1) + (eta**2).sum(axis=-1))


def _build_unit_noise(linear: Floats) -> LinearGaussian:
    """Return the linear model of data with unit noise and shared errors A eta, eta standard normal, A of shape (..., k, q)."""
    return LinearGaussian.from_shared_errors(linear, np.ones(linear.shape[-2]))


def _multiply(matrix: Floats, vector: Floats) -> Floats:
    """Return products of matrices (..., m, n) and vectors (..., n), shape (..., m)."""
    return np.asarray((matrix @ vector[..., None])[..., 0])


def _compute_products(eta: Floats, powers: Ints) -> Floats:
    """Return the products of powers of eta, shape (..., n), for exponents of shape (n, q)."""
    # table[..., j, p] = eta_j^p
    table = np.vander(eta.ravel(), POWERS[-1] + 1, increasing=True).reshape(*eta.shape, POWERS[-1] + 1)
    products = np.ones((*eta.shape[:-1], len(powers)))
    for j, exponents in enumerate(powers.T):
        products *= table[..., j, exponents]
    return products


@dataclass(frozen=True)
class NuisanceErrors:
    """Errors by nuisances along an unknown.

    Attributes
    ----------
    x
        Coordinates of the unknown, increasing, shape (n,); interpolated by a cubic spline if n > 3, else linearly.
    errors
        eq. ES.7 at x, coefficients of shape (n, k, terms).
    """

    x: Floats
    errors: SharedErrors

    def interpolate(self, x: Floats) -> SharedErrors:
        """Return eq. ES.7 at points x of shape (s,): coefficients of shape (s, k, terms)."""
        inside = np.clip(x, self.x[0], self.x[-1])
        unit = np.eye(len(self.x))  # interpolating the unit vectors gives the weights of the nodes
        if len(self.x) > 3:
            weights = CubicSpline(self.x, unit)(inside)
        else:
            weights = np.stack([np.interp(inside, self.x, row) for row in unit], axis=1)
        return self.errors.transform(lambda coefficients: np.tensordot(weights, coefficients, axes=1))


def check_nuisances(scene: Scene, stated: Mapping[str, object], unknown: str) -> dict[str, float]:
    """Return the stated relative standard deviations as numbers, by the keys of the scene's numbers.

    Parameters
    ----------
    scene
        Whose numbers are uncertain.
    stated
        Numbers or texts such as "20 %", by key.
    unknown
        The number that is estimated, which cannot be a nuisance.

    Raises
    ------
    InputError
        The scene has no such number, or it is the unknown, or its standard deviation is not allowed.
    """
    unknown_key = f"inclusion.{unknown}" if len(scene.inclusion) == 1 else unknown
    others = [name for name, value in (list_loss_factors(scene) | list_law_constants(scene)).items() if value]
    allowed = [
        name
        for name in (*list_values(scene), *others)
        if name not in (unknown_key, unknown) and not name.endswith("poisson_ratio")
    ]
    for name in stated:
        if name not in allowed:
            raise InputError("nuisance", name, describe_choices(name, allowed))
    sds = {name: read_fraction(f"nuisance.{name}", value, ALLOWED_SD) for name, value in stated.items()}
    for name, sd in sds.items():
        if not 0 < sd <= MAX_LOG_SD:
            raise InputError(f"nuisance.{name}", stated[name], ALLOWED_SD)
    return sds


def compute_nuisance_errors(
    model: TargetModel,
    nuisances: Mapping[str, float],
    x: Floats,
    unknown_values: dict[str, Floats],
    centre: Predictions | None = None,
) -> NuisanceErrors:
    """Return the errors that nuisances cause along an unknown.

    Parameters
    ----------
    model
        See ``TargetModel``.
    nuisances
        Standard deviations of logarithms by name.
    x
        Coordinates of the unknown, shape (n,).
    unknown_values
        The unknown's name and its values at x, SI.
    centre
        Predictions at x, if they are known already.

    Raises
    ------
    InputError
        One standard deviation off, the scene is not valid, or the model cannot predict the data.
    """
    centre = _predict(model, unknown_values) if centre is None else centre
    compute_shift = partial(_compute_shift, model, nuisances, unknown_values, centre)
    units = np.eye(len(nuisances), dtype=int)
    axes = np.array([_fit_axis(compute_shift, unit) for unit in units])
    powers, coefficients = [power * units for power in POWERS], [axes[:, power - 1] for power in POWERS]
    for pair in combinations(range(len(nuisances)), 2):
        for corner in (CORNER_SDS, 1.0):
            with suppress(InputError):  # both numbers cannot deviate so far at once
                coefficients.append(_fit_products(compute_shift, corner, units[list(pair)], axes[list(pair)]))
                powers.append(PRODUCT_POWERS @ units[list(pair)])
                break
    return NuisanceErrors(x, SharedErrors(np.moveaxis(np.concatenate(coefficients), 0, -1), np.concatenate(powers)))


def _fit_axis(compute_shift: Callable[[Floats], Floats], unit: Ints) -> Floats:
    """Return the coefficients of the powers 1 to 4 of one number, shape (4, n, k).

    The powers 3 and 4 have coefficients of 0 where the scene does not allow ``FAR_SDS`` standard deviations.

    Parameters
    ----------
    compute_shift
        Returns the change of the data at eta, shape (n, k).
    unit
        The number's unit vector in eta, shape (q,).
    """
    steps = np.array([1.0, -1.0, FAR_SDS, -FAR_SDS])
    shifts = [compute_shift(step * unit) for step in steps[:2]]
    with suppress(InputError):
        shifts += [compute_shift(step * unit) for step in steps[2:]]
    powers = steps[: len(shifts), None] ** POWERS[: len(shifts)]
    coefficients = np.tensordot(np.linalg.inv(powers), np.array(shifts), axes=1)
    return np.concatenate([coefficients, np.zeros((len(POWERS) - len(shifts), *coefficients.shape[1:]))])


def _fit_products(compute_shift: Callable[[Floats], Floats], corner: float, units: Ints, axes: Floats) -> Floats:
    """Return the coefficients of the products ``PRODUCT_POWERS`` of two numbers, shape (4, n, k).

    Parameters
    ----------
    compute_shift
        Returns the change of the data at eta, shape (n, k).
    corner
        Standard deviations by which both numbers deviate at once.
    units
        The unit vectors of both in eta, shape (2, q).
    axes
        The coefficients of the powers of each alone, shape (2, 4, n, k).
    """
    deviations = corner * np.array(list(product((1, -1), repeat=2)))
    shifts = np.array([compute_shift(deviation @ units) for deviation in deviations])
    # c: corner, i: number, p: power; what both numbers change together is the total less the change by each alone
    shifts_alone = np.einsum("cip,ip...->c...", deviations[..., None] ** POWERS, axes)
    products = (deviations[:, None] ** PRODUCT_POWERS).prod(axis=2)
    return np.asarray(np.tensordot(np.linalg.inv(products), shifts - shifts_alone, axes=1))


def _compute_shift(
    model: TargetModel, nuisances: Mapping[str, float], unknown_values: dict[str, Floats], centre: Predictions, eta: Floats
) -> Floats:
    """Return the change of predictions where numbers deviate by eta standard deviations, shape (n, k).

    See ``compute_nuisance_errors`` for the other parameters.

    Raises
    ------
    InputError
        The scene is not valid, or the model cannot predict the data.
    """
    numbers = list_values(model.scene) | list_loss_factors(model.scene) | list_law_constants(model.scene)
    shifted = {name: (sd, step) for (name, sd), step in zip(nuisances.items(), eta, strict=True) if step}
    new_values = {name: numbers[name] * math.exp(sd * step) for name, (sd, step) in shifted.items()}
    name, (sd, _) = next(iter(shifted.items()))  # the first one stands for all in messages
    try:
        predicted = _predict(model, unknown_values, new_values)
    except (ProbeError, ValueError) as fault:
        reason = f"one that leaves {name} = {new_values[name]:.4g} possible ({fault})"
        raise InputError(f"nuisance.{name}", Words(f"{sd:g}"), reason) from None
    if not (predicted.resolved & (predicted.agrees == centre.agrees)).all():  # logarithms of ratios of either sign do not compare
        raise InputError(f"nuisance.{name}", sd, "a smaller one: the model cannot predict readings at so large a deviation")
    return np.asarray(predicted.value - centre.value)


def _predict(
    model: TargetModel, unknown_values: dict[str, Floats], new_values: Mapping[str, float] = MappingProxyType({})
) -> Predictions:
    """Predict at some values of an unknown of the target, or of the tissue, in a scene with ``new_values`` of other numbers."""
    ((unknown, points),) = unknown_values.items()
    if unknown in TARGET_UNKNOWNS:
        return (model.replace_values(new_values) if new_values else model).predict(unknown_values)
    return Predictions.join([model.replace_values({unknown: float(value)} | dict(new_values)).predict({}) for value in points])
