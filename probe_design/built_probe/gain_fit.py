"""Estimate the gain matrix of both channels from readings on references.

On a reference k under the load F_k, the film forces are F_k (s, 1 - s): s is 1 or 0 for a pin or a ring, except for the fraction
that leaks to the other block; ln(s / (1 - s)) = lambda_k is predicted for a block of tissue with errors of the solver, the
block's modulus and the workshop. M, F_k, lambda_k and the leaks follow together from least squares (BP.2), each datum and each
prediction with its covariance. Only the blocks' readings separate a leak from cross-talk. Without force channel, and without a
reference of known load, all F_k are free and M is determined only up to a common factor.

Readings of the films alone cannot confirm the force channel's scale: a sensor that reads 10 % high makes all gains 10 % too small
and contradicts nothing. Its maker's tolerance is used once a known load has confirmed it. Until then the scale k is unknown, and
follows from the films' nominal gains, of standard deviation sigma each:

    F_read = k F,    (g_inner + g_outer) / 2 = 1 +- sigma / sqrt(2)                                        (BP.9)

F is the true force, F_read the channel's reading, g_inner and g_outer the films' gains. A reference of known load determines k.

Where readings are charges, F_k is sigma_k times the load, eq. BP.11, and all lambda_k and ln sigma_k depend on the bonds'
modulus. Its logarithm is one more unknown, with the catalogue's spread as its prior; M's diagonal has one scale of d per film.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import InputError, Words
from probe_design.built_probe.bench import Bench, Reference
from probe_design.built_probe.block_predictions import BlockPredictions, compute_inner_fractions
from probe_design.built_probe.gains import BondFactor, ForceScale, Gains, Observation
from probe_design.built_probe.reference_charges import BondModulus, LoadFactor
from probe_design.inference.linear_gaussian import LinearGaussian

MAX_RESOLVED_GAIN_SD = 0.2  # relative standard deviation of a gain above which the readings do not determine it
MAX_FIT_STEPS = 25  # iterations of the fit; readings that agree take ten
PRIOR_ONLY = 0.7  # posterior over prior standard deviation of a cross-talk above which the readings do not determine it
UNKNOWN_SCALE_SD = 1.0  # of ln k if unknown: the films' nominal gains have 400 times the weight


def estimate_gains(observations: Sequence[Observation], predictions: BlockPredictions, bench: Bench) -> Gains:
    """Estimate M from readings on references, eq. BP.2.

    Parameters
    ----------
    observations
        One for each reading.
    predictions
        For those of them that are on tissue, in their order.
    bench
        Tolerances, and the assumed cross-talk.

    Raises
    ------
    InputError
        The references do not determine the gains.
    """
    from scipy.optimize import least_squares

    problem = _GainProblem(tuple(observations), predictions, bench)
    start = problem.build_start()
    # the mean gain's residual is an assumption, not a datum
    data_count = len(problem.compute_residuals(start)) - len(problem.compute_mean_gain_residual(start))
    if data_count <= len(start):
        raise _build_unresolved_error(np.inf)
    max_evaluations = MAX_FIT_STEPS * (len(start) + 1)  # readings that contradict each other may not converge
    solved = least_squares(
        problem.compute_residuals, start, method="lm", x_scale="jac", xtol=1e-12, ftol=1e-12, max_nfev=max_evaluations
    )
    jacobian = np.asarray(solved.jac)  # of residuals over their standard deviations
    fit = LinearGaussian(jacobian, np.ones(len(jacobian)), np.full(len(start), np.inf))
    unknowns_covariance = fit.compute_posterior_covariance()
    if not np.isfinite(unknowns_covariance).all():
        raise _build_unresolved_error(np.inf)
    matrix, derivatives = problem.compute_matrix(solved.x), problem.compute_entry_derivatives(solved.x)
    covariance = derivatives @ unknowns_covariance @ derivatives.T
    entry_sds = np.sqrt(np.diag(covariance))
    if max(entry_sds[[0, 3]] / np.abs(np.diag(matrix))) > MAX_RESOLVED_GAIN_SD:
        raise _build_unresolved_error(max(entry_sds[[0, 3]]))
    if not problem.is_absolute:  # the readings do not improve the common factor
        covariance[:4, :4] += bench.channels.gain**2 * np.outer(matrix.ravel(), matrix.ravel())
    inner_resolved, outer_resolved = (bool(entry_sds[k] < PRIOR_ONLY * bench.channels.cross_talk) for k in (1, 2))
    prior_misfit = float((problem.compute_mean_gain_residual(solved.x) ** 2).sum())  # no reading: not part of the chi-square
    return Gains(
        matrix=matrix,
        covariance=covariance,
        slopes=derivatives @ fit.compute_posterior_mean(problem.shift_residuals().T).T,
        workshop=predictions.compute_tolerances(bench.workshop),
        absolute=problem.is_absolute,
        cross_talk_resolved=(inner_resolved, outer_resolved),
        chi_square=float(2 * solved.cost - prior_misfit),
        degrees_of_freedom=data_count - len(start),
        force_scale=problem.build_force_scale(solved.x, derivatives, unknowns_covariance),
        bonds=problem.build_bond_factor(solved.x),
    )


def _build_unresolved_error(gain_sd: float) -> InputError:
    """Build the error for references that leave a gain with this relative standard deviation."""
    entry = Words(f"these leave a gain uncertain by {gain_sd:.2g}")
    references = "two or more references on which the films' fractions of the load differ"
    return InputError("reference", entry, f"{references}: a pin on the inner and a ring on the outer block do most")


def compute_mean_gain_sd(bench: Bench) -> float:
    """Return the standard deviation of the mean of both channels' gains, due to films and amplifiers."""
    amplifiers = bench.amplifier.build_films()
    return float(np.sqrt(sum(bench.channels.gain**2 + amplifier.capacitance_tolerance**2 for amplifier in amplifiers)) / 2)


