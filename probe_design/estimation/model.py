"""Predict the readings for many bodies in the target's place at once, by `equivalent-inclusion`.

Far from a sphere of diameter D its effect depends on its strength S alone (PHYSICS section 2),

    S = D^3 (c - 1) / (1 + beta (c - 1)),   c = E_object / E_tissue,   beta = 2 (4 - 5 nu) / (15 (1 - nu))     (ES.1)

in m^3, with nu the tissue's Poisson's ratio; S is positive where the sphere is stiffer than the tissue, at most D^3 / beta and at
least -D^3 / (1 - beta). beta is the shear part of Eshelby's tensor of a sphere.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from geometry.common.arrays import Floats, Ints
from geometry.common.errors import InputError, Refusal, Words
from geometry.scenes.probe import Material, format_mm
from geometry.scenes.scene import Scene
from geometry.scenes.scene_tables import Inclusion, Load, Placement
from geometry.scenes.units import MODULUS_QUANTITY
from geometry.scenes.variables import list_values
from probe_design.estimation.measurements import Measurements
from probe_design.estimation.predictions import Predictions, build_turned_bodies, build_turned_scenes, insert_phases
from probe_design.maps.target_grid import check_spheres, compute_free_radii
from solver.contact.evaluator import ContactEvaluator
from solver.contact.preloaded_tissue import PreloadedTissue
from solver.contact.pressed_tissue import PressedTissue
from solver.equivalent_inclusion.evaluator import EquivalentInclusion
from solver.equivalent_inclusion.probe_on_tissue import Undisturbed
from solver.equivalent_inclusion.readings import Readings, compute_readings
from solver.inclusions.tumours import Tumours
from solver.phase.losses import compute_angle_spread
from solver.planning.load_check import LoadChanges
from solver.planning.load_limits import build_load_rule
from solver.planning.loads import LoadRule

MAX_FILL_FRACTION = 0.995  # of the distance to surface, interfaces and neighbours: a body that touches these cannot be modelled
SEARCH_DEPTH_RADII = 20.0  # tube radii, or times the scene's depth: largest depth searched where the tissue has no bottom
NEGLIGIBLE_REFLECTION = 0.1  # of the accuracy: reflections that change the ratio by less are neglected
TARGET_UNKNOWNS = ("youngs_modulus", "diameter", "depth")  # unknowns of the target; other unknowns are the tissue's
TISSUE_SEARCH_FACTOR = 8.0  # times the scene's value, upwards and downwards: search range of a number of the tissue


@dataclass(frozen=True)
class TargetModel:
    """A scene whose target is replaced by bodies of other modulus, diameter or depth.

    Attributes
    ----------
    scene
        With a target.
    data
        Measured values and their places.
    accuracy
        Relative, required of the evaluator.
    pressing
        Whether ``contact`` presses the probe to the loads of the readings; otherwise readings are linear.
    """

    scene: Scene
    data: Measurements
    accuracy: float
    pressing: bool = False

    @property
    def evaluator(self) -> str:
        """Name of the evaluator."""
        return ContactEvaluator.name if self.pressing else EquivalentInclusion.name

    @property
    def heaviest_scene(self) -> Scene:
        """The scene under the largest load of its readings."""
        largest_force = max(self.data.force, key=lambda force: _get_force(self.scene, force))
        return _replace_force(self.scene, float(largest_force))

    @property
    def target(self) -> Inclusion:
        """The inclusion whose number is unknown."""
        assert self.scene.target is not None  # see check_kind
        return self.scene.inclusion[self.scene.target]

    @property
    def host(self) -> Material:
        """The material around the target, which stays in its layer."""
        return self.scene.tissue.find_material(self.target.depth)

    @property
    def beta(self) -> float:
        """The beta of eq. ES.1, of the material around the target."""
        nu = self.host.poisson_ratio
        return 2 * (4 - 5 * nu) / (15 * (1 - nu))

    def compute_strength(self, modulus: Floats | float | None = None, diameter: Floats | float | None = None) -> Floats:
        """Return the strength, eq. ES.1, m^3, of the target, or of targets with other moduli (Pa) or diameters (m)."""
        # a rigid target has an infinite excess, whose limit is 1 / beta; np.where computes the invalid branch, too
        E = np.asarray(self.target.youngs_modulus if modulus is None else modulus, dtype=float)
        size = np.asarray(self.target.diameter if diameter is None else diameter, dtype=float)
        excess = E / self.host.youngs_modulus - 1
        with np.errstate(invalid="ignore"):
            return np.asarray(size**3 * np.where(np.isinf(excess), 1 / self.beta, excess / (1 + self.beta * excess)))

    def replace_values(self, new_values: Mapping[str, float]) -> TargetModel:
        """Return the model of a scene with other numbers; see ``Scene.replace``."""
        return replace(self, scene=self.scene.replace(new_values))

    @cached_property
    def base(self) -> Undisturbed:
        """The probe on tissue without tumours; its bounds are those of the place farthest from the tissue's middle."""
        if self.pressing:
            return self._press(float(self.data.force[0])).base
        return EquivalentInclusion().prepare(self._farthest_scene, self.accuracy)

    @cached_property
    def _pressed(self) -> dict[float, PressedTissue | PreloadedTissue]:
        """Cache: the probe pressed on tissue without tumours by force, N."""
        return {}

    def _press(self, force: float) -> PressedTissue | PreloadedTissue:
        """Return the probe pressed by a reading's force, N, or by the scene's load for NaN."""
        scene = _replace_force(self._farthest_scene, force)
        key = scene.load.force or 0.0
        if key not in self._pressed:
            self._pressed[key] = ContactEvaluator().press_tissue(scene, self.accuracy)
        return self._pressed[key]

    @property
    def _farthest_scene(self) -> Scene:
        """The scene with the probe at the place farthest from the tissue's middle."""
        farthest = np.abs(self.data.places).max(axis=0)
        if self.scene.tissue.shape == "cylinder":  # only the distance from the axis matters
            farthest = np.array([np.hypot(*self.data.places.T).max(), 0.0])
        return self.scene.model_copy(update={"placement": Placement(x=float(farthest[0]), y=float(farthest[1]))})

    @cached_property
    def rule(self) -> LoadRule:
        """The limits of the scene's load, from the stiffness without tumours."""
        return build_load_rule(self.scene)

    @property
    def tolerance(self) -> float:
        """How much the load may change the ratio, relative, before this linear model is replaced by one that presses.

        It is the smallest noise of the ratios, at most 0.9.
        """
        return min(float(self.data.noise[self.data.is_ratio].min()), 0.9)

    @property
    def stiffness_error(self) -> float:
        """Bound on the relative error of the stiffness without tumours."""
        return self.base.films.stiffness_error

    def compute_max_diameter(self, depth: Floats) -> Floats:
        """Return the largest diameter, m, of a target that fits at each of n depths, m, shape (n,)."""
        radius = compute_free_radii(self.scene, depth)
        for interface in self.scene.tissue.interfaces:
            radius = np.minimum(radius, np.abs(interface - depth))
        return np.asarray(2 * radius * MAX_FILL_FRACTION)

    def find_search_range(self, unknown: str) -> tuple[float, float]:
        """Return lower and upper end of the search range of the unknown, SI.

        Moduli from 1e-3 to 1e6 times that of the tissue around the target; diameters from 1/100 of the largest that fits; depths
        between which the target fits, without passing through another inclusion or an interface; numbers of the tissue from 1/8
        to 8 times the scene's.

        Raises
        ------
        Refusal
            The target fits at one depth only.
        """
        if unknown not in TARGET_UNKNOWNS:
            current = list_values(self.scene)[unknown]
            return current / TISSUE_SEARCH_FACTOR, current * TISSUE_SEARCH_FACTOR
        body, tissue = self.target, self.scene.tissue
        if unknown == "youngs_modulus":
            E = self.host.youngs_modulus
            return max(1e-3 * E, MODULUS_QUANTITY.low), min(1e6 * E, MODULUS_QUANTITY.high)
        if unknown == "diameter":
            max_diameter = float(self.compute_max_diameter(np.array([body.depth]))[0])
            return max_diameter / 100, max_diameter
        no_bottom_depth = SEARCH_DEPTH_RADII * max(self.scene.probe.tube_radius, body.depth)
        depths = np.linspace(0.0, tissue.bottom if np.isfinite(tissue.bottom) else no_bottom_depth, 20_001)
        fits = np.append(self.compute_max_diameter(depths) >= (body.diameter or 0.0), False)  # False ends the last run
        if not fits.any():
            allowed = "a target with free tissue above and below, for another depth"
            raise Refusal("inclusion.diameter", format_mm(body.diameter or 0.0), allowed)
        current = int(np.argmin(np.where(fits[:-1], np.abs(depths - body.depth), np.inf)))
        # the ends of the run of fitting depths about the current one; argmin gives the distance to the first that does not fit
        low, high = current - int(np.argmin(fits[current::-1])) + 1, current + int(np.argmin(fits[current:])) - 1
        return float(depths[low]), float(depths[high])

    def predict(self, target: dict[str, Floats], reflect: bool | None = None, by_diameter: bool = False) -> Predictions:
        """Predict the data for n bodies in the target's place.

        Parameters
        ----------
        target
            youngs_modulus, diameter, depth of shape (n,); missing ones are the scene's, n = 1 if all are missing.
        reflect
            Whether to model the reflections by surface and blocks for all bodies, or for none; default: where needed.
        by_diameter
            Whether to compute the derivative with respect to ln diameter, too.
        """
        predicted, are_phases = self._predict_with_ratios(target, reflect, by_diameter), self.data.is_phase
        if not are_phases.any():
            return predicted
        pairs = zip(self._turned_models, build_turned_bodies(self.scene, target), strict=True)
        stiffer, softer = (model._predict_with_ratios(bodies, reflect, by_diameter) for model, bodies in pairs)
        return insert_phases(predicted, stiffer, softer, are_phases, compute_angle_spread(self.scene))

    @cached_property
    def _turned_models(self) -> tuple[TargetModel, TargetModel]:
        """The models of the stiffer and of the softer scene of eq. ES.9, without losses."""
        stiffer, softer = (replace(self, scene=scene) for scene in build_turned_scenes(self.scene))
        return stiffer, softer

    def _predict_with_ratios(self, target: dict[str, Floats], reflect: bool | None, by_diameter: bool) -> Predictions:
        """Predict the data, with the logarithm of a ratio in the place of each phase."""
        n, data = len(next(iter(target.values()), [0])), self.data
        predicted = Predictions.empty(n, len(data.value))
        is_blank = data.is_blank | (not self.scene.inclusion)
        if is_blank.any():
            no_tumours = Tumours.from_scene(self.scene.model_copy(update={"inclusion": ()}))
            self._fill(predicted, np.flatnonzero(is_blank), self._blank_readings, no_tumours)
        if is_blank.all():
            return predicted
        tumours = self._build_tumours(self._distinct_places[0], n, target)
        self._fill(predicted, np.flatnonzero(~is_blank), self._compute_linear(tumours, reflect, by_diameter), tumours)
        return predicted

    def _fill(self, predicted: Predictions, columns: Ints, linear: Readings, tumours: Tumours) -> None:
        """Fill columns of predictions from linear readings over tumours, each at its place and load."""
        places, place_indices = self._distinct_places
        forces = self.data.force[columns]
        for force in np.unique(forces):  # NaN counts as one value
            film_readings = self._apply_load(linear, tumours, float(force))
            observable = film_readings.get_observable(self.scene)
            for k in columns[(forces == force) | (np.isnan(forces) & np.isnan(force))].tolist():
                # rows are ordered by body, then place: every len(places)-th row is the same place
                is_one = len(film_readings.bound) == 1
                rows = slice(None) if is_one else slice(int(place_indices[self.data.place[k]]), None, len(places))
                predicted.fill(k, film_readings, rows, self.data, observable)

    @cached_property
    def _blank_readings(self) -> Readings:
        """The linear readings over tumour-free tissue."""
        no_tumours = Tumours.from_scene(self.scene.model_copy(update={"inclusion": ()}))
        return self._compute_linear(no_tumours, reflect=False, by_diameter=False)

    @cached_property
    def _distinct_places(self) -> tuple[Floats, Ints]:
        """Distinct places, (q, 2), and for each place the index of the one that replaces it.

        Over a single body, places at the same distance from its axis count as one.
        """
        places = self.data.places
        if len(self.scene.inclusion) != 1:
            return places, np.arange(len(places))
        offset = np.round(np.hypot(*(places - [self.target.x, self.target.y]).T), 10)
        _, first, indices = np.unique(offset, return_index=True, return_inverse=True)
        return places[first], indices

    def _compute_linear(self, tumours: Tumours, reflect: bool | None, by_diameter: bool) -> Readings:
        """Return the linear readings over tumours to first order, with reflections where they may matter."""
        scene, index = self.scene, self.scene.target or 0
        film_readings = compute_readings(self.base, tumours, index, by_diameter, reflect=False)
        is_reflected = np.full(len(tumours.x), bool(reflect))
        if reflect is None:
            read, films = film_readings.get_observable(scene), self.base.films.get_observable(scene)
            is_reflected = read.first_share - films.bound.log_ratio > NEGLIGIBLE_REFLECTION * self.accuracy
        if is_reflected.any():
            reflected_readings = compute_readings(self.base, tumours.select(is_reflected), index, by_diameter, reflect=True)
            film_readings.store(is_reflected, reflected_readings)
        return film_readings

    def _apply_load(self, film_readings: Readings, tumours: Tumours, force: float) -> Readings:
        """Return linear readings over tumours pressed to a force, N, or to the scene's load for NaN.

        Linear readings remain what they are, with error bounds that count the effect of the load; there is no ratio where that
        effect is not known.
        """
        if self.pressing:
            return self._press(force).compute_readings(film_readings, tumours, self.scene.target or 0)
        scene = _replace_force(self.scene, force)
        # relative change c of the ratio by the load, which changes its logarithm by at most -ln(1 - c)
        changes = LoadChanges.from_stiffness(scene, self.rule, film_readings.stiffness).ratio
        charges = None if film_readings.charges is None else _add_load_changes(film_readings.charges, changes)
        return replace(_add_load_changes(film_readings, changes), charges=charges)

    def _build_tumours(self, places: Floats, n: int, target: dict[str, Floats]) -> Tumours:
        """Return the inclusions for n targets at each of p places, positions relative to the probe, shape (n p, inclusions).

        Parameters
        ----------
        places
            Of the probe's axis, m, shape (p, 2).
        n
            Number of targets.
        target
            New numbers of the target, by key, shape (n,).
        """
        keys = ("x", "y", "depth", "diameter", "youngs_modulus", "poisson_ratio")
        table = {key: np.array([[[getattr(body, key) for body in self.scene.inclusion]]], dtype=float) for key in keys}
        table = {key: np.tile(value, (n, len(places), 1)) for key, value in table.items()}
        for axis, key in enumerate("xy"):
            table[key] -= places[None, :, axis, None]
        for key, chosen in target.items():
            table[key][:, :, self.scene.target] = chosen[:, None]
        return Tumours(*(table[key].reshape(n * len(places), -1) for key in keys))


