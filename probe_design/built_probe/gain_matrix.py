"""The gain matrix of both channels: what it makes of readings, and its estimate from readings on references.

A reading y = Q / c (N, c the nominal charge per force) of film forces f is y = M f (BP.1): M has the relative gains on its
diagonal and beside it the cross-talk. On a reference k under the load F_k, f = F_k (s, 1 - s): s is 1 or 0 for a pin or a ring,
but for the share that leaks to the other block; ln(s / (1 - s)) = lambda_k is predicted for a block of tissue with an error that
the solver, the block's modulus and the workshop leave. M, F_k, lambda_k and the leaks follow together from least squares (BP.2),
each datum and each prediction with its covariance. A leak cannot be told from cross-talk but by what the blocks add.

The force channel shows k F_k, k of eq. BP.9. Without it, and without a reference of known load, all F_k are free and M is told up
to a common factor only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.special import chdtrc

from geometry.common.arrays import Floats
from geometry.common.errors import InputError, Words
from hw.common.samples import Ints
from probe_design.built_probe.bench import Bench, Reference
from probe_design.built_probe.block_predictions import Shares, inner_shares
from probe_design.built_probe.force_scale import ForceScale, mean_gain_sd, prior_sd

ENTRIES = ("inner gain", "inner from outer", "outer from inner", "outer gain")
FACTOR = np.array([0, 1, 2])  # entries that are free where the outer gain is the unit
PER_KELVIN = 0.005  # relative, by which a PVDF film's charge per force changes
LEAST_TOLD = 0.2  # standard deviation of a gain above which it counts as not told
STEPS = 25  # of the fit: readings that agree take ten
PRIOR_ONLY = 0.7  # of what was assumed of a cross-talk: a standard deviation above it was not told by the readings


@dataclass(frozen=True)
class Observed:
    """One reading on a reference.

    Attributes:
        films: both films' readings y, N, shape (2,).
        covariance: of them by noise, N^2, shape (2, 2).
        force: amplitude of the load by the force channel, N, or None.
        force_sd: by noise, N.
        force_doubt: relative, by which whatever makes the force channel lag may have changed it, in all readings alike.
    """

    reference: Reference
    films: Floats
    covariance: Floats
    force: float | None = None
    force_sd: float | None = None
    force_doubt: float = 0.0

    @property
    def load(self) -> float:
        """Amplitude of the load, N: by the force channel, else by the films' nominal gains."""
        return float(self.films.sum()) if self.force is None else self.force


