"""Define the readings on references, and the gain matrix that converts readings to film forces, with its uncertainty.

A reading y = Q / c (N, c the nominal charge per force) of film forces f is y = M f (BP.1): M has the relative gains on its
diagonal and the cross-talk off it. ``gain_fit`` estimates M.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Annotated

import numpy as np
from pydantic import Field
from scipy.special import chdtrc

from geometry.common.arrays import Floats
from geometry.scenes.quantities import Frozen
from probe_design.built_probe.bench import Bench, Reference
from probe_design.built_probe.reference_charges import LoadFactor

ENTRY_NAMES = ("inner gain", "inner from outer", "outer from inner", "outer gain", "ln bonds")
BOND_CHANGE_PER_KELVIN = 0.07  # relative change of a tape's modulus (assumed); glue changes less
GAIN_CHANGE_PER_KELVIN = 0.005  # relative change of a PVDF film's charge per force
Finite = Annotated[float, Field(ge=-1e30, le=1e30)]  # in records, so that products are finite, too


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
    force_loss
        Fraction of ``force`` that a lag of the force channel may have removed, in all readings alike.
    load_factor
        The predicted sum of both films' readings over the load, eq. BP.11; None where it is 1, as readings are forces.
    """

    reference: Reference
    films: Floats
    covariance: Floats
    force: float | None = None
    force_sd: float | None = None
    force_loss: float = 0.0
    load_factor: LoadFactor | None = None

    @property
    def load(self) -> float:
        """Amplitude of the load, N: by the force channel, else by the films' nominal gains and the predicted sum."""
        if self.force is not None:
            return self.force
        return float(self.films.sum()) / (1.0 if self.load_factor is None else math.exp(self.load_factor.log))


class ForceScale(Frozen):
    """The force channel's scale, its reading over the true force, as a calibration estimates it; see ``gain_fit``.

    Attributes
    ----------
    factor
        Reading over true force; 1 without force channel.
    sd
        Relative standard deviation of ``factor``.
    entries
        Change of the entries of M, row by row, and of ln of the bonds' modulus, where it is fitted, for an error of ``factor`` by
        one ``sd``; readings with the same channel share it.
    confirmed
        Whether a known load determines the scale; if not, the films' nominal gains do.
    """

    factor: Annotated[float, Field(ge=1e-3, le=1e3)] = 1.0
    sd: Annotated[float, Field(ge=0.0, le=1e3)] = 0.0
    entries: Annotated[tuple[Finite, ...], Field(strict=False, min_length=4, max_length=5)] = (0.0, 0.0, 0.0, 0.0)
    confirmed: bool = True

    @property
    def covariance(self) -> Floats:
        """Part of ``Gains.covariance`` that is due to the scale, shape (n, n)."""
        return np.outer(self.entries, self.entries)


class BondFactor(Frozen):
    """The modulus of the films' bonds, as a calibration estimates it.

    Attributes
    ----------
    log_factor
        ln of the factor on the drawing's moduli of all bonds.
    film_derivatives
        Derivatives of ln of each film's charge under a given load with respect to ``log_factor``, the mean over blocks of tissue.
    """

    log_factor: Annotated[float, Field(ge=-30.0, le=30.0)]
    film_derivatives: Annotated[tuple[Finite, Finite], Field(strict=False)]


