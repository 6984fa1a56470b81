"""Compute the effects of single tumours from which a table is built: relative changes of what the two films and the hand feel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import Refusal, Words
from geometry.scenes.scene import Scene
from geometry.scenes.scene_tables import Load, Placement
from solver.equivalent_inclusion.evaluator import EquivalentInclusion
from solver.equivalent_inclusion.probe_on_tissue import Undisturbed
from solver.equivalent_inclusion.readings import compute_readings
from solver.inclusions.tumours import Tumours

BASE_ACCURACY = 0.003  # of the probe without tumours: the error of effects is below it


class EffectSampler(Protocol):
    """Effects of single tumours under a probe, of any evaluator."""

    @property
    def key(self) -> str:
        """A text with everything that changes the effects, for the cache."""
        ...

    @property
    def tissue_radius(self) -> float:
        """Lateral distance from the probe's axis at which the modelled tissue ends, m."""
        ...

    def compute_effects(self, tumours: Tumours, reflect: bool) -> Floats:
        """Return relative changes of the inner reading, the outer reading and the stiffness by n tumours, shape (n, 3).

        ``tumours`` have shape (n,); their x is the distance from the probe's axis. Without ``reflect`` the effects are an
        approximation that costs little; the difference between both is smoother than either.
        """
        ...


@dataclass(frozen=True)
class LinearEffects:
    """Effects by ``equivalent-inclusion`` in linear elasticity, with reflections or to first order.

    Attributes
    ----------
    scene
        The scene; its inclusions and its load are not used.
    """

    scene: Scene

    @property
    def key(self) -> str:
        """See ``EffectSampler``."""
        return f"linear {BASE_ACCURACY} {self._bare.model_dump_json()}"

    @property
    def tissue_radius(self) -> float:
        """See ``EffectSampler``."""
        return float(self._solve().field.states.model.section.tissue_radius)

    def compute_effects(self, tumours: Tumours, reflect: bool) -> Floats:
        """See ``EffectSampler``."""
        base = self._solve()
        readings = compute_readings(base, tumours.select((slice(None), None)), reflect=reflect)
        read, blank = readings.get_observable(base.scene).totals, base.films.get_observable(base.scene).totals
        if not np.all(np.abs(blank) > base.films.get_observable(base.scene).bound.totals):
            raise Refusal("probe", Words("a film that reads nothing without a tumour"), "a probe whose films both read a load")
        return np.concatenate([read / blank - 1, readings.stiffness[:, None] / base.films.totals.sum() - 1], axis=1)

    @property
    def _bare(self) -> Scene:
        """The scene with all left out that the effects do not depend on; the probe presses on the middle of the tissue."""
        placement, load = Placement(tilt=self.scene.placement.tilt), Load(indentation=0.0)
        return self.scene.model_copy(update={"inclusion": (), "placement": placement, "load": load})

    def _solve(self) -> Undisturbed:
        """Return the probe on the tissue without tumours, which the workspace caches."""
        return EquivalentInclusion().prepare(self._bare, BASE_ACCURACY)
