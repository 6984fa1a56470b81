"""Compute the interval of one unknown: the set of values that a likelihood-ratio test does not reject.

k measured logarithms y_i are the model's m_i(u), u a coordinate of the unknown (eq. ES.2), with independent normal noise of
standard deviation s_i:

    chi2(u) = sum_i ((y_i - m_i(u)) / s_i)^2                                                       (ES.3)
    {u : chi2(u) - minimum <= q(u)},   minimum = the chi2 of the best fit                          (ES.4)

These are likelihood-ratio intervals in the manner of Feldman and Cousins (Phys. Rev. D 57 (1998) 3873): q(u) is the 95 % quantile
of the left side where u is the truth. Where the curve m(u) / s continues far to both sides of u that is 3.841, the quantile of
chi-square with one degree. Where it ends A standard deviations below and B above, measured along its tangent at u, as it does
where a very stiff body saturates the ratio, the left side is, for a straight line and with z standard normal,

    z^2 for -A <= z <= B,   B (2 z - B) above,   A (2 |z| - A) below                               (ES.4a)

whose quantile is 2.706 at an end: the interval is never empty, and covers 95 % there, too. Readings may lie beyond an end. If the
curve prolonged along its tangent is closer to them by more than noise explains in 1 % of all cases, no value agrees with them:
scene or noise are not as stated.

Where numbers of the scene are uncertain, eq. ES.8 of ``nuisances.py`` replaces eq. ES.3, and its products replace those of
derivatives.

The model's error. Let b_i bound the error of m_i. With g the unit tangent of m / s it shifts the root of eq. ES.4's
statistic by at most

    t = sum_i |g_i| b_i / s_i                                                                      (ES.5)

Up to t = 1/3 the worst such shift leaves a coverage of 93.7 %, and q stays: an interval wider by a bound that is hardly ever
reached would cover too much. Beyond, q becomes the square of the 95 % quantile of |N(t, 1)|, the shortest interval that covers
95 % under every error within the bounds (Armstrong and Kolesar, Econometrica 86 (2018) 655): 1.96 at t = 0, t + 1.645 for large
t. The fit as a whole is tested likewise, by the noncentral chi-square of k - 1 degrees and noncentrality sum_i (b_i / s_i)^2.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.optimize import brentq
from scipy.optimize.elementwise import find_root
from scipy.stats import chi2, ncx2, norm

from geometry.common.arrays import Bools, Floats, Ints
from probe_design.estimation.nuisances import SharedErrors
from probe_design.estimation.profile import Track

CONFIDENCE = 0.95
UNEXPLAINED_CHI2 = float(chi2.ppf(0.99, 1))  # 99 % quantile: larger excess of chi2 over the prolonged curve's: no fit
QUANTILE_BISECTIONS = 50  # bisections of the search for a quantile
LIMIT_STRIDE = 10  # q of eq. ES.4 is computed at every tenth point of the runs, and interpolated
CHI2_QUANTILE = float(chi2.ppf(CONFIDENCE, 1))
TOLERATED_SHIFT = 1 / 3  # t of eq. ES.5 up to which the interval neglects the model's error: coverage is still 93.7 %
GAUSS_NEWTON_STEPS = 6  # for the best fit
MAX_NONCENTRALITY_ROOT = 30.0  # so large an error of the model explains any readings
END_TOLERANCE = 1e-7  # of the ends of many intervals, in the unknown's coordinate
Interval = tuple[float | None, float | None]  # an end is None where it is open
OPEN_INTERVAL: Interval = (None, None)


@dataclass(frozen=True)
class Piece:
    """An interval of the unknown, SI, that agrees with the readings; an end is open where it is the end of the search range."""

    low: float
    high: float
    low_open: bool = False
    high_open: bool = False


def compute_hull(pieces: tuple[Piece, ...]) -> Interval:
    """Return lower and upper end of the union of pieces; None for an open end, and if there are no pieces."""
    if not pieces:
        return OPEN_INTERVAL
    return None if pieces[0].low_open else pieces[0].low, None if pieces[-1].high_open else pieces[-1].high


@dataclass(frozen=True)
class Likelihood:
    """Likelihood of measured values along one unknown.

    Attributes
    ----------
    track
        Predictions, with at least one run of usable nodes.
    noise
        Standard deviations of the data, shape (k,).
    """

    track: Track
    noise: Floats

    def _compute_shared_errors(self, u: Floats) -> SharedErrors:
        """Return the errors that all data share, divided by the noise, at u of shape (s,)."""
        return self.track.compute_shared_errors(u).divide_by_noise(self.noise)

    def predict(self, u: Floats) -> tuple[Floats, Floats]:
        """Return predictions and their derivatives with respect to u, both over the noise, shape (s, k), at u of shape (s,)."""
        value, derivative = self.track.interpolate(u)
        return value / self.noise, derivative / self.noise

    def _compute_tangent(self, u: Floats) -> tuple[Floats, Floats, Floats]:
        """Return m / s, W g and g^T W g at u of shape (n,), with g the derivative of m / s; shapes (n, k), (n, k) and (n,).

        m are the predictions, s the noise, and W is that of eq. ES.8.
        """
        value, derivative = self.predict(u)
        tangent = self._compute_shared_errors(u).decorrelate(derivative)
        return value, tangent, (derivative * tangent).sum(axis=1)

    @cached_property
    def _grid(self) -> tuple[Floats, Floats, Floats, Floats]:
        """The points of all runs, their neighbours below and above in the same run, and the predictions over the noise there."""
        runs = self.track.runs
        lower = np.concatenate([run[np.maximum(np.arange(len(run)) - 1, 0)] for run in runs])
        upper = np.concatenate([run[np.minimum(np.arange(len(run)) + 1, len(run) - 1)] for run in runs])
        points = np.concatenate(runs)
        return points, lower, upper, self.predict(points)[0]

    def compute_chi_square(self, u: Floats, y: Floats) -> Floats:
        """Return chi2 of eq. ES.3 at u of shape (s,) for measured values of shape (k,) or (s, k)."""
        return self._compute_shared_errors(u).compute_misfit(y / self.noise - self.predict(u)[0])

    def find_best(self, y: Floats) -> tuple[Floats, Floats]:
        """Return the best-fitting u and its chi-square, both (s,), for s sets of measured values, (s, k)."""
        points, lower, upper, values = self._grid
        w = y / self.noise
        errors = self._compute_shared_errors(points)
        start = np.array([np.argmin(errors.compute_misfit(row - values)) for row in w])
        u = best = points[start]
        min_chi2 = self.compute_chi_square(u, y)
        for _ in range(GAUSS_NEWTON_STEPS):
            value, tangent, square = self._compute_tangent(u)
            step = ((w - value) * tangent).sum(axis=1) / np.where(square > 0, square, 1.0)  # none where the curve is flat
            u = np.clip(u + step, lower[start], upper[start])
            new_chi2 = self.compute_chi_square(u, y)
            best, min_chi2 = np.where(new_chi2 < min_chi2, u, best), np.minimum(new_chi2, min_chi2)
        return best, min_chi2

    def compute_floor(self, y: Floats) -> Floats:
        """Return the minimum of chi2, (s,), on the curve prolonged along its end tangents, for s sets of data, (s, k)."""
        if y.shape[1] == 1:  # the prolonged curve fits any single value
            return np.zeros(len(y))
        min_chi2 = self.find_best(y)[1]
        for run in self.track.runs:
            for end, direction in ((run[0], -1.0), (run[-1], 1.0)):
                value, tangent, square = self._compute_tangent(np.array([end]))
                if square[0] > 0:
                    distance = (y / self.noise - value) @ tangent[0] * (direction / np.sqrt(square[0]))  # beyond the end
                    chi2_at_end = self.compute_chi_square(np.full(len(y), end), y)
                    min_chi2 = np.minimum(min_chi2, chi2_at_end - np.maximum(distance, 0.0) ** 2)
        return min_chi2

    def compute_shift(self, u: Floats) -> Floats:
        """Return the bound t of eq. ES.5 on the shift by the model's error, at u of shape (s,)."""
        relative_bound = self.track.predicted.bound / self.noise
        _, tangent, square = self._compute_tangent(self.track.x)
        # where the curve is flat it has no tangent; the norm bounds the shift in any direction
        t = (np.abs(tangent) * relative_bound).sum(axis=1) / np.sqrt(np.where(square > 0, square, 1.0))
        return np.asarray(np.interp(u, self.track.x, np.where(square > 0, t, np.linalg.norm(relative_bound, axis=1))))

    def interpolate_limit(self, u: Floats) -> Floats:
        """Return q of eq. ES.4 at u of shape (s,)."""
        return np.asarray(np.interp(u, *self._limits))

    @cached_property
    def _limits(self) -> tuple[Floats, Floats]:
        """Some points of the runs, and the threshold q of eq. ES.4 at these points."""
        points = np.concatenate([np.append(run[:-1:LIMIT_STRIDE], run[-1]) for run in self.track.runs])
        value, tangent, square = self._compute_tangent(points)
        # [v, u]: from point u to point v along the tangent at u, in standard deviations; no end where the curve is flat
        distance = np.einsum("uk,vuk->vu", tangent, value[:, None] - value) / np.sqrt(np.where(square > 0, square, 1.0))
        lower, upper = (np.where(square > 0, end, np.inf) for end in (-distance.min(axis=0), distance.max(axis=0)))
        return points, compute_threshold_near_ends(self.compute_shift(points), lower, upper)

    def find_unexplained(self, y: Floats) -> Bools:
        """Return whether no value of the unknown explains the measured values, shape (s,), for s sets of shape (s, k)."""
        return np.asarray(self.find_best(y)[1] - self.compute_floor(y) > UNEXPLAINED_CHI2)

    def compute_p_value(self, best: float, min_chi2: float) -> float:
        """Return the probability that noise and the model's error cause a worse fit than the best one.

        Parameters
        ----------
        best, min_chi2
            Coordinate u of the best fit, and its chi2.
        """
        degrees = max(len(self.noise) - 1, 1)
        root = np.interp(best, self.track.x, np.linalg.norm(self.track.predicted.bound / self.noise, axis=1))
        if root > MAX_NONCENTRALITY_ROOT:
            return 1.0
        return float(ncx2.sf(min_chi2, degrees, root**2) if root > 1e-6 else chi2.sf(min_chi2, degrees))

    def find_pieces(self, y: Floats) -> list[Piece]:
        """Return the set of eq. ES.4, as separate intervals, for measured values of shape (k,)."""
        if self.find_unexplained(y[None])[0]:
            return []
        best, min_chi2 = (float(part[0]) for part in self.find_best(y[None]))

        def compute_excess(u: Floats) -> Floats:
            """Return by how much chi2 exceeds its limit; values up to 0 are accepted."""
            return self.compute_chi_square(u, y) - min_chi2 - self.interpolate_limit(u)

        pieces = []
        for run in self.track.runs:
            points = _add_valleys(run, best, compute_excess)
            inside = compute_excess(points) <= 0
            # indices of the first accepted point of each piece, and of the first rejected one after it, alternately
            edges = np.flatnonzero(np.diff(np.concatenate([[False], inside, [False]]).astype(int)))
            last = len(points) - 1
            for first, end in zip(edges[::2], edges[1::2] - 1, strict=True):
                low = _find_crossing(compute_excess, points[first - 1], points[first]) if first > 0 else points[0]
                high = _find_crossing(compute_excess, points[end + 1], points[end]) if end < last else points[-1]
                ends = self.track.compute_values(np.array([low, high]))
                pieces.append(Piece(float(ends[0]), float(ends[1]), bool(first == 0), bool(end == last)))
        return pieces


