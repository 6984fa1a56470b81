"""Compute the population objective that a search maximises: in closed form, smooth, on arrays of designs.

Readings are linear in the unknowns: y = s + J c + N n + e. Here s is the signal of the tumour, c are deviations of the tumour's
parameters and n nuisances common to a scan, with Gaussian priors of covariances Pi_c and Pi, J and N the readings' derivatives
with respect to them, and e white errors with the diagonal covariance V: eq. LG.1. With the nuisances eliminated,

    d'^2 = s^T W s,     W = (V + N Pi N^T)^-1                                                       (DS.1)

is the deflection of a *known* tumour against the same tissue without it. P = Phi(d' - z) is its probability of detection at a
false alarm rate Phi(-z), with Phi the normal distribution function. It bounds that of a detector that knows only the population,
which the verification computes. The posterior standard deviation of ln contrast is that of c_1 under the covariance

    (J^T W J + Pi_c^-1)^-1                                                                          (DS.2)

c_1 itself has a prior only for the information, which is the gain over this prior. A tumour counts as resolved by the fraction
Phi((ln 0.5 - ln sd) / 0.25), a smooth step with a gradient. A baseline reading, which is subtracted from all others, is a
nuisance whose prior is its own white error. Without it the offset of each channel has the prior of the gain, and the tissue's
modulus that of the population.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from scipy.special import ndtr

from probe_design.data.noise import MAX_RESOLVED_LOG_SD
from probe_design.inference.linear_gaussian import LinearGaussian
from probe_design.populations.detection import compute_known_probabilities
from solver.closed_form.bessel import Array
from solver.tumour_waves.population_films import Films, ManyTumours

RESOLVED_STEP_LOG_SD = 0.25  # width in ln sd of the step from not resolved to resolved
MIN_VARIANCE = 1e-12  # of ln stiffness, and of a squared deflection, so that its root has a derivative at 0
FLAT_PRIOR_SD = 1e6  # of ln contrast without prior knowledge: finite, so that a tumour without effect has a derivative


@dataclass(frozen=True)
class ScanErrors:
    """Errors of one scan: relative standard deviations, except for the charge.

    Attributes
    ----------
    white
        Independent error of the ratio at a position, tilt included.
    gain
        Error common to the ratios of a scan.
    stiffness_white, stiffness_gain
        The same for the stiffness.
    charge
        Noise of each film's charge over the charge per force, N.
    stiffness
        Whether the stiffness is read.
    blank
        Whether there is a baseline reading.
    false_alarm
        Probability of a false alarm in a scan.
    """

    white: float
    gain: float
    stiffness_white: float
    stiffness_gain: float
    charge: float
    stiffness: bool
    blank: bool
    false_alarm: float


@dataclass(frozen=True)
class PopulationObjective(ABC):
    """An objective over a population, prepared for any design.

    Attributes
    ----------
    tumours
        The tumours.
    moved
        Pairs of the same tumours, for each parameter in ``VARIED_PARAMETERS`` with it multiplied by e^-step and e^step; without a
        baseline reading also for the modulus of the tissue, "tissue".
    step
        Step of the logarithms.
    channels
        Errors of the scan.
    priors
        Standard deviations of ln contrast (above 0), ln diameter, ln depth and ln tissue modulus.
    statistic
        ``mean`` or a quantile.
    """

    tumours: ManyTumours
    moved: dict[str, tuple[ManyTumours, ManyTumours]]
    step: float
    channels: ScanErrors
    priors: dict[str, float]
    statistic: Any

    VARIED_PARAMETERS: ClassVar[tuple[str, ...]] = ("diameter", "depth")

    @abstractmethod
    def evaluate_tumours(self, probes: Array, force: Any) -> Array:
        """Return the objective tumour by tumour, shape (n, m); see ``values``."""

    def values(self, probes: Array, force: Any) -> Array:
        """Return the objective of n designs, larger is better, shape (n,).

        Parameters
        ----------
        probes
            See ``ManyTumours.compute_films``; floats or complex.
        force
            Function that returns the force, N, shape (n, m), from the films' forces without tumours, shape (n, m, 2).
        """
        of_each = self.evaluate_tumours(probes, force)
        if self.statistic == "mean":
            return of_each.mean(axis=1)
        return _compute_quantile(of_each, float(self.statistic))

    def compute_log_sd(self, probes: Array, force: Any) -> Array:
        """Return ln of the posterior standard deviation of ln contrast, eq. DS.2, shape (n, m)."""
        films, noise = self._compute_noise(probes, force)
        prior_sd = np.array([self.priors[key] for key in ("object", "diameter", "depth")])
        prior_sd[0] = self.contrast_prior_sd
        return np.log(
            noise.add_unknowns(self._compute_derivatives(probes, films), prior_sd).compute_posterior_sd(np.array([1.0]))
        )

    @property
    def contrast_prior_sd(self) -> float:
        """Prior standard deviation of ln contrast that the posterior starts from."""
        return FLAT_PRIOR_SD

    def _compute_noise(self, probes: Array, force: Any) -> tuple[Films, LinearGaussian]:
        """Return films and the readings' noise; NaN where a film is in tension (no logarithm)."""
        films = self.tumours.compute_films(probes)
        films = replace(films, without=_mask_non_positive(films.without))
        variance = self._compute_variance(films, force(films.without))
        return films, LinearGaussian.from_shared_errors(self._build_shared_errors(probes, films, variance), variance)

    def _stack_channels(self, ratio: Array, stiffness: Array) -> Array:
        """Join the readings of a scan along one axis: ratios, then stiffnesses if they are read."""
        return np.concatenate([ratio, stiffness], axis=2) if self.channels.stiffness else ratio

    def _compute_signature(self, films: Films) -> Array:
        """Return the change of the log readings by each tumour, shape (n, m, readings)."""
        whole, alone = films.without[:, :, None] + films.change, films.without[:, :, None]
        ratio = np.log(_mask_non_positive(whole[..., 0] / alone[..., 0])) - np.log(
            _mask_non_positive(whole[..., 1] / alone[..., 1])
        )
        return self._stack_channels(ratio, np.log(whole.sum(axis=3) / alone.sum(axis=3)))

    def _compute_variance(self, films: Films, force: Array) -> Array:
        """Return the white variance of each reading, shape (n, m, readings)."""
        share = films.without / films.without.sum(axis=2, keepdims=True)
        charges = ((self.channels.charge / (share * force[..., None])) ** 2).sum(axis=2)
        ones = np.ones((1, 1, films.change.shape[2]))
        ratio = (self.channels.white**2 + charges)[..., None] * ones
        return self._stack_channels(ratio, self.channels.stiffness_white**2 + MIN_VARIANCE + 0 * ratio)

    def _build_shared_errors(self, probes: Array, films: Films, variance: Array) -> Array:
        """Return the errors common to a scan, one standard deviation in each column, shape (n, m, readings, a)."""
        readings, channels = variance.shape[2], 2 if self.channels.stiffness else 1
        count = readings // channels
        by_channel = np.repeat(np.eye(channels), count, axis=0)
        if self.channels.blank:
            return by_channel * np.sqrt(variance[:, :, None, ::count])
        gains = np.array([self.channels.gain, self.channels.stiffness_gain])[:channels]
        common = np.broadcast_to(by_channel * gains, (*variance.shape, channels))
        tissue = self._difference("tissue", probes, lambda films: self._stack_channels(*_compute_baseline_logs(films)))
        return np.concatenate([common, self.priors["tissue"] * tissue[..., None]], axis=3)

    def _compute_derivatives(self, probes: Array, films: Films) -> Array:
        """Return the signature's derivatives by ln contrast, ln diameter and ln depth, shape (n, m, readings, 3)."""
        whole = films.without[:, :, None] + films.change
        share = films.by_log / whole
        total = films.by_log.sum(axis=3) / whole.sum(axis=3)
        slopes = [self._stack_channels(share[..., 0] - share[..., 1], total)]
        slopes += [self._difference(key, probes, self._compute_signature) for key in ("diameter", "depth")]
        return np.stack(slopes, axis=3)

    def _difference(self, key: str, probes: Array, evaluate: Any) -> Array:
        lower, upper = (evaluate(tumours.compute_films(probes)) for tumours in self.moved[key])
        return (upper - lower) / (2 * self.step)


