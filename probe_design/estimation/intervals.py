"""Compute the interval of one unknown: the set of values that a likelihood-ratio test does not reject.

k measured logarithms y_i are the model's m_i(u), u a coordinate of the unknown (eq. ES.2), with independent normal noise of
standard deviation s_i:

    chi2(u) = sum_i ((y_i - m_i(u)) / s_i)^2                                                       (ES.3)
    {u : chi2(u) - least <= q(u)},   least = the chi2 of the best fit                              (ES.4)

These are likelihood-ratio intervals in the manner of Feldman and Cousins (Phys. Rev. D 57 (1998) 3873): q(u) is the 95 % quantile
of the left side where u is the truth. Where the curve m(u) / s continues far to both sides of u that is 3.841, the quantile of
chi-square with one degree. Where it ends A standard deviations below and B above, measured along its tangent at u, as it does
where a body stiffer than can be told saturates the ratio, the left side of a straight line is with z normal

    z^2 for -A <= z <= B,   B (2 z - B) above,   A (2 |z| - A) below                               (ES.4a)

whose quantile is 2.706 at an end: the interval is never empty, and covers 95 % there, too. Readings may lie beyond an end. If the
curve prolonged along its tangent is closer to them by more than noise explains in 1 % of all cases, no value agrees with them:
scene or noise are not as stated.

Where numbers of the scene are uncertain, eq. ES.8 of ``shared_errors.py`` replaces eq. ES.3, and its products replace those of
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
from scipy.stats import chi2, ncx2, norm

from geometry.common.arrays import Bools, Floats
from probe_design.estimation.profile import Track
from probe_design.estimation.shared_errors import SharedErrors

LEVEL = 0.95
UNEXPLAINED = float(chi2.ppf(0.99, 1))  # 99 % quantile: larger excess of chi2 over the prolonged curve's: no fit
HALVINGS = 50  # bisections of the search for a quantile
EVERY = 10  # q of eq. ES.4 is computed at every tenth point of the runs, and interpolated
QUANTILE = float(chi2.ppf(LEVEL, 1))
TOLERATED = 1 / 3  # t of eq. ES.5 up to which the interval neglects the model's error: coverage is still 93.7 %
STEPS = 6  # Gauss-Newton steps
ENDING = 6  # steps of the Illinois method for an interval's end


@dataclass(frozen=True)
class Piece:
    """An interval of the unknown, SI, that agrees with the readings; an end is open where it is the end of the search range."""

    low: float
    high: float
    low_open: bool = False
    high_open: bool = False


@dataclass(frozen=True)
class Likelihood:
    """Likelihood of measured values along one unknown.

    Attributes:
        track: predictions, with at least one run of usable nodes.
        noise: standard deviations of the data, shape (k,).
    """

    track: Track
    noise: Floats

    def _shared(self, u: Floats) -> SharedErrors:
        return self.track.shared(u).over(self.noise)

    def at(self, u: Floats) -> tuple[Floats, Floats]:
        """Return predictions and their derivatives by u, over the noise, at u of shape (s,): two of shape (s, k)."""
        value, slope = self.track.at(u)
        return value / self.noise, slope / self.noise

    @cached_property
    def _grid(self) -> tuple[Floats, Floats, Floats, Floats]:
        """The points of all runs, their lower and upper neighbours in the same run, and the predictions at the points."""
        runs = self.track.runs
        below = np.concatenate([run[np.maximum(np.arange(len(run)) - 1, 0)] for run in runs])
        above = np.concatenate([run[np.minimum(np.arange(len(run)) + 1, len(run) - 1)] for run in runs])
        points = np.concatenate(runs)
        return points, below, above, self.at(points)[0]

    def chi_square(self, u: Floats, y: Floats) -> Floats:
        """Return chi2 of eq. ES.3 at u of shape (s,) for measured values of shape (k,) or (s, k)."""
        return self._shared(u).misfit(y / self.noise - self.at(u)[0])

    def best(self, y: Floats) -> tuple[Floats, Floats]:
        """Return the best-fitting u and its chi-square, both (s,), for s sets of measured values, (s, k)."""
        points, below, above, values = self._grid
        w = y / self.noise
        errors = self._shared(points)
        start = np.array([np.argmin(errors.misfit(one - values)) for one in w])
        u = best = points[start]
        least = self.chi_square(u, y)
        for _ in range(STEPS):
            value, slope = self.at(u)
            along = self._shared(u).decorrelated(slope)
            size = (slope * along).sum(axis=1)
            u = np.clip(u + ((w - value) * along).sum(axis=1) / np.where(size > 0, size, 1.0), below[start], above[start])
            now = self.chi_square(u, y)
            best, least = np.where(now < least, u, best), np.minimum(now, least)
        return best, least

    def floor(self, y: Floats) -> Floats:
        """Return the smallest chi-square, (s,), of the curve prolonged along its end tangents, for s sets of values, (s, k)."""
        if y.shape[1] == 1:
            return np.zeros(len(y))
        least = self.best(y)[1]
        for run in self.track.runs:
            for end, outwards in ((run[0], -1.0), (run[-1], 1.0)):
                at = np.array([end])
                value, slope = self.at(at)
                tangent = self._shared(at).decorrelated(slope)[0]
                size = float(np.sqrt(slope[0] @ tangent))
                if size > 0:
                    off = y / self.noise - value
                    along = np.maximum(off @ tangent * (outwards / size), 0.0)
                    least = np.minimum(least, self.chi_square(np.full(len(y), end), y) - along**2)
        return least

    def shift(self, u: Floats) -> Floats:
        """Return the bound t of eq. ES.5 on the shift by the model's error, at u of shape (s,)."""
        relative = self.track.predicted.bound / self.noise
        slope = self.track.slope / self.noise
        tangent = self._shared(self.track.x).decorrelated(slope)
        size = np.sqrt((slope * tangent).sum(axis=1))
        t = (np.abs(tangent) * relative).sum(axis=1) / np.where(size > 0, size, 1.0)
        return np.asarray(np.interp(u, self.track.x, np.where(size > 0, t, np.linalg.norm(relative, axis=1))))

    def limit(self, u: Floats) -> Floats:
        """Return q of eq. ES.4 at u of shape (s,)."""
        return np.asarray(np.interp(u, *self._limits))

    @cached_property
    def _limits(self) -> tuple[Floats, Floats]:
        """Some points of the runs, and the threshold q of eq. ES.4 at these points."""
        points = np.concatenate([np.append(run[:-1:EVERY], run[-1]) for run in self.track.runs])
        value, slope = self.at(points)
        tangent = self._shared(points).decorrelated(slope)
        size = np.sqrt((slope * tangent).sum(axis=1))
        along = np.einsum("uk,vuk->vu", tangent, value[:, None] - value) / np.where(size > 0, size, 1.0)
        below, above = (np.where(size > 0, one, np.inf) for one in (-along.min(axis=0), along.max(axis=0)))
        return points, threshold_near_ends(self.shift(points), below, above)

    def unexplained(self, y: Floats) -> Bools:
        """Return whether no value of the unknown explains the measured values, shape (s,), for s sets of shape (s, k)."""
        return np.asarray(self.best(y)[1] - self.floor(y) > UNEXPLAINED)

    def spoiled(self, u: float) -> float:
        """Return the root of the largest noncentrality of chi2 at u that the model's error may cause."""
        return float(np.interp(u, self.track.x, np.linalg.norm(self.track.predicted.bound / self.noise, axis=1)))

    def pieces(self, y: Floats) -> list[Piece]:
        """Return the set of eq. ES.4, as separate intervals, for measured values of shape (k,)."""
        if self.unexplained(y[None])[0]:
            return []
        best, least = (float(part[0]) for part in self.best(y[None]))

        def beyond(u: Floats) -> Floats:
            return self.chi_square(u, y) - least - self.limit(u)

        pieces = []
        for run in self.track.runs:
            points = _with_valleys(run, best, beyond)
            inside = beyond(points) <= 0
            edges = np.flatnonzero(np.diff(np.concatenate([[False], inside, [False]]).astype(int)))
            last = len(points) - 1
            for first, end in zip(edges[::2], edges[1::2] - 1, strict=True):
                low = _crossing(beyond, points[first - 1], points[first]) if first > 0 else points[0]
                high = _crossing(beyond, points[end + 1], points[end]) if end < last else points[-1]
                ends = self.track.values(np.array([low, high]))
                pieces.append(Piece(float(ends[0]), float(ends[1]), bool(first == 0), bool(end == last)))
        return pieces