def compute_threshold(shift: Floats) -> Floats:
    """Return q of eq. ES.4 far from the curve's ends, for a bound t on the shift by the model's error, eq. ES.5."""
    t = np.asarray(shift, dtype=float)
    quantile, is_far = np.full(t.shape, CHI2_QUANTILE), t > 4
    is_between = (t > TOLERATED_SHIFT) & ~is_far
    quantile[is_far], quantile[is_between] = (t[is_far] + norm.ppf(CONFIDENCE)) ** 2, ncx2.ppf(CONFIDENCE, 1, t[is_between] ** 2)
    return quantile


def compute_threshold_near_ends(shift: Floats, distance_below: Floats, distance_above: Floats) -> Floats:
    """Return q of eq. ES.4 near the curve's ends, eq. ES.4a, for shifts t of eq. ES.5; all arrays have the same shape.

    ``distance_below`` and ``distance_above`` are A and B, the distances from the ends in standard deviations. The coverage is the
    smaller one of shifts by t and by -t; q is found by bisection.
    """
    t = np.where(shift > TOLERATED_SHIFT, shift, 0.0)
    low, high = np.zeros(t.shape), compute_threshold(shift)
    for _ in range(QUANTILE_BISECTIONS):
        q = (low + high) / 2
        reach_below, reach_above = _compute_reach(q, distance_below), _compute_reach(q, distance_above)
        covered = np.minimum(
            norm.cdf(reach_above - t) - norm.cdf(-reach_below - t), norm.cdf(reach_above + t) - norm.cdf(-reach_below + t)
        )
        low, high = np.where(covered < CONFIDENCE, q, low), np.where(covered < CONFIDENCE, high, q)
    return np.asarray(high)


