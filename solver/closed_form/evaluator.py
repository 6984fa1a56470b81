"""The closed form as an evaluator, for one scene or for many: scenes of one structure share one evaluation on arrays.

Each result is bit for bit that of the scene alone: what numpy and LAPACK do to one column of ``designs.compute_forces`` does
not depend on the other columns, as long as their number is a multiple of four, to which it is rounded up by repeating the last;
``tests/solver/closed_form/test_evaluator.py`` holds that.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate
from typing import NamedTuple

import numpy as np

from geometry.common.arrays import Bools, Floats
from geometry.common.errors import InputError, Refusal
from geometry.common.percent import format_percent
from geometry.common.resources import LimitReached, get_limits, start_clock, use_limits
from geometry.scenes.probe import Material
from geometry.scenes.scene import Scene
from geometry.scenes.scene_tables import Inclusion
from solver.closed_form.charge_errors import state_charge_errors
from solver.closed_form.designs import Shape, build_parameters, iterate_solutions
from solver.closed_form.error_quantile import StatedErrors, state_errors
from solver.layers.scene_layers import compute_squeeze, list_material_layers
from solver.linalg.workspace import use_own_workspace
from solver.results.evaluator import FilmEvaluator, FilmSolution, ProgressCallback
from solver.results.film_forces import Bound, FilmForces, find_shortfalls
from solver.results.refusals import GEOMETRY_KINDS, find_refusal
from solver.results.result import ErrorKind
from solver.results.warnings import Note

MIN_COVER_DIAMETERS = 0.1  # of an inclusion, in its diameters
MAX_LOG_ERROR = 1.0  # of the formulas' ratio, totals and stiffness: scenes with larger errors are refused
MAX_RESIDUAL = 1e-10
COLUMNS_AT_ONCE = 4  # designs whose number is a multiple of it are computed alike, bit for bit
ERROR_KIND: ErrorKind = "95 %"
MIN_DEPTH_OUTER_RADII = 0.1  # of the tissue, in outer radii
MIN_SIDE_OUTER_RADII = 1.05  # of the tissue: nearer to the rim of the probe, ratios were up to eighteen times off
# Poisson's ratios up to which rounding, in differences of terms that go with 1 / (1 - 2 nu), stays below a seventh of the stated
# errors; in tissue with a tumour it grows with the third power, and is beyond them from 0.4999999 on. ``tests`` hold both.
MAX_TISSUE_POISSON_RATIO = 0.499999  # of tissue with a tumour
MAX_BLOCK_POISSON_RATIO = 0.499999999999
MAX_SQUEEZE = 50.0  # see ``solver.layers.scene_layers``: beyond it totals are up to nine times too small
BROKEN_FORMULAS_ADVICE = "axisymmetric, as the formulas break down for this scene"


@dataclass(frozen=True)
class ClosedFormForces:
    """Film forces, the quantiles of their errors, and the residual of eq. CF.12."""

    films: FilmForces
    errors: StatedErrors
    residual: float

    @property
    def max_error(self) -> float:
        """Largest of the relative errors of ratio, totals and stiffness."""
        return math.expm1(self.errors.largest)


@dataclass(frozen=True)
class ClosedForm(FilmEvaluator):
    """Two elastic blocks on an elastic layer, spheres by equivalent inclusion with their image: a first look, and the search."""

    name: str = "closed-form"
    summary: str = "formulas; spheres anywhere, covered by a tenth of their diameter; 1 to 30 % in milliseconds"

    def refusal(self, scene: Scene) -> str | None:
        """Return which evaluator to use instead, and why, for scenes that the formulas do not cover; else None."""
        reason = find_refusal(scene, GEOMETRY_KINDS)
        if reason is not None:
            return reason
        if any(body.diameter is None for body in scene.inclusion):
            return "equivalent-inclusion or solid for an ellipsoid"
        if any(body.depth - body.diameter / 2 < MIN_COVER_DIAMETERS * body.diameter for body in scene.inclusion if body.diameter):
            return f"axisymmetric for an inclusion covered by less than {MIN_COVER_DIAMETERS:g} of its diameter"
        if scene.tissue.layer and any(_is_near_interface(body, scene) for body in scene.inclusion):
            return (
                "axisymmetric or solid for an inclusion nearer to an interface of layers than "
                f"{MIN_COVER_DIAMETERS:g} of its diameter"
            )
        if scene.tissue.shape != "half-space":
            if scene.tissue.depth < MIN_DEPTH_OUTER_RADII * scene.probe.tube_radius:
                return f"axisymmetric for tissue thinner than {MIN_DEPTH_OUTER_RADII:g} outer radii"
            if scene.tissue.side_radius < MIN_SIDE_OUTER_RADII * scene.probe.tube_radius:
                return f"axisymmetric or solid for tissue whose sides are within {MIN_SIDE_OUTER_RADII:g} outer radii"
        if scene.tissue.layer and compute_squeeze(scene) > MAX_SQUEEZE:
            return "axisymmetric for a layer that blocks squeeze because it is thin and softer than its neighbours"
        return _explain_incompressible_refusal(scene)

    def solve(self, scene: Scene, accuracy: float, moduli: Floats | None = None) -> FilmSolution:
        """Solve the scene with the formulas, with a warning where their stated error is above ``accuracy``.

        ``moduli`` are Young's moduli of the target, Pa, shape (k,), for each of which the scene is solved; None for its own.

        Raises
        ------
        Refusal
            The scene is of another kind, or the formulas break down.
        """
        scenes = [scene] if moduli is None else [scene.with_modulus(scene.target or 0, item) for item in moduli.tolist()]
        solutions = []
        for item in self.compute_films(scenes):
            if isinstance(item, InputError):
                raise item
            solutions.append(item)
        return _build_solution(solutions, accuracy)

    @use_own_workspace
    def solve_many(self, scenes: Sequence[Scene], accuracies: Sequence[float]) -> list[FilmSolution | InputError]:
        """Solve each scene at its accuracy, or return its refusal; scenes of one structure are solved at once."""
        pairs = zip(self.solve_arrays(scenes), accuracies, strict=True)
        return [item if isinstance(item, InputError) else item.build_solution(accuracy) for item, accuracy in pairs]

    def solve_arrays(self, scenes: Sequence[Scene]) -> list[SolvedScene | InputError]:
        """Return each scene's place in arrays of results, or its refusal; limits of time are for all scenes together.

        Where all together take too long, each is solved alone, within its own limit.
        """
        try:
            with use_limits(replace(get_limits(), seconds=len(scenes) * get_limits().seconds)), start_clock():
                return self._solve_groups(scenes)
        except LimitReached:
            return [self._solve_or_refuse_alone(scene) for scene in scenes]

    def _solve_or_refuse_alone(self, scene: Scene) -> SolvedScene | InputError:
        """Solve one scene on arrays of length one, or return its refusal."""
        try:
            with start_clock():
                return self._solve_groups([scene])[0]
        except InputError as fault:
            return fault

    @use_own_workspace
    def compute_films(self, scenes: Sequence[Scene]) -> list[ClosedFormForces | InputError]:
        """Return the film forces of each scene with their errors, or its refusal; scenes of one structure are solved at once."""
        return [item if isinstance(item, InputError) else item.build_forces() for item in self._solve_groups(scenes)]

    def _solve_groups(self, scenes: Sequence[Scene]) -> list[SolvedScene | InputError]:
        """Solve scenes of one structure at once; a scene is refused, too, where the formulas break down."""
        solved: dict[int, SolvedScene | InputError] = {}
        groups: dict[Shape, list[tuple[int, Floats]]] = defaultdict(list)
        for place, scene in enumerate(scenes):
            reason = self.refusal(scene)
            if reason is not None:
                solved[place] = Refusal("evaluator", self.name, reason)
                continue
            shape, values = build_parameters(scene)
            groups[shape].append((place, values))
        for shape, group in groups.items():
            arrays = SolvedArrays.from_values(shape, np.column_stack([values for _, values in group]))
            for column, ((place, _), holds) in enumerate(zip(group, arrays.find_valid().tolist(), strict=True)):
                solved[place] = (
                    SolvedScene(scenes[place], arrays, column)
                    if holds
                    else Refusal("evaluator", self.name, BROKEN_FORMULAS_ADVICE)
                )
        return [solved[place] for place in range(len(scenes))]


@dataclass(frozen=True)
class SolvedArrays:
    """Results of the formulas for n scenes of one structure.

    Attributes
    ----------
    shape
        The structure.
    values
        Parameters, see ``designs.build_parameters``, shape (parameters, n).
    products, derivatives, residuals
        See ``solve_columns``.
    errors
        95 % quantiles of the errors, see ``state_errors``, shape (n, 5); they mean nothing where the formulas break down.
    """

    shape: Shape
    values: Floats
    products: Floats
    derivatives: Floats
    residuals: Floats
    errors: Floats

    @classmethod
    def from_values(cls, shape: Shape, values: Floats) -> SolvedArrays:
        """Solve the scenes with these parameters."""
        products, derivatives, residuals = solve_columns(shape, values)
        with np.errstate(all="ignore"):  # of scenes for which the formulas break down
            errors = state_errors(shape, values, products[:, :2], derivatives[:, :2])
        return cls(shape, values, products, derivatives, residuals, errors)

    def find_valid(self) -> Bools:
        """Return for which scenes the formulas hold, shape (n,)."""
        with np.errstate(invalid="ignore"):
            positive = (self.products[:, :2].sum(axis=2) > 0).all(axis=1)
            exact = np.isfinite(self.products).all(axis=(1, 2)) & (self.residuals < MAX_RESIDUAL)
            return np.asarray(positive & exact & ~(self.errors[:, :-1].max(axis=1) > MAX_LOG_ERROR))


class SolvedScene(NamedTuple):
    """A scene and its place among ``SolvedArrays``."""

    scene: Scene
    arrays: SolvedArrays
    column: int

    def build_forces(self) -> ClosedFormForces:
        """Return the scene's film forces with their errors."""
        scene, arrays, k = self
        shape, products, derivatives = arrays.shape, arrays.products[k], arrays.derivatives[k]
        forces = products[:2]
        errors = StatedErrors.from_row(arrays.errors[k]).add_details(scene.probe, forces, films=shape.films)
        has_target = scene.target is not None
        charges = None
        if shape.films:
            stated = state_charge_errors(scene, shape, arrays.values[:, k], products, derivatives)
            bound = Bound(stated.log_totals * np.abs(products[2:].sum(axis=1)), stated.log_ratio)
            charges = FilmForces(products[2:], bound, derivatives[2:] if has_target else None, stated.sensitivity)
        bound, derivative = errors.compute_bound(forces.sum(axis=1)), derivatives[:2] if has_target else None
        films = FilmForces(forces, bound, derivative, errors.sensitivity, charges)
        return ClosedFormForces(films, errors, float(arrays.residuals[k]))

    def build_solution(self, accuracy: float) -> FilmSolution:
        """Return the scene's solution, with a warning where its largest error is above ``accuracy``."""
        return _build_solution([self.build_forces()], accuracy)


