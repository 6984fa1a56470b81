"""Solve scenes under load with tumours off the axis, several tumours or ellipsoids; see ``pressed_tissue.py``."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import log
from typing import NoReturn

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import Refusal, Words
from geometry.common.limits import format_maximum
from geometry.meridian.mesh_lines import MeridianFineness
from geometry.scenes.probe import format_mm
from geometry.scenes.scene import Scene
from solver.contact.limits import CLOSED_GAP_RELATIVE
from solver.contact.loaded_scene import SMALL_INDENTATION_RELATIVE, LoadedScene, build_path
from solver.contact.path import Path
from solver.contact.preloaded_tissue import STEP_RELATIVE, PreloadedTissue
from solver.contact.pressed_tissue import PressedTissue
from solver.contact.states import PathPoint, StoppedError
from solver.equivalent_inclusion.evaluator import EquivalentInclusion, build_film_forces
from solver.equivalent_inclusion.probe_on_tissue import Undisturbed, remove_tumours, solve_undisturbed
from solver.equivalent_inclusion.readings import Readings
from solver.inclusions.tumours import Tumours
from solver.linalg.workspace import keep_within_limits
from solver.results.evaluator import FilmSolution
from solver.results.film_forces import FilmForces, find_shortfalls
from solver.results.load_limits import describe_load
from solver.results.result import Decision

# order 4 on few cells, order 2 on twice as many each way: the latter was within 0.1 % of finer ones, and their contact differs.
# A third mesh, order 3, had larger bounds at all 12 loads of four scenes, and stopped where these two still converge
TISSUE_FINENESSES = MeridianFineness(1, 0, 4), MeridianFineness(2, 0, 2)
LIGHT_FINENESS = MeridianFineness(1, 0, 2)  # on which loads that are far too large are refused, in a fifth of the time
LIGHT_MARGIN = 0.01  # relative, of the largest force on that mesh: within 0.2 % on three example scenes
LINEAR_SHARE = 0.3  # of the accuracy, for the linear readings
DECISION_FEATURE = "finite strain and contact"
SHAPE_ERROR_FACTOR = 2.0  # of what the load adds, times ln of an ellipsoid's aspect ratio: it counts as the sphere of its volume
LAST_CONVERGED_SHARE = 0.9  # of the last load at which a step converges, or the gap is open: other meshes end elsewhere
MAX_X = 0.66  # outer radii, without tumours: the forces of the deepest rows of tests/reference/loaded, at 0.64 on their meshes
SEARCHED_X = 0.47  # likewise, up to which designs are searched


@dataclass(frozen=True)
class TissueUnderLoad:
    """A probe on tissue without tumours, linearly and on load paths of two meshes, to be pressed to any number of loads.

    Attributes
    ----------
    base
        The linear solution.
    loaded
        The load paths.
    """

    base: Undisturbed
    loaded: LoadedScene

    @cached_property
    def _denser(self) -> LoadedScene | None:
        """The load paths with more contact points, see ``LoadedScene.add_contact_points``; None where there are none."""
        return self.loaded.add_contact_points()

    def is_light(self, indentation: float) -> bool:
        """Return whether an indentation, m, is so small that the linear limit holds."""
        return indentation <= SMALL_INDENTATION_RELATIVE * self.loaded.paths[0].unit

    def press(self, force: float, load_entry: tuple[str, object] | None = None) -> PressedTissue:
        """Press to a force, N, that is not light.

        ``load_entry`` is the key of the load in the scene, or its name, and its value; by default the force.

        Raises
        ------
        Refusal
            The force indents the tissue deeper than is known, or closes the gap.
        StoppedError
            No further step converges.
        """
        key, value = load_entry or ("load.force", Words(f"{force:g} N"))
        self._check_depth(force, key, value)
        self._check_gap(force, key, value)  # before a finer mesh is pressed, which takes long where walls touch
        pressed = self._press_paths(force)
        if self._is_closed(pressed.bare.point):
            self._refuse_closed_gap(key, value)
        return pressed

    def press_beside(self, preload: float) -> PreloadedTissue:
        """Press to a preload, N, that is not light, ready for tangent responses; for errors see ``press``."""
        entry = "load.preload", Words(f"{preload:g} N")
        self._check_depth((1 + STEP_RELATIVE) * preload, *entry, margin=1 + STEP_RELATIVE)
        return PreloadedTissue.from_pressed(self.press(preload, entry), preload)

    def find_largest_load(self, force: float, indentation: float) -> tuple[float, str]:
        """Return the largest load, N, up to a force, N, and an indentation, m, both without tumours, and what limits it.

        The limit is "force", "indentation", "contact" (``SEARCHED_X``), "gap_closure", or "last_converged", where no further step
        converges: 0.9 of the last force at which one does.
        """
        path = self.loaded.paths[0]
        deepest, name = min((indentation, "indentation"), (SEARCHED_X * path.radius, "contact"))
        min_gap, reached = CLOSED_GAP_RELATIVE * path.points[0].walls, path.points[0]
        try:
            while path.last.indentation < deepest * (1 - 1e-12) and path.last.force < force and path.last.walls > min_gap:
                next(path.iterate_steps(deepest))
        except StoppedError as fault:
            name, deepest = "last_converged", LAST_CONVERGED_SHARE * fault.last.indentation
        for point in path.points:
            if point.walls <= min_gap:
                return LAST_CONVERGED_SHARE * reached.force, "gap_closure"
            if point.indentation > deepest * (1 + 1e-9):
                break
            reached = point
        if reached.force >= force:
            return force, "force"
        limit = path.press_to_indentation(deepest).force
        return (force, "force") if limit >= force else (limit, name)

    def _press_paths(self, force: float) -> PressedTissue:
        """Press the load paths to a force, N: with more contact points where no step converges."""
        try:
            return PressedTissue.from_loaded(self.base, self.loaded, force)
        except StoppedError:
            if self._denser is None:
                raise
            return PressedTissue.from_loaded(self.base, self._denser, force)

    def press_to_indentation(self, indentation: float) -> float:
        """Return the force at an indentation without tumours, N."""
        if indentation > MAX_X * self.loaded.paths[0].radius:
            self._refuse_depth("load.indentation", format_mm(indentation), 0.0)  # names an indentation, not a force
        return self.loaded.press_to_indentation(indentation).point.force

    def _check_depth(self, force: float, key: str, value: object, margin: float = 1.0) -> None:
        """Refuse a force, N, that indents deeper than ``MAX_X``; ``margin`` is what it is more than what is asked for."""
        path = self.loaded.paths[0]
        deepest = MAX_X * path.radius
        if path.reaches(force) or any(map(self._is_closed, path.points)):
            return
        light_limit = self._light_limit if force > deepest * float(path.points[0].tangent.sum()) else None
        if light_limit is not None and force > (1 + LIGHT_MARGIN) * light_limit:
            self._refuse_depth(key, value, (1 - LIGHT_MARGIN) * light_limit / margin)
        if any(self._is_closed(point) for point in path.iterate_steps(deepest, force)) or path.reaches(force):
            return
        self._refuse_depth(key, value, max(p.force for p in path.points if p.indentation <= deepest * (1 + 1e-9)) / margin)

    @cached_property
    def _light_limit(self) -> float | None:
        """The force, N, at the largest indentation on the light mesh; None where the gap closes before or no step converges."""
        path: Path = build_path(self.loaded.scene, self.loaded.linear, LIGHT_FINENESS)
        try:
            point = path.press_to_indentation(MAX_X * path.radius)
        except StoppedError:
            return None
        return None if any(map(self._is_closed, path.points)) else point.force

    def _refuse_depth(self, key: str, value: object, force: float) -> NoReturn:
        """Refuse a load, with the largest: a force, N, or ``MAX_X``."""
        limit = _format_limit(key, force, MAX_X * self.loaded.paths[0].radius)
        reason = f"what load does to tumours off the axis is known up to an indentation of {MAX_X:g} outer radii"
        raise Refusal(key, value, f"up to {limit} for contact: {reason}")

    def _is_closed(self, point: PathPoint) -> bool:
        """Return whether the gap's walls touch at a point of a load path."""
        return point.walls <= CLOSED_GAP_RELATIVE * self.loaded.paths[0].points[0].walls

    def _check_gap(self, force: float, key: str, value: object) -> None:
        """Refuse a force, N, under which the gap is closed on the coarser mesh, as far as that is pressed."""
        if any(self._is_closed(point) and point.force <= force for point in self.loaded.paths[0].points):
            self._refuse_closed_gap(key, value)

    def _refuse_closed_gap(self, key: str, value: object) -> NoReturn:
        """Refuse a load that closes the gap, with the largest that does not on the coarser mesh."""
        point = [point for point in self.loaded.paths[0].points if not self._is_closed(point)][-1]
        limit = _format_limit(key, point.force, point.indentation)
        raise Refusal(key, value, f"up to {limit} for contact: tumours off the axis are not modelled once the gap is closed")