def _get_force(scene: Scene, force: float) -> float:
    """Return a reading's force, N, or that of the scene for NaN; 0 where the scene gives an indentation."""
    return (scene.load.force or 0.0) if np.isnan(force) else force


def _replace_force(scene: Scene, force: float) -> Scene:
    """Return the scene under a reading's force, N; unchanged for NaN."""
    return scene if np.isnan(force) else scene.model_copy(update={"load": Load(force=force)})


def _add_load_changes(readings: Readings, changes: Floats) -> Readings:
    """Return readings whose error bounds count relative changes by the load, shape (n,); no ratio where these are infinite."""
    finite_changes = np.where(np.isfinite(changes), changes, 0.0)
    return replace(
        readings,
        bound=readings.bound + finite_changes[:, None] * np.abs(readings.totals),
        log_ratio_bound=readings.log_ratio_bound + np.where(np.isfinite(changes), -np.log1p(-finite_changes), np.inf),
    )


def check_kind(scene: Scene, is_of_target: bool = True) -> None:
    """Raise ``Refusal`` or ``InputError`` where nothing can be estimated for a scene.

    ``is_of_target``: whether the unknown is a number of the target, otherwise of the tissue.
    """
    if is_of_target and not scene.inclusion:
        raise InputError("inclusion", Words("none"), "at least one inclusion, of which a number is to be estimated")
    if is_of_target and scene.target is None:
        raise InputError("inclusion.target", Words("none of several"), "target = true in the inclusion to be estimated")
    reason = EquivalentInclusion().refusal(scene)
    if reason is not None:
        raise Refusal("evaluator", EquivalentInclusion().name, reason)
    check_spheres(scene, "estimate")
