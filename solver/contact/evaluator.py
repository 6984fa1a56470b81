"""Evaluator ``contact``: press the probe to the scene's load at finite strain and with contact, on two meshes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import Refusal, SolveError, Words
from geometry.common.resources import LimitReached
from geometry.scenes.probe import format_mm
from geometry.scenes.scene import Scene
from geometry.scenes.scene_tables import Contact
from solver.axisymmetric.evaluator import Axisymmetric
from solver.contact.law_ranges import list_range_notes
from solver.contact.loaded_scene import LoadedForces, LoadedScene, compute_modulus_curve, press_with_enough_points
from solver.contact.preloaded_tissue import PreloadedTissue
from solver.contact.pressed_tissue import PressedTissue
from solver.contact.states import StoppedError
from solver.contact.tumours_anywhere import build_decision, prepare_tissue, solve_tumours
from solver.equivalent_inclusion.evaluator import EquivalentInclusion
from solver.linalg.threads import limit_to_one_thread
from solver.linalg.workspace import use_own_workspace
from solver.results.evaluator import FilmEvaluator, FilmSolution, ProgressCallback
from solver.results.film_forces import FilmForces, find_shortfalls
from solver.results.load_limits import describe_load
from solver.results.refusals import is_round
from solver.results.warnings import Note, select_notes

ONE_SPHERE = "at most one inclusion, a sphere on the axis of an upright probe"  # what is part of the mesh


@dataclass(frozen=True)
class ContactEvaluator(FilmEvaluator):
    """Evaluate with finite strain and contact in the meridian plane.

    At most one sphere on the axis is part of the mesh, under any kind of faces. Others, off the axis or several, act by what the
    load changes of their first-order effects; faces are then bonded.
    """

    name: str = "contact"
    summary: str = "2D, finite strain, walls in contact; tumours anywhere; 5e-3 to 2e-2 in 2 to 20 s"

    def refusal(self, scene: Scene) -> str | None:
        """Return the reason for a refusal, a feature of the scene that this evaluator does not model, or None."""
        return self.refusal_of_mesh(scene) if is_round(scene) else self.refusal_off_axis(scene)

    def refusal_off_axis(self, scene: Scene) -> str | None:
        """Return the reason why tumours cannot act by their first-order effects under load, wherever they are, or None."""
        # meshes without a sphere are too coarse for faces that slide: no step converges beyond small loads
        if scene.contact.interface != "bonded" or scene.contact.edge_radius > 0:
            return f"{ONE_SPHERE} where faces slide or open, or edges are round"
        return EquivalentInclusion().refusal(scene)

    def refusal_of_mesh(self, scene: Scene) -> str | None:
        """Return the reason why the scene's tumour cannot be part of the mesh, or None."""
        if not is_round(scene):
            return ONE_SPHERE
        if scene.contact.interface != "bonded" and scene.tissue.shape == "half-space":
            return f"tissue of finite size for contact.interface = '{scene.contact.interface}' at finite strain"
        return Axisymmetric().refusal(scene.model_copy(update={"contact": Contact()}))

    def solve(self, scene: Scene, accuracy: float, moduli: Floats | None = None) -> FilmSolution:
        """Evaluate a scene on two of three meshes, as fine as ``accuracy`` needs; see ``Evaluator``.

        The log-sensitivity is taken at the scene's force, or at the force of its indentation.

        Raises
        ------
        Refusal
            The scene is not supported or too extreme, or no step converges at its load.
        """
        with limit_to_one_thread(), self._convert_errors(scene):
            if not is_round(scene):
                self.check(scene)
                return solve_tumours(scene, accuracy, moduli)
            result, loaded, notes = press_refined(
                self.prepare_scene(scene, accuracy), lambda films: _is_accurate(films, scene, accuracy)
            )
            results = [result] if moduli is None else compute_modulus_curve(loaded, np.asarray(moduli))
        return self.build_solution(scene, accuracy, loaded, results, notes)

    def load_scene(self, scene: Scene, accuracy: float) -> LoadedScene:
        """Return a scene pressed to its load, from which similar scenes can start; its log-sensitivity may miss the accuracy."""
        with limit_to_one_thread(), self._convert_errors(scene):
            return press_refined(self.prepare_scene(scene, accuracy), lambda films: films.compute_max_error(scene) <= accuracy)[1]

    def check(self, scene: Scene) -> None:
        """Raise ``Refusal`` for a scene that is not supported."""
        reason = self.refusal(scene)
        if reason is not None:
            raise Refusal("evaluator", self.name, reason)

    @use_own_workspace
    def press_tissue(self, scene: Scene, accuracy: float) -> PressedTissue | PreloadedTissue:
        """Press a scene's probe on its tissue without tumours to its force or preload, ready for tumours anywhere.

        Raises
        ------
        Refusal
            The scene is not supported or too extreme, its load is an indentation, or it is larger than is known.
        """
        reason = self.refusal_off_axis(scene)
        if reason is not None:
            raise Refusal("evaluator", self.name, reason)
        if scene.load.force is None:
            raise Refusal(*describe_load(scene), "load.force in its place, where contact reads many tumours or positions")
        with limit_to_one_thread(), self._convert_errors(scene):
            tissue = prepare_tissue(scene, accuracy)
            return tissue.press_beside(scene.load.preload) if scene.load.preload else tissue.press(scene.load.force)

    @contextmanager
    def _convert_errors(self, scene: Scene) -> Iterator[None]:
        """Convert solver errors to refusals: the load is too large, or the scene is too extreme."""
        try:
            yield
        except StoppedError as fault:
            raise self.build_stop_refusal(describe_load(scene), fault, scene.contact.interface) from fault
        except SolveError as fault:
            raise self._build_extreme_refusal(fault) from fault

    def build_solution(
        self, scene: Scene, accuracy: float, loaded: LoadedScene, results: list[LoadedForces], limits: tuple[Note, ...] = ()
    ) -> FilmSolution:
        """Build the solution from the results of a pressed scene.

        Parameters
        ----------
        scene, accuracy
            The scene and the requested relative accuracy.
        loaded
            The pressed scene.
        results
            Film forces for each modulus of the target, or one for the scene's own.
        limits
            Notes that name the limits of memory or time that kept the mesh from being finer.
        """
        films = tuple(result.films for result in results)
        worst = max(films, key=lambda result: result.compute_max_error(scene))
        decision = build_decision(scene, worst, loaded.linear.films[0], accuracy)
        stopped = (*select_notes(loaded.linear.notes, "limit"), *limits)
        notes = find_shortfalls(worst, worst.compute_max_error(scene), accuracy, stopped)
        state, model = results[0].point.equilibrium.state, loaded.paths[1].model
        if len(state.elements.u) == len(model.mesh.body):  # the point of a coarser mesh was the more accurate one
            notes = [*notes, *list_range_notes(scene, model, state)]
        residual = max(loaded.linear.sample.states.residual, *(result.point.residual for result in results))
        return FilmSolution(films, residual, (*loaded.linear.plan, decision), tuple(notes))

    def build_stop_refusal(self, load_entry: tuple[str, object], fault: StoppedError, interface: str = "bonded") -> Refusal:
        """Build the refusal of a load beyond which no step converges.

        Parameters
        ----------
        load_entry
            The load's key in the scene, or its name, and its value.
        fault
            The error, with the last point that was reached.
        interface
            That of the scene: faces that slide or open converge less far than bonded ones.
        """
        key, value = load_entry
        if fault.last.indentation == 0:
            return Refusal(key, value, f"no load but 0 for {self.name}: {fault.reason}")
        limit = format_mm(fault.last.indentation) if "indentation" in key else Words(f"{fault.last.force:.3g} N")
        remedy = "" if interface == "bonded" else ", or contact.interface = 'bonded', which mostly converges further"
        return Refusal(key, value, f"up to {limit} for {self.name}: {fault.reason}{remedy}")

    def _build_extreme_refusal(self, fault: SolveError) -> Refusal:
        """Build the refusal of a scene whose equations cannot be solved."""
        return Refusal("evaluator", self.name, f"scenes whose sizes and moduli lie closer together ({fault})")

    @use_own_workspace
    def prepare_scene(self, scene: Scene, accuracy: float = 0.01) -> LoadedScene:
        """Prepare a scene at rest on two meshes, ready to be pressed.

        Raises
        ------
        Refusal
            The scene is not supported, or too extreme.
        """
        reason = self.refusal_of_mesh(scene)
        if reason is not None:
            raise Refusal("evaluator", self.name, reason)
        try:
            return LoadedScene.from_scene(scene, accuracy)
        except SolveError as fault:
            raise self._build_extreme_refusal(fault) from fault


