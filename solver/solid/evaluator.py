"""Evaluator ``solid``: three-dimensional finite elements for groove, edges, tilt and tumours of any shape and place."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import Refusal, Words
from geometry.scenes.probe import format_mm
from geometry.scenes.scene import Scene
from solver.linalg.workspace import use_own_workspace
from solver.results.evaluator import FilmEvaluator, FilmSolution, OutOfReach, ProgressCallback, ignore_progress
from solver.results.film_forces import Bound, FilmForces, find_shortfalls
from solver.results.refusals import find_refusal, is_round, refuse_unsolvable
from solver.results.result import Result
from solver.results.warnings import Note, select_notes
from solver.solid.domain import is_coaxial
from solver.solid.film_forces import SolidForces, TiltForces, compute_solid_forces

BEST_ACCURACY = 0.003  # relative accuracy that meshes reach in about a minute
FINEST_BOUND_FACTOR = 0.4  # times that: the bound that the finest mesh often reaches
MIN_INCLUSION_RELATIVE = 1 / 15  # of the outer radius: smaller inclusions take minutes to mesh
MAX_TILT_RAD = math.radians(10)  # above 10 deg the square of the tilt exceeds 3 %


@dataclass(frozen=True)
class SolidEvaluator(FilmEvaluator):
    """Evaluate with quadratic tetrahedra on meshes by netgen or pytetwild; faces are bonded or frictionless.

    Attributes
    ----------
    progress
        Called with a line before each piece of work.
    """

    progress: ProgressCallback = field(default=ignore_progress, compare=False)
    name: str = "solid"
    summary: str = "3D finite elements: groove, edges, tilt, tumours of any shape; 1e-2 in 10 to 60 s"

    def refusal(self, scene: Scene) -> str | None:
        """Return the reason for a refusal, a feature of the scene that this evaluator does not model, or None."""
        return find_refusal(scene, ("contact",))

    def may_help(self, scene: Scene, accuracy: float) -> bool:
        """Return whether this evaluator may be more accurate than cheaper ones, because it models more of the scene."""
        has_at_most_one_sphere = len(scene.inclusion) <= 1 and all(body.diameter is not None for body in scene.inclusion)
        symmetric = (
            scene.probe.groove is None
            and is_coaxial(scene)
            and has_at_most_one_sphere
            and (not scene.tissue.layer or is_round(scene))
        )
        return accuracy >= FINEST_BOUND_FACTOR * BEST_ACCURACY and self.refusal(scene) is None and not symmetric

    def evaluate_within(self, scene: Scene, accuracy: float, allowed: float | None = None) -> Result:
        """Evaluate, but return a result only if every error bound is at most ``allowed``, by default ``accuracy``.

        Raises
        ------
        InputError, Refusal
            See ``solve``; also if the accuracy is out of reach.
        """
        allowed = accuracy if allowed is None else allowed
        if allowed < FINEST_BOUND_FACTOR * BEST_ACCURACY:
            raise OutOfReach(self.name, scene, accuracy, BEST_ACCURACY)
        return super().evaluate_within(scene, max(accuracy, BEST_ACCURACY), allowed)

    def solve(self, scene: Scene, accuracy: float, moduli: Floats | None = None) -> FilmSolution:
        """Evaluate on two or three meshes; see ``Evaluator``. All ``moduli`` of the target take one factor per mesh.

        Raises
        ------
        InputError
            A surface file that cannot be used.
        Refusal
            The scene is not supported, or cannot be meshed or solved.
        """
        return self.build_solution(scene, self.solve_forces(scene, accuracy, moduli), accuracy)

    def build_solution(self, scene: Scene, solution: SolidForces, accuracy: float) -> FilmSolution:
        """Build the film solution at the scene's load from the film forces per unit motion; see ``add_tilt_forces``."""
        tilted_films = [add_tilt_forces(scene, solution, k) for k in range(len(solution.films))]
        films = tuple(film for film, _ in tilted_films)
        worst = max(films, key=lambda film: film.compute_max_error(scene))
        shortfall_notes = find_shortfalls(worst, worst.compute_max_error(scene), accuracy, select_notes(solution.notes, "limit"))
        notes = (*_list_tilt_notes(scene, worst), *select_notes(solution.notes, "left_out"), *shortfall_notes)
        return FilmSolution(films, solution.difference.residual, solution.plan, notes, tilted_films[0][1])

    @use_own_workspace
    def solve_forces(self, scene: Scene, accuracy: float, moduli: Floats | None = None) -> SolidForces:
        """Return film forces with their errors, and the states behind them.

        Raises
        ------
        InputError, Refusal
            See ``solve``.
        """
        self.check(scene)
        if abs(scene.placement.tilt) > MAX_TILT_RAD:
            raise Refusal(
                "placement.tilt", Words(f"{math.degrees(scene.placement.tilt):.3g} deg"), "-10 to 10 deg: small rotations"
            )
        _check_sizes(scene)
        with refuse_unsolvable("evaluator", self.name, "scenes that can be meshed and solved"):
            return compute_solid_forces(scene, accuracy, moduli, self.progress)


