"""Compute the closed-form search objective for a population as a function of the design variables."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.json_types import JsonObject
from probe_design.design_search.loads import PressingRule, minimum_by_real_part
from probe_design.design_search.objective import SearchEffort, SearchObjective
from probe_design.design_search.population_objective import OBJECTIVES, PopulationObjective, ScanErrors
from probe_design.design_search.variables import ProbeSizes
from probe_design.populations.design_file import Design
from probe_design.populations.population import ScenePopulation, TumourDraw
from probe_design.populations.resolved import DEFAULT_PRIOR_LOG_SD
from solver.closed_form.bessel import Array
from solver.closed_form.designs import build_parameters
from solver.tumour_waves.population import TumourDraws
from solver.tumour_waves.population_films import ManyTumours

MAX_SEARCH_TUMOURS = 64  # tumours in the objective
SEARCH_EFFORT = SearchEffort(starts=4, screened=64, steps=25)
LOG_DIFFERENCE_STEP = (
    0.02  # of ln diameter, depth and modulus, for differences: less would show the steps of Bessel functions from tables
)


@dataclass(frozen=True)
class DesignObjective(SearchObjective):
    """The objective of designs for a population in closed form.

    Attributes
    ----------
    population_objective
        The objective of the population.
    rule
        Rule for the forces.
    draw
        The tumours.
    least_charge
        Minimum charge of each channel, C, or 0.
    effort
        Effort of a search.
    """

    population_objective: PopulationObjective
    rule: PressingRule
    draw: TumourDraw
    least_charge: float
    effort: SearchEffort = SEARCH_EFFORT

    @classmethod
    def from_design(cls, design: Design, widest: float, max_tumours: int = MAX_SEARCH_TUMOURS) -> DesignObjective:
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
        return cls.from_draw(design, population, draw, widest)

    @classmethod
    def from_draw(cls, design: Design, population: ScenePopulation, draw: TumourDraw, widest: float) -> DesignObjective:
        """Precompute the objective for tumours that are already drawn."""
        tumours = build_draw_arrays(draw)
        make = _build_tumour_factory(design, draw, widest)
        moved = {
            key: (
                make(_step_parameter(tumours, key, -LOG_DIFFERENCE_STEP)),
                make(_step_parameter(tumours, key, LOG_DIFFERENCE_STEP)),
            )
            for key in _list_varied_parameters(design)
        }
        priors = {key: population.ranges[key].deviation for key in ("diameter", "depth", "tissue")}
        priors["object"] = population.ranges["object"].deviation or DEFAULT_PRIOR_LOG_SD
        rule = PressingRule.from_draws(design, draw, population.draw_tumours(unseen=True))
        errors, statistic = build_scan_errors(design, rule), design.objective.statistic
        objective = OBJECTIVES[design.objective.maximise](make(tumours), moved, LOG_DIFFERENCE_STEP, errors, priors, statistic)
        return cls(objective, rule, draw, 0.0 if design.limits.charge is None else design.limits.charge[0])

    def values(self, x: Array, poisson: Any) -> tuple[Array, Array]:
        """See ``SearchObjective.values``."""
        sizes = ProbeSizes.from_vector(x)
        charges: list[Array] = []

        def force(totals: Array) -> Array:
            forces = self.rule.compute_forces(sizes, totals, self.draw.tissue)
            share = totals / totals.sum(axis=2, keepdims=True)
            weaker = minimum_by_real_part(share[..., 0], share[..., 1]) * forces * self.rule.charge_per_force
            charges.append(np.take_along_axis(weaker, weaker.real.argmin(axis=1)[:, None], axis=1)[:, 0])
            return forces

        values = self.population_objective.values(sizes.build_parameters(poisson), force)
        margin = np.log(charges[0] / self.least_charge) if self.least_charge > 0 else 0 * values
        return values, margin

    def evaluate_tumours(self, x: Floats, poisson: tuple[float, float], force: float) -> Floats:
        """Return the objective of each tumour for one design (6,) under a force, N; shape (m,)."""
        with np.errstate(all="ignore"):
            return np.asarray(
                self.population_objective.evaluate_tumours(
                    ProbeSizes.from_vector(x[:, None]).build_parameters(poisson), lambda totals: np.full(totals.shape[:2], force)
                )[0]
            )

    def compute_contrast_sd(self, x: Floats, poisson: tuple[float, float], force: float) -> Floats:
        """Return the standard deviation of ln contrast of each tumour for one design (6,) under a force, N; shape (m,)."""
        with np.errstate(all="ignore"):
            log_sd = self.population_objective.compute_log_sd(
                ProbeSizes.from_vector(x[:, None]).build_parameters(poisson), lambda totals: np.full(totals.shape[:2], force)
            )
        return np.asarray(np.exp(log_sd[0]))


def build_draw_arrays(draw: TumourDraw) -> TumourDraws:
    """Return a draw of tumours as arrays, in the scene's coordinates."""
    y_position = draw.scene.inclusion[0].y if draw.scene.inclusion else draw.scene.placement.y
    tissues = np.array([_list_layers(scene.tissue) for scene in draw.tissues])  # (t, layers + 1, 3)
    tissue = np.moveaxis(tissues[draw.tissue], 0, 2)
    ones = np.ones(len(draw))
    bounded = draw.scene.tissue.shape != "half-space"
    return TumourDraws(
        draw.diameter / 2, draw.depth, draw.x, y_position * ones, draw.youngs_modulus, draw.poisson_ratio * ones, tissue, bounded
    )


