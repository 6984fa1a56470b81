"""Fit variables of the design to the readings of a built probe: damped Gauss-Newton, with the design solved at each step.

Positive variables are changed by factors, so that a modulus three times too small is as near as one three times too large.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import ProbeError
from geometry.scenes.scene import Scene
from probe_design.built_probe.bench import Bench
from probe_design.built_probe.block_predictions import BLOCK_MODULI, BlockPredictions, express_by_outer_radius, predict_blocks
from probe_design.inference.linear_gaussian import LinearGaussian
from probe_design.probe_check.deviation import Deviation

GAIN_NAME = "relative gain"
MAX_STEPS = 12  # of Gauss-Newton
MAX_HALVINGS = 6  # of a step that leads to an invalid or worse design
MAX_STEP = 0.7  # step of ln(value): a factor of 2
UNKNOWN_STEP_SD = 1e6  # of a step before the readings: nothing is known, and results stay finite
STEP_TOLERANCE_SD = 0.05  # step over standard deviation at which the fit has converged
MIN_RELATIVE_GAIN = 0.01  # relative decrease of chi-square below which no further step is made


@dataclass(frozen=True)
class Changes:
    """A changed design: values of n variables, one or two, in place of the drawn ones.

    A step is a change of ln(value); of a Poisson's ratio a change of the value.

    Attributes
    ----------
    drawn
        The scene as drawn, its probe given by its outer radius.
    bench
        For its blocks.
    names
        Of the variables.
    nominal, values
        As drawn and as changed, SI; 1 for GAIN_NAME and BLOCK_MODULI, shape (n,).
    predictions
        For the changed design.
    """

    drawn: Scene
    bench: Bench
    names: tuple[str, ...]
    nominal: Floats
    values: Floats
    predictions: BlockPredictions

    @classmethod
    def from_drawing(cls, scene: Scene, bench: Bench, predictions: BlockPredictions, name: str) -> Changes:
        """Start from the design as drawn, to change the variable ``name``; ``predictions`` are for the design as drawn."""
        nominal = np.array([_get_nominal(predictions, name)])
        return cls(express_by_outer_radius(scene), bench, (name,), nominal, nominal, predictions)

    def add_variable(self, predictions: BlockPredictions, name: str) -> Changes:
        """Add a second variable, with its drawn value."""
        nominal = _get_nominal(predictions, name)
        names, nominals = (*self.names, name), np.append(self.nominal, nominal)
        return replace(self, names=names, nominal=nominals, values=np.append(self.values, nominal))

    @property
    def per_step(self) -> Floats:
        """Derivatives of the values with respect to the steps, shape (n,)."""
        return np.array([1.0 if _is_additive(name) else value for name, value in zip(self.names, self.values, strict=True)])

    def apply_steps(self, steps: Floats) -> Changes | None:
        """Apply steps, shape (n,); return None if the design is invalid, or the evaluator refuses it."""
        moves = zip(self.names, self.values, steps, strict=True)
        values = np.array([value + step if _is_additive(name) else value * np.exp(step) for name, value, step in moves])
        try:
            return replace(self, values=values, predictions=self._predict(values))
        except (ValueError, ProbeError):  # ValueError: pydantic's, for an invalid scene
            return None

    def compute_residual(self, deviation: Deviation) -> Floats:
        """Return the deviation that remains with the changed design, shape (k,): readings less predictions on k blocks.

        The predictions follow the changed design. A gain shifts all readings by its logarithm; the calibration, which assumed the
        drawing, shifts them by its bias.
        """
        residual = deviation.logs - self.predictions.log_ratios
        for name, value, nominal in zip(self.names, self.values, self.nominal, strict=True):
            residual = residual - np.log(value) if name == GAIN_NAME else residual + deviation.get_bias(name) * (value - nominal)
        return np.asarray(residual)

    def compute_derivatives(self, deviation: Deviation, names: tuple[str, ...] = ()) -> Floats:
        """Return the deviation's derivatives with respect to steps of variables, shape (k, n).

        These are ``names``; if empty, the changed variables.
        """
        return np.stack([self._compute_derivative(deviation, name) for name in names or self.names], axis=1)

    def _compute_derivative(self, deviation: Deviation, name: str) -> Floats:
        """Return the deviation's derivative with respect to a step of one variable, shape (k,)."""
        if name == GAIN_NAME:
            return np.ones(len(deviation.logs))
        derivative = self.predictions.derivatives[:, self.predictions.variables.index(name)]
        if name == BLOCK_MODULI:  # already with respect to ln of the blocks' moduli
            return derivative
        value = dict(zip(self.names, self.values, strict=True)).get(name, _get_nominal(self.predictions, name))
        return (derivative - deviation.get_bias(name)) * (1.0 if _is_additive(name) else value)  # d value = value d ln(value)

    def _predict(self, values: Floats) -> BlockPredictions:
        """Predict the blocks for changed values of the variables."""
        new = dict(zip(self.names, values.tolist(), strict=True))
        new.pop(GAIN_NAME, None)
        if not new:
            return self.predictions
        factor = new.pop(BLOCK_MODULI, 1.0)
        blocks = [
            block.model_copy(update={"youngs_modulus": (block.youngs_modulus or 0.0) * factor}) for block in self.bench.blocks
        ]
        light = predict_blocks(self.drawn.replace(new), blocks, limit_loads=False)
        steps = {
            name: value - nominal if _is_additive(name) else nominal * math.log(value / nominal)
            for name, value, nominal in zip(self.names, values.tolist(), self.nominal.tolist(), strict=True)
        }
        return light.carry_loads(self.predictions, steps)


