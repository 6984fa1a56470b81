"""How well the contrast of a found tumour is told: its posterior standard deviation, with all that is not known beside it.

About each tumour the readings are straight lines in what is not known: logarithms of depth, diameter and moduli, of the layers'
thicknesses, and the place x. With J their derivatives, C their covariance, eq. PO.8, S the prior variances of all but the
object's modulus, j its derivative, and ln contrast k = ln E_object - ln E_host put in its place, so that the host's derivative
is t + j,

    W = (C + sum S_i J_i J_i^T)^-1,   sd(k) = (j^T W j)^(-1/2)                                     (PO.6)

with nothing taken as known of the contrast before: that is the posterior of k with an infinite prior of the object. The same
with t in place of t + j is the standard deviation of ln E_object, which of one tumour of which all else is known is eq. DS.6.
With the prior of the object too,

    sd(k)^2 = c^T (S^-1 + J^T C^-1 J)^-1 c,   c = e_object - e_host                                (PO.7)

and the information is the logarithm by which that is below the prior's (S_object + S_host)^(1/2). Never negative, its mean over
a population is no mean of 1/variance, which the few tumours that are told best would rule.
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

DEFAULT_PRIOR_LOG_SD = 1.0  # prior standard deviation of ln E_object where the population has one value of it


@dataclass(frozen=True)
class Unknowns:
    """What is not known of each tumour and its tissue, with priors.

    Attributes:
        names: in the order of ``ScenePopulation.ranges``, the object first.
        deviations: of the priors, shape (q,).
        host: number of each tumour's host modulus among the names, -1 where that is known, shape (n,).
    """

    names: tuple[str, ...]
    deviations: Floats
    host: Ints

    @classmethod
    def from_draw(cls, population: ScenePopulation, draw: TumourDraw) -> Unknowns:
        """Return what the ranges leave open."""
        open_ones = {
            key: value_range.deviation
            for key, value_range in population.ranges.items()
            if not value_range.is_single and key != "object"
        }
        names = ("object", *open_ones)
        hosts = np.array([name_host_modulus(draw, number) for number in range(len(draw))])
        index = np.array([names.index(name) if name in names else -1 for name in hosts.tolist()])
        deviations = [population.ranges["object"].deviation or DEFAULT_PRIOR_LOG_SD, *open_ones.values()]
        return cls(names, np.array(deviations), index)

    @property
    def contrast(self) -> Floats:
        """Coefficients of ln contrast, the object's modulus less the host's, shape (n, q)."""
        hosts = (self.host[:, None] == np.arange(len(self.names))) & (self.host[:, None] > 0)
        return np.asarray(np.eye(len(self.names))[0] - hosts)

    def build_derivatives(self, readings: ScanReadings, blank: bool) -> Floats:
        """Return J of all readings, the blank's after those of the scan where there is one, shape (n, m or m + c, q)."""
        columns = []
        for name in self.names:
            baseline = readings.blank_derivatives.get(name, np.zeros_like(readings.blank_error))
            whole = readings.derivatives[name] + readings.repeat_over_positions(baseline)[readings.tissue]
            columns.append(np.concatenate([whole, baseline[readings.tissue]], axis=1) if blank else whole)
        return np.stack(columns, axis=-1)


def compute_log_sds(unknowns: Unknowns, J: Floats, noise: LinearGaussian) -> tuple[Floats, Floats]:
    """Return the standard deviations of ln contrast and of ln E_object (eq. PO.6), shape (n,) each; inf without information.

    Args:
        unknowns: q of them.
        J: their derivatives, shape (n, m, q).
        noise: of the m readings.
    """
    model = noise.add_unknowns(J, np.array([np.inf, *unknowns.deviations[1:]]))
    return model.compute_posterior_sd(unknowns.contrast), model.compute_posterior_sd(np.array([1.0]))


def compute_informations(unknowns: Unknowns, J: Floats, noise: LinearGaussian) -> Floats:
    """Return ln(prior / posterior standard deviation) of ln contrast, eq. PO.7, shape (n,)."""
    prior = np.linalg.norm(unknowns.contrast * unknowns.deviations, axis=1)
    posterior = noise.add_unknowns(J, unknowns.deviations).compute_posterior_sd(unknowns.contrast)
    return np.asarray(np.maximum(np.log(prior / posterior), 0.0))


def is_resolved(deviations: Floats) -> Floats:
    """Return 1 for tumours whose sd of ln contrast is at most ``MAX_RESOLVED_LOG_SD``, 0 for others, shape (n,)."""
    return np.asarray((deviations <= MAX_RESOLVED_LOG_SD).astype(float))


def is_undecided(deviations: Floats, share: Floats) -> Floats:
    """Return 1 for tumours resolved with derivatives larger by this fraction but not with smaller ones, shape (n,)."""
    with np.errstate(divide="ignore"):
        return is_resolved(deviations / (1 + share)) - is_resolved(deviations / (1 - share))


def compute_fraction_error(resolved_values: Floats) -> float:
    """Return the standard error of a share from 0 or 1 of n tumours drawn at random, shape (n,).

    With one more told and one more not, as by Laplace's rule of succession, it is above 0 even where all or none are told. 0 of
    one tumour, which is a population of its own.
    """
    n, p = len(resolved_values), (float(resolved_values.sum()) + 1) / (len(resolved_values) + 2)
    return math.sqrt(p * (1 - p) / n) if n > 1 else 0.0
