"""Compute the objective of a population that a search maximises: by the closed form, smooth, on arrays of designs.

Readings are linear in the unknowns: y = s + J c + N n + e. Here s is the signal of the tumour, c are deviations of the tumour's
parameters and n nuisances common to a scan, with Gaussian priors of covariances Pi_c and Pi, J and N the readings' derivatives
with respect to them, and e white errors with the diagonal covariance V: eq. LG.1. With the nuisances eliminated,

    d'^2 = s^T W s,     W = (V + N Pi N^T)^-1                                                       (DS.1)

is the deflection of a *known* tumour against the same tissue without it. P = Phi(d' - z) is its probability of detection at a
false alarm rate Phi(-z), with Phi the normal distribution function. It bounds that of a detector that knows only the population,
which the verification computes. The posterior standard deviations of ln contrast, c_1, and of the place are those under the
covariance

    (J^T W J + Pi_c^-1)^-1                                                                          (DS.2)

and the information about all parameters is half of ln det(Pi_c) less ln det of it. For resolving, ln contrast has no prior, and
a tumour counts by the fraction Phi((ln 0.5 - ln sd) / 0.25), a smooth step with a gradient. A baseline reading, which is
subtracted from all others, is a nuisance whose prior is its own white error. Without it the offset of each channel has the prior
of the gain, and the tissue's modulus that of the population.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Self

import numpy as np
from scipy.special import ndtr

from probe_design.data.noise import MAX_RESOLVED_LOG_SD
from probe_design.design_search.film_choices import FilmChoice
from probe_design.design_search.loads import PressingRule, select_smaller
from probe_design.design_search.objective import SearchEffort, SearchObjective
from probe_design.design_search.scan_choices import ScanChoice
from probe_design.design_search.search_tumours import PLACE_UNIT_M, build_draws, build_stacks, prepare_tumours, step_parameter
from probe_design.design_search.variables import ProbeSizes
from probe_design.inference.linear_gaussian import LinearGaussian
from probe_design.populations.design_file import Design
from probe_design.populations.detection import compute_known_probabilities
from probe_design.populations.film_totals import find_charge_signs
from probe_design.populations.population import PLACE_AXES, ScenePopulation, TumourDraw, is_of_tumour
from probe_design.populations.resolved import DEFAULT_PRIOR_LOG_SD
from probe_design.populations.several_loads import combine_variances
from solver.closed_form.bessel import Array
from solver.closed_form.contact import Films as FilmStacks
from solver.tumour_waves.population_films import Films, ManyTumours

MAX_SEARCH_TUMOURS = 64  # tumours in the objective
SEARCH_EFFORT = SearchEffort(starts=4, screened=64, steps=25)
LOG_DIFFERENCE_STEP = 0.02  # of ln diameter, depth and modulus: a smaller one would show the steps of tabulated Bessel functions
RESOLVED_STEP_LOG_SD = 0.25  # width in ln sd of the step from not resolved to resolved
MIN_VARIANCE = 1e-12  # of ln stiffness, and of a squared deflection, so that its root has a derivative at 0
FLAT_PRIOR_SD = 1e6  # of ln contrast without prior knowledge: finite, so that a tumour without effect has a derivative
ForceRule = Callable[[Array], Array]  # forces, N, (n, m), from the films' forces and charges without tumours, (n, m, 2 or 4)


@dataclass(frozen=True)
class PopulationObjective(SearchObjective):
    """An objective over a population, prepared for any design.

    Attributes
    ----------
    design
        The design file: noise, protocol, limits and statistic.
    rule
        Rule for the forces.
    draw
        The tumours.
    tumours
        The same, prepared for any probe.
    widest
        Outer radius of the widest such probe, m.
    moved
        Pairs of the same tumours, for each parameter in ``VARIED_PARAMETERS`` with it multiplied by e^-step and e^step, the step
        being ``LOG_DIFFERENCE_STEP``, or moved by that many ``PLACE_UNIT_M``; without a baseline reading also for the modulus of
        the tissue, "tissue".
    priors
        Standard deviations of ln contrast (above 0), ln diameter, ln depth, ln tissue modulus, x and y in ``PLACE_UNIT_M``.
    stacks
        Films and bonds of both blocks, where the scene reads their charges and eq. (12) does not stand for them; else None.
    effort
        Effort of a search.
    scans
        The same objective of other scans, as far as a search has tried them.
    """

    design: Design
    rule: PressingRule
    draw: TumourDraw
    tumours: ManyTumours
    widest: float
    moved: dict[str, tuple[ManyTumours, ManyTumours]]
    priors: dict[str, float]
    stacks: FilmStacks | None = None
    effort: SearchEffort = SEARCH_EFFORT
    scans: dict[ScanChoice, Self] = field(default_factory=dict, repr=False)

    VARIED_PARAMETERS: ClassVar[tuple[str, ...]] = ("diameter", "depth", *PLACE_AXES)

    @staticmethod
    def from_design(design: Design, widest: float, max_tumours: int = MAX_SEARCH_TUMOURS) -> PopulationObjective:
        """Draw the tumours and precompute all that does not depend on the probe.

        Parameters
        ----------
        design
            The design file.
        widest
            Outer radius of the widest probe, m.
        max_tumours
            Maximum of tumours in the objective.
        """
        population = ScenePopulation.from_scene(design.scene, design.population)
        draw = population.draw_tumours(min(max_tumours, population.samples))
        return OBJECTIVES[design.objective.maximise].from_draw(design, population, draw, widest)

    @classmethod
    def from_draw(cls, design: Design, population: ScenePopulation, draw: TumourDraw, widest: float) -> PopulationObjective:
        """Precompute the objective for tumours that are already drawn."""
        tumours, moved = cls._prepare(design, draw, widest)
        priors = {name: population.ranges[name].deviation for name in ("diameter", "depth", "tissue")}
        priors |= {name: population.ranges[name].deviation / PLACE_UNIT_M for name in PLACE_AXES}
        priors["object"] = population.ranges["object"].deviation or DEFAULT_PRIOR_LOG_SD
        rule = PressingRule.from_draws(design, draw, population.draw_tumours(unseen=True))
        return cls(design, rule, draw, tumours, widest, moved, priors, build_stacks(design.scene))

    @classmethod
    def _prepare(
        cls, design: Design, draw: TumourDraw, widest: float
    ) -> tuple[ManyTumours, dict[str, tuple[ManyTumours, ManyTumours]]]:
        """Return ``tumours`` and ``moved`` for the places of a design's protocol."""
        draws, steps = build_draws(draw), (-LOG_DIFFERENCE_STEP, LOG_DIFFERENCE_STEP)
        names = cls.VARIED_PARAMETERS if design.protocol.blank else (*cls.VARIED_PARAMETERS, "tissue")
        moved = {}
        for name in names:
            if name in PLACE_AXES and not np.ptp(getattr(draw, name)):
                continue  # a place that all tumours have is known
            smaller, larger = (prepare_tumours(design, draw, step_parameter(draws, name, step), widest) for step in steps)
            moved[name] = smaller, larger
        return prepare_tumours(design, draw, draws, widest), moved

    @abstractmethod
    def compute_tumour_values(self, probes: Array, compute_force: ForceRule) -> Array:
        """Return the objective tumour by tumour, shape (n, m); see ``compute_statistic``."""

    def compute_statistic(self, probes: Array, compute_force: ForceRule) -> Array:
        """Return the objective of n designs, shape (n,); for probes see ``ManyTumours.compute_films``, floats or complex."""
        tumour_values, statistic = self.compute_tumour_values(probes, compute_force), self.design.objective.statistic
        return tumour_values.mean(axis=1) if statistic == "mean" else _compute_quantile(tumour_values, float(statistic))

    def set_film(self, choice: FilmChoice) -> Self:
        """See ``SearchObjective.set_film``."""
        rule = self.rule.set_film(choice)
        draw = replace(self.draw, scene=choice.set_film(self.draw.scene), tissues=tuple(map(choice.set_film, self.draw.tissues)))
        return replace(self, design=rule.design, rule=rule, draw=draw, stacks=build_stacks(rule.design.scene), scans={})

    def set_scan(self, choice: ScanChoice) -> Self:
        """See ``SearchObjective.set_scan``; prepared once for each scan."""
        if choice not in self.scans:
            design = self.design.model_copy(update={"protocol": choice.protocol})
            tumours, moved = self._prepare(design, self.draw, self.widest)
            rule = replace(self.rule, design=design)
            self.scans[choice] = replace(self, design=design, rule=rule, tumours=tumours, moved=moved, scans={})
        return self.scans[choice]

    def values(self, x: Array, poisson: Any) -> tuple[Array, Array]:
        """See ``SearchObjective.values``."""
        sizes = ProbeSizes.from_vector(x)
        charges: list[Array] = []

        def compute_force(totals: Array) -> Array:
            """Return the forces, N, and keep the smallest charge of a channel over all tumours in ``charges``."""
            forces = self.rule.compute_forces(sizes, totals, self.draw.tissue)
            # charge of the weaker channel; argmin takes the tumour whose tissue gives least
            lightest = select_smaller(min(self.design.protocol.loads, default=np.inf) + 0 * forces, forces)
            channels = self.rule.compute_charges(totals, lightest)
            weaker = select_smaller(channels[..., 0], channels[..., 1])
            charges.append(np.take_along_axis(weaker, weaker.real.argmin(axis=1)[:, None], axis=1)[:, 0])
            return forces

        values = self.compute_statistic(sizes.build_parameters(poisson), compute_force)
        min_charge = self.design.limits.charge[0] if self.design.limits.charge else 0.0
        return values, np.log(charges[0] / min_charge) if min_charge > 0 else 0 * values

    def compute_detection(self, probes: Array, compute_force: ForceRule) -> Array:
        """Return the probability of detection of each tumour if it were known, from eq. DS.1, shape (n, m)."""
        films, noise = self._compute_noise(probes, compute_force)
        squared_deflection = noise.compute_chi_square(self._compute_signature(films))
        return compute_known_probabilities(np.sqrt(squared_deflection + MIN_VARIANCE), self.design.protocol.false_alarm)

    def compute_log_sd(self, probes: Array, compute_force: ForceRule) -> Array:
        """Return ln of the posterior standard deviation of ln contrast, eq. DS.2, shape (n, m)."""
        return np.log(self.compute_posterior(probes, compute_force, FLAT_PRIOR_SD)[0].compute_posterior_sd(np.array([1.0])))

    def compute_posterior(
        self, probes: Array, compute_force: ForceRule, contrast_prior_sd: float
    ) -> tuple[LinearGaussian, LinearGaussian]:
        """Return the readings with the tumours' parameters as unknowns, ln contrast first, and without them, eq. DS.2."""
        films, noise = self._compute_noise(probes, compute_force)
        prior_sd = np.array([contrast_prior_sd, *(self.priors[name] for name in self._parameters)])
        return noise.add_unknowns(self._compute_derivatives(probes, films), prior_sd), noise

    @property
    def _parameters(self) -> tuple[str, ...]:
        """Names of the tumours' parameters that are unknown beside ln contrast, in the order of the derivatives."""
        return tuple(name for name in self.moved if is_of_tumour(name))

    def _compute_noise(self, probes: Array, compute_force: ForceRule) -> tuple[Films, LinearGaussian]:
        """Return the film forces and the noise of the readings; NaN where a film is in tension and has no logarithm."""
        films = self._compute_films(self.tumours, probes)
        variance = self._compute_variance(films, compute_force(films.without))
        return films, LinearGaussian.from_shared_errors(self._build_shared_errors(probes, films, variance), variance)

    def _compute_films(self, tumours: ManyTumours, probes: Array) -> Films:
        """Return film forces and, where the scene reads them, charges without sign.

        NaN where a film is in tension, or its charge has not the sign that d33 gives: it passes 0 for some modulus of the bonds.
        """
        films = tumours.compute_films(probes, self.stacks)
        film = self.design.scene.probe.film
        if self.design.scene.observable == "charge" and film is not None and film.uses_psi:
            factors = np.array([item.charge_per_force for item in film.by_block])
            films = Films(
                *(np.concatenate([part, part * factors], axis=-1) for part in (films.without, films.change, films.by_log))
            )
        sign = find_charge_signs(self.design.scene, films.without)
        without = _mask_non_positive(sign * films.without)
        return Films(without, sign[:, :, None] * films.change, sign[:, :, None] * films.by_log)

    def _stack_channels(self, ratio: Array, stiffness: Array) -> Array:
        """Join the readings of a scan along one axis: ratios, then stiffnesses if they are read."""
        return np.concatenate([ratio, stiffness], axis=2) if self.design.protocol.stiffness else ratio

    def _compute_signature(self, films: Films) -> Array:
        """Return the signals s: the change of ln ratio and ln stiffness by each tumour, shape (n, m, readings)."""
        without = films.without[:, :, None]
        totals = without + films.change
        inner, outer = (np.log(_mask_non_positive(totals[..., film] / without[..., film])) for film in (-2, -1))
        return self._stack_channels(inner - outer, np.log(totals[..., :2].sum(axis=3) / without[..., :2].sum(axis=3)))

    def _compute_variance(self, films: Films, force: Array) -> Array:
        """Return the variance V of each reading's own error, for forces (n, m), N; shape (n, m, readings).

        Readings under several loads count as their mean.
        """
        noise, loads = self.design.noise, self.design.protocol.loads or (np.inf,)
        charges = [self.rule.compute_charges(films.without, select_smaller(load + 0 * force, force)) for load in loads]
        parts = [noise.white**2 + noise.tilt**2 + ((noise.charge / item) ** 2).sum(axis=2) for item in charges]
        ratio = combine_variances(parts)[..., None] * np.ones((1, 1, films.change.shape[2]))
        return self._stack_channels(ratio, (noise.stiffness_white**2 + MIN_VARIANCE) / len(loads) + 0 * ratio)

    def _build_shared_errors(self, probes: Array, films: Films, variance: Array) -> Array:
        """Return the errors common to a scan: the change of the readings by one standard deviation of each of a nuisances.

        With a baseline reading these are its own errors, one for each channel; without it the gains and the tissue's modulus.

        Returns
        -------
        Array
            N Pi^(1/2) of eq. DS.1, shape (n, m, readings, a).
        """
        noise, channels = self.design.noise, 2 if self.design.protocol.stiffness else 1
        count = variance.shape[2] // channels
        by_channel = np.repeat(np.eye(channels), count, axis=0)
        if self.design.protocol.blank:
            # the baseline reading of a channel errs as much as the channel's first reading
            return by_channel * np.sqrt(variance[:, :, None, ::count])
        # sqrt(2): the ratio has the gains of two channels
        gains = np.array([math.sqrt(2) * noise.gain, noise.stiffness_gain])[:channels]
        common = np.broadcast_to(by_channel * gains, (*variance.shape, channels))
        tissue = self._differentiate("tissue", probes, lambda films: self._stack_channels(*_compute_baseline_logs(films)))
        return np.concatenate([common, self.priors["tissue"] * tissue[..., None]], axis=3)

    def _compute_derivatives(self, probes: Array, films: Films) -> Array:
        """Return the signature's derivatives by ln contrast and ``_parameters``, shape (n, m, readings, parameters)."""
        totals = films.without[:, :, None] + films.change
        inner, outer = np.moveaxis((films.by_log / totals)[..., -2:], 3, 0)
        stiffness = films.by_log[..., :2].sum(axis=3) / totals[..., :2].sum(axis=3)
        derivatives = [self._stack_channels(inner - outer, stiffness)]
        derivatives += [self._differentiate(name, probes, self._compute_signature) for name in self._parameters]
        return np.stack(derivatives, axis=3)

    def _differentiate(self, name: str, probes: Array, evaluate: Callable[[Films], Array]) -> Array:
        """Return the derivative of ``evaluate``, readings, by the logarithm of a parameter in ``moved``, a central difference."""
        lower, upper = (evaluate(self._compute_films(tumours, probes)) for tumours in self.moved[name])
        return (upper - lower) / (2 * LOG_DIFFERENCE_STEP)