@dataclass(frozen=True)
class Fit:
    """The changes of a design that explain a deviation best.

    Attributes
    ----------
    changes
        Of n variables.
    chi_square
        Of the remaining deviation.
    uncertainties
        Standard deviations of the values, SI, shape (n,).
    """

    changes: Changes
    chi_square: float
    uncertainties: Floats


def fit_changes(changes: Changes, deviation: Deviation) -> Fit:
    """Fit the variables' values to a deviation by damped Gauss-Newton steps, starting from the values in ``changes``."""
    errors = deviation.build_errors(*changes.names)
    chi_square = _compute_chi_square(changes, deviation, errors)
    for k in range(MAX_STEPS):
        model = _build_linear_model(changes, deviation, errors)
        step = model.compute_posterior_mean(changes.compute_residual(deviation))[: len(changes.names)]
        expected_gain = float(errors.compute_chi_square(changes.compute_derivatives(deviation) @ step))
        if k and expected_gain < MIN_RELATIVE_GAIN * (1.0 + chi_square):
            break  # saves solving a design that is no better; not at first, where linear theory may miss an improvement
        better = _halve_step(changes, deviation, errors, step * (MAX_STEP / max(MAX_STEP, float(np.abs(step).max()))))
        if better is None:
            break
        changes, previous, chi_square = better, chi_square, _compute_chi_square(better, deviation, errors)
        is_converged = np.all(np.abs(step) < STEP_TOLERANCE_SD * _compute_sds(model, len(changes.names)))
        if is_converged or previous - chi_square < MIN_RELATIVE_GAIN * (1.0 + chi_square):
            break
    sds = _compute_sds(_build_linear_model(changes, deviation, errors), len(changes.names))
    return Fit(changes, chi_square, sds * changes.per_step)


def predict_chi_square(fit: Fit, deviation: Deviation, second_name: str) -> float:
    """Predict the chi-square if a second variable were fitted, too, by linear theory about a fit of one variable."""
    names = (*fit.changes.names, second_name)
    model = _build_linear_model(fit.changes, deviation, deviation.build_errors(*names), names)
    return float(model.compute_chi_square(fit.changes.compute_residual(deviation)))


def _build_linear_model(
    changes: Changes, deviation: Deviation, errors: LinearGaussian, names: tuple[str, ...] = ()
) -> LinearGaussian:
    """Return the linear model of a deviation: its errors, and as unknowns the steps of variables, with a very wide prior.

    The variables are ``names``; if empty, the changed ones.
    """
    derivatives = changes.compute_derivatives(deviation, names)
    return errors.add_unknowns(derivatives, np.full(derivatives.shape[1], UNKNOWN_STEP_SD))


def _compute_sds(model: LinearGaussian, n: int) -> Floats:
    """Return the standard deviations of the steps, which are the first n unknowns, shape (n,)."""
    return np.asarray(np.sqrt(np.diag(model.compute_posterior_covariance())[:n]))


def _halve_step(changes: Changes, deviation: Deviation, errors: LinearGaussian, step: Floats) -> Changes | None:
    """Return the changed design after a step, halved until chi-square decreases; None if it never does.

    Parameters
    ----------
    changes
        The design before the step.
    deviation, errors
        Of the readings from the predictions as drawn.
    step
        Of each variable, shape (n,); it is halved at most ``MAX_HALVINGS`` - 1 times.
    """
    initial = _compute_chi_square(changes, deviation, errors)
    for halving in range(MAX_HALVINGS):
        candidate = changes.apply_steps(step / 2**halving)
        if candidate is not None and _compute_chi_square(candidate, deviation, errors) < initial:
            return candidate
    return None


def _compute_chi_square(changes: Changes, deviation: Deviation, errors: LinearGaussian) -> float:
    """Return the chi-square of the deviation that remains with the changed design."""
    return float(errors.compute_chi_square(changes.compute_residual(deviation)))


def _get_nominal(predictions: BlockPredictions, name: str) -> float:
    """Return a variable's value as drawn, SI; 1 for the relative gain."""
    return 1.0 if name == GAIN_NAME else float(predictions.nominal[predictions.variables.index(name)])


def _is_additive(name: str) -> bool:
    """Whether a variable is changed by adding to it, not by a factor."""
    return name.endswith("poisson_ratio")
