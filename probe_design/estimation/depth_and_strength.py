"""Fit depth and strength of the target together to readings at several places.

The strength S is that of eq. ES.1. With chi2(depth, S) of eq. ES.3 and its minimum over both,

    {(depth, S) : chi2 - minimum <= q}                                                             (ES.6)

is the joint set. Its projections on both axes are the intervals of depth and strength by profile likelihood. q is the threshold
of ``intervals.py``, with t of eq. ES.5 replaced by the root of sum_i (b_i / s_i)^2, which bounds a shift in any direction (b_i is
the error bound and s_i the noise of datum i). The strength is varied by E_object at the scene's diameter, or by the diameter at
the scene's E_object.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import BarycentricInterpolator
from scipy.ndimage import binary_dilation, map_coordinates

from geometry.common.arrays import Bools, Floats
from probe_design.estimation.estimate_result import DepthAndStrength
from probe_design.estimation.intervals import CHI2_QUANTILE, Interval, compute_threshold
from probe_design.estimation.model import TargetModel
from probe_design.estimation.nuisances import SharedErrors
from probe_design.estimation.predictions import Predictions

DEPTH_NODES, STRENGTH_NODES = 40, 48  # nodes of the grid
WINDOW_POINTS = 121  # points along each axis of a window
MAX_WINDOWS = 5  # each covers the pairs inside of the one before
FULL_WINDOW_FRACTION = 0.8  # of the points of a window: so many inside along both axes need no smaller window
BEST_FIT_WINDOWS = 12  # each a seventh of the one before
MAX_CONTRAST = 1e4  # of E_object to E_tissue: a stiffer body changes nothing any more
REFLECTION_UNCERTAINTY = 0.3  # fraction of the change by reflections that counts as error: not all grow with the square of S
DEPTH_MARGIN, MIN_DEPTH_DISTANCE = 0.05, 0.02  # of ln depth: beyond the interval, and between depths with reflections
MAX_SQUARED_STRENGTH = 4.0  # squared strength, over that of the fit, beyond which the change by reflections grows no further


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
    derivative
        Derivatives of the predicted values with respect to v, shape (a b, k).
    shared
        Errors that all data share, near the best fit.
    """

    model: TargetModel
    partner: str
    u: Floats
    v: Floats
    predicted: Predictions
    derivative: Floats
    shared: SharedErrors

    @classmethod
    def from_model(cls, model: TargetModel, partner: str, shared: SharedErrors | None = None) -> Plane:
        """Predict the data at all nodes of a grid in depth and strength.

        Parameters
        ----------
        model
            See ``TargetModel``.
        partner
            youngs_modulus or diameter, by which the strength is varied.
        shared
            Errors that all data share; by default none.
        """
        top, bottom = np.log(model.find_search_range("depth"))
        u = np.linspace(top, bottom, DEPTH_NODES)
        if partner == "youngs_modulus":
            low, high = model.find_search_range(partner)
            v = np.linspace(np.log(low), np.log(min(high, MAX_CONTRAST * model.host.youngs_modulus)), STRENGTH_NODES)
        else:
            v = np.linspace(np.log(1 / 50), 0.0, STRENGTH_NODES)  # from 1/50 of the largest diameter that fits
        depth, size = (part.ravel() for part in np.meshgrid(np.exp(u), v, indexing="ij"))
        values = np.exp(size) * (model.compute_max_diameter(depth) if partner == "diameter" else 1.0)
        predicted = model.predict({"depth": depth, partner: values}, reflect=False, by_diameter=partner == "diameter")
        shared = shared or SharedErrors.from_linear(np.zeros((predicted.value.shape[1], 0)))
        derivative = predicted.by_diameter if partner == "diameter" else predicted.by_modulus
        return cls(model, partner, u=u, v=v, predicted=predicted, derivative=derivative, shared=shared)

    def add_reflections(self, y: Floats) -> Plane:
        """Add the change by reflections to the first-order predictions, near the fit to measured values y of shape (k,).

        The change is computed at three depths, at the fitted strength S_fit, and grows with the square of the strength S:
        ln m = ln m_first + D(u) (S / S_fit)^2, where m is the prediction with reflections, m_first the one without, u = ln depth
        and D(u) the parabola through the three changes. 30 % of the change counts as error.
        """
        rough = self.fit(y, exact=True)
        if rough is None or rough.strength == 0:
            return self
        at_fit = self._predict_both(np.log([rough.depth]), rough)
        if at_fit is None:
            return self
        first, better = at_fit
        error = better.bound[0] + REFLECTION_UNCERTAINTY * np.abs(better.value - first.value)[0]
        shift = np.linalg.norm(error / self.model.data.noise)
        u = self._choose_depths(rough, 2.5 * float(np.sqrt(compute_threshold(np.asarray(shift)) / CHI2_QUANTILE)))
        at_depths = self._predict_both(u, rough)
        return self if at_depths is None else self._add_change(u, rough, *at_depths)

    def _add_change(self, u: Floats, rough: DepthAndStrength, first: Predictions, better: Predictions) -> Plane:
        """Return the plane with the change from first-order to better predictions, interpolated between three depths.

        Parameters
        ----------
        u
            Ln depths at which both were computed, increasing, shape (3,).
        rough
            The fit at whose strength they were computed.
        first, better
            Predictions to first order and with reflections, for three bodies each.
        """
        flat_shape, ratio = self.predicted.value.shape, self.compute_strengths(self.u, self.v) / rough.strength
        change = BarycentricInterpolator(u, better.value - first.value)(np.clip(self.u, u[0], u[-1]))[:, None]  # (a, 1, k)
        added = change * np.minimum(ratio**2, MAX_SQUARED_STRENGTH)[..., None]
        growth = 2 * ratio * self._differentiate_strength() / rough.strength  # derivative of ratio^2 with respect to v
        added_derivative = change * np.where(ratio**2 < MAX_SQUARED_STRENGTH, growth, 0.0)[..., None]
        better_bound = np.stack([np.interp(self.u, u, row) for row in better.bound.T], axis=-1)[:, None]
        bound = better_bound + REFLECTION_UNCERTAINTY * np.abs(added)
        inside = np.repeat((self.u > u[0] - 1e-9) & (self.u < u[-1] + 1e-9), len(self.v))  # 1e-9: rounding
        predicted = replace(
            self.predicted,
            value=self.predicted.value + added.reshape(flat_shape),
            bound=bound.reshape(flat_shape),
            resolved=self.predicted.resolved & inside,
        )
        return replace(self, predicted=predicted, derivative=self.derivative + added_derivative.reshape(flat_shape))

    def _choose_depths(self, rough: DepthAndStrength, factor: float) -> Floats:
        """Return ln of three usable depths: the fitted one, and two ``factor`` times as far from it as the interval's ends."""
        v = np.log(rough.modulus)
        if self.partner == "diameter":
            v = np.log(rough.diameter / self.model.compute_max_diameter(np.array([rough.depth]))[0])
        is_usable = self.predicted.usable.reshape(len(self.u), -1)[:, int(np.argmin(np.abs(self.v - v)))]
        first, last = self.u[is_usable][[0, -1]]
        fit, (shallow, deep) = np.log(rough.depth), rough.depth_interval
        low, high = first, last
        if shallow is not None:
            low = np.clip(fit + factor * (np.log(shallow) - fit) - DEPTH_MARGIN, first, last)
        if deep is not None:
            high = np.clip(fit + factor * (np.log(deep) - fit) + DEPTH_MARGIN, first, last)
        return np.array([low, min(max(fit, low + MIN_DEPTH_DISTANCE), high - MIN_DEPTH_DISTANCE), high])

    def _predict_both(self, u: Floats, rough: DepthAndStrength) -> tuple[Predictions, Predictions] | None:
        """Return predictions to first order and with reflections, for bodies of the fitted strength at ln depths u.

        None where the model cannot predict one of them.
        """
        depths = np.exp(u)
        fitted = np.full(len(u), rough.modulus if self.partner == "youngs_modulus" else rough.diameter)
        if self.partner == "diameter":
            fitted = np.minimum(fitted, self.model.compute_max_diameter(depths))
        target = {"depth": depths, self.partner: fitted}
        first, better = (self.model.predict(target, reflect=reflect) for reflect in (False, True))
        return (first, better) if (first.usable & better.usable).all() else None

    def _differentiate_strength(self) -> Floats:
        """Return the derivative of the strength S with respect to v at the nodes, shape (a, b)."""
        if self.partner == "diameter":  # S grows with the cube of the diameter, and v is its logarithm
            return 3 * self.compute_strengths(self.u, self.v)
        step = 1e-5
        return (self.compute_strengths(self.u, self.v + step) - self.compute_strengths(self.u, self.v - step)) / (2 * step)

    def compute_strengths(self, u: Floats, v: Floats) -> Floats:
        """Return the strength, eq. ES.1, at all pairs of u, (m,), and v, (n,), shape (m, n), m^3."""
        if self.partner == "youngs_modulus":
            return np.broadcast_to(self.model.compute_strength(modulus=np.exp(v)), (len(u), len(v)))
        return self.model.compute_strength(diameter=np.outer(self.model.compute_max_diameter(np.exp(u)), np.exp(v)))

    def interpolate(self, u: Floats, v: Floats) -> tuple[Floats, Bools]:
        """Return interpolated predictions at all pairs of u, (m,), and v, (n,): shape (m, n, k); and whether unusable, (m, n)."""
        shape, predicted = (len(self.u), len(self.v), -1), self.predicted
        depth_weights = compute_lagrange_weights(self.u, u)
        value_weights, derivative_weights = compute_hermite_weights(self.v, v)
        value = np.einsum("ma,nb,abk->mnk", depth_weights, value_weights, predicted.value.reshape(shape), optimize=True)
        value += np.einsum("ma,nb,abk->mnk", depth_weights, derivative_weights, self.derivative.reshape(shape), optimize=True)
        is_unusable = ~predicted.usable.reshape(shape[:2])
        # a point is unusable if any node that contributes to it is
        return value, np.asarray(np.abs(depth_weights) @ is_unusable @ (np.abs(value_weights) + np.abs(derivative_weights)).T > 0)

    def compute_misfit(self, y: Floats, u: Floats, v: Floats, exact: bool = False) -> tuple[Floats, Floats]:
        """Return chi2 of eq. ES.3, inf where there is no prediction, and q of eq. ES.4, at all pairs of u and v, both (m, n).

        ``y`` are the measured values, shape (k,); with ``exact`` the error of the model is neglected in q.
        """
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
        best, min_chi2 = self._find_best(y)
        if not np.isfinite(min_chi2):
            return None
        window = self._cover_all_nodes()
        for _ in range(MAX_WINDOWS):
            u, v = window
            chi2, q = self.compute_misfit(y, u, v, exact)
            inside = chi2 - min_chi2 <= q
            inside[np.argmin(np.abs(u - best[0])), np.argmin(np.abs(v - best[1]))] = True  # the set may lie between points
            depth_ends, strength_ends = (_find_ends(np.asarray(inside.any(axis=axis))) for axis in (1, 0))
            if min(last - first for first, last in (depth_ends, strength_ends)) > FULL_WINDOW_FRACTION * WINDOW_POINTS:
                break
            window = _refine_window(u, *depth_ends), _refine_window(v, *strength_ends)
        return self._summarise(u, v, chi2, inside, best)

    def _cover_all_nodes(self) -> tuple[Floats, Floats]:
        """Return the points u and v of a window over all nodes."""
        return np.linspace(self.u[0], self.u[-1], WINDOW_POINTS), np.linspace(self.v[0], self.v[-1], WINDOW_POINTS)

    def _find_best(self, y: Floats) -> tuple[tuple[float, float], float]:
        """Return the best-fitting pair (u, v) and its chi-square, by windows that narrow about it."""
        u, v = self._cover_all_nodes()
        for _ in range(BEST_FIT_WINDOWS):
            chi2, _q = self.compute_misfit(y, u, v, exact=True)
            i, j = (int(index) for index in np.unravel_index(np.argmin(chi2), chi2.shape))
            best, min_chi2 = (float(u[i]), float(v[j])), float(chi2[i, j])
            u, v = _refine_window(u, i - 8, i + 8), _refine_window(v, j - 8, j + 8)  # about a seventh of the window
        return best, min_chi2

    def _summarise(self, u: Floats, v: Floats, chi2: Floats, inside: Bools, best: tuple[float, float]) -> DepthAndStrength:
        """Return best fit and intervals; an end at the edge of the searched pairs is open.

        Parameters
        ----------
        u, v
            Points of a window, shapes (m,) and (n,).
        chi2, inside
            Eq. ES.3 at all pairs, and whether eq. ES.6 accepts them, shape (m, n).
        best
            The best-fitting pair (u, v).
        """
        near_unpredicted = inside & binary_dilation(~np.isfinite(chi2))  # next to pairs that the model cannot predict
        depths, strengths = np.broadcast_to(np.exp(u)[:, None], inside.shape), self.compute_strengths(u, v)
        depth, strength = float(np.exp(best[0])), float(self.compute_strengths(*np.array(best)[:, None])[0, 0])
        low_depth, high_depth = _find_extremes(depths, inside, near_unpredicted, depth)
        low_strength, high_strength = _find_extremes(strengths, inside, near_unpredicted, strength)
        if self.partner == "diameter" and inside[:, -1].any() and v[-1] >= self.v[-1]:  # no larger body fits
            if float(self.model.compute_strength()) > 0:  # a soft body has a negative strength: its lower end is open
                high_strength = None
            else:
                low_strength = None
        modulus, size = self.model.target.youngs_modulus, float(self.model.target.diameter or 0.0)
        if self.partner == "youngs_modulus":
            modulus = float(np.exp(best[1]))
        else:
            size = float(np.exp(best[1]) * self.model.compute_max_diameter(np.array([depth]))[0])
        return DepthAndStrength(
            depth=depth,
            depth_interval=(
                None if inside[0].any() and u[0] <= self.u[0] else low_depth,
                None if inside[-1].any() and u[-1] >= self.u[-1] else high_depth,
            ),
            strength=strength,
            strength_interval=(low_strength, high_strength),
            modulus=modulus,
            diameter=size,
        )


