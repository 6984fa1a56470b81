"""Predict readings by ``contact`` at loads beyond linear elasticity, for one value of the unknown at a time."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from threadpoolctl import threadpool_limits

from geometry.common.arrays import Floats
from geometry.common.resources import start_clock
from geometry.scenes.scene import Load, Placement, Scene
from probe_design.estimation.model import TARGET_UNKNOWNS, TargetModel
from probe_design.estimation.predictions import MAX_LOG_RATIO_ERROR
from solver.contact.evaluator import DECISION_FEATURE, ContactEvaluator
from solver.contact.loaded_scene import LoadedScene, solve_neighbour
from solver.results.film_forces import FilmForces
from solver.results.result import Decision

LogPrediction = tuple[Floats, Floats]  # logarithms of the data, and bounds on their errors, both of shape (k,)


def explain_refusal(model: TargetModel, nuisances: bool) -> str | None:
    """Return what ``contact`` requires if it cannot model the readings or the scene, else None."""
    if nuisances:
        return "no numbers that are known only roughly"
    places = model.data.places[model.data.place[~model.data.is_blank]]
    if model.scene.inclusion:
        lateral_offset = np.hypot(*(places - [model.target.x, model.target.y]).T)
        if len(model.scene.inclusion) > 1 or (lateral_offset > 1e-9 * (model.target.diameter or 0.0)).any():
            return "one tumour, read on its axis"
    return None if ContactEvaluator().refusal(_place_on_axis(model)) is None else "bonded faces"


def _place_on_axis(model: TargetModel) -> Scene:
    """Return the scene with the probe over its target, or without inclusions at the reading farthest from the tissue's middle."""
    placement = Placement(x=model.target.x, y=model.target.y) if model.scene.inclusion else model.base.scene.placement
    return model.scene.model_copy(update={"placement": placement})


@dataclass
class LoadedModel:
    """Predictions by ``contact`` under the scene's load.

    Attributes
    ----------
    model
        Scene and data; ``contact`` can model the scene.
    unknown
        The number that is varied.
    accuracy
        Relative, required of ``contact``.
    """

    model: TargetModel
    unknown: str
    accuracy: float
    _blank_films: dict[Scene, FilmForces] = field(default_factory=dict)
    _loaded_scenes: dict[float, LoadedScene] = field(default_factory=dict)

    @property
    def unloaded_model(self) -> TargetModel:
        """The model without load, which linear elasticity describes exactly."""
        zero_load = Load(force=0.0) if self.model.scene.load.indentation is None else Load(indentation=0.0)
        return replace(self.model, scene=self.model.scene.model_copy(update={"load": zero_load}))

    @property
    def name(self) -> str:
        """Name of the evaluator."""
        return ContactEvaluator().name

    def build_decision(self, change: float) -> Decision:
        """Return the line of the plan, for a relative change of the ratio by the load."""
        return Decision(DECISION_FEATURE, True, change, self.accuracy, "what they change of the ratio at this load")

    def predict(self, value: float) -> LogPrediction | None:
        """Return predictions for a value of the unknown, SI; None where errors are too large, or the sign of a ratio differs.

        Raises
        ------
        ProbeError, ValueError
            ``contact`` does not reach the load, or the scene is not valid.
        """
        data, scene = self.model.data, self._build_scene(value)
        values, bounds = np.zeros((2, len(data.value)))
        for blank in {bool(is_blank) for is_blank in data.is_blank}:
            films = self._solve_blank(scene) if blank else self._solve_with_target(scene, value)
            rows = data.is_blank == blank
            values[rows], bounds[rows] = np.log(films.totals.sum()), films.stiffness_error
            ratios, ratio = rows & ~data.is_stiffness, self._compute_ratio(films)
            values[ratios], bounds[ratios] = np.log(abs(ratio)), films.bound.log_ratio
            if (data.sign[ratios] != np.sign(ratio)).any() or bounds[rows].max() > MAX_LOG_RATIO_ERROR:
                return None
        return values, bounds

    def _build_scene(self, value: float) -> Scene:
        scene = _place_on_axis(self.model)
        if self.unknown not in TARGET_UNKNOWNS:
            return scene.replace({self.unknown: value})
        return scene.model_copy(update={"inclusion": (scene.inclusion[0].model_copy(update={self.unknown: value}),)})

    def _compute_ratio(self, films: FilmForces) -> float:
        probe = self.model.scene.probe
        return float(films.totals[0] / films.totals[1] * probe.outer_area / probe.inner_area)

    def _solve_with_target(self, scene: Scene, value: float) -> FilmForces:
        if self.unknown != "youngs_modulus":
            return self._solve(scene)
        with start_clock(), threadpool_limits(1, user_api="blas"):
            return self._solve_from_neighbour(value)

    def _solve_blank(self, scene: Scene) -> FilmForces:
        blank_scene = scene.model_copy(update={"inclusion": ()})
        if blank_scene not in self._blank_films:
            self._blank_films[blank_scene] = self._solve(blank_scene)
        return self._blank_films[blank_scene]

    def _solve(self, scene: Scene) -> FilmForces:
        with start_clock():
            return ContactEvaluator().solve(scene, self.accuracy).films[0]

    def _solve_from_neighbour(self, value: float) -> FilmForces:
        """Return the film forces for another modulus, computed from the solved state with the nearest modulus."""
        if not self._loaded_scenes:
            self._loaded_scenes[value] = loaded_scene = ContactEvaluator().load_scene(self._build_scene(value), self.accuracy)
            return loaded_scene.press_to_scene_load().films
        nearest = min(self._loaded_scenes, key=lambda modulus: abs(np.log(modulus / value)))
        path_point, self._loaded_scenes[value] = solve_neighbour(self._loaded_scenes[nearest], value)
        return path_point.films
