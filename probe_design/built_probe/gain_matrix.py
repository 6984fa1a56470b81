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
from probe_design.built_probe.block_predictions import BlockPredictions, compute_inner_shares
from probe_design.built_probe.force_scale import ForceScale, compute_mean_gain_sd, compute_prior_sd
from probe_design.inference.linear_gaussian import LinearGaussian

ENTRY_NAMES = ("inner gain", "inner from outer", "outer from inner", "outer gain")
FREE_ENTRIES = np.array([0, 1, 2])  # free entries if the common factor is unknown: the outer gain is then 1
PER_KELVIN = 0.005  # relative change of a PVDF film's charge per force, 1/K
MAX_RESOLVED_GAIN_SD = 0.2  # relative standard deviation of a gain above which the readings do not determine it
MAX_FIT_STEPS = 25  # iterations of the fit; readings that agree take ten
PRIOR_ONLY = 0.7  # posterior over prior standard deviation of a cross-talk above which the readings do not determine it


@dataclass(frozen=True)
class Observation:
    """One reading on a reference.

    Attributes
    ----------
    films
        Both films' readings y, N, shape (2,).
    covariance
        Of them by noise, N^2, shape (2, 2).
    force
        Amplitude of the load by the force channel, N, or None.
    force_sd
        By noise, N.
    force_doubt
        Relative error of ``force`` that a lag of the force channel may cause, common to all readings.
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

    Attributes
    ----------
    matrix
        M of eq. BP.1, shape (2, 2).
    covariance
        Of its entries row by row, shape (4, 4).
    slopes
        Derivatives of the entries with respect to the design's variables, per SI unit, shape (4, v).
    workshop
        Standard deviations of these variables, SI, shape (v,); ``covariance`` includes their effect.
    absolute
        Whether a force channel or a known load determines the common factor.
    cross_talk_resolved
        Whether the readings determine each cross-talk; if not, the assumed one stands.
    chi_square
        Of the fit.
    freedom
        Degrees of freedom of the fit.
    force_scale
        Scale of the force channel; ``covariance`` includes its effect.
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
    def from_bench(cls, bench: Bench) -> Gains:
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

    def add_warming(self, kelvin: float) -> Gains:
        """Add a change of temperature (1 sd, K) since the calibration: each film's gain, a row of M, drifts independently."""
        drift = PER_KELVIN * kelvin * np.kron(np.eye(2), np.ones((2, 1))).T @ np.diag(self.matrix.ravel())
        return replace(self, covariance=self.covariance + drift.T @ drift)

    @property
    def p_value(self) -> float:
        """Probability of a chi-square as large or larger."""
        return float(chdtrc(self.freedom, self.chi_square)) if self.freedom else 1.0

    @property
    def errors_as_drawn(self) -> Floats:
        """Independent errors of the entries, 1 sd, without the workshop's tolerances: for a probe as drawn, shape (4, 4)."""
        spread = self.slopes * self.workshop
        variances, directions = np.linalg.eigh(self.covariance - spread @ spread.T)
        return np.asarray(directions * np.sqrt(np.maximum(variances, 0.0)))

    def compute_forces(self, films: Floats) -> Floats:
        """Return the film forces f, N, from readings y, N, shape (2,)."""
        return np.asarray(np.linalg.solve(self.matrix, films), dtype=float)

    def differentiate_by_entries(self, films: Floats) -> Floats:
        """Return the derivatives of the forces with respect to the entries of M, shape (2, 4): df = -M^-1 dM f."""
        return np.asarray(-np.linalg.inv(self.matrix) @ np.kron(np.eye(2), self.compute_forces(films)))

    def compute_forces_covariance(self, films: Floats, covariance: Floats) -> Floats:
        """Return the covariance of the forces due to the readings' and M's covariances, N^2, shape (2, 2)."""
        inverse, slopes = np.linalg.inv(self.matrix), self.differentiate_by_entries(films)
        return np.asarray(inverse @ covariance @ inverse.T + slopes @ self.covariance @ slopes.T)