def _is_accurate(films: FilmForces, scene: Scene, accuracy: float) -> bool:
    """Return whether stresses, ratio and log-sensitivity, those of charges included if they are read, are within tolerances."""
    read = films.get_observable(scene)
    return films.compute_max_error(scene) <= accuracy and films.meets_sensitivity(accuracy) and read.meets_sensitivity(accuracy)


def press_refined(
    loaded: LoadedScene, is_accurate: Callable[[FilmForces], bool]
) -> tuple[LoadedForces, LoadedScene, tuple[Note, ...]]:
    """Press a scene to its load, on finer and finer meshes until the result is accurate enough.

    Returns the most accurate result, the scene on the finest meshes that were pressed, and a note that names the limit of memory
    or time that stopped the refinement, if one did.

    Parameters
    ----------
    loaded
        The scene at rest.
    is_accurate
        Function that returns whether film forces are accurate enough.

    Raises
    ------
    Refusal, StoppedError, LimitReached
        See ``LoadedScene.press_to_force``; on the first two meshes.
    """
    result, loaded = press_with_enough_points(loaded, LoadedScene.press_to_scene_load)
    while not is_accurate(result.films):
        try:
            finer = loaded.refine()
            if finer is None:
                break
            better = finer.press_to_scene_load()
        except SolveError:  # the result of the coarser meshes remains valid, with its own error
            break
        except LimitReached as fault:
            return result, loaded, (Note("limit", str(fault)),)
        loaded = finer
        errors = [forces.films.get_observable(loaded.scene).bound.log_ratio for forces in (result, better)]
        result = better if errors[1] < errors[0] else result
    return result, loaded, ()


def create_evaluator(progress: ProgressCallback | None = None) -> ContactEvaluator:
    """Return the evaluator; it does not report progress."""
    return ContactEvaluator()
