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
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from geometry.common.arrays import Floats
from geometry.common.errors import InputError, ProbeError, Words, one_of
from geometry.scenes.scene import Scene
from geometry.scenes.units import fraction
from geometry.scenes.variables import loss_factors, values
from probe_design.estimation.model import OF_TARGET, TargetModel
from probe_design.estimation.predicted import Predicted
from probe_design.estimation.shared_errors import SharedErrors

LARGEST = 1.0  # standard deviation of a logarithm; the polynomial is not valid beyond
FAR, CORNER = 2.0, 1.5  # standard deviations at which eq. ES.7 interpolates the model, besides 1
ALLOWED = f"a relative standard deviation above 0 and up to {LARGEST:g}, such as 0.2 or 20 %"


@dataclass(frozen=True)
class Spread:
    """Errors by nuisances along an unknown.

    Attributes:
        x: coordinates of the unknown, increasing, shape (n,); interpolated by a cubic spline if n > 3, else linearly.
        errors: coefficients of eq. ES.7 at x, shapes (n, k, q).
    """

    x: Floats
    errors: SharedErrors

    def at(self, x: Floats) -> SharedErrors:
        """Return the coefficients of eq. ES.7 at points x of shape (s,): shapes (s, k, q)."""
        inside = np.clip(x, self.x[0], self.x[-1])
        unit = np.eye(len(self.x))
        if len(self.x) > 3:
            weights = CubicSpline(self.x, unit)(inside)
        else:
            weights = np.stack([np.interp(inside, self.x, row) for row in unit], axis=1)
        return self.errors.mapped(lambda part: np.tensordot(weights, part, axes=1))


def deviation(key: str, value: Any) -> float:
    """Return a relative standard deviation, given as 0.2 or "20 %".

    Raises:
        InputError: the value is not allowed.
    """
    deviation = fraction(key, value, ALLOWED)
    if not 0 < deviation <= LARGEST:
        raise InputError(key, value, ALLOWED)
    return deviation


def checked(scene: Scene, given: Mapping[str, Any], unknown: str) -> dict[str, float]:
    """Return relative standard deviations as numbers, by the keys of the scene's numbers.

    Raises:
        InputError: the scene has no such number, or it is the unknown, or its standard deviation is not allowed.
    """
    asked = f"inclusion.{unknown}" if len(scene.inclusion) == 1 else unknown
    lossy = [name for name, loss in loss_factors(scene).items() if loss]
    allowed = [name for name in (*values(scene), *lossy) if name not in (asked, unknown) and not name.endswith("poisson_ratio")]
    for name in given:
        if name not in allowed:
            raise InputError("nuisance", name, one_of(name, allowed))
    return {name: deviation(f"nuisance.{name}", value) for name, value in given.items()}


def spread(
    model: TargetModel, nuisances: Mapping[str, float], x: Floats, at: dict[str, Floats], middle: Predicted | None = None
) -> Spread:
    """Return the errors that nuisances cause along an unknown.

    Args:
        model: see ``TargetModel``.
        nuisances: standard deviations of logarithms by name.
        x: coordinates of the unknown, shape (n,).
        unknown_values: the unknown's name and its values at x, SI.
        centre: predictions at x, if they are known already.

    Raises:
        InputError: one standard deviation off, the scene is not valid, or the model cannot predict the data.
    """
    middle = _predict(model, at) if middle is None else middle
    moved = partial(_moved, model, nuisances, at, middle)
    units = np.eye(len(nuisances))
    axes = [_axis(moved, unit) for unit in units]
    terms = {_powers(power * unit): axis[power - 1] for unit, axis in zip(units, axes, strict=True) for power in (3, 4)}
    for i, j in combinations(range(len(nuisances)), 2):
        terms |= _products(moved, (units[i], units[j]), (axes[i], axes[j]))
    line, bend = (np.stack([axis[k] for axis in axes], axis=-1) for k in (0, 1))
    return Spread(x, SharedErrors(line, bend, np.stack(list(terms.values()), axis=-1), tuple(terms)))


def _axis(moved: Callable[[Floats], Floats], unit: Floats) -> list[Floats]:
    """Return the coefficients of the first four powers of one number."""
    above, below = moved(unit), moved(-unit)
    odd, even = (above - below) / 2, (above + below) / 2
    try:
        above, below = moved(FAR * unit), moved(-FAR * unit)
    except InputError:
        return [odd, even, np.zeros_like(odd), np.zeros_like(odd)]
    cube = ((above - below) / 2 - FAR * odd) / (FAR**3 - FAR)
    fourth = ((above + below) / 2 - FAR**2 * even) / (FAR**4 - FAR**2)
    return [odd - cube, even - fourth, cube, fourth]


def _products(
    moved: Callable[[Floats], Floats], units: tuple[Floats, Floats], axes: tuple[list[Floats], list[Floats]]
) -> dict[tuple[int, ...], Floats]:
    """Return the coefficients of products of powers of two numbers; none where both cannot deviate at once."""
    for corner in (CORNER, 1.0):
        rest = {}
        try:
            for signs in product((1, -1), repeat=2):
                rest[signs] = moved(corner * (signs[0] * units[0] + signs[1] * units[1]))
        except InputError:
            continue
        for signs in rest:
            for sign, axis in zip(signs, axes, strict=True):
                rest[signs] = rest[signs] - sum(part * (sign * corner) ** (k + 1) for k, part in enumerate(axis))
        return {
            _powers(i * units[0] + j * units[1]): np.asarray(sum(a**i * b**j * one for (a, b), one in rest.items()))
            / (4 * corner ** (i + j))
            for i, j in product((1, 2), repeat=2)
        }
    return {}


def _powers(of: Floats) -> tuple[int, ...]:
    """Return exponents as integers."""
    return tuple(int(power) for power in of)


def _moved(model: TargetModel, nuisances: Mapping[str, float], at: dict[str, Floats], middle: Predicted, eta: Floats) -> Floats:
    """Return the change of predictions where numbers deviate by eta standard deviations, shape (n, k).

    Raises:
        InputError: the scene is not valid, or the model cannot predict the data.
    """
    told = values(model.scene) | loss_factors(model.scene)
    off = {name: (sd, step) for (name, sd), step in zip(nuisances.items(), eta, strict=True) if step}
    new = {name: told[name] * math.exp(sd * step) for name, (sd, step) in off.items()}
    name, (sd, _) = next(iter(off.items()))
    try:
        found = _predict(model, at, new)
    except (ProbeError, ValueError) as fault:
        why = f"one that leaves {name} = {new[name]:.4g} possible ({fault})"
        raise InputError(f"nuisance.{name}", Words(f"{sd:g}"), why) from None
    if not (found.resolved & (found.agrees == middle.agrees)).all():  # a change of sign would make logarithms incomparable
        raise InputError(f"nuisance.{name}", sd, "a smaller one: the model cannot predict readings at so large a deviation")
    return np.asarray(found.value - middle.value)


def _predict(model: TargetModel, at: dict[str, Floats], new: Mapping[str, float] = MappingProxyType({})) -> Predicted:
    """Predict along an unknown of the target, or of the tissue, in a scene with other numbers."""
    ((unknown, along),) = at.items()
    if unknown in OF_TARGET:
        return (model.changed(new) if new else model).predict(at)
    return Predicted.joined([model.changed({unknown: float(value)} | dict(new)).predict({}) for value in along])
