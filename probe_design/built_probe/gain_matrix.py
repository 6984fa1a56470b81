"""Apply the gain matrix of both channels to readings, and estimate it from readings on references.

A reading y = Q / c (N, c the nominal charge per force) of film forces f is y = M f (BP.1): M has the relative gains on its
diagonal and the cross-talk off it. On a reference k under the load F_k, f = F_k (s, 1 - s): s is 1 or 0 for a pin or a ring,
except for the fraction that leaks to the other block; ln(s / (1 - s)) = lambda_k is predicted for a block of tissue with errors
of the solver, the block's modulus and the workshop. M, F_k, lambda_k and the leaks follow together from least squares (BP.2),
each datum and each prediction with its covariance. Only the blocks' readings separate a leak from cross-talk.

The force channel shows k F_k, with its scale k of eq. BP.9. Without it, and without a reference of known load, all F_k are free
and M is determined only up to a common factor.
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
FACTOR = np.array([0, 1, 2])  # free entries if the common factor is unknown: the outer gain is then 1
PER_KELVIN = 0.005  # relative change of a PVDF film's charge per force, 1/K
LEAST_TOLD = 0.2  # relative standard deviation of a gain above which the readings do not determine it
STEPS = 25  # iterations of the fit; readings that agree take ten
PRIOR_ONLY = 0.7  # posterior over prior standard deviation of a cross-talk above which the readings do not determine it


@dataclass(frozen=True)
class Observed:
    """One reading on a reference.

    Attributes:
        films: both films' readings y, N, shape (2,).
        covariance: of them by noise, N^2, shape (2, 2).
        force: amplitude of the load by the force channel, N, or None.
        force_sd: by noise, N.
        force_doubt: relative error of ``force`` that a lag of the force channel may cause, common to all readings.
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
    """The gain matrix with its uncertainty.

    Attributes:
        matrix: M of eq. BP.1, shape (2, 2).
        covariance: of its entries row by row, shape (4, 4).
        slopes: derivatives of the entries with respect to the design's variables, per SI unit, shape (4, v).
        workshop: standard deviations of these variables, SI, shape (v,); ``covariance`` includes their effect.
        absolute: whether a force channel or a known load determines the common factor.
        cross_talk_resolved: whether the readings determine each cross-talk; if not, the assumed one stands.
        chi_square: of the fit.
        freedom: degrees of freedom of the fit.
        force_scale: scale of the force channel; ``covariance`` includes its effect.
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
        """Return nominal gains with the bench's tolerances, as known without calibration."""
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
        """Add a change of temperature (1 sd, K) since the calibration: each film's gain, a row of M, drifts independently."""
        drift = PER_KELVIN * kelvin * np.kron(np.eye(2), np.ones((2, 1))).T @ np.diag(self.matrix.ravel())
        return replace(self, covariance=self.covariance + drift.T @ drift)

    @property
    def p_value(self) -> float:
        """Probability of a chi-square as large or larger."""
        return float(chdtrc(self.freedom, self.chi_square)) if self.freedom else 1.0

    @property
    def as_drawn(self) -> Floats:
        """Covariance of the entries for a probe exactly as drawn, without the workshop's tolerances, shape (4, 4)."""
        spread = self.slopes * self.workshop
        return np.asarray(self.covariance - spread @ spread.T)

    def forces(self, films: Floats) -> Floats:
        """Return the film forces f, N, from readings y, N, shape (2,)."""
        return np.asarray(np.linalg.solve(self.matrix, films), dtype=float)

    def by_entries(self, films: Floats) -> Floats:
        """Return the derivatives of the forces with respect to the entries of M, shape (2, 4): df = -M^-1 dM f."""
        return np.asarray(-np.linalg.inv(self.matrix) @ np.kron(np.eye(2), self.forces(films)))

    def forces_covariance(self, films: Floats, covariance: Floats) -> Floats:
        """Return the covariance of the forces due to the readings' and M's covariances, N^2, shape (2, 2)."""
        inverse, slopes = np.linalg.inv(self.matrix), self.by_entries(films)
        return np.asarray(inverse @ covariance @ inverse.T + slopes @ self.covariance @ slopes.T)