class Detection(PopulationObjective):
    """The probability of detection of each tumour."""

    VARIED_PARAMETERS = ()

    def compute_tumour_values(self, probes: Array, compute_force: ForceRule) -> Array:
        """Return the probability of detection."""
        return self.compute_detection(probes, compute_force)


class Resolved(PopulationObjective):
    """Whether the stiffness of each tumour is resolved: a smooth step of the standard deviation of ln contrast."""

    VARIED_PARAMETERS = ("diameter", "depth")

    def compute_tumour_values(self, probes: Array, compute_force: ForceRule) -> Array:
        """Return the step, from 0 to 1."""
        return ndtr((math.log(MAX_RESOLVED_LOG_SD) - self.compute_log_sd(probes, compute_force)) / RESOLVED_STEP_LOG_SD)


class Information(PopulationObjective):
    """The information about all that is unknown of each tumour, in nats."""

    def compute_tumour_values(self, probes: Array, compute_force: ForceRule) -> Array:
        """Return the information of the readings with the tumour's parameters unknown, less that with the tumour known."""
        posterior, noise = self.compute_posterior(probes, compute_force, self.priors["object"])
        return posterior.compute_half_log_determinant() - noise.compute_half_log_determinant()


class PlaceError(PopulationObjective):
    """The posterior standard deviation of each tumour's place, which the search makes small."""

    def compute_tumour_values(self, probes: Array, compute_force: ForceRule) -> Array:
        """Return the standard deviation, m."""
        posterior = self.compute_posterior(probes, compute_force, self.priors["object"])[0]
        names = ("object", *self._parameters)
        axes = [np.eye(len(names))[number] for number, name in enumerate(names) if name in PLACE_AXES]
        return PLACE_UNIT_M * np.sqrt(sum(posterior.compute_posterior_sd(axis) ** 2 for axis in axes))

    def compute_statistic(self, probes: Array, compute_force: ForceRule) -> Array:
        """Return minus ln of the statistic, so that the search makes it small, see ``Objective.convert_searched``."""
        return -np.log(super().compute_statistic(probes, compute_force))


