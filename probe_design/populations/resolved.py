"""Compute the posterior standard deviation of the contrast of a detected tumour, with all other unknowns taken into account.

The readings are linearised about each tumour in the unknowns: logarithms of depth, diameter, moduli and the layers' thicknesses,
and the position x. J_i is the derivative of the readings with respect to unknown i, C the readings' covariance, eq. PO.8, S_i
the prior variance of unknown i, where i runs over all unknowns but the object's modulus, and j the derivative with respect to
ln E_object. With ln contrast k = ln E_object - ln E_host in place of ln E_object, the host's derivative becomes t + j, t being
the one before:

    W = (C + sum S_i J_i J_i^T)^-1,   sd(k) = (j^T W j)^(-1/2)                                     (PO.6)

The contrast has no prior here, as if the prior variance of the object were infinite. For a tumour of which all else is known it
is that of eq. DS.6. With the prior of the object,

    sd(k)^2 = c^T (S^-1 + J^T C^-1 J)^-1 c,   c = e_object - e_host                                (PO.7)

with J and S now those of all unknowns, e_object and e_host the unit vectors of both moduli. The information is the logarithm of
the prior's (S_object + S_host)^(1/2) over this sd(k). It is never negative, and its mean over a population is not dominated by
the few tumours with the smallest variance, as a mean of 1/variance would be.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Floats, Ints
from probe_design.data.noise import MAX_RESOLVED_LOG_SD
from probe_design.inference.linear_gaussian import LinearGaussian
from probe_design.populations.population import ScenePopulation, TumourDraw, name_host_modulus
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
    """Return the standard deviation of ln contrast (eq. PO.6), shape (n,); inf without information.

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
    """Return the information gained: ln(prior / posterior standard deviation) of ln contrast, eq. PO.7, nats, shape (n,).

    The parameters are those of ``compute_contrast_sd``.
    """
    prior = np.linalg.norm(unknowns.contrast * unknowns.deviations, axis=1)
    posterior = noise.add_unknowns(J, unknowns.deviations).compute_posterior_sd(unknowns.contrast)
    return np.asarray(np.maximum(np.log(prior / posterior), 0.0))


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
