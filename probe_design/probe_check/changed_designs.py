"""Fit variables of the design to the readings of a built probe: damped Gauss-Newton, with the design solved at each step.

Positive variables are changed by factors, so that a modulus three times too small is as near as one three times too large.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import ProbeError
from geometry.scenes.scene import Scene
from geometry.scenes.variables import changed
from probe_design.built_probe.bench import Bench
from probe_design.built_probe.block_predictions import MODULI, Shares, by_outer_radius, predicted
from probe_design.probe_check.deviation import Deviation

GAIN = "relative gain"
STEPS = 12  # of Gauss-Newton
HALVINGS = 6  # of a step that leads to an invalid or worse design
LARGEST = 0.7  # step of ln(value): a factor of 2
SETTLED = 0.05  # step over standard deviation at which the fit has converged
LITTLE = 0.01  # relative decrease of chi-square below which no further step is made


@dataclass(frozen=True)
class Changes:
    """A changed design: values of n variables, one or two, in place of the drawn ones.

    A step is a change of ln(value); of a Poisson's ratio a change of the value.

    Attributes:
        drawn: the scene as drawn, its probe given by its outer radius.
        bench: for its blocks.
        names: of the variables.
        nominal, values: as drawn and as changed, SI; 1 for GAIN_NAME and BLOCK_MODULI, shape (n,).
        there: predictions for the changed design.
    """

    drawn: Scene
    bench: Bench
    names: tuple[str, ...]
    nominal: Floats
    values: Floats
    there: Shares

    @classmethod
    def none(cls, scene: Scene, bench: Bench, shares: Shares, name: str) -> Changes:
        """Start from the design as drawn, with known predictions, to change one variable."""
        nominal = np.array([_nominal(shares, name)])
        return cls(by_outer_radius(scene), bench, (name,), nominal, nominal, shares)

    def and_other(self, shares: Shares, name: str) -> Changes:
        """Add a second variable, with its drawn value."""
        nominal = _nominal(shares, name)
        names, both = (*self.names, name), np.append(self.nominal, nominal)
        return replace(self, names=names, nominal=both, values=np.append(self.values, nominal))

    @property
    def per_step(self) -> Floats:
        """Derivatives of the values with respect to the steps, shape (n,)."""
        return np.array([1.0 if _additive(name) else value for name, value in zip(self.names, self.values, strict=True)])

    def moved(self, steps: Floats) -> Changes | None:
        """Apply steps, shape (n,); return None if the design is invalid, or the evaluator refuses it."""
        moves = zip(self.names, self.values, steps, strict=True)
        values = np.array([value + step if _additive(name) else value * np.exp(step) for name, value, step in moves])
        try:
            return replace(self, values=values, there=self._predicted(values))
        except (ValueError, ProbeError):  # pydantic's and ours
            return None

    def left(self, deviation: Deviation) -> Floats:
        """Return the deviation that remains with the changed design, shape (k,)."""
        off = deviation.logs - self.there.log_ratios
        for name, value, nominal in zip(self.names, self.values, self.nominal, strict=True):
            off = off - np.log(value) if name == GAIN else off + deviation.bias(name) * (value - nominal)
        return np.asarray(off)

    def slopes(self, deviation: Deviation, names: tuple[str, ...] = ()) -> Floats:
        """Return the deviation's derivatives with respect to steps of ``names``, or of its own variables, shape (k, n)."""
        return np.stack([self._slope(deviation, name) for name in names or self.names], axis=1)

    def _slope(self, deviation: Deviation, name: str) -> Floats:
        if name == GAIN:
            return np.ones(len(deviation.logs))
        slope = self.there.slopes[:, self.there.variables.index(name)]
        if name == MODULI:  # already a derivative with respect to ln of the blocks' moduli
            return slope
        value = dict(zip(self.names, self.values, strict=True)).get(name, _nominal(self.there, name))
        return (slope - deviation.bias(name)) * (1.0 if _additive(name) else value)

    def _predicted(self, values: Floats) -> Shares:
        new = dict(zip(self.names, values.tolist(), strict=True))
        new.pop(GAIN, None)
        if not new:
            return self.there
        factor = new.pop(MODULI, 1.0)
        blocks = [one.model_copy(update={"youngs_modulus": (one.youngs_modulus or 0.0) * factor}) for one in self.bench.blocks]
        return predicted(changed(self.drawn, new), blocks)


