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
from probe_design.estimation.intervals import QUANTILE, threshold
from probe_design.estimation.model import TargetModel
from probe_design.estimation.predicted import Predicted
from probe_design.estimation.shared_errors import SharedErrors
from probe_design.estimation.strength import DepthAndStrength, strength

DEPTHS, SIZES = 40, 48  # nodes of the grid
FINE = 121  # points along each axis of a window
WINDOWS = 5  # each covers what remains of the one before
MOST_CONTRAST = 1e4  # of E_object to E_tissue: a stiffer body changes nothing any more
UNSURE = 0.3  # fraction of the change by reflections that counts as error: they need not grow with the square of the strength
SLOPES = {"youngs_modulus": "by_modulus", "diameter": "by_diameter"}


@dataclass(frozen=True)
class Plane:
    """Predictions for targets of many depths and strengths.

    Attributes:
        model: see ``TargetModel``.
        partner: youngs_modulus or diameter, by which the strength is varied.
        u: ln depth, shape (a,).
        v: ln modulus, or ln of the diameter over the largest that fits at each depth, shape (b,).
        predicted: shapes (a b, ...).
        slope: derivatives of the predicted values by v, shape (a b, k).
        shared: errors that all data share, near the best fit.
    """

    model: TargetModel
    partner: str
    u: Floats
    v: Floats
    predicted: Predicted
    slope: Floats
    shared: SharedErrors

    @classmethod
    def of(cls, model: TargetModel, partner: str, shared: SharedErrors | None = None) -> Plane:
        """Predict at all nodes; without ``shared`` the data share no errors."""
        top, bottom = np.log(model.span("depth"))
        u = np.linspace(top, bottom, DEPTHS)
        if partner == "youngs_modulus":
            low, high = model.span(partner)
            v = np.linspace(np.log(low), np.log(min(high, MOST_CONTRAST * model.host.youngs_modulus)), SIZES)
        else:
            v = np.linspace(np.log(1 / 50), 0.0, SIZES)
        depth, size = (part.ravel() for part in np.meshgrid(np.exp(u), v, indexing="ij"))
        values = np.exp(size) * (model.room(depth) if partner == "diameter" else 1.0)
        predicted = model.predict({"depth": depth, partner: values}, reflect=False, by_diameter=partner == "diameter")
        shared = shared or SharedErrors.none(predicted.value.shape[1])
        return cls(model, partner, u=u, v=v, predicted=predicted, slope=getattr(predicted, SLOPES[partner]), shared=shared)

    def with_reflections(self, y: Floats) -> Plane:
        """Add the change by reflections to the first-order predictions, near the fit to measured values y of shape (k,).

        The change is computed at three depths, at the fitted strength S_fit, and grows with the square of the strength S:
        ln m = ln m_first + D(u) (S / S_fit)^2, where m is the prediction with reflections, m_first the one without, u = ln depth
        and D(u) the parabola through the three changes. 30 % of the change counts as error.
        """
        rough = self.fit(y, exact=True)
        if rough is None or rough.strength == 0:
            return self
        here = self._both(np.log([rough.depth]), rough)
        if here is None:
            return self
        spoiled = np.linalg.norm((here[1].bound[0] + UNSURE * np.abs(here[1].value - here[0].value)[0]) / self.model.data.noise)
        u = self._window_of(rough, 2.5 * float(np.sqrt(threshold(np.asarray(spoiled)) / QUANTILE)))
        both = self._both(u, rough)
        return self if both is None else self._moved(u, rough, *both)

    def _moved(self, u: Floats, rough: DepthAndStrength, first: Predicted, better: Predicted) -> Plane:
        """Return the plane with the change from first-order to better predictions, interpolated between three depths u."""
        flat = self.predicted.value.shape
        share = self.strengths(self.u, self.v) / rough.strength
        change = (parabola(u, self.u) @ (better.value - first.value))[:, None]  # (a, 1, k)
        more = change * np.minimum(share**2, 4.0)[..., None]
        steeper = change * np.where(share**2 < 4.0, 2 * share * self._strength_slope() / rough.strength, 0.0)[..., None]
        bound = np.stack([np.interp(self.u, u, row) for row in better.bound.T], axis=-1)[:, None] + UNSURE * np.abs(more)
        inside = np.repeat((self.u > u[0] - 1e-9) & (self.u < u[-1] + 1e-9), len(self.v))
        of = self.predicted
        of = replace(of, value=of.value + more.reshape(flat), bound=bound.reshape(flat), resolved=of.resolved & inside)
        return replace(self, predicted=of, slope=self.slope + steeper.reshape(flat))

    def _window_of(self, rough: DepthAndStrength, wider: float) -> Floats:
        """Return three depths (ln): the fit, and ends at ``factor`` times the interval, within the usable depths."""
        middle = float(np.log(rough.depth))
        usable = self.u[self.predicted.usable.reshape(len(self.u), -1)[:, int(np.argmin(np.abs(self.v - self._place_of(rough))))]]
        low, high = (
            edge if end is None else float(np.clip(middle + wider * (np.log(end) - middle) + spare, usable[0], usable[-1]))
            for end, edge, spare in zip(rough.depth_interval, (usable[0], usable[-1]), (-0.05, 0.05), strict=True)
        )
        return np.array([low, min(max(middle, low + 0.02), high - 0.02), high])

    def _place_of(self, rough: DepthAndStrength) -> float:
        """Return the coordinate v of a fit."""
        if self.partner == "youngs_modulus":
            return float(np.log(rough.modulus))
        return float(np.log(rough.diameter / self.model.room(np.array([rough.depth]))[0]))

    def _both(self, u: Floats, rough: DepthAndStrength) -> tuple[Predicted, Predicted] | None:
        """Predict the fitted strength at depths (ln), to first order and with reflections; None where the model fails."""
        depths = np.exp(u)
        fitted = np.full(len(u), rough.modulus if self.partner == "youngs_modulus" else rough.diameter)
        if self.partner == "diameter":
            fitted = np.minimum(fitted, self.model.room(depths))
        target = {"depth": depths, self.partner: fitted}
        first, better = (self.model.predict(target, reflect=reflect) for reflect in (False, True))
        return (first, better) if (first.usable & better.usable).all() else None

    def _strength_slope(self) -> Floats:
        """Return the derivative of the strength S by v at the nodes, shape (a, b)."""
        if self.partner == "diameter":
            return 3 * self.strengths(self.u, self.v)
        step = 1e-5
        return (self.strengths(self.u, self.v + step) - self.strengths(self.u, self.v - step)) / (2 * step)

    def strengths(self, u: Floats, v: Floats) -> Floats:
        """Return the strength, eq. ES.1, at all pairs of u, (m,), and v, (n,), shape (m, n), m^3."""
        if self.partner == "youngs_modulus":
            row = strength(self.model.host, self.model.target, modulus=np.exp(v))
            return np.broadcast_to(row, (len(u), len(v)))
        sizes = np.outer(self.model.room(np.exp(u)), np.exp(v))
        return strength(self.model.host, self.model.target, diameter=sizes)

    def values(self, u: Floats, v: Floats) -> tuple[Floats, Bools]:
        """Return interpolated predictions, (m, n, k), and whether they are unusable, (m, n), at all pairs of u and v."""
        shape, of = (len(self.u), len(self.v), -1), self.predicted
        along = lagrange(self.u, u)
        whole, half = hermite(self.v, v)
        value = np.einsum("ma,nb,abk->mnk", along, whole, of.value.reshape(shape), optimize=True)
        value += np.einsum("ma,nb,abk->mnk", along, half, self.slope.reshape(shape), optimize=True)
        bad = ~of.usable.reshape(shape[:2])
        return value, np.asarray(np.abs(along) @ bad @ (np.abs(whole) + np.abs(half)).T > 0)

    def misfit(self, y: Floats, u: Floats, v: Floats, exact: bool = False) -> tuple[Floats, Floats]:
        """Return chi2 of eq. ES.3, inf without a prediction, and q of eq. ES.4, at all pairs of u and v, shapes (m, n)."""
        value, unknown = self.values(u, v)
        shape, of, noise = (len(self.u), len(self.v)), self.predicted, self.model.data.noise
        chi2 = np.where(unknown, np.inf, self.shared.over(noise).misfit((y - value) / noise))
        if exact:
            return chi2, threshold(np.zeros_like(chi2))
        shift = np.sqrt(((of.bound / noise) ** 2).sum(axis=1)).reshape(shape)
        at = np.meshgrid(place(self.u, u), place(self.v, v), indexing="ij")
        return chi2, threshold(map_coordinates(shift, at, order=1, mode="nearest"))

    def fit(self, y: Floats, exact: bool = False) -> DepthAndStrength | None:
        """Fit depth and strength to measured values of shape (k,), eq. ES.6; None where the model predicts no pair.

        Args:
            y: in the order of ``Measurements``.
            exact: whether to neglect the error of the model.
        """
        u, v, least, best = self._best(y)
        if not np.isfinite(least):
            return None
        for _ in range(WINDOWS):
            chi2, q = self.misfit(y, u, v, exact)
            inside = chi2 - least <= q
            i, j = int(np.argmin(np.abs(u - best[0]))), int(np.argmin(np.abs(v - best[1])))
            inside[i, j] = True
            (top, bottom), (left, right) = _ends(np.asarray(inside.any(axis=1))), _ends(np.asarray(inside.any(axis=0)))
            if (bottom - top) > 0.8 * FINE and (right - left) > 0.8 * FINE:
                break
            last = u, v, chi2, inside
            u = _window(u, top, bottom)
            v = _window(v, left, right)
        else:
            u, v, chi2, inside = last
        return self._summary(u, v, chi2, inside, best)

    def _best(self, y: Floats) -> tuple[Floats, Floats, float, tuple[float, float]]:
        """Return the window of all nodes, the smallest chi-square and its place (u, v), by windows that narrow about it."""
        whole = u, v = np.linspace(self.u[0], self.u[-1], FINE), np.linspace(self.v[0], self.v[-1], FINE)
        for _ in range(12):
            chi2, _q = self.misfit(y, u, v, exact=True)
            i, j = np.unravel_index(int(np.argmin(chi2)), chi2.shape)
            best, least = (float(u[i]), float(v[j])), float(chi2[i, j])
            u, v = _window(u, int(i) - 8, int(i) + 8), _window(v, int(j) - 8, int(j) + 8)
        return *whole, least, best

    def _summary(self, u: Floats, v: Floats, chi2: Floats, inside: Bools, best: tuple[float, float]) -> DepthAndStrength:
        """Return best fit and intervals from the pairs inside; an end at the edge of the searched pairs is open."""
        dark = np.pad(~np.isfinite(chi2), 1)  # pairs that the model cannot predict; one more row and column on each side
        near_dark = inside & (dark[:-2, 1:-1] | dark[2:, 1:-1] | dark[1:-1, :-2] | dark[1:-1, 2:])
        rows, strengths = np.exp(u), self.strengths(u, v)
        shallow = bool(inside[0].any() and u[0] <= self.u[0]) or _reached(
            np.asarray(near_dark.any(axis=1)), np.asarray(inside.any(axis=1)), rows, np.min
        )
        deep = bool(inside[-1].any() and u[-1] >= self.u[-1]) or _reached(
            np.asarray(near_dark.any(axis=1)), np.asarray(inside.any(axis=1)), rows, np.max
        )
        full = self.partner == "diameter" and bool(inside[:, -1].any() and v[-1] >= self.v[-1])  # no larger body fits
        weak, strong = (_reached(near_dark, inside, strengths, end) for end in (np.min, np.max))
        positive = float(strength(self.model.host, self.model.target)) > 0
        within = strengths[inside]
        depths = rows[inside.any(axis=1)]
        here = float(self.strengths(np.array([best[0]]), np.array([best[1]]))[0, 0])
        low = None if weak or (full and not positive) else float(min(within.min(), here))
        high = None if strong or (full and positive) else float(max(within.max(), here))
        depth = float(np.exp(best[0]))
        ends = None if shallow else float(min(depths.min(), depth)), None if deep else float(max(depths.max(), depth))
        modulus = float(np.exp(best[1])) if self.partner == "youngs_modulus" else self.model.target.youngs_modulus
        size = float(self.model.target.diameter or 0.0)
        if self.partner == "diameter":
            size = float(np.exp(best[1]) * self.model.room(np.array([depth]))[0])
        return DepthAndStrength(
            depth=depth, depth_interval=ends, strength=here, strength_interval=(low, high), modulus=modulus, diameter=size
        )