def build_scan_errors(design: Design, rule: PressingRule) -> ScanErrors:
    """Return the errors of a scan that a design file states."""
    noise, protocol = design.noise, design.protocol
    return ScanErrors(
        white=math.hypot(noise.white, noise.tilt),
        gain=noise.gain * math.sqrt(2),
        stiffness_white=noise.stiffness_white,
        stiffness_gain=noise.stiffness_gain,
        charge=noise.charge / rule.charge_per_force,
        stiffness=protocol.stiffness,
        blank=protocol.blank,
        false_alarm=protocol.false_alarm,
    )


def _list_layers(tissue: Any) -> list[list[float]]:
    depth = getattr(tissue, "depth", 1.0)
    layers = [[layer.thickness, layer.youngs_modulus, layer.poisson_ratio] for layer in tissue.layer]
    return [*layers, [depth, tissue.youngs_modulus, tissue.poisson_ratio]]


def _build_tumour_factory(design: Design, draw: TumourDraw, widest: float) -> Any:
    scene = draw.tissues[0]
    shape, values = build_parameters(scene, merged=False)
    side = (float(values[10]), shape.side_nodes) if shape.bounded else (1.0, 0)
    y = scene.placement.y * np.ones(len(design.protocol.places))
    positions = np.stack([design.protocol.places, y], axis=1)
    bonded = scene.contact.interface == "bonded" or scene.contact.interface == "unilateral"
    settings: JsonObject = {"bonded": bonded, "side": side, "layer_nodes": shape.layer_nodes}
    return lambda tumours: ManyTumours.from_draws(tumours, positions, widest, **settings)


def _list_varied_parameters(design: Design) -> list[str]:
    moving = [*OBJECTIVES[design.objective.maximise].VARIED_PARAMETERS]
    return moving if design.protocol.blank else [*moving, "tissue"]


def _step_parameter(tumours: TumourDraws, key: str, step: float) -> TumourDraws:
    factor = math.exp(step)
    if key == "diameter":
        return replace(tumours, radius=tumours.radius * factor)
    if key == "depth":
        return replace(tumours, depth=tumours.depth * factor)
    tissue = tumours.tissue.copy()
    tissue[-1, 1] *= factor
    return replace(tumours, tissue=tissue)
