"""Compute the errors of readings by uncertain numbers of the scene ("nuisances"), such as a skin's thickness.

The logarithm of such a number theta_j is normal about the scene's value with standard deviation t_j. If the numbers deviate by
eta_j standard deviations, the data are

    y = m(u) + d(u, eta) + noise,   d = J(u) eta + C(u) eta^2 + (cubes and fourth powers) + (products of two numbers)   (ES.7)

where m(u) are the predictions at the value u of the unknown, and J and C the coefficients of first and second order. The
polynomial d interpolates the model's predictions with one number 1 and 2 standard deviations off on either side, and with each
pair of numbers ``CORNER_SDS`` off at once, for the terms eta_i eta_j, eta_i^2 eta_j, eta_i eta_j^2 and eta_i^2 eta_j^2. Where the
scene does not allow 2 standard deviations, only 1 is used. Readings at several places, baseline readings included, thus share
errors: ``shared_errors.py``. Terms of three numbers are neglected.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from itertools import combinations, product
from types import MappingProxyType

import numpy as np
from scipy.interpolate import CubicSpline

from geometry.common.arrays import Floats
from geometry.common.errors import InputError, ProbeError, Words, describe_choices
from geometry.scenes.scene import Scene
from geometry.scenes.units import read_fraction
from geometry.scenes.variables import list_law_constants, list_loss_factors, list_values
from probe_design.estimation.model import TARGET_UNKNOWNS, TargetModel
from probe_design.estimation.predictions import Predictions
from probe_design.estimation.shared_errors import SharedErrors

MAX_LOG_SD = 1.0  # standard deviation of a logarithm; the polynomial is not valid beyond
FAR_SDS, CORNER_SDS = 2.0, 1.5  # standard deviations at which eq. ES.7 interpolates the model, besides 1
ALLOWED_SD = f"a relative standard deviation above 0 and up to {MAX_LOG_SD:g}, such as 0.2 or 20 %"


@dataclass(frozen=True)
class NuisanceErrors:
    """Errors by nuisances along an unknown.

    Attributes
    ----------
    x
        Coordinates of the unknown, increasing, shape (n,); interpolated by a cubic spline if n > 3, else linearly.
    errors
        Coefficients of eq. ES.7 at x, shapes (n, k, q).
    """

    x: Floats
    errors: SharedErrors

    def interpolate(self, x: Floats) -> SharedErrors:
        """Return the coefficients of eq. ES.7 at points x of shape (s,): shapes (s, k, q)."""
        inside = np.clip(x, self.x[0], self.x[-1])
        unit = np.eye(len(self.x))
        if len(self.x) > 3:
            weights = CubicSpline(self.x, unit)(inside)
        else:
            weights = np.stack([np.interp(inside, self.x, row) for row in unit], axis=1)
        return self.errors.transform(lambda part: np.tensordot(weights, part, axes=1))


def read_sd(key: str, value: object) -> float:
    """Return a relative standard deviation, given as 0.2 or "20 %".

    Raises
    ------
    InputError
        The value is not allowed.
    """
    sd = read_fraction(key, value, ALLOWED_SD)
    if not 0 < sd <= MAX_LOG_SD:
        raise InputError(key, value, ALLOWED_SD)
    return sd


def check_nuisances(scene: Scene, stated: Mapping[str, object], unknown: str) -> dict[str, float]:
    """Return relative standard deviations as numbers, by the keys of the scene's numbers.

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
    return {name: read_sd(f"nuisance.{name}", value) for name, value in stated.items()}


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
    units = np.eye(len(nuisances))
    axes = [_fit_axis(compute_shift, unit) for unit in units]
    terms = {_list_powers(power * unit): axis[power - 1] for unit, axis in zip(units, axes, strict=True) for power in (3, 4)}
    for i, j in combinations(range(len(nuisances)), 2):
        terms |= _fit_products(compute_shift, (units[i], units[j]), (axes[i], axes[j]))
    line, bend = (np.stack([axis[k] for axis in axes], axis=-1) for k in (0, 1))
    return NuisanceErrors(x, SharedErrors(line, bend, np.stack(list(terms.values()), axis=-1), tuple(terms)))


