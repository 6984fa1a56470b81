"""The solid evaluator: three-dimensional finite elements for groove, edges, tilt and tumours of any shape and place."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
from threadpoolctl import threadpool_limits

from geometry.common.arrays import Floats
from geometry.common.errors import Refusal, SolveError, Words
from geometry.scenes.probe import mm
from geometry.scenes.scene import Scene
from solver.linalg.workspace import in_own_workspace
from solver.results.evaluator import Answer, FilmLevel, OutOfReach, Tell, silent
from solver.results.film_forces import Bound, FilmForces, shortfalls
from solver.results.kinds import is_round, unsupported
from solver.results.result import Result
from solver.results.warnings import Note, of_kind
from solver.solid.domain import coaxial
from solver.solid.film_forces import SolidForces, solid_forces

BEST = 0.003  # relative accuracy that meshes reach in about a minute
OFTEN = 0.4  # times that: the bound that the finest mesh often reaches
LEAST = 1 / 15  # of the outer radius: smaller inclusions take minutes to mesh
STEEP = math.radians(10)  # above 10 deg the square of the tilt exceeds 3 %


@dataclass(frozen=True)
class SolidLevel(FilmLevel):
    """Evaluate with quadratic tetrahedra on meshes by netgen or pytetwild; faces are bonded or frictionless.

    Attributes:
        tell: called with a line before each piece of work.
    """

    tell: Tell = field(default=silent, compare=False)
    name: str = "solid"
    summary: str = "3D finite elements: groove, edges, tilt, tumours of any shape; 1e-2 in 10 to 60 s"

    def refusal(self, scene: Scene) -> str | None:
        """Return the feature of the scene that this evaluator does not model, or None."""
        return unsupported(scene)

    def may_help(self, scene: Scene, accuracy: float) -> bool:
        """Return whether this evaluator may reach an accuracy that cheaper ones do not, because it models more of the scene."""
        lone = len(scene.inclusion) <= 1 and all(body.diameter is not None for body in scene.inclusion)
        symmetric = scene.probe.groove is None and coaxial(scene) and lone and (not scene.tissue.layer or is_round(scene))
        return accuracy >= OFTEN * BEST and self.refusal(scene) is None and not symmetric

    def evaluate_within(self, scene: Scene, accuracy: float, allowed: float | None = None) -> Result:
        """Evaluate, but return a result only if every error bound is at most ``allowed``, by default ``accuracy``.

        Raises:
            InputError, Refusal: see ``answer``; also if the accuracy is out of reach.
        """
        allowed = accuracy if allowed is None else allowed
        if allowed < OFTEN * BEST:
            raise OutOfReach(self.name, scene, accuracy, BEST)
        return super().evaluate_within(scene, max(accuracy, BEST), allowed)

    def answer(self, scene: Scene, accuracy: float, moduli: Floats | None = None) -> Answer:
        """Evaluate on two or three meshes; a curve of moduli takes one factor per mesh.

        Raises:
            InputError: a surface file that cannot be used.
            Refusal: the scene is not supported, or cannot be meshed or solved.
        """
        return self.answer_of(scene, self.solved(scene, accuracy, moduli), accuracy)

    def answer_of(self, scene: Scene, solution: SolidForces, accuracy: float) -> Answer:
        """Build the answer of a solution at the scene's load; see ``add_tilt_forces`` for refusals."""
        every = [tilted(scene, solution, k) for k in range(len(solution.films))]
        films = tuple(one for one, _ in every)
        worst = max(films, key=lambda one: one.error_under(scene))
        short = shortfalls(worst, worst.error_under(scene), accuracy, of_kind(solution.notes, "limit"))
        notes = (*_tilt_notes(scene, worst), *of_kind(solution.notes, "left_out"), *short)
        return Answer(films, solution.difference.residual, solution.plan, notes, every[0][1])

    @in_own_workspace
    def solved(self, scene: Scene, accuracy: float, moduli: Floats | None = None) -> SolidForces:
        """Return film forces with their errors, and the states behind them.

        Raises:
            InputError, Refusal: see ``answer``.
        """
        why = self.refusal(scene)
        if why is not None:
            raise Refusal("evaluator", self.name, why)
        if abs(scene.placement.tilt) > STEEP:
            raise Refusal(
                "placement.tilt", Words(f"{math.degrees(scene.placement.tilt):.3g} deg"), "-10 to 10 deg: small rotations"
            )
        _check_sizes(scene)
        with threadpool_limits(1, user_api="blas"):
            try:
                return solid_forces(scene, accuracy, moduli, self.tell)
            except SolveError as fault:
                raise Refusal("evaluator", self.name, f"scenes that can be meshed and solved ({fault})") from fault


