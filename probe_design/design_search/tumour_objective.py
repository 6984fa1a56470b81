"""Compute the objective for one tumour read once: the standard deviation of ln E_object after the reading of the ratio.

With g the noise of the ratio, half of its variance from each channel, q0 the charge noise and Q_j the charge of channel j under
the force that ``loads`` allows the design (PHYSICS section 2), that of its film where the scene reads charges, else |d33| F_j,

    v_j = g^2 / 2 + (q0 / Q_j)^2                    (DS.4)
    I   = S^2 / (v_inner + v_outer)                 (DS.5)
    sd  = I^(-1/2), smaller is better               (DS.6)

with v_j the variance of ln Q_j, S the log-sensitivity of the ratio of charges or of stresses that is read, I the information
about ln E_object and sd its standard deviation. The derivative d(ratio)/dE alone would favour designs whose outer film carries no
load and reads only noise. A search maximises -ln sd.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import Refusal, Words
from geometry.scenes.film import Film
from geometry.scenes.scene import Scene
from geometry.scenes.scene_tables import Load
from probe_design.data.noise import (
    DEFAULT_CHARGE_NOISE_C,
    DEFAULT_NOISE,
    check_noise,
    find_charge_per_force,
)
from probe_design.design_search.film_choices import FilmChoice
from probe_design.design_search.loads import PressingRule
from probe_design.design_search.objective import (
    COMPLEX_STEP_RELATIVE,
    SearchEffort,
    SearchObjective,
    build_complex_steps,
)
from probe_design.design_search.scan_choices import ScanChoice
from probe_design.design_search.search_space import SearchSpace
from probe_design.design_search.variables import VARIABLES, ProbeSizes, read_vector
from probe_design.populations.film_totals import append_charges, find_charge_signs
from solver.casadi_functions.finite_elements import FilmCallback, TumourCallback
from solver.closed_form.bessel import Array
from solver.closed_form.designs import PROBE_PARAMETERS, Shape, build_parameters, compute_products

SCREENED_PER_SHELL, MAX_IPOPT_STEPS = 512, 40  # the closed form for one tumour takes a tenth of a population's time
UNIT_INDENTATION_M = 1e-6  # m
REFINEMENT_ACCURACY = 0.03  # of finite elements in a refinement; its result is verified more accurately


@dataclass(frozen=True)
class Noise:
    """The noise of a reading.

    Attributes
    ----------
    ratio
        Relative standard deviation of one reading of the ratio, see ``probe_design.data.noise``.
    charge
        Charge noise of each channel, C.
    charge_per_force
        |d33| of the films, C/N.

    Raises
    ------
    InputError
        The noise of the ratio is not allowed, see ``check_noise``.
    """

    ratio: float = DEFAULT_NOISE
    charge: float = DEFAULT_CHARGE_NOISE_C
    charge_per_force: float = abs(Film().d33)

    def __post_init__(self) -> None:
        """Refuse a noise that is not allowed."""
        check_noise(self.ratio)

    @classmethod
    def from_scene(cls, scene: Scene, ratio: float = DEFAULT_NOISE) -> Noise:
        """Return the noise of a scene's probe, with the charge per force of its film if it has one."""
        return cls(ratio, charge_per_force=find_charge_per_force(scene.probe))

    def compute_information(
        self, sensitivity: Any, inner_fraction: Any, force: Any, charge_per_force: tuple[Any, Any] | None = None
    ) -> Any:
        """Return the Fisher information of one reading of the ratio about ln E_object (eqs. DS.4, DS.5); floats or arrays.

        Parameters
        ----------
        sensitivity
            Log-sensitivity S of the ratio.
        inner_fraction
            Inner film's fraction of the force; the outer film has the remainder.
        force
            Force on the probe, N.
        charge_per_force
            Of the inner and the outer film, C/N, above 0; default: that of ``self`` for both.
        """
        inner_charge, outer_charge = charge_per_force or (self.charge_per_force, self.charge_per_force)
        # the first quotient is the relative error of a film's charge if the film had the whole force
        inner = self.charge / (inner_charge * force) / inner_fraction
        outer = self.charge / (outer_charge * force) / (1 - inner_fraction)
        variance = self.ratio**2 + inner**2 + outer**2
        return sensitivity**2 / variance


def compute_standard_deviation(information: float) -> float:
    """Return the standard deviation of ln E_object from the information (eq. DS.6); inf where that is 0."""
    return 1 / math.sqrt(information) if information > 0 else math.inf


