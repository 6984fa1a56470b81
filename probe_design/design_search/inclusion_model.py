"""Compute the search objective with the first-order equivalent-inclusion evaluator, which refines a design."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from geometry.common.arrays import Floats
from geometry.scenes.scene import Scene
from probe_design.design_search.design_objective import DesignObjective
from probe_design.design_search.variables import ProbeSizes
from probe_design.populations.design_file import Design
from solver.equivalent_inclusion.probe_on_tissue import Undisturbed
from solver.equivalent_inclusion.readings import compute_readings
from solver.inclusions.tumours import Tumours
from solver.planning.coarse_model import CoarseModel
from solver.tumour_waves.population import TumourDraws
from solver.tumour_waves.population_films import Films, ManyTumours


@dataclass(frozen=True)
class InclusionTumours:
    """Readings over many tumours in place of ``ManyTumours``, for one probe that finite elements solve on each tissue.

    Attributes
    ----------
    bases
        The probe on each tissue.
    draws
        The tumours.
    tissue
        Number of each tumour's tissue, shape (m,).
    positions
        x of the probe's axis, m, shape (P,), and its y.
    """

    bases: tuple[Undisturbed, ...]
    draws: TumourDraws
    tissue: Any
    positions: tuple[Floats, float]

    def compute_films(self, probes: Any) -> Films:
        """Return the film forces of the one probe; ``probes`` is ignored."""
        m, places = len(self.tissue), len(self.positions[0])
        baseline, change, by_log = np.zeros((1, m, 2)), np.zeros((1, m, places, 2)), np.zeros((1, m, places, 2))
        for number, base in enumerate(self.bases):
            which = np.flatnonzero(self.tissue == number)
            if not len(which):
                continue
            answers = compute_readings(base, self._list_relative_tumours(which), 0, reflect=False)
            totals = base.films.forces.sum(axis=1)
            baseline[0, which] = totals
            change[0, which] = answers.totals.reshape(len(which), places, 2) - totals
            by_log[0, which] = answers.derivatives["youngs_modulus"].sum(axis=2).reshape(len(which), places, 2)
        return Films(baseline, change, by_log)

    def _list_relative_tumours(self, which: Any) -> Tumours:
        """Return the tumours relative to the probe's axis at each of P positions, shape (k P, 1)."""
        draws, (x_positions, across) = self.draws, self.positions
        places = len(x_positions)
        columns = [(draws.x[which, None] - x_positions).ravel(), np.repeat(draws.y[which] - across, places)]
        columns += [
            np.repeat(values[which], places)
            for values in (draws.depth, 2 * draws.radius, draws.youngs_modulus, draws.poisson_ratio)
        ]
        x, y, depth, diameter, modulus, poisson = (column[:, None] for column in columns)
        return Tumours(x, y, depth, diameter, modulus, poisson)


def compute_inclusion_objective(design_objective: DesignObjective, design: Design, scene: Scene) -> float:
    """Return the objective of a scene's probe, larger is better; ``-inf`` where it is not finite.

    Raises
    ------
    Refusal
        The evaluator does not support the scene.
    """
    bases = tuple(
        CoarseModel.from_scene(tissue, details=False).base_states for tissue in design_objective.draw.replace_probe(scene).tissues
    )
    sizes = ProbeSizes.from_scene(scene)

    def replace_tumours(tumours: ManyTumours) -> Any:
        draws = tumours.draws
        return InclusionTumours(bases, draws, design_objective.draw.tissue, (design.protocol.places, scene.placement.y))

    objective = design_objective.population_objective
    moved = {key: (replace_tumours(smaller), replace_tumours(larger)) for key, (smaller, larger) in objective.moved.items()}
    inclusion_objective = replace(objective, tumours=replace_tumours(objective.tumours), moved=moved)
    with np.errstate(all="ignore"):
        value = float(
            inclusion_objective.values(
                np.zeros((9, 1)), lambda totals: design_objective.rule.compute_forces(sizes, totals, design_objective.draw.tissue)
            )[0]
        )
    return value if np.isfinite(value) else -np.inf