@dataclass(frozen=True)
class Gains:
    """The gain matrix with what is known of its error.

    Attributes:
        matrix: M of eq. BP.1, shape (2, 2).
        covariance: of its entries row by row, shape (4, 4).
        slopes: by how much the estimate moves per SI unit by which a design variable is off its drawing, shape (4, v).
        workshop: standard deviations of these variables that ``covariance`` counts, SI, shape (v,).
        absolute: whether a force channel has told the common factor.
        cross_talk_resolved: whether the readings have told each cross-talk, or what was assumed of it stands.
        chi_square: of the fit.
        freedom: its degrees of freedom.
        force_scale: what was found of the force channel, whose part ``covariance`` counts.
    """

    matrix: Floats
    covariance: Floats
    slopes: Floats
    workshop: Floats
    absolute: bool
    cross_talk_resolved: tuple[bool, bool]
    chi_square: float = 0.0
    freedom: int = 0
    force_scale: ForceScale = field(default_factory=ForceScale)

    @classmethod
    def nominal(cls, bench: Bench) -> Gains:
        """Return what is known without calibration."""
        gain, cross = bench.channels.gain**2, bench.channels.cross_talk**2
        return cls(
            matrix=np.eye(2),
            covariance=np.diag([gain, cross, cross, gain]),
            slopes=np.zeros((4, 0)),
            workshop=np.zeros(0),
            absolute=False,
            cross_talk_resolved=(False, False),
        )

    def warmed(self, kelvin: float) -> Gains:
        """Return them at another temperature than the calibration's: each film's gain, a row of M, drifts on its own."""
        drift = PER_KELVIN * kelvin * np.kron(np.eye(2), np.ones((2, 1))).T @ np.diag(self.matrix.ravel())
        return replace(self, covariance=self.covariance + drift.T @ drift)

    @property
    def p_value(self) -> float:
        """Probability of a chi-square as large or larger."""
        return float(chdtrc(self.freedom, self.chi_square)) if self.freedom else 1.0

    @property
    def as_drawn(self) -> Floats:
        """Covariance of the entries if the probe is as drawn: without the workshop's part, shape (4, 4)."""
        spread = self.slopes * self.workshop
        return np.asarray(self.covariance - spread @ spread.T)

    def forces(self, films: Floats) -> Floats:
        """Film forces f, N, from readings y, N, shape (2,)."""
        return np.asarray(np.linalg.solve(self.matrix, films), dtype=float)

    def by_entries(self, films: Floats) -> Floats:
        """Derivatives of ``forces`` by the entries of M, shape (2, 4): df = -M^-1 dM f."""
        return np.asarray(-np.linalg.inv(self.matrix) @ np.kron(np.eye(2), self.forces(films)))

    def forces_covariance(self, films: Floats, covariance: Floats) -> Floats:
        """Of ``forces`` by that of the readings and that of M, N^2, shape (2, 2)."""
        inverse, slopes = np.linalg.inv(self.matrix), self.by_entries(films)
        return np.asarray(inverse @ covariance @ inverse.T + slopes @ self.covariance @ slopes.T)


def estimated(observed: Sequence[Observed], shares: Shares, bench: Bench) -> Gains:
    """Estimate M from readings on references, eq. BP.2.

    Args:
        observed: one for each reading.
        shares: predictions for those of them that are on tissue, in their order.
        bench: tolerances, and what is assumed of the cross-talk.

    Raises:
        InputError: the references cannot tell the gains.
    """
    from scipy.optimize import least_squares  # 15 MB that a logger of hours, who knows the gains, need not hold

    problem = _Problem(tuple(observed), shares, bench)
    if problem.read_data <= len(problem.start()):
        raise _unresolved(np.inf)
    most = STEPS * (len(problem.start()) + 1)  # of readings that contradict each other it may wander
    solved = least_squares(problem.residuals, problem.start(), method="lm", x_scale="jac", xtol=1e-12, ftol=1e-12, max_nfev=most)
    information = solved.jac.T @ solved.jac
    scale = np.sqrt(np.maximum(np.diag(information), np.finfo(float).tiny))
    if np.linalg.cond(information / np.outer(scale, scale)) > 1e14:
        raise _unresolved(np.inf)
    whole = np.linalg.inv(information / np.outer(scale, scale)) / np.outer(scale, scale)
    matrix, by_unknowns = problem.matrix(solved.x), problem.matrix_derivatives(solved.x)
    covariance = by_unknowns @ whole @ by_unknowns.T
    slopes = by_unknowns @ whole @ solved.jac.T @ problem.shift(shares.slopes)
    spread = np.sqrt(np.diag(covariance))
    if max(spread[[0, 3]] / np.abs(np.diag(matrix))) > LEAST_TOLD:
        raise _unresolved(max(spread[[0, 3]]))
    if not problem.absolute:  # the common factor is what it was before
        covariance += bench.channels.gain**2 * np.outer(matrix.ravel(), matrix.ravel())
    inner_resolved, outer_resolved = (bool(spread[k] < PRIOR_ONLY * bench.channels.cross_talk) for k in (1, 2))
    assumed = problem.mean_gain(solved.x)  # nothing that was read: gains far from nominal are refused elsewhere
    return Gains(
        matrix=matrix,
        covariance=covariance,
        slopes=slopes,
        workshop=shares.tolerances(bench.workshop),
        absolute=problem.absolute,
        cross_talk_resolved=(inner_resolved, outer_resolved),
        chi_square=float(2 * solved.cost - assumed @ assumed),
        freedom=problem.read_data - len(solved.x),
        force_scale=problem.force_scale(solved.x, by_unknowns, whole),
    )


