"""Fit depth and strength of the target together to readings at several places.

The strength S is that of eq. ES.1. With chi2(depth, S) of eq. ES.3 and its least value over both,

    {(depth, S) : chi2 - least chi2 <= q}                                                          (ES.6)

is the joint set. Its projections on both axes are the intervals of depth and strength by profile likelihood. q is the threshold
of ``intervals.py``, with t of eq. ES.5 replaced by the root of sum_i (b_i / s_i)^2, which bounds a shift in any direction (b_i is
the error bound and s_i the noise of datum i). The strength is varied by E_object at the scene's diameter, or by the diameter at
the scene's E_object.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import map_coordinates

from geometry.common.arrays import Bools, Floats
from probe_design.estimation.intervals import CHI2_QUANTILE, compute_threshold
from probe_design.estimation.model import TargetModel
from probe_design.estimation.predictions import Predictions
from probe_design.estimation.shared_errors import SharedErrors
from probe_design.estimation.strength import DepthAndStrength, compute_strength

DEPTH_NODES, STRENGTH_NODES = 40, 48  # nodes of the grid
WINDOW_POINTS = 121  # points along each axis of a window
MAX_WINDOWS = 5  # each covers what remains of the one before
MAX_CONTRAST = 1e4  # of E_object to E_tissue: a stiffer body changes nothing any more
REFLECTION_UNCERTAINTY = (
    0.3  # fraction of the change by reflections that counts as error: they need not grow with the square of the strength
)
DERIVATIVE_NAMES = {"youngs_modulus": "by_modulus", "diameter": "by_diameter"}


@dataclass(frozen=True)
class Plane:
    """Predictions for targets of many depths and strengths.

    Attributes
    ----------
    model
        See ``TargetModel``.
    partner
        youngs_modulus or diameter, by which the strength is varied.
    u
        Ln depth, shape (a,).
    v
        Ln modulus, or ln of the diameter over the largest that fits at each depth, shape (b,).
    predicted
        Shapes (a b, ...).
    slope
        Derivatives of the predicted values by v, shape (a b, k).
    shared
        Errors that all data share, near the best fit.
    """

    model: TargetModel
    partner: str
    u: Floats
    v: Floats
    predicted: Predictions
    slope: Floats
    shared: SharedErrors

    @classmethod
    def from_model(cls, model: TargetModel, partner: str, shared: SharedErrors | None = None) -> Plane:
        """Predict at all nodes; without ``shared`` the data share no errors."""
        top, bottom = np.log(model.find_search_range("depth"))
        u = np.linspace(top, bottom, DEPTH_NODES)
        if partner == "youngs_modulus":
            low, high = model.find_search_range(partner)
            v = np.linspace(np.log(low), np.log(min(high, MAX_CONTRAST * model.host.youngs_modulus)), STRENGTH_NODES)
        else:
            v = np.linspace(np.log(1 / 50), 0.0, STRENGTH_NODES)
        depth, size = (part.ravel() for part in np.meshgrid(np.exp(u), v, indexing="ij"))
        values = np.exp(size) * (model.compute_max_diameter(depth) if partner == "diameter" else 1.0)
        predicted = model.predict({"depth": depth, partner: values}, reflect=False, by_diameter=partner == "diameter")
        shared = shared or SharedErrors.empty(predicted.value.shape[1])
        return cls(
            model, partner, u=u, v=v, predicted=predicted, slope=getattr(predicted, DERIVATIVE_NAMES[partner]), shared=shared
        )

    def add_reflections(self, y: Floats) -> Plane:
        """Add the change by reflections to the first-order predictions, near the fit to measured values y of shape (k,).

        The change is computed at three depths, at the fitted strength S_fit, and grows with the square of the strength S:
        ln m = ln m_first + D(u) (S / S_fit)^2, where m is the prediction with reflections, m_first the one without, u = ln depth
        and D(u) the parabola through the three changes. 30 % of the change counts as error.
        """
        rough = self.fit(y, exact=True)
        if rough is None or rough.strength == 0:
            return self
        fit_predictions = self._predict_both(np.log([rough.depth]), rough)
        if fit_predictions is None:
            return self
        shift = np.linalg.norm(
            (
                fit_predictions[1].bound[0]
                + REFLECTION_UNCERTAINTY * np.abs(fit_predictions[1].value - fit_predictions[0].value)[0]
            )
            / self.model.data.noise
        )
        u = self._choose_depths(rough, 2.5 * float(np.sqrt(compute_threshold(np.asarray(shift)) / CHI2_QUANTILE)))
        depth_predictions = self._predict_both(u, rough)
        return self if depth_predictions is None else self._add_change(u, rough, *depth_predictions)

    def _add_change(self, u: Floats, rough: DepthAndStrength, first: Predictions, better: Predictions) -> Plane:
        """Return the plane with the change from first-order to better predictions, interpolated between three depths u."""
        flat_shape = self.predicted.value.shape
        relative_strength = self.compute_strengths(self.u, self.v) / rough.strength
        change = (parabola_weights(u, self.u) @ (better.value - first.value))[:, None]  # (a, 1, k)
        added = change * np.minimum(relative_strength**2, 4.0)[..., None]
        added_derivative = (
            change
            * np.where(relative_strength**2 < 4.0, 2 * relative_strength * self._differentiate_strength() / rough.strength, 0.0)[
                ..., None
            ]
        )
        bound = np.stack([np.interp(self.u, u, row) for row in better.bound.T], axis=-1)[
            :, None
        ] + REFLECTION_UNCERTAINTY * np.abs(added)
        inside = np.repeat((self.u > u[0] - 1e-9) & (self.u < u[-1] + 1e-9), len(self.v))
        predicted = self.predicted
        predicted = replace(
            predicted,
            value=predicted.value + added.reshape(flat_shape),
            bound=bound.reshape(flat_shape),
            resolved=predicted.resolved & inside,
        )
        return replace(self, predicted=predicted, slope=self.slope + added_derivative.reshape(flat_shape))

    def _choose_depths(self, rough: DepthAndStrength, factor: float) -> Floats:
        """Return three depths (ln): the fit, and ends at ``factor`` times the interval, within the usable depths."""
        middle = float(np.log(rough.depth))
        usable_depths = self.u[
            self.predicted.usable.reshape(len(self.u), -1)[:, int(np.argmin(np.abs(self.v - self._locate_fit(rough))))]
        ]
        low, high = (
            edge
            if end is None
            else float(np.clip(middle + factor * (np.log(end) - middle) + spare, usable_depths[0], usable_depths[-1]))
            for end, edge, spare in zip(rough.depth_interval, (usable_depths[0], usable_depths[-1]), (-0.05, 0.05), strict=True)
        )
        return np.array([low, min(max(middle, low + 0.02), high - 0.02), high])

    def _locate_fit(self, rough: DepthAndStrength) -> float:
        """Return the coordinate v of a fit."""
        if self.partner == "youngs_modulus":
            return float(np.log(rough.modulus))
        return float(np.log(rough.diameter / self.model.compute_max_diameter(np.array([rough.depth]))[0]))

    def _predict_both(self, u: Floats, rough: DepthAndStrength) -> tuple[Predictions, Predictions] | None:
        """Predict the fitted strength at depths (ln), to first order and with reflections; None where the model fails."""
        depths = np.exp(u)
        fitted = np.full(len(u), rough.modulus if self.partner == "youngs_modulus" else rough.diameter)
        if self.partner == "diameter":
            fitted = np.minimum(fitted, self.model.compute_max_diameter(depths))
        target = {"depth": depths, self.partner: fitted}
        first, better = (self.model.predict(target, reflect=reflect) for reflect in (False, True))
        return (first, better) if (first.usable & better.usable).all() else None

    def _differentiate_strength(self) -> Floats:
        """Return the derivative of the strength S by v at the nodes, shape (a, b)."""
        if self.partner == "diameter":
            return 3 * self.compute_strengths(self.u, self.v)
        step = 1e-5
        return (self.compute_strengths(self.u, self.v + step) - self.compute_strengths(self.u, self.v - step)) / (2 * step)

    def compute_strengths(self, u: Floats, v: Floats) -> Floats:
        """Return the strength, eq. ES.1, at all pairs of u, (m,), and v, (n,), shape (m, n), m^3."""
        if self.partner == "youngs_modulus":
            row = compute_strength(self.model.host, self.model.target, modulus=np.exp(v))
            return np.broadcast_to(row, (len(u), len(v)))
        sizes = np.outer(self.model.compute_max_diameter(np.exp(u)), np.exp(v))
        return compute_strength(self.model.host, self.model.target, diameter=sizes)

    def interpolate(self, u: Floats, v: Floats) -> tuple[Floats, Bools]:
        """Return interpolated predictions, (m, n, k), and whether they are unusable, (m, n), at all pairs of u and v."""
        shape, predicted = (len(self.u), len(self.v), -1), self.predicted
        depth_weights = lagrange_weights(self.u, u)
        value_weights, derivative_weights = hermite_weights(self.v, v)
        value = np.einsum("ma,nb,abk->mnk", depth_weights, value_weights, predicted.value.reshape(shape), optimize=True)
        value += np.einsum("ma,nb,abk->mnk", depth_weights, derivative_weights, self.slope.reshape(shape), optimize=True)
        is_unusable = ~predicted.usable.reshape(shape[:2])
        return value, np.asarray(np.abs(depth_weights) @ is_unusable @ (np.abs(value_weights) + np.abs(derivative_weights)).T > 0)

    def compute_misfit(self, y: Floats, u: Floats, v: Floats, exact: bool = False) -> tuple[Floats, Floats]:
        """Return chi2 of eq. ES.3, inf without a prediction, and q of eq. ES.4, at all pairs of u and v, shapes (m, n)."""
        value, is_unknown = self.interpolate(u, v)
        shape, predicted, noise = (len(self.u), len(self.v)), self.predicted, self.model.data.noise
        chi2 = np.where(is_unknown, np.inf, self.shared.divide_by_noise(noise).compute_misfit((y - value) / noise))
        if exact:
            return chi2, compute_threshold(np.zeros_like(chi2))
        shift = np.sqrt(((predicted.bound / noise) ** 2).sum(axis=1)).reshape(shape)
        coordinates = np.meshgrid(compute_steps(self.u, u), compute_steps(self.v, v), indexing="ij")
        return chi2, compute_threshold(map_coordinates(shift, coordinates, order=1, mode="nearest"))

    def fit(self, y: Floats, exact: bool = False) -> DepthAndStrength | None:
        """Fit depth and strength to measured values of shape (k,), eq. ES.6; None where the model predicts no pair.

        Parameters
        ----------
        y
            In the order of ``Measurements``.
        exact
            Whether to neglect the error of the model.
        """
        u, v, min_chi2, best = self._find_best(y)
        if not np.isfinite(min_chi2):
            return None
        for _ in range(MAX_WINDOWS):
            chi2, q = self.compute_misfit(y, u, v, exact)
            inside = chi2 - min_chi2 <= q
            i, j = int(np.argmin(np.abs(u - best[0]))), int(np.argmin(np.abs(v - best[1])))
            inside[i, j] = True
            (top, bottom), (left, right) = _find_ends(np.asarray(inside.any(axis=1))), _find_ends(np.asarray(inside.any(axis=0)))
            if (bottom - top) > 0.8 * WINDOW_POINTS and (right - left) > 0.8 * WINDOW_POINTS:
                break
            previous = u, v, chi2, inside
            u = _refine_window(u, top, bottom)
            v = _refine_window(v, left, right)
        else:
            u, v, chi2, inside = previous
        return self._summarise(u, v, chi2, inside, best)

    def _find_best(self, y: Floats) -> tuple[Floats, Floats, float, tuple[float, float]]:
        """Return the window of all nodes, the smallest chi-square and its place (u, v), by windows that narrow about it."""
        first_window = u, v = np.linspace(self.u[0], self.u[-1], WINDOW_POINTS), np.linspace(self.v[0], self.v[-1], WINDOW_POINTS)
        for _ in range(12):
            chi2, _q = self.compute_misfit(y, u, v, exact=True)
            i, j = np.unravel_index(int(np.argmin(chi2)), chi2.shape)
            best, min_chi2 = (float(u[i]), float(v[j])), float(chi2[i, j])
            u, v = _refine_window(u, int(i) - 8, int(i) + 8), _refine_window(v, int(j) - 8, int(j) + 8)
        return *first_window, min_chi2, best

    def _summarise(self, u: Floats, v: Floats, chi2: Floats, inside: Bools, best: tuple[float, float]) -> DepthAndStrength:
        """Return best fit and intervals from the pairs inside; an end at the edge of the searched pairs is open."""
        is_unpredicted = np.pad(
            ~np.isfinite(chi2), 1
        )  # pairs that the model cannot predict; one more row and column on each side
        near_unpredicted = inside & (
            is_unpredicted[:-2, 1:-1] | is_unpredicted[2:, 1:-1] | is_unpredicted[1:-1, :-2] | is_unpredicted[1:-1, 2:]
        )
        rows, strengths = np.exp(u), self.compute_strengths(u, v)
        is_top_open = bool(inside[0].any() and u[0] <= self.u[0]) or _touches_unpredicted(
            np.asarray(near_unpredicted.any(axis=1)), np.asarray(inside.any(axis=1)), rows, np.min
        )
        is_bottom_open = bool(inside[-1].any() and u[-1] >= self.u[-1]) or _touches_unpredicted(
            np.asarray(near_unpredicted.any(axis=1)), np.asarray(inside.any(axis=1)), rows, np.max
        )
        is_size_open = self.partner == "diameter" and bool(inside[:, -1].any() and v[-1] >= self.v[-1])  # no larger body fits
        is_low_open, is_high_open = (_touches_unpredicted(near_unpredicted, inside, strengths, end) for end in (np.min, np.max))
        positive = float(compute_strength(self.model.host, self.model.target)) > 0
        inside_strengths = strengths[inside]
        depths = rows[inside.any(axis=1)]
        best_strength = float(self.compute_strengths(np.array([best[0]]), np.array([best[1]]))[0, 0])
        low = None if is_low_open or (is_size_open and not positive) else float(min(inside_strengths.min(), best_strength))
        high = None if is_high_open or (is_size_open and positive) else float(max(inside_strengths.max(), best_strength))
        depth = float(np.exp(best[0]))
        ends = (
            None if is_top_open else float(min(depths.min(), depth)),
            None if is_bottom_open else float(max(depths.max(), depth)),
        )
        modulus = float(np.exp(best[1])) if self.partner == "youngs_modulus" else self.model.target.youngs_modulus
        size = float(self.model.target.diameter or 0.0)
        if self.partner == "diameter":
            size = float(np.exp(best[1]) * self.model.compute_max_diameter(np.array([depth]))[0])
        return DepthAndStrength(
            depth=depth,
            depth_interval=ends,
            strength=best_strength,
            strength_interval=(low, high),
            modulus=modulus,
            diameter=size,
        )


def _touches_unpredicted(near_unpredicted: Bools, inside: Bools, values: Floats, end: Callable[[Floats], Floats]) -> bool:
    """Return whether the smallest or largest value inside lies next to pairs that the model cannot predict."""
    if not near_unpredicted.any():
        return False
    edge = end(values[inside])
    return bool(np.isclose(end(values[near_unpredicted]), edge, rtol=1e-9, atol=0))


def _find_ends(row: Bools) -> tuple[int, int]:
    """Return the indices of the first and the last true element."""
    indices = np.flatnonzero(row)
    return int(indices[0]), int(indices[-1])


def _refine_window(points: Floats, low: int, high: int) -> Floats:
    """Return new points from one before index ``low`` to one after index ``high``."""
    return np.linspace(points[max(low - 1, 0)], points[min(high + 1, len(points) - 1)], WINDOW_POINTS)


# Interpolation weights: a product of these matrices with the values at the nodes evaluates a smooth function anywhere.


def compute_steps(nodes: Floats, points: Floats) -> Floats:
    """Return the distance of points from the first of evenly spaced nodes, in steps."""
    return np.asarray((points - nodes[0]) / (nodes[1] - nodes[0]))


def lagrange_weights(nodes: Floats, points: Floats) -> Floats:
    """Return cubic Lagrange weights of the four evenly spaced nodes around each point, shape (m, nodes)."""
    steps = compute_steps(nodes, points)
    first = np.clip(np.floor(steps).astype(int) - 1, 0, len(nodes) - 4)
    x = steps - first
    weights = np.zeros((len(points), len(nodes)))
    for k in range(4):
        other_nodes = [j for j in range(4) if j != k]
        weight = np.prod([(x - j) / (k - j) for j in other_nodes], axis=0)
        weights[np.arange(len(points)), first + k] = np.where(np.abs(weight) < 1e-12, 0.0, weight)
    return weights


def hermite_weights(nodes: Floats, points: Floats) -> tuple[Floats, Floats]:
    """Return cubic Hermite weights of values and derivatives at evenly spaced nodes, each of shape (m, nodes)."""
    steps, step = compute_steps(nodes, points), nodes[1] - nodes[0]
    first = np.clip(np.floor(steps).astype(int), 0, len(nodes) - 2)
    x, rows = steps - first, np.arange(len(points))
    value_weights, derivative_weights = np.zeros((2, len(points), len(nodes)))
    value_weights[rows, first], value_weights[rows, first + 1] = (1 + 2 * x) * (1 - x) ** 2, x**2 * (3 - 2 * x)
    derivative_weights[rows, first], derivative_weights[rows, first + 1] = step * x * (1 - x) ** 2, step * x**2 * (x - 1)
    return value_weights, derivative_weights


def parabola_weights(nodes: Floats, points: Floats) -> Floats:
    """Return weights of the parabola through three nodes, shape (m, 3); constant beyond the outer nodes."""
    x = np.clip(points, nodes[0], nodes[-1])
    other_nodes = [[j for j in range(3) if j != k] for k in range(3)]
    return np.stack([np.prod([(x - nodes[j]) / (nodes[k] - nodes[j]) for j in other_nodes[k]], axis=0) for k in range(3)], axis=1)