def _check_sizes(scene: Scene) -> None:
    """Raise ``Refusal`` for inclusions that are too small to be meshed with the probe."""
    least = LEAST * scene.probe.tube_radius
    for k, body in enumerate(scene.inclusion):
        size = min(body.diameters) if body.diameters is not None else body.diameter
        if size is not None and size < least:
            allowed = f"{mm(least)} or more for solid, a fifteenth of the outer radius (equivalent-inclusion takes smaller ones)"
            raise Refusal(f"inclusion[{k}].diameter", mm(size), allowed)


def indentation(scene: Scene, solution: SolidForces, k: int) -> float:
    """Return how far the scene's load lowers the centre of the base, m."""
    if scene.load.indentation is not None:
        return scene.load.indentation
    tilting = float(solution.tilt[k].sum()) * scene.placement.tilt
    return ((scene.load.force or 0.0) - tilting) / float(solution.films[k].totals.sum())


def tilted(scene: Scene, solution: SolidForces, k: int) -> tuple[FilmForces, float]:
    """Return film forces per unit indentation including those of the tilt, and the stiffness without tilt, N/m.

    With w the indentation of the base's centre, t the tilt, F the film forces per unit indentation and T those per unit tilt, the
    forces on the films are F 1 w + T t, so that per unit of w T t / w is added (SO.6).

    Raises:
        Refusal: a tilted probe has no load, or the load does not press it down.
    """
    films, tilt = solution.films[k], scene.placement.tilt
    stiffness = float(films.totals.sum())
    if tilt == 0:
        return films, stiffness
    w = indentation(scene, solution, k)
    if not w > 0:
        key, value = ("indentation", f"{w:g} m") if scene.load.force is None else ("force", f"{scene.load.force:g} N")
        raise Refusal(f"load.{key}", Words(value), "a load that presses the tilted probe into the tissue")
    share = tilt / w
    error = films.bound.totals + np.abs(share) * solution.tilt_error + tilt**2 * np.abs(share * solution.tilt[k])
    forces = films.forces + np.diag(share * solution.tilt[k])
    slope = None if films.slope is None else films.slope + np.diag(share * solution.tilt_slope[k])
    bound = Bound.independent(np.asarray(error), forces)
    return replace(films, forces=forces, bound=bound, slope=slope), stiffness


def _tilt_notes(scene: Scene, films: FilmForces) -> list[Note]:
    """List a note if the tilt lifts one side of the probe more than the load lowers it."""
    tilt, load = abs(scene.placement.tilt), scene.load
    if tilt == 0:
        return []
    indentation = load.indentation if load.indentation is not None else (load.force or 0.0) / float(films.totals.sum())
    raised = tilt * scene.probe.tube_radius
    if raised <= indentation:
        return []
    sides = f"the tilt raises one side by {1e3 * raised:.3g} mm, the load lowers the probe by {1e3 * indentation:.3g} mm"
    return [Note("linear", f"{sides}: the model lets this side pull the tissue, but real contact opens there")]


def level(tell: Tell | None = None) -> SolidLevel:
    """Return the evaluator, which reports its progress to ``tell``."""
    return SolidLevel(tell=tell or silent)