def estimated(observed: Sequence[Observed], shares: Shares, bench: Bench) -> Gains:
    """Estimate M from readings on references, eq. BP.2.

    Args:
        observed: one for each reading.
        shares: predictions for those of them that are on tissue, in their order.
        bench: tolerances, and the assumed cross-talk.

    Raises:
        InputError: the references do not determine the gains.
    """
    from scipy.optimize import least_squares  # 15 MB that a logger with known gains need not load

    problem = _Problem(tuple(observed), shares, bench)
    if problem.read_data <= len(problem.start()):
        raise _unresolved(np.inf)
    most = STEPS * (len(problem.start()) + 1)  # readings that contradict each other may not converge
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
    if not problem.absolute:  # the readings do not improve the common factor
        covariance += bench.channels.gain**2 * np.outer(matrix.ravel(), matrix.ravel())
    inner_resolved, outer_resolved = (bool(spread[k] < PRIOR_ONLY * bench.channels.cross_talk) for k in (1, 2))
    assumed = problem.mean_gain(solved.x)  # a prior, no reading: not part of the chi-square
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
    """The least-squares problem of eq. BP.2: residuals, each over its standard deviation.

    Unknowns: entries of M / k, ln(k F_k), lambda_k, leaks and, with a force channel, ln k over its standard deviation. With these
    unknowns the poorly determined k does not make other residuals nonlinear; without a force channel it is 1.
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
        """Number of residuals of readings and predictions, without the prior on nominal gains."""
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
        """Return the derivatives of M's entries with respect to the unknowns, shape (4, unknowns)."""
        out = np.zeros((4, len(unknowns)))
        out[self.entries, np.arange(len(self.entries))] = np.exp(self._log_scale(unknowns))
        if self.sensed:
            out[:, -1] = prior_sd(self.bench, self._doubt) * self.matrix(unknowns).ravel()
        return out

    def _scaled_matrix(self, unknowns: Floats) -> Floats:
        """Return M / k, shape (2, 2)."""
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
        """Return the mean gain's deviation from 1, in sd, shape (1,), if nothing else determines k; otherwise shape (0,)."""
        if not self.sensed or self._confirmed:
            return np.zeros(0)
        return np.array([(np.trace(self.matrix(unknowns)) / 2 - 1) / mean_gain_sd(self.bench)])

    @property
    def _confirmed(self) -> bool:
        return (self.bench.force is not None and self.bench.force.verified) or bool(self._known_forces)

    def force_scale(self, unknowns: Floats, by_unknowns: Floats, covariance: Floats) -> ForceScale:
        """Build the estimated scale of the force channel."""
        if not self.sensed:
            return ForceScale()
        sd, spread = prior_sd(self.bench, self._doubt), float(np.sqrt(covariance[-1, -1]))
        entries = by_unknowns @ covariance[:, -1] / spread
        return ForceScale(float(np.exp(self._log_scale(unknowns))), sd * spread, entries, self._confirmed)

    def shift(self, slopes: Floats) -> Floats:
        """Return minus the derivatives of the residuals with respect to the design's variables, shape (residuals, v)."""
        before = 2 * len(self.observed)
        out = np.zeros((len(self.residuals(self.start())), slopes.shape[1]))
        if len(slopes):
            out[before : before + len(slopes)] = np.linalg.solve(self._root, slopes)
        return out

    def _shares(self, lambdas: Floats, leaks: Floats) -> Floats:
        """Return both films' shares of the load, shape (readings, 2)."""
        shares = inner_shares(lambdas, [one.reference for one in self.observed]) + self._leaks @ leaks
        return np.stack([shares, 1 - shares], axis=1)

    @cached_property
    def _leaks(self) -> Floats:
        """Change of the inner film's shares for a leak of one sd, shape (readings, pins and rings)."""
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
        """Readings with a known load: index, ln of the load and its standard deviation."""
        pairs = enumerate(one.reference for one in self.observed)
        return [(k, float(np.log(one.known_force)), one.known_force_tolerance) for k, one in pairs if one.known_force is not None]

    def _known(self, loads: Floats, log_scale: float) -> Floats:
        return np.array([(np.log(loads[k]) - log_scale - log) / spread for k, log, spread in self._known_forces])

    def _predicted(self, off: Floats) -> Floats:
        return np.asarray(np.linalg.solve(self._root, off), dtype=float) if len(off) else off

    @cached_property
    def _whitening(self) -> list[Floats]:
        """Matrices that make each reading's errors independent and of unit variance."""
        return [np.linalg.inv(np.linalg.cholesky(one.covariance)) for one in self.observed]

    @cached_property
    def _root(self) -> Floats:
        """Cholesky factor of the predictions' covariance: each block's own error, and the workshop's error shared by all."""
        blocks = [one.reference for one in self.observed if one.reference.on == "tissue"]
        own = [share.variance(block) for share, block in zip(self.shares.blocks, blocks, strict=True)]
        common = self.shares.slopes * self.shares.tolerances(self.bench.workshop)
        return np.asarray(np.linalg.cholesky(np.diag(own) + common @ common.T), dtype=float)