def _compute_reach(q: Floats, end: Floats) -> Floats:
    """Return |z| at which eq. ES.4a equals q, towards an end of the curve that is ``end`` standard deviations away."""
    root = np.sqrt(q)
    safe = np.clip(end, 1e-9, 1e9)  # no division by zero or infinity
    return np.where(root <= end, root, (q / safe + safe) / 2)


def _add_valleys(run: Floats, best: float, compute_excess: Callable[[Floats], Floats]) -> Floats:
    """Return the points of a run with the best fit and the minima of chi2 added, which may be narrower than the steps."""
    values = compute_excess(run)
    middle = np.flatnonzero((values[1:-1] <= values[:-2]) & (values[1:-1] <= values[2:]) & (values[1:-1] > 0)) + 1
    bottoms = [best] if run[0] <= best <= run[-1] else []
    for index in middle:
        fine = np.linspace(run[index - 1], run[index + 1], 401)
        bottoms.append(float(fine[np.argmin(compute_excess(fine))]))
    return np.unique(np.concatenate([run, bottoms]))


def _find_crossing(compute_excess: Callable[[Floats], Floats], outside: float, inside: float) -> float:
    """Return the point between a rejected (``outside``) and an accepted (``inside``) one at which the excess of chi2 is zero."""

    def compute_scalar_excess(u: float) -> float:
        """Return the excess of chi2 at one point."""
        return float(compute_excess(np.array([u]))[0])

    return float(brentq(compute_scalar_excess, outside, inside, xtol=1e-12)) if compute_scalar_excess(inside) < 0 else inside