def _format_limit(key: str, force: float, indentation: float) -> str:
    """Format the largest load in the unit of a load's key."""
    return f"{format_maximum(1e3 * indentation, 3)} mm" if "indentation" in key else f"{format_maximum(force, 3)} N"


@keep_within_limits
def _load_tissue(scene: Scene, accuracy: float) -> LoadedScene:
    """Return the load paths, at rest, of a scene without tumours and load."""
    return LoadedScene.from_scene(scene, accuracy, TISSUE_FINENESSES)


def prepare_tissue(scene: Scene, accuracy: float) -> TissueUnderLoad:
    """Prepare a scene's probe and tissue to be pressed; what is common to scenes that differ in tumours and load is cached.

    Raises
    ------
    Refusal
        Scenes so extreme that their equations cannot be solved in double precision.
    SolveError, LimitReached
        See ``LoadedScene.from_scene``.
    """
    return TissueUnderLoad(solve_undisturbed(scene, LINEAR_SHARE * accuracy), _load_tissue(remove_tumours(scene), accuracy))


@dataclass(frozen=True)
class TumoursUnderLoad:
    """A scene with spheres or ellipsoids anywhere, to be pressed to any number of loads.

    Attributes
    ----------
    tissue
        Probe and tissue without them.
    scene
        The scene; its load does not matter.
    solution, readings
        The linear solution and readings, for each modulus of the target.
    tumours
        Spheres for each modulus, arrays of shape (n, inclusions).
    """

    tissue: TissueUnderLoad
    scene: Scene
    solution: FilmSolution
    readings: Readings
    tumours: Tumours

    @classmethod
    def from_scene(cls, scene: Scene, accuracy: float, moduli: Floats | None = None) -> TumoursUnderLoad:
        """Solve a scene linearly, for each of several moduli of its target, Pa, or for its own; see ``prepare_tissue``."""
        tissue = prepare_tissue(scene, accuracy)
        solution, readings = EquivalentInclusion().solve_readings(tissue.base, scene, accuracy, moduli)
        spheres = Tumours.from_scene(scene)
        tumours = spheres if moduli is None else spheres.with_moduli(moduli, scene.target or 0)
        return cls(tissue, scene, solution, readings, tumours)

    def convert_to_force(self, indentation: float, load_entry: tuple[str, object] | None = None) -> float:
        """Return the force, N, at an indentation, m: one that is not light takes what the tumours raise the force there."""
        if self.tissue.is_light(indentation):
            return indentation * float(self.readings.stiffness.min())
        bare_force = self.tissue.press_to_indentation(indentation)
        changes = self.tissue.press(bare_force, load_entry).compute_changes(self.readings, self.tumours, self.scene.target or 0)
        return bare_force * float(np.exp(changes.changes[0, 0, -1]))

    def is_light(self, force: float) -> bool:
        """Return whether a force, N, is so small that the linear limit holds."""
        return self.tissue.is_light(force / float(self.readings.stiffness.min()))

    def press(self, force: float, load_entry: tuple[str, object] | None = None) -> tuple[PressedTissue, tuple[FilmForces, ...]]:
        """Press to a force, N, that is not light; return the state without tumours, and film forces for each modulus.

        For the parameters and errors see ``TissueUnderLoad.press``.
        """
        pressed = self.tissue.press(force, load_entry)
        return pressed, self._read(pressed)

    def press_beside(self, preload: float) -> tuple[PreloadedTissue, tuple[FilmForces, ...]]:
        """Press to a preload, N, that is not light; return the same of the tangent response, see ``press``."""
        preloaded = self.tissue.press_beside(preload)
        return preloaded, self._read(preloaded)

    def _read(self, pressed: PressedTissue | PreloadedTissue) -> tuple[FilmForces, ...]:
        """Return the film forces for each modulus under a load."""
        scene = self.scene
        longest = max((max(body.diameters) / min(body.diameters) for body in scene.inclusion if body.diameters), default=1.0)
        shape_error = min(1.0, SHAPE_ERROR_FACTOR * log(longest))
        loaded = pressed.compute_readings(self.readings, self.tumours, scene.target or 0, shape_error=shape_error)
        return tuple(build_film_forces(loaded, k, scene.target is not None) for k in range(len(loaded.forces)))