class Detection(PopulationObjective):
    """The probability of detection of each tumour, from the deflection of eq. DS.1."""

    VARIED_PARAMETERS = ()

    def evaluate_tumours(self, probes: Array, force: Any) -> Array:
        """Return the probability of detection."""
        films, noise = self._compute_noise(probes, force)
        squared_deflection = noise.compute_chi_square(self._compute_signature(films))
        return compute_known_probabilities(np.sqrt(squared_deflection + MIN_VARIANCE), self.channels.false_alarm)


class Resolved(PopulationObjective):
    """Whether the stiffness of each tumour is resolved: a smooth step of the standard deviation of ln contrast."""

    def evaluate_tumours(self, probes: Array, force: Any) -> Array:
        """Return the step, from 0 to 1."""
        return ndtr((math.log(MAX_RESOLVED_LOG_SD) - self.compute_log_sd(probes, force)) / RESOLVED_STEP_LOG_SD)


class Information(PopulationObjective):
    """The information gained about ln contrast of each tumour, in nats."""

    @property
    def contrast_prior_sd(self) -> float:
        """Prior standard deviation of ln contrast in the population."""
        return self.priors["object"]

    def evaluate_tumours(self, probes: Array, force: Any) -> Array:
        """Return the logarithm of the prior's standard deviation over the posterior's."""
        return math.log(self.priors["object"]) - self.compute_log_sd(probes, force)


OBJECTIVES: dict[str, type[PopulationObjective]] = {
    "detection": Detection,
    "resolved": Resolved,
    "information": Information,
}
"""The objectives by their names in design files."""


def _mask_non_positive(values: Array) -> Array:
    """Return values above 0 unchanged, complex ones by their real parts, and NaN for others."""
    return np.where(values.real > 0, values, np.nan)


def _compute_baseline_logs(films: Films) -> tuple[Array, Array]:
    """Return ln ratio and ln stiffness without the tumour at each position, shapes (n, m, P)."""
    ratio = np.log(films.without[..., 0] / films.without[..., 1])
    stiffness = np.log(films.without.sum(axis=2))
    ones = np.ones(films.change.shape[2])
    return ratio[..., None] * ones, stiffness[..., None] * ones


def _compute_quantile(values: Array, share: float) -> Array:
    """Return a quantile over the last axis, of complex numbers by their real parts; shape (n,)."""
    order = np.argsort(values.real, axis=1)
    rank = share * (values.shape[1] - 1)
    low = min(int(rank), values.shape[1] - 1)
    ends = np.take_along_axis(values, order[:, [low, min(low + 1, values.shape[1] - 1)]], axis=1)
    return ends[:, 0] * (1 - (rank - low)) + ends[:, 1] * (rank - low)
