"""Compute what the readings say of a tumour: the contrast's and the place's posterior standard deviation, and the information.

The readings are linearised about each tumour in the unknowns: logarithms of depth, diameter, moduli and the layers' thicknesses,
and the place x, y. J_i is the derivative of the readings with respect to unknown i, C the readings' covariance, eq. PO.8, S_i
the prior variance of unknown i, where i runs over all unknowns but the object's modulus, and j the derivative with respect to
ln E_object. With ln contrast k = ln E_object - ln E_host in place of ln E_object, the host's derivative becomes t + j, t being
the one before:

    W = (C + sum S_i J_i J_i^T)^-1,   sd(k) = (j^T W j)^(-1/2)                                     (PO.6)

The contrast has no prior here, as if the prior variance of the object were infinite. For a tumour of which all else is known it
is that of eq. DS.6. With the prior of the object,

    sd(k)^2 = c^T (S^-1 + J^T C^-1 J)^-1 c,   c = e_object - e_host                                (PO.7)

with J and S now those of all unknowns, e_object and e_host the unit vectors of both moduli; with the unit vectors of x and y in
c it is the place's. The information about all that is unknown of the tumour (ln contrast, depth, diameter, x, y), in nats, is

    1/2 ln det(C + sum S_i J_i J_i^T) - 1/2 ln det(C + sum' S_i J_i J_i^T)                           (PO.16)

with sum' over the unknowns of the tissue alone. In it the host's modulus changes at a given contrast, so that its derivative is
t + j, and its variance the one that remains once the contrast is known, S_object S_host / (S_object + S_host). The mean of
neither over a population is dominated by the few tumours with the smallest variance, as a mean of 1/variance would be.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Floats, Ints
from probe_design.data.noise import MAX_RESOLVED_LOG_SD
from probe_design.inference.linear_gaussian import LinearGaussian
from probe_design.populations.population import PLACE_AXES, ScenePopulation, TumourDraw, is_of_tumour, name_host_modulus
from probe_design.populations.scan_readings import ScanReadings

DEFAULT_PRIOR_LOG_SD = 1.0  # prior standard deviation of ln E_object if the population has a single value of it


@dataclass(frozen=True)
class Unknowns:
    """The q unknown numbers of each tumour and its tissue, with priors.

    Attributes
    ----------
    names
        Names in the order of ``ScenePopulation.ranges``, the object first.
    deviations
        Standard deviations of the priors, shape (q,).
    host
        Index among the names of the modulus around each tumour, -1 if it is known, shape (n,).
    """

    names: tuple[str, ...]
    deviations: Floats
    host: Ints

    @classmethod
    def from_draw(cls, population: ScenePopulation, draw: TumourDraw) -> Unknowns:
        """Return the unknowns of a draw: the numbers that vary in the population."""
        varied = {
            key: value_range.deviation
            for key, value_range in population.ranges.items()
            if not value_range.is_single and key != "object"
        }
        names = ("object", *varied)
        hosts = np.array([name_host_modulus(draw, number) for number in range(len(draw))])
        index = np.array([names.index(name) if name in names else -1 for name in hosts.tolist()])
        deviations = [population.ranges["object"].deviation or DEFAULT_PRIOR_LOG_SD, *varied.values()]
        return cls(names, np.array(deviations), index)

    @property
    def contrast(self) -> Floats:
        """Coefficients of ln contrast = ln E_object - ln E_host in the unknowns: 1, -1 for an unknown host, else 0; (n, q)."""
        hosts = (self.host[:, None] == np.arange(len(self.names))) & (self.host[:, None] > 0)
        return np.asarray(np.eye(len(self.names))[0] - hosts)

    def bound_information_errors(self, informations: Floats, fraction: Floats) -> Floats:
        """Return bounds on the errors of ``compute_informations`` where derivatives err by fractions of at most 1, shape (n,)."""
        count = sum(is_of_tumour(name) for name in self.names)  # each is determined better or worse by the fraction
        return np.asarray(np.minimum(count * fraction, informations))

    def bound_place_errors(self, sds: Floats, fraction: Floats) -> Floats:
        """Return bounds on the errors of ``compute_place_errors`` likewise, shape (n,): none is above the prior's."""
        prior = math.hypot(*(sd for name, sd in zip(self.names, self.deviations, strict=True) if name in PLACE_AXES))
        with np.errstate(divide="ignore", invalid="ignore"):
            larger = np.nan_to_num(sds * fraction / (1 - fraction), nan=np.inf)
        return np.maximum(np.minimum(larger, prior - sds), fraction * sds)

    def build_derivatives(self, readings: ScanReadings, blank: bool) -> Floats:
        """Return the derivatives J of all readings with respect to the q unknowns.

        Parameters
        ----------
        readings
            Readings over n tumours, m each.
        blank
            Whether there is a baseline reading, whose c channels are appended.

        Returns
        -------
        Floats
            J, shape (n, m, q), with a baseline reading (n, m + c, q).
        """
        columns = []
        for name in self.names:
            baseline = readings.blank_derivatives.get(name, np.zeros_like(readings.blank_error))
            # the signal is a difference: the baseline is added to obtain the reading over the tumour itself
            derivative = readings.derivatives[name] + readings.repeat_over_positions(baseline)[readings.tissue]
            columns.append(np.concatenate([derivative, baseline[readings.tissue]], axis=1) if blank else derivative)
        return np.stack(columns, axis=-1)


