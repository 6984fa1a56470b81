"""Compute the effects of single tumours from which a table is built: relative changes of what the two films and the hand feel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import Refusal, Words
from geometry.scenes.scene import Scene
from geometry.scenes.scene_tables import Load, Placement
from solver.contact.evaluator import ContactEvaluator
from solver.contact.preloaded_tissue import PreloadedTissue
from solver.contact.pressed_tissue import PressedTissue
from solver.equivalent_inclusion.evaluator import EquivalentInclusion
from solver.equivalent_inclusion.probe_on_tissue import Undisturbed
from solver.equivalent_inclusion.readings import Readings, compute_readings
from solver.inclusions.tumours import Tumours
from solver.linalg.workspace import keep_result
from solver.planning.load_limits import compute_load_limits
from solver.results.film_forces import FilmForces

BASE_ACCURACY = 0.003  # of the probe without tumours: the error of effects is below it
LOADED_ACCURACY = 0.01  # of the ratio without tumours under load, a third of it for the linear part
LOAD_ACCURACY = 0.01  # relative change of the ratio by the load above which effects are those under the load


class EffectSampler(Protocol):
    """Effects of single tumours under a probe, of any evaluator."""

    @property
    def name(self) -> str:
        """Name of the evaluator."""
        ...

    @property
    def key(self) -> str:
        """A text with everything that changes the effects, for the cache."""
        ...

    @property
    def films(self) -> FilmForces:
        """Films of the probe on the tissue without tumours."""
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

    def compute_errors(self, tumours: Tumours) -> Floats:
        """Return the standard deviations of the model's errors of ln ratio and ln stiffness by n tumours, shape (n, 2)."""
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
    def name(self) -> str:
        """See ``EffectSampler``."""
        return EquivalentInclusion.name

    @property
    def films(self) -> FilmForces:
        """See ``EffectSampler``."""
        return self._solve().films

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
        return _compare(self.scene, self.read_sets(tumours.select((slice(None), None)), reflect), self.films)

    def compute_errors(self, tumours: Tumours) -> Floats:
        """See ``EffectSampler``: the solver's errors are below those of the table."""
        return np.zeros((len(tumours.x), 2))

    def read_sets(self, tumours: Tumours, reflect: bool = True) -> Readings:
        """Return the readings over n sets of t tumours, arrays of shape (n, t), relative to the probe's axis."""
        return compute_readings(self._solve(), tumours, reflect=reflect)

    @property
    def _bare(self) -> Scene:
        """The scene with all left out that the effects do not depend on; the probe presses on the middle of the tissue."""
        placement, load = Placement(tilt=self.scene.placement.tilt), Load(indentation=0.0)
        return self.scene.model_copy(update={"inclusion": (), "placement": placement, "load": load})

    def _solve(self) -> Undisturbed:
        """Return the probe on the tissue without tumours, which the workspace caches."""
        return EquivalentInclusion().prepare(self._bare, BASE_ACCURACY)


@dataclass(frozen=True)
class LoadedEffects:
    """Effects under the scene's load by ``contact``: of one press from zero, or of small changes about a preload.

    Attributes
    ----------
    scene
        The scene; its inclusions are not used.
    """

    scene: Scene

    @property
    def name(self) -> str:
        """See ``EffectSampler``."""
        return ContactEvaluator.name

    @property
    def films(self) -> FilmForces:
        """See ``EffectSampler``."""
        return self._press().bare.films

    @property
    def key(self) -> str:
        """See ``EffectSampler``."""
        return f"loaded {LOADED_ACCURACY} {self._bare.model_dump_json()}"

    @property
    def tissue_radius(self) -> float:
        """See ``EffectSampler``."""
        return float(self._press().base.field.states.model.section.tissue_radius)

    def compute_effects(self, tumours: Tumours, reflect: bool) -> Floats:
        """See ``EffectSampler``."""
        return _compare(self.scene, self._read(tumours, reflect), self.films)

    def compute_errors(self, tumours: Tumours) -> Floats:
        """See ``EffectSampler``: half of the bounds of ``contact`` on what a tumour changes."""
        bare, loaded = self._press().bare, self._read(tumours, True)
        log_ratio = loaded.get_observable(self.scene).log_ratio_bound - bare.films.get_observable(self.scene).bound.log_ratio
        # of the stiffness: below that of either film, which adds its own
        films = (loaded.bound / np.abs(loaded.totals) - bare.films.relative_errors).min(axis=1)
        return np.stack([log_ratio, films], axis=-1) / 2

    @property
    def _bare(self) -> Scene:
        """The scene with the probe on the middle of the tissue, without tumours."""
        return self.scene.model_copy(update={"inclusion": (), "placement": Placement(tilt=self.scene.placement.tilt)})

    def _press(self) -> PressedTissue | PreloadedTissue:
        """Return the probe pressed on the tissue without tumours, which the workspace caches."""
        return _press(self._bare)

    def _read(self, tumours: Tumours, reflect: bool) -> Readings:
        """Return the readings over single tumours."""
        return self.read_sets(tumours.select((slice(None), None)), reflect)

    def read_sets(self, tumours: Tumours, reflect: bool = True) -> Readings:
        """Return the readings over n sets of t tumours, arrays of shape (n, t), relative to the probe's axis."""
        pressed = self._press()
        return pressed.tabulate(tumours).compute_readings(compute_readings(pressed.base, tumours, reflect=reflect), tumours)


def choose_sampler(scene: Scene) -> LinearEffects | LoadedEffects:
    """Return the sampler of a scene: under its load where that changes the ratio by more than ``LOAD_ACCURACY``, else linear.

    Raises
    ------
    Refusal
        The scene is too extreme for double precision.
    """
    bare = scene.model_copy(update={"inclusion": ()})
    largest, load = compute_load_limits(bare, LOAD_ACCURACY).linear, scene.load.departure
    if largest is None:
        return LinearEffects(scene)
    is_force = load.force is not None
    given, limit = (load.force, largest.force) if is_force else (load.indentation, largest.indentation)
    return LinearEffects(scene) if (given or 0.0) <= limit else LoadedEffects(scene)


@keep_result
def _press(scene: Scene) -> PressedTissue | PreloadedTissue:
    """Press a probe on its tissue without tumours."""
    return ContactEvaluator().press_tissue(scene, LOADED_ACCURACY)


def _compare(scene: Scene, readings: Readings, films: FilmForces) -> Floats:
    """Return the relative changes of readings against those without tumours, ``films``, shape (n, 3)."""
    read, blank = readings.get_observable(scene).totals, films.get_observable(scene)
    if not np.all(np.abs(blank.totals) > blank.bound.totals):
        raise Refusal("probe", Words("a film that reads nothing without a tumour"), "a probe whose films both read a load")
    return np.concatenate([read / blank.totals - 1, readings.stiffness[:, None] / films.totals.sum() - 1], axis=1)