def _check_sizes(scene: Scene) -> None:
    """Raise ``Refusal`` for inclusions that are too small to be meshed with the probe."""
    min_size = MIN_INCLUSION_RELATIVE * scene.probe.tube_radius
    for k, body in enumerate(scene.inclusion):
        size = min(body.diameters) if body.diameters is not None else body.diameter
        if size is not None and size < min_size:
            allowed = (
                f"{format_mm(min_size)} or more for solid, a fifteenth of the outer radius (equivalent-inclusion "
                "takes smaller ones)"
            )
            raise Refusal(f"inclusion[{k}].diameter", format_mm(size), allowed)


def compute_indentation(scene: Scene, solution: SolidForces, k: int) -> float:
    """Return how far the scene's load lowers the centre of the base, m, for modulus number ``k`` of the solution."""
    if scene.load.indentation is not None:
        return scene.load.indentation
    # the force that the tilt alone causes while the centre is held
    tilting = float(solution.tilt.forces[k].sum()) * scene.placement.tilt
    return ((scene.load.amplitude or 0.0) - tilting) / float(solution.films[k].totals.sum())


def add_tilt_forces(scene: Scene, solution: SolidForces, k: int) -> tuple[FilmForces, float]:
    """Return film forces per unit indentation including those of the tilt, and the stiffness without tilt, N/m.

    ``k`` is the number of the modulus in the solution.

    With w the indentation of the base's centre, t the tilt, rad, F the film forces per unit indentation and T those per unit
    tilt, the forces on the films are F 1 w + T t, so that per unit of w T t / w is added (SO.6).

    Raises
    ------
    Refusal
        A tilted probe has no load, or the load does not press it down.
    """
    films, tilt = solution.films[k], scene.placement.tilt
    stiffness = float(films.totals.sum())
    if tilt == 0:
        return films, stiffness
    w = compute_indentation(scene, solution, k)
    if not w > 0:
        key, value = ("indentation", f"{w:g} m") if scene.load.force is None else ("force", f"{scene.load.force:g} N")
        raise Refusal(f"load.{key}", Words(value), "a load that presses the tilted probe into the tissue")
    charges, tilt_charges = films.charges, solution.tilt_charges
    if charges is not None and tilt_charges is not None:
        charges = _add_tilt(charges, tilt_charges, k, tilt, w)
    return replace(_add_tilt(films, solution.tilt, k, tilt, w), charges=charges), stiffness


def _add_tilt(films: FilmForces, tilt_forces: TiltForces, k: int, tilt: float, indentation: float) -> FilmForces:
    """Return film forces, or charges, per unit indentation with those of a tilt, rad, at modulus number ``k``, by eq. SO.6."""
    per_indentation = tilt / indentation
    # errors of the film forces and of the tilt forces, and what a linear model neglects: the square of the tilt
    error = (
        films.bound.totals
        + np.abs(per_indentation) * tilt_forces.error
        + tilt**2 * np.abs(per_indentation * tilt_forces.forces[k])
    )
    forces = films.forces + np.diag(per_indentation * tilt_forces.forces[k])
    modulus_derivative = (
        None
        if films.modulus_derivative is None
        else films.modulus_derivative + np.diag(per_indentation * tilt_forces.derivative[k])
    )
    bound = Bound.from_independent_errors(np.asarray(error), forces)
    return replace(films, forces=forces, bound=bound, modulus_derivative=modulus_derivative)


def _list_tilt_notes(scene: Scene, films: FilmForces) -> list[Note]:
    """Return a list with a note if the tilt raises one side of the probe more than the load lowers it, else an empty list."""
    tilt, load = abs(scene.placement.tilt), scene.load
    if tilt == 0:
        return []
    force = load.preload or load.force or 0.0  # the lightest that the probe is read under
    indentation = load.indentation if load.indentation is not None else force / float(films.totals.sum())
    raised = tilt * scene.probe.tube_radius
    if raised <= indentation:
        return []
    sides = f"the tilt raises one side by {1e3 * raised:.3g} mm, the load lowers the probe by {1e3 * indentation:.3g} mm"
    return [Note("linear", f"{sides}: the model lets this side pull the tissue, but real contact opens there")]


def create_evaluator(progress: ProgressCallback | None = None) -> SolidEvaluator:
    """Return the evaluator, which reports its progress to ``progress``."""
    return SolidEvaluator(progress=progress or ignore_progress)
