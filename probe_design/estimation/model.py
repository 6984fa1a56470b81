"""Predict the readings for many bodies in the target's place at once, by `equivalent-inclusion`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np

from geometry.common.arrays import Floats, Ints
from geometry.common.errors import InputError, Refusal, Words
from geometry.scenes.probe import Material, mm
from geometry.scenes.scene import Inclusion, Placement, Scene
from geometry.scenes.units import MODULUS
from geometry.scenes.variables import changed, values
from probe_design.estimation.phases import turned, turned_bodies, with_phases
from probe_design.estimation.predicted import Predicted
from probe_design.estimation.readings import Measurements
from probe_design.maps.target_grid import check_spheres
from solver.equivalent_inclusion.level import EquivalentInclusion
from solver.equivalent_inclusion.probe_on_tissue import Undisturbed
from solver.equivalent_inclusion.readings import Readings, readings
from solver.inclusions.tumours import Tumours
from solver.phase.losses import spread
from solver.planning.load_check import LoadChanges
from solver.planning.load_limits import load_rule
from solver.planning.loads import LoadRule

CLEAR = 0.995  # of the distance to surface, interfaces and neighbours: a body that touches these cannot be modelled
DEEP = 20.0  # tube radii, or times the scene's depth: largest depth searched where the tissue has no bottom
NEGLIGIBLE = 0.1  # of the accuracy: reflections that change the ratio by less are neglected
OF_TARGET = ("youngs_modulus", "diameter", "depth")  # unknowns of the target; other unknowns are the tissue's
TIMES = 8.0  # times the scene's value, upwards and downwards: search range of a number of the tissue


@dataclass(frozen=True)
class TargetModel:
    """A scene whose target is replaced by bodies of other modulus, diameter or depth.

    Attributes:
        scene: with a target.
        data: measured values and their places.
        accuracy: relative, required of the evaluator.
    """

    scene: Scene
    data: Measurements
    accuracy: float

    @property
    def target(self) -> Inclusion:
        """The inclusion whose number is unknown."""
        assert self.scene.target is not None  # see check_kind
        return self.scene.inclusion[self.scene.target]

    @property
    def host(self) -> Material:
        """The material around the target, which stays in its layer."""
        return self.scene.tissue.material_at(self.target.depth)

    @property
    def others(self) -> list[Inclusion]:
        """All inclusions but the target."""
        return [body for index, body in enumerate(self.scene.inclusion) if index != self.scene.target]

    def changed(self, new: Mapping[str, float]) -> TargetModel:
        """Return the model of a scene with other numbers; see ``geometry.scenes.variables.changed``."""
        return replace(self, scene=changed(self.scene, new))

    @cached_property
    def base(self) -> Undisturbed:
        """The probe on tissue without tumours; its bounds are those of the place farthest from the tissue's middle."""
        far = np.abs(self.data.places).max(axis=0)
        if self.scene.tissue.shape == "cylinder":
            far = np.array([np.hypot(*self.data.places.T).max(), 0.0])
        scene = self.scene.model_copy(update={"placement": Placement(x=float(far[0]), y=float(far[1]))})
        return EquivalentInclusion().prepared(scene, self.accuracy)

    @cached_property
    def rule(self) -> LoadRule:
        """The limits of the scene's load, from the stiffness without tumours."""
        return load_rule(self.scene)

    @property
    def tolerance(self) -> float:
        """Relative change of the ratio by the load that needs no other model: the smallest noise of the ratio, at most 0.9."""
        return min(float(self.data.noise[self.data.is_ratio].min()), 0.9)

    @property
    def stiffness_error(self) -> float:
        """Bound on the relative error of the stiffness without tumours."""
        return self.base.films.stiffness_error

    def room(self, depth: Floats) -> Floats:
        """Return the largest diameter that fits in the target's place at depths of shape (n,), m."""
        at, tissue = self.target, self.scene.tissue
        free = np.asarray(depth, dtype=float)
        if tissue.shape == "cylinder":
            free = np.minimum(free, tissue.radius - np.hypot(at.x, at.y))
        elif tissue.shape == "block":
            free = np.minimum(free, min(tissue.length / 2 - abs(at.x), tissue.breadth / 2 - abs(at.y)))
        if tissue.shape != "half-space":
            free = np.minimum(free, tissue.depth - depth)
        for interface in tissue.interfaces:
            free = np.minimum(free, np.abs(interface - np.asarray(depth)))
        for other in self.others:
            apart = np.sqrt((other.x - at.x) ** 2 + (other.y - at.y) ** 2 + (other.depth - depth) ** 2)
            free = np.minimum(free, apart - (other.diameter or 0.0) / 2)
        return np.asarray(2 * free * CLEAR)

    def span(self, unknown: str) -> tuple[float, float]:
        """Return lower and upper end of the search range of the unknown, SI.

        Moduli from 1e-3 to 1e6 times that of the tissue around the target; diameters from 1/100 of the largest that fits; depths
        between which the target fits, without passing through another inclusion or an interface; numbers of the tissue from 1/8
        to 8 times the scene's.

        Raises:
            Refusal: the target fits at one depth only.
        """
        if unknown not in OF_TARGET:
            here = values(self.scene)[unknown]
            return here / TIMES, here * TIMES
        body, tissue = self.target, self.scene.tissue
        if unknown == "youngs_modulus":
            E = self.host.youngs_modulus
            return max(1e-3 * E, MODULUS.low), min(1e6 * E, MODULUS.high)
        if unknown == "diameter":
            most = float(self.room(np.array([body.depth]))[0])
            return most / 100, most
        deepest = tissue.depth if tissue.shape != "half-space" else DEEP * max(self.scene.probe.tube_radius, body.depth)
        depths = np.linspace(0.0, deepest, 20_001)
        fits = np.append(self.room(depths) >= (body.diameter or 0.0), False)
        if not fits.any():
            raise Refusal("inclusion.diameter", mm(body.diameter or 0.0), "a target with room above and below for another depth")
        here = int(np.argmin(np.where(fits[:-1], np.abs(depths - body.depth), np.inf)))
        low, high = here - int(np.argmin(fits[here::-1])) + 1, here + int(np.argmin(fits[here:])) - 1
        return float(depths[low]), float(depths[high])

    def predict(self, target: dict[str, Floats], reflect: bool | None = None, by_diameter: bool = False) -> Predicted:
        """Predict the data for n bodies in the target's place.

        Args:
            target: youngs_modulus, diameter, depth of shape (n,); missing ones are the scene's, n = 1 if all are missing.
            reflect: whether to model the reflections by surface and blocks for all bodies, or for none; default: where needed.
            by_diameter: whether to compute the derivative by the diameter, too.
        """
        found, are_phases = self._predicted(target, reflect, by_diameter), self.data.is_phase
        if not are_phases.any():
            return found
        pairs = zip(self._turned, turned_bodies(self.scene, target), strict=True)
        above, below = (model._predicted(bodies, reflect, by_diameter) for model, bodies in pairs)
        return with_phases(found, above, below, are_phases, spread(self.scene))

    @cached_property
    def _turned(self) -> tuple[TargetModel, TargetModel]:
        """The stiffer and the softer model of eq. ES.9."""
        above, below = (replace(self, scene=scene) for scene in turned(self.scene))
        return above, below

    def _predicted(self, target: dict[str, Floats], reflect: bool | None, by_diameter: bool) -> Predicted:
        """Predict the data, with the logarithm of a ratio in the place of each phase."""
        n, of = len(next(iter(target.values()), [0])), self.data
        out = Predicted.empty(n, len(of.value))
        bare = of.is_blank | (not self.scene.inclusion)
        for k in np.flatnonzero(bare):
            out.fill(int(k), self._bare, slice(None), of)
        if bare.all():
            return out
        seen, alike = self._alike
        answers = self._readings(self._tumours(seen, n, target), reflect, by_diameter)
        for k in np.flatnonzero(~bare):
            out.fill(int(k), answers, slice(int(alike[of.place[k]]), None, len(seen)), of)
        return out

    @cached_property
    def _bare(self) -> Readings:
        """The readings over tumour-free tissue."""
        none = Tumours.of(self.scene.model_copy(update={"inclusion": ()}))
        return self._readings(none, reflect=False, by_diameter=False)

    @cached_property
    def _alike(self) -> tuple[Floats, Ints]:
        """Distinct places, (q, 2), and the index of the one that replaces each place; of one body only the distance matters."""
        places = self.data.places
        if len(self.scene.inclusion) > 1:
            return places, np.arange(len(places))
        offset = np.round(np.hypot(*(places - [self.target.x, self.target.y]).T), 10)
        _, first, alike = np.unique(offset, return_index=True, return_inverse=True)
        return places[first], alike

    def _readings(self, tumours: Tumours, reflect: bool | None, by_diameter: bool) -> Readings:
        """Return first-order readings, with reflections where they may matter; they change smoothly along an unknown.

        The error bounds count the effect of the load; there is no ratio where that effect is not known.
        """
        scene = self.scene
        answers = readings(self.base, tumours, scene.target or 0, by_diameter, reflect=False)
        reflected = np.full(len(tumours.x), bool(reflect))
        if reflect is None:
            reflected = answers.first_share - self.base.films.bound.log_ratio > NEGLIGIBLE * self.accuracy
        if reflected.any():
            better = readings(self.base, tumours.of_index(reflected), scene.target or 0, by_diameter, reflect=True)
            for field in fields(answers):
                if field.name not in ("areas", "by"):
                    getattr(answers, field.name)[reflected] = getattr(better, field.name)
            for key, values in answers.by.items():
                values[reflected] = better.by[key]
        changes = LoadChanges.of(scene, self.rule, answers.stiffness).ratio
        small = np.where(np.isfinite(changes), changes, 0.0)
        return replace(
            answers,
            bound=answers.bound + small[:, None] * np.abs(answers.totals),
            log_ratio_bound=answers.log_ratio_bound + np.where(np.isfinite(changes), -np.log1p(-small), np.inf),
        )

    def _tumours(self, places: Floats, n: int, target: dict[str, Floats]) -> Tumours:
        """Return the inclusions with n targets, relative to some places of the probe, shape (n times places, inclusions)."""
        keys = ("x", "y", "depth", "diameter", "youngs_modulus", "poisson_ratio")
        table = {key: np.array([[[getattr(body, key) for body in self.scene.inclusion]]], dtype=float) for key in keys}
        table = {key: np.tile(value, (n, len(places), 1)) for key, value in table.items()}
        for axis, key in enumerate("xy"):
            table[key] -= places[None, :, axis, None]
        for key, chosen in target.items():
            table[key][:, :, self.scene.target] = chosen[:, None]
        return Tumours(*(table[key].reshape(n * len(places), -1) for key in keys))


def check_kind(scene: Scene, of_target: bool = True) -> None:
    """Raise ``Refusal`` or ``InputError`` where nothing can be estimated for a scene; ``is_of_target``: of its target."""
    if of_target and not scene.inclusion:
        raise InputError("inclusion", Words("none"), "at least one inclusion, of which a number is to be estimated")
    if of_target and scene.target is None:
        raise InputError("inclusion.target", Words("none of several"), "target = true in the inclusion to be estimated")
    why = EquivalentInclusion().refusal(scene)
    if why is not None:
        raise Refusal("evaluator", EquivalentInclusion().name, why)
    check_spheres(scene, "estimate")