@dataclass(frozen=True)
class Gains:
    """The gain matrix with its uncertainty; where readings are charges, the scales of d of both films and the bonds' modulus.

    Attributes
    ----------
    matrix
        M of eq. BP.1, shape (2, 2).
    covariance
        Of its entries row by row, and of ln of the bonds' modulus, if that is fitted: n = 4 or 5, shape (n, n).
    slopes
        Derivatives of these with respect to the design's variables, per SI unit, shape (n, v).
    workshop
        Standard deviations of these variables, SI, shape (v,); ``covariance`` includes their effect.
    absolute
        Whether a force channel or a known load determines the common factor.
    cross_talk_resolved
        Whether the readings determine each cross-talk; if not, the assumed one stands.
    chi_square, degrees_of_freedom
        Of the fit: the misfit, and its degrees of freedom.
    force_scale
        Scale of the force channel; ``covariance`` includes its effect.
    bonds
        The bonds' modulus; None where it is not fitted. Predictions of readings are then those with this modulus.
    """

    matrix: Floats
    covariance: Floats
    slopes: Floats
    workshop: Floats
    absolute: bool
    cross_talk_resolved: tuple[bool, bool]
    chi_square: float = 0.0
    degrees_of_freedom: int = 0
    force_scale: ForceScale = field(default_factory=ForceScale)
    bonds: BondFactor | None = None

    @classmethod
    def from_bench(cls, bench: Bench) -> Gains:
        """Return nominal gains with the bench's tolerances, as known without calibration."""
        gain, cross_talk = bench.channels.gain**2, bench.channels.cross_talk**2
        covariance = np.diag([gain, cross_talk, cross_talk, gain])
        return cls(np.eye(2), covariance, np.zeros((4, 0)), np.zeros(0), absolute=False, cross_talk_resolved=(False, False))

    def add_warming(self, kelvin: float) -> Gains:
        """Add a change of temperature (1 sd, K) since the calibration: each film's gain, a row of M, drifts independently.

        The modulus of the bonds drifts, too.
        """
        # shape (2, 4): the change of M's entries, row by row, for one sd of the inner and of the outer film's temperature
        drift = GAIN_CHANGE_PER_KELVIN * kelvin * np.kron(np.eye(2), np.ones((2, 1))).T @ np.diag(self.matrix.ravel())
        change = self.pad_entries(drift.T @ drift)
        change[4:, 4:] = (BOND_CHANGE_PER_KELVIN * kelvin) ** 2
        return replace(self, covariance=self.covariance + change)

    def pad_entries(self, covariance: Floats) -> Floats:
        """Return a covariance of the entries of M, shape (4, 4), with zeros for the bonds' modulus, if that is fitted; (n, n)."""
        padded = np.zeros_like(self.covariance)
        padded[:4, :4] = covariance
        return padded

    def remove_force_scale_error(self) -> Gains:
        """Return the gains without the part of their covariance that readings with the same force channel share."""
        scale = self.force_scale.covariance
        shared = scale if scale.shape == self.covariance.shape else self.pad_entries(scale)
        return replace(self, covariance=self.covariance - shared)

    @property
    def p_value(self) -> float:
        """Probability of a chi-square as large or larger."""
        return float(chdtrc(self.degrees_of_freedom, self.chi_square)) if self.degrees_of_freedom else 1.0

    @property
    def errors_as_drawn(self) -> Floats:
        """Independent errors of M's entries and the bonds' modulus for a probe as drawn, (n, n): each column one error of 1 sd.

        The effect of the workshop's tolerances is subtracted from the covariance, and its square root taken.
        """
        workshop_errors = self.slopes * self.workshop
        variances, directions = np.linalg.eigh(self.covariance - workshop_errors @ workshop_errors.T)
        return np.asarray(directions * np.sqrt(np.maximum(variances, 0.0)))  # rounding may leave variances below 0

    def compute_forces(self, films: Floats) -> Floats:
        """Return the film forces f, N, from readings y, N, shape (2,)."""
        return np.asarray(np.linalg.solve(self.matrix, films), dtype=float)

    def differentiate_by_entries(self, films: Floats) -> Floats:
        """Return the derivatives of the forces with respect to the entries of M, df = -M^-1 dM f, shape (2, n).

        Where the bonds' modulus is fitted, the last column is its effect on forces that are compared with predictions: these
        change with that modulus, and the difference is as if the forces changed the other way.
        """
        forces = self.compute_forces(films)
        by_matrix = np.asarray(-np.linalg.inv(self.matrix) @ np.kron(np.eye(2), forces))
        if self.bonds is None:
            return by_matrix
        return np.column_stack([by_matrix, -forces * np.array(self.bonds.film_derivatives)])

    def compute_forces_covariance(self, films: Floats, covariance: Floats) -> Floats:
        """Return the covariance of the forces due to the readings' and M's covariances, N^2, shape (2, 2)."""
        inverse, derivatives = np.linalg.inv(self.matrix), self.differentiate_by_entries(films)
        return np.asarray(inverse @ covariance @ inverse.T + derivatives @ self.covariance @ derivatives.T)