OBJECTIVES: dict[str, type[PopulationObjective]] = {
    "detection": Detection,
    "resolved": Resolved,
    "information": Information,
    "place_error": PlaceError,
}
"""The objectives by their names in design files."""


def _mask_non_positive(values: Array) -> Array:
    """Return values above 0 unchanged, complex ones by their real parts, and NaN for others."""
    return np.where(values.real > 0, values, np.nan)


def _compute_baseline_logs(films: Films) -> tuple[Array, Array]:
    """Return ln ratio and ln stiffness without the tumour at each position, shapes (n, m, P)."""
    ratio = np.log(films.without[..., -2] / films.without[..., -1])
    stiffness = np.log(films.without[..., :2].sum(axis=2))
    ones = np.ones(films.change.shape[2])
    return ratio[..., None] * ones, stiffness[..., None] * ones


def _compute_quantile(values: Array, fraction: float) -> Array:
    """Return the quantile of values (n, m) over m tumours, interpolated linearly; complex ones by their real parts; (n,)."""
    order = np.argsort(values.real, axis=1)
    rank = fraction * (values.shape[1] - 1)
    low = min(int(rank), values.shape[1] - 1)
    ends = np.take_along_axis(values, order[:, [low, min(low + 1, values.shape[1] - 1)]], axis=1)
    return ends[:, 0] * (1 - (rank - low)) + ends[:, 1] * (rank - low)