def threshold(shift: Floats) -> Floats:
    """Return q of eq. ES.4 far from the curve's ends, for a bound t on the shift by the model's error, eq. ES.5."""
    t = np.asarray(shift, dtype=float)
    out, far = np.full(t.shape, QUANTILE), t > 4
    between = (t > TOLERATED) & ~far
    out[far], out[between] = (t[far] + norm.ppf(LEVEL)) ** 2, ncx2.ppf(LEVEL, 1, t[between] ** 2)
    return out


def threshold_near_ends(shift: Floats, below: Floats, above: Floats) -> Floats:
    """Return q of eq. ES.4 where the curve ends A = ``distance_below`` and B = ``distance_above`` sd away, eq. ES.4a."""
    t = np.where(shift > TOLERATED, shift, 0.0)
    low, high = np.zeros(t.shape), threshold(shift)
    for _ in range(HALVINGS):
        q = (low + high) / 2
        down, up = _reach(q, below), _reach(q, above)
        covered = np.minimum(norm.cdf(up - t) - norm.cdf(-down - t), norm.cdf(up + t) - norm.cdf(-down + t))
        low, high = np.where(covered < LEVEL, q, low), np.where(covered < LEVEL, high, q)
    return np.asarray(high)


def _reach(q: Floats, end: Floats) -> Floats:
    """Return |z| at which eq. ES.4a equals q, where the curve ends ``end`` standard deviations away."""
    root = np.sqrt(q)
    safe = np.clip(end, 1e-9, 1e9)
    return np.where(root <= end, root, (q / safe + safe) / 2)


