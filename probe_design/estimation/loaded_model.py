"""Predict readings by ``contact`` at loads beyond linear elasticity, for one value of the unknown at a time."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from threadpoolctl import threadpool_limits

from geometry.common.arrays import Floats
from geometry.common.resources import timed
from geometry.scenes.scene import Load, Placement, Scene
from geometry.scenes.variables import changed
from probe_design.estimation.model import OF_TARGET, TargetModel
from probe_design.estimation.predicted import WORST
from solver.contact.level import FEATURE, ContactLevel
from solver.contact.loaded import LoadedScene, beside
from solver.results.film_forces import FilmForces
from solver.results.result import Decision

Told = tuple[Floats, Floats]  # logarithms of the data, and bounds on their errors, both of shape (k,)


def refusal(model: TargetModel, nuisances: bool) -> str | None:
    """Return what ``contact`` requires if it cannot model the readings or the scene, else None."""
    if nuisances:
        return "no numbers that are known only roughly"
    over = model.data.places[model.data.place[~model.data.is_blank]]
    if model.scene.inclusion:
        off = np.hypot(*(over - [model.target.x, model.target.y]).T)
        if len(model.scene.inclusion) > 1 or (off > 1e-9 * (model.target.diameter or 0.0)).any():
            return "one tumour, read on its axis"
    return None if ContactLevel().refusal(_on_axis(model)) is None else "bonded faces"


def _on_axis(model: TargetModel) -> Scene:
    """Return the scene with the probe over its target, or without inclusions at the reading farthest from the tissue's middle."""
    at = Placement(x=model.target.x, y=model.target.y) if model.scene.inclusion else model.base.scene.placement
    return model.scene.model_copy(update={"placement": at})


@dataclass
class LoadedModel:
    """Predictions by ``contact`` under the scene's load.

    Attributes:
        model: scene and data; ``contact`` can model the scene.
        unknown: the number that is varied.
        accuracy: relative, required of ``contact``.
    """

    model: TargetModel
    unknown: str
    accuracy: float
    _bare: dict[Scene, FilmForces] = field(default_factory=dict)
    _loaded: dict[float, LoadedScene] = field(default_factory=dict)

    @property
    def at_rest(self) -> TargetModel:
        """The model without load, which linear elasticity describes exactly."""
        rest = Load(force=0.0) if self.model.scene.load.indentation is None else Load(indentation=0.0)
        return replace(self.model, scene=self.model.scene.model_copy(update={"load": rest}))

    @property
    def name(self) -> str:
        """Name of the evaluator."""
        return ContactLevel().name

    def decision(self, change: float) -> Decision:
        """Return the line of the plan, for a relative change of the ratio by the load."""
        return Decision(FEATURE, True, change, self.accuracy, "what they change of the ratio at this load")

    def told(self, value: float) -> Told | None:
        """Return predictions for a value of the unknown, SI; None where errors are too large, or the sign of a ratio differs.

        Raises:
            ProbeError, ValueError: ``contact`` does not reach the load, or the scene is not valid.
        """
        data, scene = self.model.data, self._scene(value)
        values, bounds = np.zeros((2, len(data.value)))
        for blank in {bool(one) for one in data.is_blank}:
            films = self._blank(scene) if blank else self._over(scene, value)
            rows = data.is_blank == blank
            values[rows], bounds[rows] = np.log(films.totals.sum()), films.stiffness_error
            ratios, ratio = rows & ~data.is_stiffness, self._ratio(films)
            values[ratios], bounds[ratios] = np.log(abs(ratio)), films.bound.log_ratio
            if (data.sign[ratios] != np.sign(ratio)).any() or bounds[rows].max() > WORST:
                return None
        return values, bounds

    def _scene(self, value: float) -> Scene:
        scene = _on_axis(self.model)
        if self.unknown not in OF_TARGET:
            return changed(scene, {self.unknown: value})
        return scene.model_copy(update={"inclusion": (scene.inclusion[0].model_copy(update={self.unknown: value}),)})

    def _ratio(self, films: FilmForces) -> float:
        probe = self.model.scene.probe
        return float(films.totals[0] / films.totals[1] * probe.outer_area / probe.inner_area)

    def _over(self, scene: Scene, value: float) -> FilmForces:
        if self.unknown != "youngs_modulus":
            return self._pressed(scene)
        with timed(), threadpool_limits(1, user_api="blas"):
            return self._neighbour(value)

    def _blank(self, scene: Scene) -> FilmForces:
        bare = scene.model_copy(update={"inclusion": ()})
        if bare not in self._bare:
            self._bare[bare] = self._pressed(bare)
        return self._bare[bare]

    def _pressed(self, scene: Scene) -> FilmForces:
        with timed():
            return ContactLevel().answer(scene, self.accuracy).films[0]

    def _neighbour(self, value: float) -> FilmForces:
        """Return the film forces for another modulus, computed from the solved state with the nearest modulus."""
        if not self._loaded:
            self._loaded[value] = first = ContactLevel().loaded(self._scene(value), self.accuracy)
            return first.at_scene_s_load().films
        nearest = min(self._loaded, key=lambda modulus: abs(np.log(modulus / value)))
        found, self._loaded[value] = beside(self._loaded[nearest], value)
        return found.films