def compute_contrast_sd(unknowns: Unknowns, J: Floats, noise: LinearGaussian) -> Floats:
    """Return the standard deviation of ln contrast (eqs. PO.6 and PO.7), shape (n,); inf without information.

    Parameters
    ----------
    unknowns
        The q unknowns.
    J
        Derivatives of the readings with respect to them, shape (n, m, q).
    noise
        Noise of the m readings.
    """
    # inf: the object's modulus, which comes first, has no prior
    return noise.add_unknowns(J, np.array([np.inf, *unknowns.deviations[1:]])).compute_posterior_sd(unknowns.contrast)


def compute_informations(unknowns: Unknowns, J: Floats, noise: LinearGaussian) -> Floats:
    """Return the information about all that is unknown of each tumour, eq. PO.16, nats, shape (n,).

    The parameters are those of ``compute_contrast_sd``.
    """
    variances = unknowns.deviations**2
    derivatives, remaining = J.copy(), np.tile(variances, (len(J), 1))
    for number in np.flatnonzero(unknowns.host > 0).tolist():  # the host's modulus at a given contrast
        host = unknowns.host[number]
        derivatives[number, :, host] += J[number, :, 0]
        remaining[number, host] *= variances[0] / (variances[0] + variances[host])
    tissue = [k for k, name in enumerate(unknowns.names) if not is_of_tumour(name)]
    others = noise.add_unknowns(derivatives[..., tissue], np.sqrt(remaining[:, tissue])) if tissue else noise
    every = noise.add_unknowns(J, unknowns.deviations)
    return np.asarray(np.maximum(every.compute_half_log_determinant() - others.compute_half_log_determinant(), 0.0))


def compute_place_errors(unknowns: Unknowns, J: Floats, noise: LinearGaussian) -> Floats:
    """Return the posterior standard deviation of each tumour's place, m, shape (n,): the root of the sum of the axes' variances.

    The parameters are those of ``compute_contrast_sd``; a place that all tumours have is known.
    """
    posterior, identity = noise.add_unknowns(J, unknowns.deviations), np.eye(len(unknowns.names))
    axes = [posterior.compute_posterior_sd(identity[k]) for k, name in enumerate(unknowns.names) if name in PLACE_AXES]
    return np.sqrt(sum((sd**2 for sd in axes), np.zeros(len(J))))


def is_resolved(deviations: Floats) -> Floats:
    """Return 1 for tumours whose sd of ln contrast is at most ``MAX_RESOLVED_LOG_SD``, 0 for others, shape (n,)."""
    return np.asarray((deviations <= MAX_RESOLVED_LOG_SD).astype(float))


def is_undecided(deviations: Floats, fraction: Floats) -> Floats:
    """Return 1 for tumours that are resolved or not depending on the model's error, 0 for the others, shape (n,).

    Parameters
    ----------
    deviations
        Standard deviations of ln contrast, shape (n,).
    fraction
        Relative error bound of the derivatives, at most 1: deviations are smaller by it, or larger, at 1 without limit.
    """
    with np.errstate(divide="ignore"):
        return is_resolved(deviations / (1 + fraction)) - is_resolved(deviations / (1 - fraction))


def compute_fraction_error(resolved_values: Floats) -> float:
    """Return the standard error of a fraction, from 0 or 1 of n tumours drawn at random, shape (n,).

    One resolved and one unresolved tumour are added, as in Laplace's rule of succession, so that the error is above 0 even if
    all or none are resolved. It is 0 for one tumour, which is the whole population.
    """
    n, p = len(resolved_values), (float(resolved_values.sum()) + 1) / (len(resolved_values) + 2)
    return math.sqrt(p * (1 - p) / n) if n > 1 else 0.0
