"""Level 4: the probe pressed as deep as its load says, at finite strain and with contact, on two meshes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from threadpoolctl import threadpool_limits

from geometry.common.arrays import Floats
from geometry.common.errors import Refusal, SolveError, Words
from geometry.scenes.probe import mm
from geometry.scenes.scene import Scene
from solver.axisymmetric.level import Axisymmetric
from solver.axisymmetric.refinement import LEVELS
from solver.axisymmetric.sample import sample
from solver.axisymmetric.sections import sections
from solver.contact.loaded import Loaded, LoadedScene, curve, loaded
from solver.contact.pressed import StoppedError
from solver.linalg.workspace import in_own_workspace
from solver.results.evaluator import Answer, FilmLevel, Tell
from solver.results.film_forces import FilmForces, shortfalls
from solver.results.result import Decision

FEATURE = "finite strain and contact"
FAR_TOO_DEEP = 3.0  # outer radii, by the linear stiffness


@dataclass(frozen=True)
class ContactLevel(FilmLevel):
    """Finite strain and contact in the meridian plane: bonded faces, one sphere on the axis at most."""

    name: str = "contact"
    summary: str = "2D, finite strain, walls in contact; tumour on the probe's axis; 5e-3 to 2e-2 in 2 to 20 s"

    def refusal(self, scene: Scene) -> str | None:
        """Say which kind of thing in the scene this level does not know, or None."""
        if scene.contact.interface == "frictionless":
            return "axisymmetric, linearly, for contact.interface = 'frictionless'"
        return Axisymmetric().refusal(scene)

    def answer(self, scene: Scene, accuracy: float, moduli: Floats | None = None) -> Answer:
        """Press on meshes as fine as ``accuracy`` needs, of the three there are; see ``Evaluator``.

        The log-sensitivity is that at the scene's force, or at the force that its indentation takes.

        Raises:
            Refusal: the scene is of another kind, too extreme, or pressed further than any step converges.
        """
        if self.refusal(scene) is not None:
            raise Refusal("evaluator", self.name, str(self.refusal(scene)))
        with threadpool_limits(1, user_api="blas"):
            try:
                _check_depth(scene)
                found, on = loaded(scene, accuracy, lambda films: _good(films, scene, accuracy))
                answers = [found] if moduli is None else curve(on, np.asarray(moduli))
            except StoppedError as fault:
                raise self.stopped(scene, fault) from fault
            except SolveError as fault:
                extremes = "scenes whose sizes and moduli lie closer together"
                raise Refusal("evaluator", self.name, f"{extremes} ({fault})") from fault
        return self._answer(scene, accuracy, on, answers)

    def _answer(self, scene: Scene, accuracy: float, on: LoadedScene, answers: list[Loaded]) -> Answer:
        films = tuple(one.films for one in answers)
        worst = max(films, key=lambda one: one.error_under(scene))
        change = float(np.exp(np.abs(_log_ratio(worst) - _log_ratio(on.linear.films[0]))) - 1)
        decision = Decision(FEATURE, True, change, accuracy, "what they change of the ratio at this load")
        notes = shortfalls(worst, worst.error_under(scene), accuracy)
        residual = max(on.linear.sample.states.residual, *(one.point.residual for one in answers))
        return Answer(films, residual, (*on.linear.plan, decision), tuple(notes))

    def stopped(self, scene: Scene, fault: StoppedError) -> Refusal:
        """Say how far the scene can be pressed."""
        if scene.load.indentation is not None:
            key, value, most = "load.indentation", mm(scene.load.indentation), mm(fault.last.indentation)
        else:
            key, value, most = "load.force", Words(f"{scene.load.force:g} N"), Words(f"{fault.last.force:.3g} N")
        return Refusal(key, value, f"up to {most} for {self.name}: no further step converges, {fault.why}")

    @in_own_workspace
    def pressed(self, scene: Scene, accuracy: float = 0.01) -> LoadedScene:
        """Return a scene at rest on two meshes, ready to be pressed.

        Raises:
            Refusal: the scene is of another kind, or too extreme.
        """
        if self.refusal(scene) is not None:
            raise Refusal("evaluator", self.name, str(self.refusal(scene)))
        try:
            return LoadedScene.of(scene, accuracy)
        except SolveError as fault:
            extremes = "scenes whose sizes and moduli lie closer together"
            raise Refusal("evaluator", self.name, f"{extremes} ({fault})") from fault


def _check_depth(scene: Scene) -> None:
    """Refuse at once what is far deeper than any path comes."""
    force, plain = scene.load.force, sections(scene)
    if not force:
        return
    stiffness = float(sample(plain.section, plain, scene, LEVELS[0]).totals[0].sum())
    if force > FAR_TOO_DEEP * stiffness * scene.probe.tube_radius:
        most = f"some {stiffness * scene.probe.tube_radius:.2g} N, which drives it as deep as it is wide"
        raise Refusal("load.force", Words(f"{force:g} N"), f"for contact less than {most}")


def _good(films: FilmForces, scene: Scene, accuracy: float) -> bool:
    sensitive = films.sensitivity_error <= max(5 * accuracy * abs(films.log_sensitivity or 0.0), 1e-5)
    return films.error_under(scene) <= accuracy and sensitive


def _log_ratio(films: FilmForces) -> float:
    return float(np.log(np.abs(films.totals)) @ [1.0, -1.0])


def level(tell: Tell | None = None) -> ContactLevel:
    """Return the level; it has nothing to tell."""
    return ContactLevel()
