"""Interpolate predictions along one unknown from few bodies.

Between nodes the predictions are cubic Hermite polynomials of a coordinate x(unknown), in which the film forces are nearly
polynomials:

    youngs_modulus   x = -1 / (1 + beta (c - 1)),  c = E_object / E_tissue, beta as in eq. ES.1 of ``strength.py``
    diameter         x = diameter over the largest that fits
    depth            x = ln depth; likewise a layer's thickness or modulus, the tissue's modulus      (ES.2)

The strength of a sphere is linear in the first coordinate, which tends to 0 for ever stiffer bodies. The derivatives at the nodes
are the evaluator's for E_object, otherwise those of a cubic spline through the values.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicSpline

from geometry.common.arrays import Bools, Floats, Ints
from geometry.common.errors import InputError, ProbeError
from probe_design.estimation.model import OF_TARGET, TargetModel
from probe_design.estimation.nuisances import Spread, spread
from probe_design.estimation.predicted import Predicted
from probe_design.estimation.shared_errors import SharedErrors
from probe_design.estimation.strength import share_of_shear
from solver.equivalent_inclusion.level import EquivalentInclusion
from solver.results.result import Decision

SOFT = (0.01, 0.04, 0.1, 0.22, 0.45)  # contrasts E_object / E_tissue of the nodes below 1, where predictions change fast
STIFF = 5  # nodes from contrast 1 to the largest
SIZES = (0.01, 0.14, 0.26, 0.36, 0.45, 0.53, 0.6, 0.67, 0.74, 0.8, 0.86, 0.91, 0.96, 1.0)
DEPTHS = 20
TISSUES = 17  # nodes along a number of the tissue
SPREADS, ROUGH = 6, 5  # nodes at which nuisances are varied: for unknowns of the target, and of the tissue
FINER = 100  # points of a run from node to node


@dataclass(frozen=True)
class Track:
    """Predictions along one unknown.

    Attributes:
        model: scene and data.
        unknown: youngs_modulus, diameter or depth, or the key of a number of the tissue.
        x: eq. ES.2 at the nodes, increasing, shape (n,).
        predicted: at the nodes.
        slope: derivatives of ``predicted.value`` by x, shape (n, k).
        spread: eq. ES.7; None without nuisances.
        evaluator: its name.
        plan: decisions beyond those of ``model``.
        finer: points of ``runs`` from node to node.
    """

    model: TargetModel
    unknown: str
    x: Floats
    predicted: Predicted
    slope: Floats
    spread: Spread | None = None
    level: str = EquivalentInclusion.name
    plan: tuple[Decision, ...] = ()
    finer: int = FINER

    @classmethod
    def of(cls, model: TargetModel, unknown: str) -> Track:
        """Predict the data at all nodes of the unknown."""
        if unknown not in OF_TARGET:
            return cls._of_tissue(model, unknown)
        low, high = model.span(unknown)
        x = _nodes(model, unknown, low, high)
        values = _value_at(model, unknown, x)
        predicted = model.predict({unknown: values})
        if unknown == "youngs_modulus":
            return cls(model, unknown, x, predicted, predicted.by_modulus / _by_log_modulus(model, values)[:, None])
        return cls(model, unknown, x, predicted, _splined(x, predicted))

    @classmethod
    def _of_tissue(cls, model: TargetModel, unknown: str) -> Track:
        """Predict along a number of the tissue; each value needs a new solution of the probe on the tissue."""
        x = np.log(np.geomspace(*model.span(unknown), TISSUES))
        predicted = Predicted.joined([_with(model, unknown, value) for value in np.exp(x)])
        return cls(model, unknown, x, predicted, _splined(x, predicted))

    def with_spread(self, nuisances: Mapping[str, float]) -> Track:
        """Return the track with the errors by nuisances, given as relative standard deviations by name.

        They are computed at some of the nodes, as they change slowly. For a number of the tissue they are computed at the scene's
        value alone where the scene is not valid with these nuisances at other values.
        """
        if not nuisances or not self.runs:
            return self
        usable = np.flatnonzero(self.predicted.usable)
        nodes = np.unique(
            usable[np.linspace(0, len(usable) - 1, SPREADS if self.unknown in OF_TARGET else ROUGH).round().astype(int)]
        )
        try:
            return replace(self, spread=self._spread(nuisances, nodes))
        except InputError:
            own = len(self.x) // 2  # the range is about the scene's own value
            if self.unknown in OF_TARGET or own not in usable:
                raise
            return replace(self, spread=self._spread(nuisances, np.array([own])))

    def _spread(self, nuisances: Mapping[str, float], nodes: Ints) -> Spread:
        x = self.x[nodes]
        return spread(self.model, nuisances, x, {self.unknown: self.values(x)}, self.predicted.rows(nodes))

    def exact(self) -> Track:
        """Return the track with error bounds of zero."""
        return replace(self, predicted=replace(self.predicted, bound=np.zeros_like(self.predicted.bound)))

    def shared(self, x: Floats) -> SharedErrors:
        """Return the errors that the data share at points of shape (s,), eq. ES.7."""
        return SharedErrors.none(self.predicted.value.shape[1]) if self.spread is None else self.spread.at(x)

    def values(self, x: Floats) -> Floats:
        """Return values of the unknown, SI, at coordinates x."""
        return _value_at(self.model, self.unknown, np.asarray(x, dtype=float))

    def at(self, x: Floats) -> tuple[Floats, Floats]:
        """Return predictions and their derivatives by x at points of shape (s,): two of shape (s, k)."""
        cell = np.clip(np.searchsorted(self.x, x, side="right") - 1, 0, len(self.x) - 2)
        step = (self.x[cell + 1] - self.x[cell])[:, None]
        t = (x - self.x[cell])[:, None] / step
        low, high = self.predicted.value[cell], self.predicted.value[cell + 1]
        left, right = self.slope[cell] * step, self.slope[cell + 1] * step
        bend, twist = 3 * (high - low) - 2 * left - right, 2 * (low - high) + left + right
        return low + t * (left + t * (bend + t * twist)), (left + t * (2 * bend + t * 3 * twist)) / step

    @cached_property
    def runs(self) -> list[Floats]:
        """Points along the unknown, as one array for each run of neighbouring usable nodes."""
        share = np.arange(self.finer) / self.finer
        cells = self.x[:-1, None] + np.diff(self.x)[:, None] * share
        return [np.append(cells[run[:-1]].ravel(), self.x[run[-1]]) for run in _runs(self.predicted.usable) if len(run) > 1]


def _splined(x: Floats, predicted: Predicted) -> Floats:
    """Return derivatives by x at the nodes, of a cubic spline through each run of usable values; 0 elsewhere."""
    slope = np.zeros_like(predicted.value)
    for run in _runs(predicted.usable):
        if len(run) > 1:
            slope[run] = CubicSpline(x[run], predicted.value[run])(x[run], 1)
    return slope


def _with(model: TargetModel, unknown: str, value: float) -> Predicted:
    """Predict with another number of the tissue; not resolved where the scene is not valid or cannot be modelled."""
    try:
        return model.changed({unknown: float(value)}).predict({})
    except (ProbeError, ValueError):
        return Predicted.empty(1, len(model.data.value), resolved=False)


def _runs(good: Bools) -> list[Ints]:
    """Return the indices of each run of neighbouring true elements."""
    indices = np.flatnonzero(good)
    return [run for run in np.split(indices, np.flatnonzero(np.diff(indices) > 1) + 1) if len(run)]


def _nodes(model: TargetModel, unknown: str, low: float, high: float) -> Floats:
    """Return the coordinates x of the nodes between two values of the unknown, SI."""
    if unknown == "diameter":
        return np.array(SIZES)
    ends = coordinate(model, unknown, np.array([low, high]))
    if unknown == "depth":
        return np.linspace(ends[0], ends[1], DEPTHS)
    soft = coordinate(model, unknown, np.array([c * model.host.youngs_modulus for c in SOFT]))
    stiff = np.linspace(-1.0, ends[1], STIFF)
    return np.concatenate([ends[:1], soft[soft > ends[0]], stiff])


def _beta(model: TargetModel) -> float:
    """Return beta of eq. ES.1 for the tissue around the target."""
    return share_of_shear(model.host)


def coordinate(model: TargetModel, unknown: str, values: Floats) -> Floats:
    """Return x of eq. ES.2 for values of the unknown, SI, shape (n,)."""
    if unknown == "youngs_modulus":
        return np.asarray(-1 / (1 + _beta(model) * (values / model.host.youngs_modulus - 1)))
    return np.asarray(values / model.span("diameter")[1]) if unknown == "diameter" else np.log(values)


def _value_at(model: TargetModel, unknown: str, x: Floats) -> Floats:
    """Return values of the unknown, SI, at coordinates x: the inverse of eq. ES.2."""
    if unknown == "youngs_modulus":
        return np.asarray(model.host.youngs_modulus * (1 + (-1 / x - 1) / _beta(model)))
    return np.asarray(x * model.span("diameter")[1]) if unknown == "diameter" else np.exp(x)


def _by_log_modulus(model: TargetModel, moduli: Floats) -> Floats:
    """Return the derivative of x, eq. ES.2, by ln E_object at moduli, Pa: d x / d ln E = beta c x^2, c = E / E_tissue."""
    x = coordinate(model, "youngs_modulus", moduli)
    return np.asarray(_beta(model) * moduli / model.host.youngs_modulus * x**2)