def _reached(near_dark: Bools, inside: Bools, values: Floats, end: Callable[[Floats], Floats]) -> bool:
    """Return whether the smallest or largest value inside lies next to pairs that the model cannot predict."""
    if not near_dark.any():
        return False
    edge = end(values[inside])
    return bool(np.isclose(end(values[near_dark]), edge, rtol=1e-9, atol=0))


def _ends(row: Bools) -> tuple[int, int]:
    """Return the indices of the first and the last true element."""
    places = np.flatnonzero(row)
    return int(places[0]), int(places[-1])


def _window(points: Floats, low: int, high: int) -> Floats:
    """Return new points from one before index ``low`` to one after index ``high``."""
    return np.linspace(points[max(low - 1, 0)], points[min(high + 1, len(points) - 1)], FINE)


# Interpolation weights: a product of these matrices with the values at the nodes evaluates a smooth function anywhere.


def place(nodes: Floats, points: Floats) -> Floats:
    """Return the distance of points from the first of evenly spaced nodes, in steps."""
    return np.asarray((points - nodes[0]) / (nodes[1] - nodes[0]))


def lagrange(nodes: Floats, points: Floats) -> Floats:
    """Return cubic Lagrange weights of the four evenly spaced nodes around each point, shape (m, nodes)."""
    at = place(nodes, points)
    first = np.clip(np.floor(at).astype(int) - 1, 0, len(nodes) - 4)
    x = at - first
    out = np.zeros((len(points), len(nodes)))
    for k in range(4):
        rest = [j for j in range(4) if j != k]
        weight = np.prod([(x - j) / (k - j) for j in rest], axis=0)
        out[np.arange(len(points)), first + k] = np.where(np.abs(weight) < 1e-12, 0.0, weight)
    return out


def hermite(nodes: Floats, points: Floats) -> tuple[Floats, Floats]:
    """Return cubic Hermite weights of values and derivatives at evenly spaced nodes, each of shape (m, nodes)."""
    at, step = place(nodes, points), nodes[1] - nodes[0]
    first = np.clip(np.floor(at).astype(int), 0, len(nodes) - 2)
    x, rows = at - first, np.arange(len(points))
    whole, half = np.zeros((2, len(points), len(nodes)))
    whole[rows, first], whole[rows, first + 1] = (1 + 2 * x) * (1 - x) ** 2, x**2 * (3 - 2 * x)
    half[rows, first], half[rows, first + 1] = step * x * (1 - x) ** 2, step * x**2 * (x - 1)
    return whole, half


def parabola(nodes: Floats, points: Floats) -> Floats:
    """Return weights of the parabola through three nodes, shape (m, 3); constant beyond the outer nodes."""
    x = np.clip(points, nodes[0], nodes[-1])
    rest = [[j for j in range(3) if j != k] for k in range(3)]
    return np.stack([np.prod([(x - nodes[j]) / (nodes[k] - nodes[j]) for j in rest[k]], axis=0) for k in range(3)], axis=1)