def estimate_gains(observed: Sequence[Observation], shares: BlockPredictions, bench: Bench) -> Gains:
    """Estimate M from readings on references, eq. BP.2.

    Parameters
    ----------
    observed
        One for each reading.
    shares
        Predictions for those of them that are on tissue, in their order.
    bench
        Tolerances, and the assumed cross-talk.

    Raises
    ------
    InputError
        The references do not determine the gains.
    """
    from scipy.optimize import least_squares

    problem = _Problem(tuple(observed), shares, bench)
    if problem.read_data <= len(problem.build_start()):
        raise _build_unresolved_error(np.inf)
    max_evaluations = MAX_FIT_STEPS * (len(problem.build_start()) + 1)  # readings that contradict each other may not converge
    solved = least_squares(
        problem.compute_residuals,
        problem.build_start(),
        method="lm",
        x_scale="jac",
        xtol=1e-12,
        ftol=1e-12,
        max_nfev=max_evaluations,
    )
    jacobian = np.asarray(solved.jac)  # of residuals over their standard deviations
    fit = LinearGaussian(jacobian, np.ones(len(jacobian)), np.full(len(solved.x), np.inf))
    whole = fit.compute_posterior_covariance()
    if not np.isfinite(whole).all():
        raise _build_unresolved_error(np.inf)
    matrix, derivatives = problem.compute_matrix(solved.x), problem.compute_matrix_derivatives(solved.x)
    covariance = derivatives @ whole @ derivatives.T
    slopes = derivatives @ fit.compute_posterior_mean(problem.compute_shift(shares.slopes).T).T
    spread = np.sqrt(np.diag(covariance))
    if max(spread[[0, 3]] / np.abs(np.diag(matrix))) > MAX_RESOLVED_GAIN_SD:
        raise _build_unresolved_error(max(spread[[0, 3]]))
    if not problem.absolute:  # the readings do not improve the common factor
        covariance += bench.channels.gain**2 * np.outer(matrix.ravel(), matrix.ravel())
    inner_resolved, outer_resolved = (bool(spread[k] < PRIOR_ONLY * bench.channels.cross_talk) for k in (1, 2))
    assumed = problem.compute_mean_gain_residual(solved.x)  # a prior, no reading: not part of the chi-square
    return Gains(
        matrix=matrix,
        covariance=covariance,
        slopes=slopes,
        workshop=shares.compute_tolerances(bench.workshop),
        absolute=problem.absolute,
        cross_talk_resolved=(inner_resolved, outer_resolved),
        chi_square=float(2 * solved.cost - assumed @ assumed),
        freedom=problem.read_data - len(solved.x),
        force_scale=problem.build_force_scale(solved.x, derivatives, whole),
    )


def _build_unresolved_error(spread: float) -> InputError:
    entry = Words(f"these leave a gain uncertain by {spread:.2g}")
    allowed = "two or more references on which the films' shares differ: a pin on the inner and a ring on the outer block do most"
    return InputError("reference", entry, allowed)