def compute_hulls(fit: Likelihood, y: Floats) -> list[Interval]:
    """Return the lowest and highest value that eq. ES.4 accepts, SI, for s sets of data, shape (s, k); None for an open end.

    Both are None for an empty set.
    The points of the runs and the best fit bracket each end; the ends of all sets are then computed together. Between points q is
    interpolated linearly.
    """
    best, min_chi2 = fit.find_best(y)
    points, brackets = np.concatenate(fit.track.runs), np.full((2, len(y), 2), np.nan)  # (lower or upper end, set, points)
    q = fit.interpolate_limit(points)
    for k in np.flatnonzero(~fit.find_unexplained(y)):
        u = np.insert(points, np.searchsorted(points, best[k]), best[k])
        inside = np.flatnonzero(fit.compute_chi_square(u, y[k]) - min_chi2[k] - np.interp(u, points, q) <= 0)
        if len(inside) and inside[0] > 0:
            brackets[0, k] = u[inside[0] - 1], u[inside[0]]
        if len(inside) and inside[-1] < len(u) - 1:
            brackets[1, k] = u[inside[-1]], u[inside[-1] + 1]

    def compute_excess(u: Floats, rows: Ints) -> Floats:
        """Return by how much the root of chi2 exceeds that of its limit, at one point u for each of some sets of data.

        The difference of roots is closer to a straight line in u than that of squares.
        """
        excess_chi2 = fit.compute_chi_square(u, y[rows]) - min_chi2[rows]
        return np.asarray(np.sqrt(np.maximum(excess_chi2, 0.0)) - np.sqrt(fit.interpolate_limit(u)))

    ends = np.full((2, len(y)), np.nan)
    for end, bracket in zip(ends, brackets, strict=True):
        rows = np.flatnonzero(np.isfinite(bracket[:, 0]))
        if len(rows):
            low, high = bracket[rows].T
            roots = find_root(
                compute_excess, (low, high), args=(rows,), tolerances={"xatol": END_TOLERANCE, "xrtol": END_TOLERANCE}
            )
            end[rows] = fit.track.compute_values(roots.x)
    return [(None if np.isnan(low) else float(low), None if np.isnan(high) else float(high)) for low, high in ends.T]