def solve_tumours(scene: Scene, accuracy: float, moduli: Floats | None = None) -> FilmSolution:
    """Solve a scene with spheres or ellipsoids anywhere under its load; see ``ContactEvaluator.solve``.

    Raises
    ------
    Refusal
        The load is larger than is known, or the scene of a kind that ``equivalent-inclusion`` refuses.
    StoppedError
        No further step converges.
    """
    under_load, load = TumoursUnderLoad.from_scene(scene, accuracy, moduli), scene.load
    force = load.preload or load.force or 0.0
    solution, entry = under_load.solution, describe_load(scene)
    if load.indentation is not None:
        force = under_load.convert_to_force(load.indentation, entry)
    if under_load.is_light(force):
        return solution
    pressed, films = under_load.press_beside(force) if load.preload else under_load.press(force, entry)
    number = max(range(len(films)), key=lambda k: films[k].compute_max_error(scene))
    worst = films[number]
    residual = max(solution.residual or 0.0, pressed.bare.point.residual)
    decision, base = build_decision(scene, worst, solution.films[number], accuracy), under_load.tissue.base
    notes = (*base.notes, *find_shortfalls(worst, worst.compute_max_error(scene), accuracy, base.stopped))
    return FilmSolution(films, residual, (*solution.plan, decision), notes)


def build_decision(scene: Scene, films: FilmForces, linear: FilmForces, accuracy: float) -> Decision:
    """Build the decision on finite strain and contact from their relative change of the ratio that is read."""
    inner, outer = np.log(np.abs(films.get_observable(scene).totals / linear.get_observable(scene).totals))
    effect = float(np.expm1(abs(inner - outer)))
    return Decision(DECISION_FEATURE, True, effect, accuracy, f"their change of the ratio of {scene.load.response}")