def p_value(least: float, data: int, shift: float) -> float:
    """Return the probability that chi-square of the best fit is above a value; ``shift`` is the root of the noncentrality."""
    degrees = max(data - 1, 1)
    if shift > 30:  # such a large model error explains any readings
        return 1.0
    return float(ncx2.sf(least, degrees, shift**2) if shift > 1e-6 else chi2.sf(least, degrees))


def _with_valleys(run: Floats, best: float, beyond: Callable[[Floats], Floats]) -> Floats:
    """Add the best fit and the minima of other valleys to the points of a run, as valleys may be narrower than its steps."""
    values = beyond(run)
    middle = np.flatnonzero((values[1:-1] <= values[:-2]) & (values[1:-1] <= values[2:]) & (values[1:-1] > 0)) + 1
    bottoms = [best] if run[0] <= best <= run[-1] else []
    for index in middle:
        fine = np.linspace(run[index - 1], run[index + 1], 401)
        bottoms.append(float(fine[np.argmin(beyond(fine))]))
    return np.unique(np.concatenate([run, bottoms]))


def _crossing(beyond: Callable[[Floats], Floats], outside: float, inside: float) -> float:
    """Return the point between a rejected and an accepted point at which the excess of chi2 is zero."""

    def scalar(u: float) -> float:
        return float(beyond(np.array([u]))[0])

    return float(brentq(scalar, outside, inside, xtol=1e-12)) if scalar(inside) < 0 else inside


def hulls(fit: Likelihood, y: Floats) -> list[tuple[float | None, float | None]]:
    """Return the outer ends of eq. ES.4, SI, for s sets of data, shape (s, k); None for an open end or an empty set.

    The points of the runs and the best fit bracket each end; the ends of all sets are then computed together. Between points q is
    interpolated linearly.
    """
    best, least = fit.best(y)
    points, ends = np.concatenate(fit.track.runs), np.full((2, len(y), 2), np.nan)
    q, open_ends = fit.limit(points), fit.unexplained(y)
    for k, (one, at) in enumerate(zip(y, best, strict=True)):
        if open_ends[k]:
            continue
        u = np.insert(points, np.searchsorted(points, at), at)
        inside = np.flatnonzero(fit.chi_square(u, one) - least[k] - np.interp(u, points, q) <= 0)
        if len(inside) and inside[0] > 0:
            ends[0, k] = u[inside[0]], u[inside[0] - 1]
        if len(inside) and inside[-1] < len(u) - 1:
            ends[1, k] = u[inside[-1]], u[inside[-1] + 1]
    found = [_crossings(fit, y, least, of) for of in ends]
    return [tuple(None if np.isnan(end) else float(end) for end in pair) for pair in zip(*found, strict=True)]  # type: ignore[misc]


def _crossings(fit: Likelihood, y: Floats, least: Floats, between: Floats) -> Floats:
    """Return the ends of the sets, SI, by the Illinois method between an inner and an outer point, (s, 2); data y (s, k)."""
    found = np.full(len(y), np.nan)
    some = np.flatnonzero(np.isfinite(between[:, 0]))
    if not len(some):
        return found

    def beyond(u: Floats) -> Floats:  # difference of roots: closer to a straight line than the difference of squares
        return np.asarray(np.sqrt(np.maximum(fit.chi_square(u, y[some]) - least[some], 0.0)) - np.sqrt(fit.limit(u)))

    a, b = between[some].T
    at, low, high, side = a, np.minimum(beyond(a), -1e-300), np.maximum(beyond(b), 1e-300), np.zeros(len(a))
    for _ in range(ENDING):
        at = a + low / (low - high) * (b - a)
        value = beyond(at)
        now = np.where(value <= 0, -1, 1)
        kept, side = np.where(now == side, 0.5, 1.0), now
        low, high = np.where(now < 0, value, kept * low), np.where(now > 0, value, kept * high)
        low, high = np.minimum(low, -1e-300), np.maximum(high, 1e-300)
        a, b = np.where(now < 0, at, a), np.where(now > 0, at, b)
    found[some] = fit.track.values(at)
    return found