def _find_extremes(values: Floats, inside: Bools, near_unpredicted: Bools, best: float) -> Interval:
    """Return the lower and the upper end of the accepted values, ``best`` included; None where an end is open.

    Parameters
    ----------
    values
        Depths or strengths at all pairs of a window, shape (m, n).
    inside
        Whether a pair is accepted.
    near_unpredicted
        Whether it is accepted and next to pairs that the model cannot predict; an end there is open.
    best
        The value of the best fit.
    """
    extremes: list[float | None] = []
    for find in (np.min, np.max):
        end = find(values[inside])
        is_open = near_unpredicted.any() and np.isclose(find(values[near_unpredicted]), end, rtol=1e-9, atol=0)
        extremes.append(None if is_open else float(find([end, best])))
    return extremes[0], extremes[1]


def _find_ends(row: Bools) -> tuple[int, int]:
    """Return the indices of the first and the last true element."""
    indices = np.flatnonzero(row)
    return int(indices[0]), int(indices[-1])


def _refine_window(points: Floats, low: int, high: int) -> Floats:
    """Return ``WINDOW_POINTS`` new points, from the point before index ``low`` to the one after index ``high``."""
    return np.linspace(points[max(low - 1, 0)], points[min(high + 1, len(points) - 1)], WINDOW_POINTS)