@dataclass(frozen=True)
class TumourObjective(SearchObjective):
    """-ln of eq. DS.6 by the closed form, for the target of a scene.

    Attributes
    ----------
    rule
        Rule for the forces.
    noise
        Noise of the reading.
    shape, parameters
        Structure and parameters of the closed form, see ``solver.closed_form.designs.build_parameters``.
    effort
        Effort of a search.
    """

    rule: PressingRule
    noise: Noise
    shape: Shape
    parameters: Floats
    effort: SearchEffort

    @classmethod
    def from_scene(cls, rule: PressingRule, noise: Noise, starts: int) -> TumourObjective:
        """Return the objective of the rule's scene.

        Raises
        ------
        Refusal
            The target is not a sphere; the closed form has a sensitivity for spheres only.
        """
        scene = rule.design.scene
        if scene.target is not None and scene.inclusion[scene.target].diameter is None:
            raise Refusal("inclusion", Words("of a kind without sensitivity in the closed form"), "a sphere as the target")
        return cls(rule, noise, *build_parameters(scene), SearchEffort(starts, SCREENED_PER_SHELL, MAX_IPOPT_STEPS))

    def set_scan(self, choice: ScanChoice) -> Self:
        """See ``SearchObjective.set_scan``: one reading is the same in all of them."""
        return self

    def set_film(self, choice: FilmChoice) -> Self:
        """See ``SearchObjective.set_film``."""
        rule = self.rule.set_film(choice)
        noise = replace(self.noise, charge_per_force=rule.charge_per_force)
        shape, parameters = build_parameters(rule.design.scene)
        return replace(self, rule=rule, noise=noise, shape=shape, parameters=parameters)

    def values(self, x: Array, poisson: Any) -> tuple[Array, Array]:
        """Return the values of ``SearchObjective.values``; no charge is required, so that the second is 0."""
        sizes = ProbeSizes.from_vector(x)
        # one column of the closed form's parameters for each design, complex if x is; the probe's come first
        columns = np.repeat(self.parameters[:, None], x.shape[1], axis=1).astype(x.dtype)
        columns[: len(PROBE_PARAMETERS)] = sizes.build_parameters(poisson)
        products = (part.sum(axis=2) for part in compute_products(self.shape, columns))
        totals, derivatives = (append_charges(self.rule.design.scene, part).T for part in products)
        sensitivity = derivatives[-2] / totals[-2] - derivatives[-1] / totals[-1]
        values = self.compute_log_precision(sizes, totals, sensitivity)
        return values, 0 * values

    def compute_log_precision(self, sizes: ProbeSizes, totals: Array, sensitivity: Array) -> Array:
        """Return -ln sd, eq. DS.6, of n designs, shape (n,); NaN where a charge has not the sign that d33 gives.

        Parameters
        ----------
        sizes
            Sizes of the probes, shape (n,) each.
        totals
            Forces on both films per unit indentation, N/m, and their charges where the scene reads them, C/m, shape (2 or 4, n).
        sensitivity
            Log-sensitivity S of the ratio that is read, shape (n,).
        """
        scene = self.rule.design.scene
        totals = totals * find_charge_signs(scene, totals.T).T
        totals = np.where(totals.real > 0, totals, np.nan)
        force = self.rule.compute_forces(sizes, totals.T[:, None], np.zeros(1, dtype=int))[:, 0]
        per_force = (totals[2] / totals[0], totals[3] / totals[1]) if len(totals) == 4 else None
        return 0.5 * np.log(self.noise.compute_information(sensitivity, totals[0] / (totals[0] + totals[1]), force, per_force))


class FiniteElementObjective:
    """The objective of one tumour by finite elements with their exact derivatives, for IPOPT.

    Parameters
    ----------
    formulas
        The objective by the closed form, whose rule for forces and noise are used.
    space
        The variables with their bounds.
    start
        A scene with a design within the bounds, whose mesh moves with the design.
    evaluator
        ``axisymmetric``, or ``equivalent-inclusion``, whose derivatives are those of its first order.

    Raises
    ------
    Refusal
        The evaluator cannot model the scene.
    """

    def __init__(self, formulas: TumourObjective, space: SearchSpace, start: Scene, evaluator: str) -> None:
        scene = space.build_exact_scene(read_vector(start, space.names))
        assert scene is not None
        pressed = scene.model_copy(update={"load": Load(indentation=UNIT_INDENTATION_M)})
        keys = tuple(VARIABLES[name].key for name in space.names)
        self.formulas = formulas
        self.films = (FilmCallback if evaluator == "axisymmetric" else TumourCallback)(pressed, keys, REFINEMENT_ACCURACY)

    def gradient(self, x: Floats, poisson: tuple[float, float], which: list[int]) -> tuple[Floats, Floats]:
        """See ``ExactGradients.gradient``; Poisson's ratios are the start's."""
        outputs, jacobian = self.films.compute(x)
        steps = build_complex_steps(x, which)
        # first order in the complex steps, which is exact for the derivatives; see ``output_names``
        _, inner, outer, sensitivity, *charges = outputs[:, None] + jacobian @ (steps - x[:, None])
        sizes = ProbeSizes.from_vector(steps)
        totals = np.array([inner, outer]) * np.array(sizes.areas) / UNIT_INDENTATION_M
        with np.errstate(all="ignore"):
            totals = np.concatenate([totals, np.array(charges).reshape(-1, len(which)) / UNIT_INDENTATION_M])
            values = self.formulas.compute_log_precision(sizes, totals, sensitivity)
        return np.array([values[0].real, 0.0]), np.array([values.imag, 0 * values.imag]) / COMPLEX_STEP_RELATIVE