def _unresolved(spread: float) -> InputError:
    left = Words(f"these leave a gain uncertain by {spread:.2g}")
    need = "two or more references on which the films' shares differ: a pin on the inner and a ring on the outer block do most"
    return InputError("reference", left, need)


@dataclass(frozen=True)
class _Problem:
    """Residuals of eq. BP.2, each over its standard deviation.

    Unknowns: entries of M / k, ln(k F_k), lambda_k, leaks and, with a force channel, ln k over its standard deviation. So k, of
    which the readings say little, bends no other residual; without a force channel it is 1.
    """

    observed: tuple[Observed, ...]
    shares: Shares
    bench: Bench

    @property
    def sensed(self) -> bool:
        """Whether the force channel shows each load."""
        return all(one.force is not None for one in self.observed)

    @property
    def absolute(self) -> bool:
        return self.sensed or any(one.reference.known_force is not None for one in self.observed)

    @property
    def entries(self) -> Ints:
        return np.arange(4) if self.absolute else FACTOR

    @property
    def read_data(self) -> int:
        """How many residuals there are of readings and what is known of them, not of nominal gains."""
        return len(self.residuals(self.start())) - len(self.mean_gain(self.start()))

    def start(self) -> Floats:
        loads = [one.load for one in self.observed]
        entries = np.array([1.0, 0.0, 0.0, 1.0])[self.entries]
        leaks = np.zeros(self._leaks.shape[1])
        return np.concatenate([entries, np.log(loads), self.shares.log_ratios, leaks, [0.0] * self.sensed])

    def matrix(self, unknowns: Floats) -> Floats:
        """Return M, shape (2, 2)."""
        return np.asarray(np.exp(self._log_scale(unknowns)) * self._scaled_matrix(unknowns))

    def matrix_derivatives(self, unknowns: Floats) -> Floats:
        """Return the derivatives of M's entries by the unknowns, shape (4, unknowns)."""
        out = np.zeros((4, len(unknowns)))
        out[self.entries, np.arange(len(self.entries))] = np.exp(self._log_scale(unknowns))
        if self.sensed:
            out[:, -1] = prior_sd(self.bench, self._doubt) * self.matrix(unknowns).ravel()
        return out

    def _scaled_matrix(self, unknowns: Floats) -> Floats:
        """M / k."""
        entries = np.array([0.0, 0.0, 0.0, 1.0])
        entries[self.entries] = unknowns[: len(self.entries)]
        return entries.reshape(2, 2)

    def _log_scale(self, unknowns: Floats) -> float:
        """Return ln k."""
        return prior_sd(self.bench, self._doubt) * float(unknowns[-1]) if self.sensed else 0.0

    def residuals(self, unknowns: Floats) -> Floats:
        matrix, rest = self._scaled_matrix(unknowns), unknowns[len(self.entries) :]
        count, blocks = len(self.observed), len(self.shares.blocks)
        loads, lambdas = np.exp(rest[:count]), rest[count : count + blocks]
        leaks = rest[count + blocks :][: self._leaks.shape[1]]
        shown = self._shares(lambdas, leaks) * loads[:, None] @ matrix.T
        films = [white @ (one.films - y) for white, one, y in zip(self._whitening, self.observed, shown, strict=True)]
        cross_talk = matrix[[0, 1], [1, 0]] / max(self.bench.channels.cross_talk, 1e-9)
        parts = [*films, self._predicted(lambdas - self.shares.log_ratios), leaks, cross_talk]
        parts += [self.mean_gain(unknowns), self._known(loads, self._log_scale(unknowns))]
        if self.sensed:
            parts += [self._forces(loads), rest[-1:]]
        return np.concatenate(parts)

    def mean_gain(self, unknowns: Floats) -> Floats:
        """Return by how many standard deviations the mean gain is off 1, (1,), where nothing else tells k; else (0,)."""
        if not self.sensed or self._confirmed:
            return np.zeros(0)
        return np.array([(np.trace(self.matrix(unknowns)) / 2 - 1) / mean_gain_sd(self.bench)])

    @property
    def _confirmed(self) -> bool:
        return (self.bench.force is not None and self.bench.force.verified) or bool(self._known_forces)

    def force_scale(self, unknowns: Floats, by_unknowns: Floats, covariance: Floats) -> ForceScale:
        """Return what was found of the force channel."""
        if not self.sensed:
            return ForceScale()
        sd, spread = prior_sd(self.bench, self._doubt), float(np.sqrt(covariance[-1, -1]))
        entries = by_unknowns @ covariance[:, -1] / spread
        return ForceScale(float(np.exp(self._log_scale(unknowns))), sd * spread, entries, self._confirmed)

    def shift(self, slopes: Floats) -> Floats:
        """By how much minus the residuals move with the design's variables, shape (residuals, v)."""
        before = 2 * len(self.observed)
        out = np.zeros((len(self.residuals(self.start())), slopes.shape[1]))
        if len(slopes):
            out[before : before + len(slopes)] = np.linalg.solve(self._root, slopes)
        return out

    def _shares(self, lambdas: Floats, leaks: Floats) -> Floats:
        """Shares of the load on both films, shape (readings, 2)."""
        shares = inner_shares(lambdas, [one.reference for one in self.observed]) + self._leaks @ leaks
        return np.stack([shares, 1 - shares], axis=1)

    @cached_property
    def _leaks(self) -> Floats:
        """What pins and rings that leak by their standard deviation add to the inner film's shares, (readings, those)."""
        added = [(-1.0 if one.reference.on == "inner" else 1.0) * one.reference.strays for one in self.observed]
        return np.diag(added)[:, [one.reference.on != "tissue" for one in self.observed]]

    def _forces(self, loads: Floats) -> Floats:
        read = np.array([one.force for one in self.observed], dtype=float)
        spread = np.array([one.force_sd for one in self.observed], dtype=float)
        return np.asarray((read - loads) / spread)

    @property
    def _doubt(self) -> float:
        return max(one.force_doubt for one in self.observed)

    @cached_property
    def _known_forces(self) -> list[tuple[int, float, float]]:
        """Which readings' loads are known: number, ln of the load and standard deviation."""
        pairs = enumerate(one.reference for one in self.observed)
        return [(k, float(np.log(one.known_force)), one.known_force_tolerance) for k, one in pairs if one.known_force is not None]

    def _known(self, loads: Floats, log_scale: float) -> Floats:
        return np.array([(np.log(loads[k]) - log_scale - log) / spread for k, log, spread in self._known_forces])

    def _predicted(self, off: Floats) -> Floats:
        return np.asarray(np.linalg.solve(self._root, off), dtype=float) if len(off) else off

    @cached_property
    def _whitening(self) -> list[Floats]:
        """By which each reading's errors are made independent and of unit variance."""
        return [np.linalg.inv(np.linalg.cholesky(one.covariance)) for one in self.observed]

    @cached_property
    def _root(self) -> Floats:
        """Cholesky factor of the predictions' covariance: each block's own error, and the workshop's, which all share."""
        blocks = [one.reference for one in self.observed if one.reference.on == "tissue"]
        own = [share.variance(block) for share, block in zip(self.shares.blocks, blocks, strict=True)]
        common = self.shares.slopes * self.shares.tolerances(self.bench.workshop)
        return np.asarray(np.linalg.cholesky(np.diag(own) + common @ common.T), dtype=float)