@dataclass(frozen=True)
class _Problem:
    """The least-squares problem of eq. BP.2: residuals, each over its standard deviation.

    Unknowns: entries of M / k, ln(k F_k), lambda_k, leaks and, with a force channel, ln k over its standard deviation. With these
    unknowns the poorly determined k does not make other residuals nonlinear; without a force channel it is 1.
    """

    observed: tuple[Observation, ...]
    shares: BlockPredictions
    bench: Bench

    @property
    def sensed(self) -> bool:
        """Whether the force channel shows each load."""
        return all(observation.force is not None for observation in self.observed)

    @property
    def absolute(self) -> bool:
        return self.sensed or any(observation.reference.known_force is not None for observation in self.observed)

    @property
    def entries(self) -> Ints:
        return np.arange(4) if self.absolute else FREE_ENTRIES

    @property
    def read_data(self) -> int:
        """Number of residuals of readings and predictions, without the prior on nominal gains."""
        return len(self.compute_residuals(self.build_start())) - len(self.compute_mean_gain_residual(self.build_start()))

    def build_start(self) -> Floats:
        loads = [observation.load for observation in self.observed]
        entries = np.array([1.0, 0.0, 0.0, 1.0])[self.entries]
        leaks = np.zeros(self._leaks.shape[1])
        return np.concatenate([entries, np.log(loads), self.shares.log_ratios, leaks, [0.0] * self.sensed])

    def compute_matrix(self, unknowns: Floats) -> Floats:
        """Return M, shape (2, 2)."""
        return np.asarray(np.exp(self._get_log_scale(unknowns)) * self._compute_scaled_matrix(unknowns))

    def compute_matrix_derivatives(self, unknowns: Floats) -> Floats:
        """Return the derivatives of M's entries with respect to the unknowns, shape (4, unknowns)."""
        derivatives = np.zeros((4, len(unknowns)))
        derivatives[self.entries, np.arange(len(self.entries))] = np.exp(self._get_log_scale(unknowns))
        if self.sensed:
            derivatives[:, -1] = compute_prior_sd(self.bench, self._doubt) * self.compute_matrix(unknowns).ravel()
        return derivatives

    def _compute_scaled_matrix(self, unknowns: Floats) -> Floats:
        """Return M / k, shape (2, 2)."""
        entries = np.array([0.0, 0.0, 0.0, 1.0])
        entries[self.entries] = unknowns[: len(self.entries)]
        return entries.reshape(2, 2)

    def _get_log_scale(self, unknowns: Floats) -> float:
        """Return ln k."""
        return compute_prior_sd(self.bench, self._doubt) * float(unknowns[-1]) if self.sensed else 0.0

    def compute_residuals(self, unknowns: Floats) -> Floats:
        matrix, parameters = self._compute_scaled_matrix(unknowns), unknowns[len(self.entries) :]
        count, blocks = len(self.observed), len(self.shares.blocks)
        loads, lambdas = np.exp(parameters[:count]), parameters[count : count + blocks]
        leaks = parameters[count + blocks :][: self._leaks.shape[1]]
        shown = self._compute_shares(lambdas, leaks) * loads[:, None] @ matrix.T
        films = self._whitening @ (np.array([observation.films for observation in self.observed]) - shown)[..., None]
        cross_talk = matrix[[0, 1], [1, 0]] / max(self.bench.channels.cross_talk, 1e-9)
        parts = [films.ravel(), np.linalg.solve(self._root, lambdas - self.shares.log_ratios), leaks, cross_talk]
        parts += [self.compute_mean_gain_residual(unknowns), self._compute_known_residuals(loads, self._get_log_scale(unknowns))]
        if self.sensed:
            parts += [self._compute_force_residuals(loads), parameters[-1:]]
        return np.concatenate(parts)

    def compute_mean_gain_residual(self, unknowns: Floats) -> Floats:
        """Return the mean gain's deviation from 1, in sd, shape (1,), if nothing else determines k; otherwise shape (0,)."""
        if not self.sensed or self._is_confirmed:
            return np.zeros(0)
        return np.array([(np.trace(self.compute_matrix(unknowns)) / 2 - 1) / compute_mean_gain_sd(self.bench)])

    @property
    def _is_confirmed(self) -> bool:
        return (self.bench.force is not None and self.bench.force.verified) or bool(self._known_forces)

    def build_force_scale(self, unknowns: Floats, derivatives: Floats, covariance: Floats) -> ForceScale:
        """Build the estimated scale of the force channel."""
        if not self.sensed:
            return ForceScale()
        sd, spread = compute_prior_sd(self.bench, self._doubt), float(np.sqrt(covariance[-1, -1]))
        entries = derivatives @ covariance[:, -1] / spread
        return ForceScale(float(np.exp(self._get_log_scale(unknowns))), sd * spread, entries, self._is_confirmed)

    def compute_shift(self, slopes: Floats) -> Floats:
        """Return minus the derivatives of the residuals with respect to the design's variables, shape (residuals, v)."""
        first_row = 2 * len(self.observed)
        shifts = np.zeros((len(self.compute_residuals(self.build_start())), slopes.shape[1]))
        shifts[first_row : first_row + len(slopes)] = np.linalg.solve(self._root, slopes)
        return shifts

    def _compute_shares(self, lambdas: Floats, leaks: Floats) -> Floats:
        """Return both films' shares of the load, shape (readings, 2)."""
        shares = compute_inner_shares(lambdas, [observation.reference for observation in self.observed]) + self._leaks @ leaks
        return np.stack([shares, 1 - shares], axis=1)

    @cached_property
    def _leaks(self) -> Floats:
        """Change of the inner film's shares for a leak of one sd, shape (readings, pins and rings)."""
        added = [
            (-1.0 if observation.reference.on == "inner" else 1.0) * observation.reference.leak_sd
            for observation in self.observed
        ]
        return np.diag(added)[:, [observation.reference.on != "tissue" for observation in self.observed]]

    def _compute_force_residuals(self, loads: Floats) -> Floats:
        read = np.array([observation.force for observation in self.observed], dtype=float)
        spread = np.array([observation.force_sd for observation in self.observed], dtype=float)
        return np.asarray((read - loads) / spread)

    @property
    def _doubt(self) -> float:
        return max(observation.force_doubt for observation in self.observed)

    @cached_property
    def _known_forces(self) -> list[tuple[int, float, float]]:
        """Readings with a known load: index, ln of the load and its standard deviation."""
        pairs = enumerate(reference.reference for reference in self.observed)
        return [
            (k, float(np.log(reference.known_force)), reference.known_force_tolerance)
            for k, reference in pairs
            if reference.known_force is not None
        ]

    def _compute_known_residuals(self, loads: Floats, log_scale: float) -> Floats:
        return np.array([(np.log(loads[k]) - log_scale - log) / spread for k, log, spread in self._known_forces])

    @cached_property
    def _whitening(self) -> Floats:
        """Matrices that make each reading's errors independent and of unit variance, shape (readings, 2, 2)."""
        return np.asarray(np.linalg.inv(np.linalg.cholesky([observation.covariance for observation in self.observed])))

    @cached_property
    def _root(self) -> Floats:
        """Cholesky factor of the predictions' covariance: each block's own error, and the workshop's error shared by all."""
        blocks = [observation.reference for observation in self.observed if observation.reference.on == "tissue"]
        block_variances = [share.compute_variance(block) for share, block in zip(self.shares.blocks, blocks, strict=True)]
        common = self.shares.slopes * self.shares.compute_tolerances(self.bench.workshop)
        errors = LinearGaussian.from_shared_errors(common, np.array(block_variances))
        return np.asarray(np.linalg.cholesky(errors.covariance), dtype=float)
