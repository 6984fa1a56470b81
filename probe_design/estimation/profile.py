"""Interpolate predictions along one unknown from few bodies.

Between nodes the predictions are cubic Hermite polynomials of a coordinate x(unknown), in which the film forces are nearly
polynomials:

    youngs_modulus   x = -1 / (1 + beta (c - 1)),  c = E_object / E_tissue, beta as in eq. ES.1 of ``model.py``
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
from scipy.interpolate import CubicHermiteSpline, CubicSpline

from geometry.common.arrays import Bools, Floats, Ints
from geometry.common.errors import InputError, ProbeError
from probe_design.estimation.model import TARGET_UNKNOWNS, TargetModel
from probe_design.estimation.nuisances import NuisanceErrors, SharedErrors, compute_nuisance_errors
from probe_design.estimation.predictions import Predictions
from solver.equivalent_inclusion.evaluator import EquivalentInclusion
from solver.results.result import Decision

SOFT_CONTRASTS = (0.01, 0.04, 0.1, 0.22, 0.45)  # E_object / E_tissue of the nodes below 1, where predictions change fast
STIFF_NODES = 5  # nodes from contrast 1 to the largest
RELATIVE_DIAMETERS = (0.01, 0.14, 0.26, 0.36, 0.45, 0.53, 0.6, 0.67, 0.74, 0.8, 0.86, 0.91, 0.96, 1.0)
DEPTH_NODES = 20
TISSUE_NODES = 17  # nodes along a number of the tissue
TARGET_SPREAD_NODES, TISSUE_SPREAD_NODES = 6, 5  # at which nuisances are varied, for unknowns of the target and of the tissue
POINTS_PER_NODE = 100  # points of a run from node to node


@dataclass(frozen=True)
class Track:
    """Predictions along one unknown.

    Attributes
    ----------
    model
        Scene and data.
    unknown
        youngs_modulus, diameter or depth, or the key of a number of the tissue.
    x
        eq. ES.2 at the nodes, increasing, shape (n,).
    predicted
        At the nodes.
    derivative
        Derivatives of ``predicted.value`` with respect to x, shape (n, k).
    spread
        eq. ES.7; None without nuisances.
    evaluator
        Name of the evaluator.
    plan
        Decisions beyond those of ``model``.
    points_per_node
        Points of ``runs`` from node to node.
    """

    model: TargetModel
    unknown: str
    x: Floats
    predicted: Predictions
    derivative: Floats
    spread: NuisanceErrors | None = None
    evaluator: str = EquivalentInclusion.name
    plan: tuple[Decision, ...] = ()
    points_per_node: int = POINTS_PER_NODE

    @classmethod
    def from_model(cls, model: TargetModel, unknown: str) -> Track:
        """Predict the data at all nodes of the unknown."""
        low, high = model.find_search_range(unknown)
        if unknown not in TARGET_UNKNOWNS:  # each value needs a new solution of the probe on the tissue
            x = np.log(np.geomspace(low, high, TISSUE_NODES))
            predicted = Predictions.join([_predict_tissue(model, unknown, value) for value in np.exp(x)])
            return cls(model, unknown, x, predicted, _differentiate_by_spline(x, predicted), evaluator=model.evaluator)
        x = _choose_nodes(model, unknown, low, high)
        values = _invert_coordinate(model, unknown, x)
        predicted = model.predict({unknown: values})
        if unknown == "youngs_modulus":  # d x / d ln E = beta c x^2
            d_x = model.beta * values / model.host.youngs_modulus * x**2
            return cls(model, unknown, x, predicted, predicted.by_modulus / d_x[:, None], evaluator=model.evaluator)
        return cls(model, unknown, x, predicted, _differentiate_by_spline(x, predicted), evaluator=model.evaluator)

    def add_nuisances(self, nuisances: Mapping[str, float]) -> Track:
        """Return the track with the errors by nuisances, for relative standard deviations by name.

        They are computed at some of the nodes, as they change slowly. For a number of the tissue they are computed at the scene's
        value alone where the scene is not valid with these nuisances at other values.
        """
        if not nuisances or not self.runs:
            return self
        usable_nodes = np.flatnonzero(self.predicted.usable)
        count = TARGET_SPREAD_NODES if self.unknown in TARGET_UNKNOWNS else TISSUE_SPREAD_NODES
        nodes = np.unique(usable_nodes[np.linspace(0, len(usable_nodes) - 1, count).round().astype(int)])
        try:
            return self._add_nuisances(nuisances, nodes)
        except InputError:
            middle = len(self.x) // 2  # the range is about the scene's own value
            if self.unknown in TARGET_UNKNOWNS or middle not in usable_nodes:
                raise
            return self._add_nuisances(nuisances, np.array([middle]))

    def _add_nuisances(self, nuisances: Mapping[str, float], nodes: Ints) -> Track:
        """Return the track with the errors by nuisances, computed at some of its nodes."""
        x, centre = self.x[nodes], self.predicted.select_rows(nodes)
        values = {self.unknown: self.compute_values(x)}
        return replace(self, spread=compute_nuisance_errors(self.model, nuisances, x, values, centre))

    def remove_model_error(self) -> Track:
        """Return the track with error bounds of zero."""
        return replace(self, predicted=replace(self.predicted, bound=np.zeros_like(self.predicted.bound)))

    def compute_shared_errors(self, x: Floats) -> SharedErrors:
        """Return the errors that the data share at points of shape (s,), eq. ES.7."""
        return (
            SharedErrors.from_linear(np.zeros((self.predicted.value.shape[1], 0)))
            if self.spread is None
            else self.spread.interpolate(x)
        )

    def compute_values(self, x: Floats) -> Floats:
        """Return values of the unknown, SI, at coordinates x."""
        return _invert_coordinate(self.model, self.unknown, np.asarray(x, dtype=float))

    def interpolate(self, x: Floats) -> tuple[Floats, Floats]:
        """Return predictions and their derivatives with respect to x at s points, both of shape (s, k)."""
        return self._spline(x), self._spline(x, 1)

    @cached_property
    def _spline(self) -> CubicHermiteSpline:
        """The predictions between the nodes."""
        return CubicHermiteSpline(self.x, self.predicted.value, self.derivative)

    @cached_property
    def runs(self) -> list[Floats]:
        """Points along the unknown, as one array for each run of neighbouring usable nodes."""
        fractions = np.arange(self.points_per_node) / self.points_per_node
        cells = self.x[:-1, None] + np.diff(self.x)[:, None] * fractions
        return [np.append(cells[run[:-1]].ravel(), self.x[run[-1]]) for run in _split_runs(self.predicted.usable) if len(run) > 1]


def _differentiate_by_spline(x: Floats, predicted: Predictions) -> Floats:
    """Return derivatives with respect to x at the nodes, of a cubic spline through each run of usable values; 0 elsewhere."""
    derivative = np.zeros_like(predicted.value)
    for run in _split_runs(predicted.usable):
        if len(run) > 1:
            derivative[run] = CubicSpline(x[run], predicted.value[run])(x[run], 1)
    return derivative


def _predict_tissue(model: TargetModel, unknown: str, value: float) -> Predictions:
    """Predict with another number of the tissue; not resolved where the scene is not valid or cannot be modelled."""
    try:
        return model.replace_values({unknown: float(value)}).predict({})
    except (ProbeError, ValueError):
        return Predictions.empty(1, len(model.data.value), resolved=False)


def _split_runs(is_good: Bools) -> list[Ints]:
    """Return the indices of each run of neighbouring true elements."""
    indices = np.flatnonzero(is_good)
    return [run for run in np.split(indices, np.flatnonzero(np.diff(indices) > 1) + 1) if len(run)]


def _choose_nodes(model: TargetModel, unknown: str, low: float, high: float) -> Floats:
    """Return the coordinates x of the nodes between two values of the unknown, SI."""
    if unknown == "diameter":
        return np.array(RELATIVE_DIAMETERS)
    ends = compute_coordinate(model, unknown, np.array([low, high]))
    if unknown == "depth":
        return np.linspace(ends[0], ends[1], DEPTH_NODES)
    soft = compute_coordinate(model, unknown, np.array([c * model.host.youngs_modulus for c in SOFT_CONTRASTS]))
    stiff = np.linspace(-1.0, ends[1], STIFF_NODES)  # x = -1 at contrast 1
    return np.concatenate([ends[:1], soft[soft > ends[0]], stiff])


def compute_coordinate(model: TargetModel, unknown: str, values: Floats) -> Floats:
    """Return x of eq. ES.2 for values of the unknown, SI, shape (n,)."""
    if unknown == "youngs_modulus":
        return np.asarray(-1 / (1 + model.beta * (values / model.host.youngs_modulus - 1)))
    return np.asarray(values / model.find_search_range("diameter")[1]) if unknown == "diameter" else np.log(values)


def _invert_coordinate(model: TargetModel, unknown: str, x: Floats) -> Floats:
    """Return values of the unknown, SI, at coordinates x: the inverse of eq. ES.2."""
    if unknown == "youngs_modulus":
        return np.asarray(model.host.youngs_modulus * (1 + (-1 / x - 1) / model.beta))
    return np.asarray(x * model.find_search_range("diameter")[1]) if unknown == "diameter" else np.exp(x)
