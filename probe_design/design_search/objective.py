"""Define the objective that a search maximises: a function of designs by the closed form, with exact derivatives."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, Protocol, Self

import numpy as np

from geometry.common.arrays import Floats
from probe_design.design_search.combination import Combination
from probe_design.design_search.film_choices import FilmChoice
from probe_design.design_search.scan_choices import ScanChoice
from solver.closed_form.bessel import Array

COMPLEX_STEP_RELATIVE = 1e-30
MARGIN_TOLERANCE = 1e-6  # of the logarithm of a charge over the required minimum


@dataclass(frozen=True)
class SearchEffort:
    """The effort of a search.

    Attributes
    ----------
    starts
        Number of local searches.
    screened
        Designs in each shell of outer radii; a power of two, for which a Sobol sequence is balanced.
    steps
        Maximum of IPOPT's steps from each start.
    """

    starts: int
    screened: int
    steps: int


class ExactGradients(Protocol):
    """An objective with exact derivatives, as IPOPT needs it."""

    def gradient(self, x: Floats, poisson: tuple[float, float], which: list[int]) -> tuple[Floats, Floats]:
        """Return the objective and the charge's margin of one design, and their derivatives.

        Parameters
        ----------
        x
            The design, shape (variables,).
        poisson
            Poisson's ratios of both blocks.
        which
            Indices of the k variables with respect to whose logarithms the derivatives are taken.

        Returns
        -------
        tuple[Floats, Floats]
            The objective and ln(charge of the weaker channel / required charge), shape (2,), and their derivatives, (2, k).
        """


class SearchObjective(ABC):
    """An objective of designs x, shape (variables, n), by the closed form; see ``variables.ProbeSizes.from_vector``."""

    effort: SearchEffort

    @abstractmethod
    def values(self, x: Array, poisson: Any) -> tuple[Array, Array]:
        """Return the objective and ln(charge of the weaker channel / required charge) of designs, shapes (n,).

        Parameters
        ----------
        x
            Designs, floats or complex, shape (variables, n).
        poisson
            Poisson's ratios of both blocks, floats or shape (2, n).
        """

    @abstractmethod
    def set_film(self, choice: FilmChoice) -> Self:
        """Return the same objective of probes with other films and bonds."""

    @abstractmethod
    def set_scan(self, choice: ScanChoice) -> Self:
        """Return the same objective of another scan."""

    def set_choices(self, combination: Combination) -> Self:
        """Return the same objective with the scan and the films of a combination."""
        objective = self if combination.scan is None else self.set_scan(combination.scan)
        return objective if combination.film is None else objective.set_film(combination.film)

    def evaluate_designs(self, x: Floats, poisson: Any) -> Floats:
        """Return the objective of designs, ``-inf`` where it is not finite or a channel's charge is too small."""
        with np.errstate(all="ignore"):
            values, margin = self.values(x, poisson)
        return np.where(np.isfinite(values) & (margin >= -MARGIN_TOLERANCE), values, -np.inf)

    def gradient(self, x: Floats, poisson: Any, which: list[int]) -> tuple[Floats, Floats]:
        """Compute the gradient by complex steps; see ``ExactGradients.gradient``."""
        with np.errstate(all="ignore"):
            both_values = np.array(self.values(build_complex_steps(x, which), poisson))
        return both_values[:, 0].real, both_values.imag / COMPLEX_STEP_RELATIVE


def build_complex_steps(x: Floats, which: list[int]) -> Array:
    """Return k copies of a design x, each with a complex step of the logarithm of one variable, shape (variables, k).

    The imaginary part of a function of column j, over the step, is its derivative by the logarithm of variable ``which[j]``.
    """
    steps = np.repeat(x[:, None].astype(complex), len(which), axis=1)
    steps[which, range(len(which))] += 1j * COMPLEX_STEP_RELATIVE * x[which]
    return steps