@dataclass(frozen=True)
class Fit:
    """The changes of a design that explain a deviation best.

    Attributes:
        changes: of n variables.
        chi_square: of the remaining deviation.
        uncertainties: standard deviations of the values, SI, shape (n,).
    """

    changes: Changes
    chi_square: float
    uncertainties: Floats


def settled(changes: Changes, deviation: Deviation) -> Fit:
    """Fit the variables' values to a deviation, starting from the present ones."""
    weight = deviation.weight(*changes.names)
    for k in range(STEPS):
        step, spread = _newton(changes, deviation, weight)
        if k and _promised(changes, deviation, weight, step) < LITTLE * (1.0 + _chi_square(changes, deviation, weight)):
            break  # saves solving a design that is no better; not at first, where linear theory may miss an improvement
        nearer = _nearer(changes, deviation, weight, step * (LARGEST / max(LARGEST, float(np.abs(step).max()))))
        if nearer is None:
            break
        gained = _chi_square(changes, deviation, weight) - _chi_square(nearer, deviation, weight)
        changes = nearer
        if np.all(np.abs(step) < SETTLED * spread) or gained < LITTLE * (1.0 + _chi_square(nearer, deviation, weight)):
            break
    _, spread = _newton(changes, deviation, weight)
    return Fit(changes, _chi_square(changes, deviation, weight), spread * changes.per_step)


def linear_left(fit: Fit, deviation: Deviation, other: str) -> float:
    """Predict the chi-square with a second variable, by linear theory about a fit of one."""
    names = (*fit.changes.names, other)
    weight = deviation.weight(*names)
    slopes, off = fit.changes.slopes(deviation, names), fit.changes.left(deviation)
    root = np.linalg.cholesky(weight).T
    steps = np.linalg.lstsq(root @ slopes, root @ off)[0]
    rest = off - slopes @ steps
    return float(rest @ weight @ rest)


def _newton(changes: Changes, deviation: Deviation, weight: Floats) -> tuple[Floats, Floats]:
    """Return the Gauss-Newton step and its standard deviations, shape (n,) each."""
    slopes, root = changes.slopes(deviation), np.linalg.cholesky(weight).T
    step = np.linalg.lstsq(root @ slopes, root @ changes.left(deviation))[0]
    information = slopes.T @ weight @ slopes
    scale = np.sqrt(np.maximum(np.diag(information), np.finfo(float).tiny))
    spread = np.sqrt(np.diag(np.linalg.pinv(information / np.outer(scale, scale)))) / scale
    return np.asarray(step), np.asarray(spread)


def _promised(changes: Changes, deviation: Deviation, weight: Floats, step: Floats) -> float:
    """Return the decrease of chi-square by a step, by linear theory."""
    moved = changes.slopes(deviation) @ step
    return float(moved @ weight @ moved)


def _nearer(changes: Changes, deviation: Deviation, weight: Floats, step: Floats) -> Changes | None:
    """Return the changes after a step, which is halved until chi-square decreases, or None."""
    before = _chi_square(changes, deviation, weight)
    for halving in range(HALVINGS):
        there = changes.moved(step / 2**halving)
        if there is not None and _chi_square(there, deviation, weight) < before:
            return there
    return None


def _chi_square(changes: Changes, deviation: Deviation, weight: Floats) -> float:
    rest = changes.left(deviation)
    return float(rest @ weight @ rest)


def _nominal(shares: Shares, name: str) -> float:
    return 1.0 if name == GAIN else float(shares.nominal[shares.variables.index(name)])


def _additive(name: str) -> bool:
    return name.endswith("poisson_ratio")
