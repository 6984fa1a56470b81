"""The contact evaluator: press the probe to the scene's load at finite strain and with contact, on two meshes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
from threadpoolctl import threadpool_limits

from geometry.common.arrays import Floats
from geometry.common.errors import Refusal, SolveError, Words
from geometry.common.resources import LimitReached
from geometry.scenes.probe import mm
from geometry.scenes.scene import Contact, Scene
from solver.axisymmetric.level import Axisymmetric
from solver.contact.loaded import LoadedScene, curve
from solver.contact.pressed import Loaded, StoppedError
from solver.linalg.workspace import in_own_workspace
from solver.results.evaluator import Answer, FilmLevel, Tell
from solver.results.film_forces import FilmForces, shortfalls
from solver.results.result import Decision
from solver.results.warnings import Note, of_kind

FEATURE = "finite strain and contact"


@dataclass(frozen=True)
class ContactLevel(FilmLevel):
    """Evaluate with finite strain and contact in the meridian plane: any kind of faces, at most one sphere on the axis."""

    name: str = "contact"
    summary: str = "2D, finite strain, walls in contact; tumour on the probe's axis; 5e-3 to 2e-2 in 2 to 20 s"

    def refusal(self, scene: Scene) -> str | None:
        """Return the feature of the scene that this evaluator does not model, or None."""
        if scene.contact.interface != "bonded" and scene.tissue.shape == "half-space":
            return f"tissue of finite size for contact.interface = '{scene.contact.interface}' at finite strain"
        return Axisymmetric().refusal(scene.model_copy(update={"contact": Contact()}))

    def answer(self, scene: Scene, accuracy: float, moduli: Floats | None = None) -> Answer:
        """Evaluate a scene on two of three meshes, as fine as ``accuracy`` needs; see ``Evaluator``.

        The log-sensitivity is taken at the scene's force, or at the force of its indentation.

        Raises:
            Refusal: the scene is not supported or too extreme, or no step converges at its load.
        """
        return self.pressed_answer(scene, accuracy, moduli)[0]

    def pressed_answer(self, scene: Scene, accuracy: float, moduli: Floats | None = None) -> tuple[Answer, LoadedScene]:
        """Return the result and the pressed scene, which holds all states on the load path; see ``answer``."""
        with threadpool_limits(1, user_api="blas"), self._refusing(scene):
            found, on, notes = refined(self.pressed(scene, accuracy), lambda films: _good(films, scene, accuracy))
            answers = [found] if moduli is None else curve(on, np.asarray(moduli))
        return self._answer(scene, accuracy, on, answers, notes), on

    def loaded(self, scene: Scene, accuracy: float) -> LoadedScene:
        """Return a scene pressed to its load, to start similar scenes from; its log-sensitivity may miss the accuracy."""
        with threadpool_limits(1, user_api="blas"), self._refusing(scene):
            return refined(self.pressed(scene, accuracy), lambda films: films.error_under(scene) <= accuracy)[1]

    def answer_of(self, scene: Scene, accuracy: float, on: LoadedScene, found: Loaded) -> Answer:
        """Build the answer of one result of a pressed scene, with its warnings."""
        return self._answer(scene, accuracy, on, [found], ())

    @contextmanager
    def _refusing(self, scene: Scene) -> Iterator[None]:
        """Convert solver errors to refusals: the load is too large, or the scene is too extreme."""
        try:
            yield
        except StoppedError as fault:
            raise self.stopped(_key(scene), fault) from fault
        except SolveError as fault:
            raise self._extreme(fault) from fault

    def _answer(self, scene: Scene, accuracy: float, on: LoadedScene, answers: list[Loaded], limits: tuple[Note, ...]) -> Answer:
        films = tuple(one.films for one in answers)
        worst = max(films, key=lambda one: one.error_under(scene))
        change = float(np.exp(np.abs(_log_ratio(worst) - _log_ratio(on.linear.films[0]))) - 1)
        decision = Decision(FEATURE, True, change, accuracy, "their change of the ratio at this load")
        stopped = (*of_kind(on.linear.notes, "limit"), *limits)
        notes = shortfalls(worst, worst.error_under(scene), accuracy, stopped)
        residual = max(on.linear.sample.states.residual, *(one.point.residual for one in answers))
        return Answer(films, residual, (*on.linear.plan, decision), tuple(notes))

    def stopped(self, asked: tuple[str, object], fault: StoppedError) -> Refusal:
        """Build the refusal of a load, given as its key and value, that is larger than the solver reached."""
        key, value = asked
        if fault.last.indentation == 0:
            return Refusal(key, value, f"no load but 0 for {self.name}: {fault.why}")
        most = mm(fault.last.indentation) if "indentation" in key else Words(f"{fault.last.force:.3g} N")
        return Refusal(key, value, f"up to {most} for {self.name}: {fault.why}")

    def _extreme(self, fault: SolveError) -> Refusal:
        return Refusal("evaluator", self.name, f"scenes whose sizes and moduli lie closer together ({fault})")

    @in_own_workspace
    def pressed(self, scene: Scene, accuracy: float = 0.01) -> LoadedScene:
        """Prepare a scene at rest on two meshes, ready to be pressed.

        Raises:
            Refusal: the scene is not supported, or too extreme.
        """
        why = self.refusal(scene)
        if why is not None:
            raise Refusal("evaluator", self.name, why)
        try:
            return LoadedScene.of(scene, accuracy)
        except SolveError as fault:
            raise self._extreme(fault) from fault


def _key(scene: Scene) -> tuple[str, object]:
    """Return the key and the value of the scene's load."""
    if scene.load.indentation is not None:
        return "load.indentation", mm(scene.load.indentation)
    return "load.force", Words(f"{scene.load.force:g} N")


def _good(films: FilmForces, scene: Scene, accuracy: float) -> bool:
    """Return whether stresses, ratio and log-sensitivity are within their tolerances."""
    sensitive = films.sensitivity_error <= max(5 * accuracy * abs(films.log_sensitivity or 0.0), 1e-5)
    return films.error_under(scene) <= accuracy and sensitive


def _log_ratio(films: FilmForces) -> float:
    return float(np.log(np.abs(films.totals)) @ [1.0, -1.0])


def refined(on: LoadedScene, good: Callable[[FilmForces], bool]) -> tuple[Loaded, LoadedScene, tuple[Note, ...]]:
    """Press a scene to its load, on finer meshes until the result is accurate enough; a note names a limit that stopped this.

    Args:
        loaded: the scene at rest.
        is_accurate: whether film forces are accurate enough.

    Raises:
        Refusal, StoppedError, LimitReached: see ``LoadedScene.press_to_force``; on the first two meshes.
    """
    found = on.at_scene_s_load()
    while not good(found.films):
        try:
            finer = on.finer()
            if finer is None:
                break
            better = finer.at_scene_s_load()
        except SolveError:  # what the rougher meshes found stays an answer, with its own error
            break
        except LimitReached as fault:
            return found, on, (Note("limit", str(fault)),)
        on = finer
        found = better if better.films.bound.log_ratio < found.films.bound.log_ratio else found
    return found, on, ()


def level(tell: Tell | None = None) -> ContactLevel:
    """Return the evaluator; it does not report progress."""
    return ContactLevel()
