"""The search objective computed with the first-order equivalent-inclusion evaluator, used to refine a design."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from geometry.common.arrays import Floats
from geometry.scenes.scene import Scene
from probe_design.design_search.loads import ProbeSizes
from probe_design.design_search.steered_population import SteeredDesigns
from probe_design.populations.design_file import Design
from solver.equivalent_inclusion.probe_on_tissue import Undisturbed
from solver.equivalent_inclusion.readings import readings
from solver.inclusions.tumours import Tumours
from solver.planning.coarse_model import CoarseModel
from solver.tumour_waves.population import TumourDraws
from solver.tumour_waves.readings import Films, ManyTumours


@dataclass(frozen=True)
class InclusionTumours:
    """Stands in for ``ManyTumours`` with one probe that is solved by finite elements on each tissue.

    Attributes:
        bases: the probe on each tissue.
        draws: the tumours.
        tissue: of each, shape (m,).
        positions: x of the probe's axis, m, shape (P,), and its y.
    """

    bases: tuple[Undisturbed, ...]
    draws: TumourDraws
    tissue: Any
    positions: tuple[Floats, float]

    def films(self, probes: Any) -> Films:
        """Return the film forces of the one probe; ``probes`` is ignored."""
        m, places = len(self.tissue), len(self.positions[0])
        without, change, by_log = np.zeros((1, m, 2)), np.zeros((1, m, places, 2)), np.zeros((1, m, places, 2))
        for number, base in enumerate(self.bases):
            which = np.flatnonzero(self.tissue == number)
            if not len(which):
                continue
            answers = readings(base, self._seen(which), 0, reflect=False)
            totals = base.films.forces.sum(axis=1)
            without[0, which] = totals
            change[0, which] = answers.totals.reshape(len(which), places, 2) - totals
            by_log[0, which] = answers.by["youngs_modulus"].sum(axis=2).reshape(len(which), places, 2)
        return Films(without, change, by_log)

    def _seen(self, which: Any) -> Tumours:
        """Return the tumours relative to the probe's axis at each of P positions, shape (k P, 1)."""
        draws, (along, across) = self.draws, self.positions
        places = len(along)
        columns = [(draws.x[which, None] - along).ravel(), np.repeat(draws.y[which] - across, places)]
        columns += [
            np.repeat(values[which], places)
            for values in (draws.depth, 2 * draws.radius, draws.youngs_modulus, draws.poisson_ratio)
        ]
        x, y, depth, diameter, modulus, poisson = (column[:, None] for column in columns)
        return Tumours(x, y, depth, diameter, modulus, poisson)


def inclusion_value(steered: SteeredDesigns, design: Design, scene: Scene) -> float:
    """Return the objective of a scene's probe, larger is better; ``-inf`` where it is not finite.

    Raises:
        Refusal: the evaluator does not support the scene.
    """
    bases = tuple(CoarseModel.of(one, details=False).undisturbed for one in steered.draw.on(scene).tissues)
    sizes = ProbeSizes.of(scene)

    def seen(tumours: ManyTumours) -> Any:
        draws = tumours.draws
        return InclusionTumours(bases, draws, steered.draw.tissue, (design.protocol.places, scene.placement.y))

    objective = steered.steered
    moved = {key: (seen(less), seen(more)) for key, (less, more) in objective.moved.items()}
    found = replace(objective, tumours=seen(objective.tumours), moved=moved)
    with np.errstate(all="ignore"):
        value = float(found.values(np.zeros((9, 1)), lambda totals: steered.rule.forces(sizes, totals, steered.draw.tissue))[0])
    return value if np.isfinite(value) else -np.inf