def _build_solution(solutions: Sequence[ClosedFormForces], accuracy: float) -> FilmSolution:
    """Return the film forces of several moduli, with a warning where the largest of their errors is above ``accuracy``."""
    worst = max(solutions, key=lambda item: item.max_error)
    notes = (*find_shortfalls(worst.films, worst.max_error, accuracy, kind=ERROR_KIND), *_warn_of_charges(solutions, accuracy))
    films, residual = tuple(item.films for item in solutions), max(item.residual for item in solutions)
    return FilmSolution(films, residual, notes=notes, error_kind=ERROR_KIND)


def _warn_of_charges(solutions: Sequence[ClosedFormForces], accuracy: float) -> Iterator[Note]:
    """Yield a warning where the largest error of a charge is above ``accuracy``: they are less accurate than the stresses."""
    charges = [item.films.charges for item in solutions if item.films.charges is not None]
    each = max((float(np.max(item.relative_errors)) for item in charges), default=0.0)
    ratio = max((item.ratio_error for item in charges), default=0.0)
    if max(each, ratio) > accuracy:
        sizes = f"{ERROR_KIND} errors of the charges are {format_percent(each)}, of their ratio {format_percent(ratio)}"
        yield Note("accuracy", f"{sizes}: equivalent-inclusion and axisymmetric compute both more accurately")