# Interpolation weights: a product of these matrices with the values at the nodes evaluates a smooth function anywhere.


def compute_steps(nodes: Floats, points: Floats) -> Floats:
    """Return the distance of points from the first of evenly spaced nodes, in steps."""
    return np.asarray((points - nodes[0]) / (nodes[1] - nodes[0]))


def compute_lagrange_weights(nodes: Floats, points: Floats) -> Floats:
    """Return cubic Lagrange weights of the four evenly spaced nodes around each of m points, shape (m, nodes)."""
    steps = compute_steps(nodes, points)
    first = np.clip(np.floor(steps).astype(int) - 1, 0, len(nodes) - 4)
    x = steps - first
    weights = np.zeros((len(points), len(nodes)))
    for k in range(4):
        other_nodes = [j for j in range(4) if j != k]
        weight = np.prod([(x - j) / (k - j) for j in other_nodes], axis=0)
        weights[np.arange(len(points)), first + k] = np.where(np.abs(weight) < 1e-12, 0.0, weight)  # exactly 0 at other nodes
    return weights


def compute_hermite_weights(nodes: Floats, points: Floats) -> tuple[Floats, Floats]:
    """Return cubic Hermite weights, at m points, of values and derivatives at evenly spaced nodes, each of shape (m, nodes)."""
    steps, step = compute_steps(nodes, points), nodes[1] - nodes[0]
    first = np.clip(np.floor(steps).astype(int), 0, len(nodes) - 2)
    x, rows = steps - first, np.arange(len(points))
    value_weights, derivative_weights = np.zeros((2, len(points), len(nodes)))
    value_weights[rows, first], value_weights[rows, first + 1] = (1 + 2 * x) * (1 - x) ** 2, x**2 * (3 - 2 * x)
    derivative_weights[rows, first], derivative_weights[rows, first + 1] = step * x * (1 - x) ** 2, step * x**2 * (x - 1)
    return value_weights, derivative_weights