class _Unknowns(NamedTuple):
    """The unknowns of the fit: M / k, and ln k, with which the poorly determined k leaves other residuals linear."""

    scaled_matrix: Floats  # M / k, shape (2, 2); its last entry is 1 where only the ratio of the gains is determined
    loads: Floats  # k F_k, N
    log_ratios: Floats  # lambda_k of the blocks
    leaks: Floats  # over their standard deviations
    load_factors: Floats  # ln sigma_k of the readings; none where readings are forces
    bonds: float  # ln of the factor on the bonds' modulus; 0 where it is not fitted
    log_scale: float  # ln k; 0 without force channel


@dataclass(frozen=True)
class _GainProblem:
    """The least-squares problem of eq. BP.2: residuals, each over its standard deviation."""

    observations: tuple[Observation, ...]
    predictions: BlockPredictions
    bench: Bench

    @cached_property
    def references(self) -> list[Reference]:
        """The reference of each reading."""
        return [observation.reference for observation in self.observations]

    @cached_property
    def has_force(self) -> bool:
        """Whether the force channel shows each load."""
        return all(observation.force is not None for observation in self.observations)

    @cached_property
    def has_known_load(self) -> bool:
        """Whether the load on a reference is known independently."""
        return any(reference.known_force is not None for reference in self.references)

    @property
    def is_absolute(self) -> bool:
        """Whether the common factor of the gains is determined."""
        return self.has_force or self.has_known_load

    @property
    def is_scale_confirmed(self) -> bool:
        """Whether a known load has confirmed the force channel's scale, now or before."""
        return (self.bench.force is not None and self.bench.force.verified) or self.has_known_load

    @cached_property
    def scale_sd(self) -> float:
        """Standard deviation of ln k before any reading; 0 without force channel."""
        if not self.has_force or self.bench.force is None:
            return 0.0
        max_loss = max(observation.force_loss for observation in self.observations)
        return float(np.hypot(self.bench.force.tolerance if self.bench.force.verified else UNKNOWN_SCALE_SD, max_loss))

    @cached_property
    def entry_count(self) -> int:
        """Number of free entries of M / k."""
        return 4 if self.is_absolute else 3

    def build_start(self) -> Floats:
        """Build the vector of unknowns at nominal gains.

        In this order: entries, ln loads, ln ratios, leaks, ln sigma, ln of the bonds' modulus and ln k over their prior sd.
        """
        entries = np.eye(2).ravel()[: self.entry_count]
        log_loads = np.log([observation.load for observation in self.observations])
        leaks, scale = np.zeros(self._leak_effects.shape[1]), np.zeros(int(self.has_force))
        bonds = [] if self.bonds is None else [self.bonds.log_factor / self.bonds.log_sd]
        load_factors = [factor.log for factor in self._load_factors]
        return np.concatenate([entries, log_loads, self.predictions.log_ratios, leaks, load_factors, bonds, scale])

    def _split(self, unknowns: Floats) -> _Unknowns:
        """Split the vector of unknowns, in the order of ``build_start``."""
        sizes = (
            self.entry_count,
            len(self.observations),
            len(self.predictions.blocks),
            self._leak_effects.shape[1],
            len(self._load_factors),
            int(self.bonds is not None),
        )
        entries, log_loads, log_ratios, leaks, load_factors, bonds, scale = np.split(unknowns, np.cumsum(sizes))
        matrix = np.append(entries, np.ones(4 - len(entries))).reshape(2, 2)
        log_bonds = 0.0 if self.bonds is None else self.bonds.log_sd * float(bonds[0])
        log_scale = self.scale_sd * float(scale.sum())
        return _Unknowns(matrix, np.exp(log_loads), log_ratios, leaks, load_factors, log_bonds, log_scale)

    def compute_matrix(self, unknowns: Floats) -> Floats:
        """Return M, shape (2, 2)."""
        parts = self._split(unknowns)
        return np.asarray(np.exp(parts.log_scale) * parts.scaled_matrix)

    def compute_entry_derivatives(self, unknowns: Floats) -> Floats:
        """Return the derivatives of M's entries and of ln of the bonds' modulus with respect to the unknowns, (n, unknowns)."""
        derivatives = np.zeros((4 + (self.bonds is not None), len(unknowns)))
        derivatives[: self.entry_count, : self.entry_count] = np.exp(self._split(unknowns).log_scale) * np.eye(self.entry_count)
        if self.has_force:
            derivatives[:4, -1] = self.scale_sd * self.compute_matrix(unknowns).ravel()
        if self.bonds is not None:
            derivatives[4, len(unknowns) - 1 - self.has_force] = self.bonds.log_sd
        return derivatives

    def compute_residuals(self, unknowns: Floats) -> Floats:
        """Return the residuals, each over its standard deviation.

        In this order: readings, predictions, bonds, leaks, cross-talk, mean gain, known loads, force channel, its scale.
        """
        matrix, loads, log_ratios, leaks, load_factors, log_bonds, log_scale = self._split(unknowns)
        fractions = compute_inner_fractions(log_ratios, self.references) + self._leak_effects @ leaks
        sums = loads * np.exp(load_factors) if len(load_factors) else loads
        films = np.stack([fractions, 1 - fractions], axis=1) * sums[:, None] @ matrix.T
        predicted = np.concatenate([log_ratios, load_factors]) - self._predicted_logs
        if self.bonds is not None:
            predicted = predicted - self._bond_derivatives * (log_bonds - self.bonds.log_factor)
        parts = [
            (self._whitening @ (self._films - films)[..., None]).ravel(),
            np.linalg.solve(self._prediction_root, predicted),
            np.array([log_bonds / self.bonds.log_sd]) if self.bonds is not None else np.zeros(0),
            leaks,
            matrix[[0, 1], [1, 0]] / max(self.bench.channels.cross_talk, 1e-9),  # the bench may state a cross-talk of 0
            self.compute_mean_gain_residual(unknowns),
        ]
        if self.has_known_load:
            known, forces, tolerances = self._known_loads
            parts.append((np.log(loads[known] / forces) - log_scale) / tolerances)  # ``loads`` are k times the true ones
        if self.has_force:
            forces, force_sds = self._forces
            parts += [(forces - loads) / force_sds, unknowns[-1:]]
        return np.concatenate(parts)

    def compute_mean_gain_residual(self, unknowns: Floats) -> Floats:
        """Return the mean gain's deviation from 1, in sd, shape (1,), if nothing else determines k; otherwise shape (0,)."""
        if not self.has_force or self.is_scale_confirmed:
            return np.zeros(0)
        return np.array([(np.trace(self.compute_matrix(unknowns)) / 2 - 1) / compute_mean_gain_sd(self.bench)])

    def build_force_scale(self, unknowns: Floats, derivatives: Floats, covariance: Floats) -> ForceScale:
        """Build the estimated scale of the force channel.

        Parameters
        ----------
        unknowns
            Of the fit, the last of them ln k over its prior standard deviation.
        derivatives
            Of the entries of M and of ln of the bonds' modulus with respect to the unknowns, shape (n, unknowns).
        covariance
            Of the unknowns.
        """
        if not self.has_force:
            return ForceScale()
        sd = float(np.sqrt(covariance[-1, -1]))  # over the prior's
        entries = tuple((derivatives @ covariance[:, -1] / sd).tolist())
        factor = float(np.exp(self._split(unknowns).log_scale))
        return ForceScale.model_construct(  # not validated: the fit of readings that contradict each other may give any number
            factor=factor, sd=self.scale_sd * sd, entries=entries, confirmed=self.is_scale_confirmed
        )

    def build_bond_factor(self, unknowns: Floats) -> BondFactor | None:
        """Build the estimated modulus of the bonds; None where it is not fitted."""
        if self.bonds is None:
            return None
        factors = (factor.film_bond_derivatives for factor in self.predictions.load_factors)
        by_film = [derivatives for derivatives in factors if derivatives is not None]
        inner, outer = np.mean(by_film, axis=0).tolist() if by_film else (0.0, 0.0)
        # not validated: the fit of readings that contradict each other may give any number
        return BondFactor.model_construct(log_factor=self._split(unknowns).bonds, film_derivatives=(inner, outer))

    def shift_residuals(self) -> Floats:
        """Return minus the derivatives of the residuals with respect to the design's variables, shape (residuals, v)."""
        first_row = 2 * len(self.observations)  # the predictions' residuals follow two residuals for each reading
        derivatives = self._prediction_derivatives
        shifts = np.zeros((len(self.compute_residuals(self.build_start())), derivatives.shape[1]))
        shifts[first_row : first_row + len(derivatives)] = np.linalg.solve(self._prediction_root, derivatives)
        return shifts

    @property
    def bonds(self) -> BondModulus | None:
        """The modulus of the bonds at which the predictions hold; None where it is not fitted."""
        return self.predictions.bonds

    @cached_property
    def _load_factors(self) -> tuple[LoadFactor, ...]:
        """The predicted sigma of each reading; none where readings are forces."""
        return tuple(observation.load_factor for observation in self.observations if observation.load_factor is not None)

    @cached_property
    def _predicted_logs(self) -> Floats:
        """The predicted lambda_k of the blocks, then ln sigma_k of the readings."""
        return np.concatenate([self.predictions.log_ratios, [factor.log for factor in self._load_factors]])

    @cached_property
    def _prediction_derivatives(self) -> Floats:
        """Derivatives of ``_predicted_logs`` with respect to the design's variables, shape (predictions, v)."""
        factors = [factor.derivatives for factor in self._load_factors]
        return np.concatenate([self.predictions.derivatives, np.reshape(factors, (-1, len(self.predictions.variables)))])

    @cached_property
    def _bond_derivatives(self) -> Floats:
        """Derivatives of ``_predicted_logs`` with respect to ln of the bonds' modulus."""
        blocks = [block.bond_derivative for block in self.predictions.blocks]
        return np.array([*blocks, *(factor.bond_derivative for factor in self._load_factors)])

    @cached_property
    def _leak_effects(self) -> Floats:
        """Change of the inner film's fraction of the load for a leak of one sd, shape (readings, pins and rings)."""
        effects = [(-1.0 if reference.on == "inner" else 1.0) * reference.leak_sd for reference in self.references]
        return np.diag(effects)[:, [reference.on != "tissue" for reference in self.references]]

    @cached_property
    def _films(self) -> Floats:
        """Readings of both films, N, shape (readings, 2)."""
        return np.array([observation.films for observation in self.observations])

    @cached_property
    def _known_loads(self) -> tuple[list[int], Floats, Floats]:
        """Readings of known load: their indices, loads, N, and the loads' relative standard deviations."""
        known = [k for k, reference in enumerate(self.references) if reference.known_force is not None]
        loads = [(self.references[k].known_force, self.references[k].known_force_tolerance) for k in known]
        forces, tolerances = np.array(loads, dtype=float).T
        return known, forces, tolerances

    @cached_property
    def _forces(self) -> tuple[Floats, Floats]:
        """Forces by the force channel and their standard deviations by noise, N."""
        forces = [(observation.force, observation.force_sd) for observation in self.observations]
        values, sds = np.array(forces, dtype=float).T
        return values, sds

    @cached_property
    def _whitening(self) -> Floats:
        """Matrices that make each reading's errors independent and of unit variance, shape (readings, 2, 2)."""
        return np.asarray(np.linalg.inv(np.linalg.cholesky([observation.covariance for observation in self.observations])))

    @cached_property
    def _prediction_root(self) -> Floats:
        """Lower Cholesky factor of the covariance of ``_predicted_logs``.

        Each block has its own error; the errors of the workshop, and of the loads, are common to all predictions.
        """
        blocks = zip(self.predictions.blocks, (item for item in self.references if item.on == "tissue"), strict=True)
        block_variances = [prediction.compute_variance(reference) for prediction, reference in blocks]
        variances = np.array([*block_variances, *(factor.variance for factor in self._load_factors)])
        workshop_errors = self._prediction_derivatives * self.predictions.compute_tolerances(self.bench.workshop)
        by_load = [factor.load_derivative for factor in self._load_factors]
        load_errors = np.append(self.predictions.load_errors, self.predictions.load_sd * np.array(by_load))
        shared_errors = np.column_stack([workshop_errors, load_errors])
        return np.asarray(np.linalg.cholesky(LinearGaussian.from_shared_errors(shared_errors, variances).covariance))