def _is_near_interface(body: Inclusion, scene: Scene) -> bool:
    """Return whether two layers of different materials meet in a sphere, or nearer to it than ``MIN_COVER_DIAMETERS``."""
    # 0.5 diameters from the centre to the sphere's surface, and the minimum cover
    faces = accumulate(layer[0] for layer in list_material_layers(scene.tissue))
    return any(abs(body.depth - face) < (0.5 + MIN_COVER_DIAMETERS) * (body.diameter or 0.0) for face in faces)


def _explain_incompressible_refusal(scene: Scene) -> str | None:
    """Return which Poisson's ratio is too near to 0.5 for the formulas in double precision, and its limit; else None."""
    probe, tissue = scene.probe, scene.tissue
    bodies: list[tuple[str, Material, float]] = [
        ("probe.inner", probe.inner, MAX_BLOCK_POISSON_RATIO),
        ("probe.outer", probe.outer, MAX_BLOCK_POISSON_RATIO),
    ]
    if scene.inclusion:
        layers = [(f"tissue.layer[{index}]", layer) for index, layer in enumerate(tissue.layer)]
        bodies += [(key, body, MAX_TISSUE_POISSON_RATIO) for key, body in (("tissue", tissue), *layers)]
    for key, body, limit in bodies:
        if body.poisson_ratio > limit:
            return f"{key}.poisson_ratio up to {limit:.12g}, or another evaluator"
    return None


def solve_columns(shape: Shape, columns: Floats) -> tuple[Floats, Floats, Floats]:
    """Return forces and charges, their derivatives and residuals of n designs of one structure.

    Their number is rounded up to a multiple of ``COLUMNS_AT_ONCE`` by repeating the last, see the module's docstring.

    Parameters
    ----------
    shape
        The structure of all the designs.
    columns
        The parameters of n designs, one in each column, see ``designs.build_parameters``, shape (parameters, n).

    Returns
    -------
    tuple[Floats, Floats, Floats]
        Forces F_ij, N/m, below them the films' charges, if any, and their derivatives by ln of the target's modulus, both of
        shape (n, 2 or 4, 2), and residuals of eq. CF.12, shape (n,). Forces are not finite or not positive where the formulas
        break down.
    """
    count = columns.shape[1]
    padded = np.pad(columns, ((0, 0), (0, -count % COLUMNS_AT_ONCE)), mode="edge")
    with np.errstate(all="ignore"):
        parts = [
            (solution.products, solution.product_derivatives, solution.residual) for solution in iterate_solutions(shape, padded)
        ]
        products, derivatives, residuals = (np.concatenate(part)[:count] for part in zip(*parts, strict=True))
    return products, derivatives, residuals


def create_evaluator(progress: ProgressCallback | None = None) -> ClosedForm:
    """Return the evaluator; it reports no progress."""
    return ClosedForm()