def _fit_axis(compute_shift: Callable[[Floats], Floats], unit: Floats) -> list[Floats]:
    """Return the coefficients of the first four powers of one number."""
    plus, minus = compute_shift(unit), compute_shift(-unit)
    odd_part, even_part = (plus - minus) / 2, (plus + minus) / 2
    try:
        plus, minus = compute_shift(FAR_SDS * unit), compute_shift(-FAR_SDS * unit)
    except InputError:
        return [odd_part, even_part, np.zeros_like(odd_part), np.zeros_like(odd_part)]
    cube = ((plus - minus) / 2 - FAR_SDS * odd_part) / (FAR_SDS**3 - FAR_SDS)
    fourth = ((plus + minus) / 2 - FAR_SDS**2 * even_part) / (FAR_SDS**4 - FAR_SDS**2)
    return [odd_part - cube, even_part - fourth, cube, fourth]


def _fit_products(
    compute_shift: Callable[[Floats], Floats], units: tuple[Floats, Floats], axes: tuple[list[Floats], list[Floats]]
) -> dict[tuple[int, ...], Floats]:
    """Return the coefficients of products of powers of two numbers; none where both cannot deviate at once."""
    for corner in (CORNER_SDS, 1.0):
        remainders = {}
        try:
            for signs in product((1, -1), repeat=2):
                remainders[signs] = compute_shift(corner * (signs[0] * units[0] + signs[1] * units[1]))
        except InputError:
            continue
        for signs in remainders:
            for sign, axis in zip(signs, axes, strict=True):
                remainders[signs] = remainders[signs] - sum(part * (sign * corner) ** (k + 1) for k, part in enumerate(axis))
        return {
            _list_powers(i * units[0] + j * units[1]): np.asarray(
                sum(a**i * b**j * remainder for (a, b), remainder in remainders.items())
            )
            / (4 * corner ** (i + j))
            for i, j in product((1, 2), repeat=2)
        }
    return {}


def _list_powers(exponents: Floats) -> tuple[int, ...]:
    """Return exponents as integers."""
    return tuple(int(power) for power in exponents)


def _compute_shift(
    model: TargetModel, nuisances: Mapping[str, float], unknown_values: dict[str, Floats], centre: Predictions, eta: Floats
) -> Floats:
    """Return the change of predictions where numbers deviate by eta standard deviations, shape (n, k).

    Raises
    ------
    InputError
        The scene is not valid, or the model cannot predict the data.
    """
    numbers = list_values(model.scene) | list_loss_factors(model.scene) | list_law_constants(model.scene)
    shifted = {name: (sd, step) for (name, sd), step in zip(nuisances.items(), eta, strict=True) if step}
    new_values = {name: numbers[name] * math.exp(sd * step) for name, (sd, step) in shifted.items()}
    name, (sd, _) = next(iter(shifted.items()))
    try:
        predicted = _predict(model, unknown_values, new_values)
    except (ProbeError, ValueError) as fault:
        reason = f"one that leaves {name} = {new_values[name]:.4g} possible ({fault})"
        raise InputError(f"nuisance.{name}", Words(f"{sd:g}"), reason) from None
    if not (
        predicted.resolved & (predicted.agrees == centre.agrees)
    ).all():  # a change of sign would make logarithms incomparable
        raise InputError(f"nuisance.{name}", sd, "a smaller one: the model cannot predict readings at so large a deviation")
    return np.asarray(predicted.value - centre.value)


def _predict(
    model: TargetModel, unknown_values: dict[str, Floats], new_values: Mapping[str, float] = MappingProxyType({})
) -> Predictions:
    """Predict along an unknown of the target, or of the tissue, in a scene with other numbers."""
    ((unknown, points),) = unknown_values.items()
    if unknown in TARGET_UNKNOWNS:
        return (model.replace_values(new_values) if new_values else model).predict(unknown_values)
    return Predictions.join([model.replace_values({unknown: float(value)} | dict(new_values)).predict({}) for value in points])
