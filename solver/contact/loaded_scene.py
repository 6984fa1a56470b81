"""Compute film forces under load: the linear result, corrected by the changes that two meshes show, with error bounds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import Refusal, Words
from geometry.meridian.mesh_lines import MeridianFineness
from geometry.meridian.section import Body, Section
from geometry.scenes.scene import Scene
from solver.axisymmetric.converged_forces import Converged, compute_converged_forces
from solver.axisymmetric.sections import HALF_SPACE_SIZES
from solver.contact.corner_check import CORNER_FINENESS, CornerCheck
from solver.contact.loaded_outputs import NO_DIFFERENCES, LoadedOutputs, MeshDifferences
from solver.contact.model import ContactModel
from solver.contact.path import Path
from solver.contact.states import PathPoint, StoppedError
from solver.contact.tangent_outputs import build_tangent_films
from solver.results.film_forces import Bound, FilmForces

MESH_FINENESSES = tuple(MeridianFineness(1, 0, order) for order in (2, 3, 4))
SPRING_SHARES = {2: 0.25, 3: 0.5, 4: 1.0}  # friction springs' stiffness by mesh order, so that meshes show the springs' error
LINEAR_SHARE = 0.2  # of the accuracy, for the linear solution
SMALL_INDENTATION_RELATIVE = 1e-5  # indentation, in units of a path, below which the linear result holds within ...
LIGHT_INDENTATION_RELATIVE = 1e-3  # likewise where faces may open: the contact area no longer changes below it
MIN_ERROR_RELATIVE = 1e-4  # ... this relative amount, the minimum error bound
MAX_LINEAR_DEPTH_RELATIVE = 3.0  # outer radii, estimated by the linear stiffness
HALF_SPACE_EXTENT_RELATIVE = (
    300.0  # sizes of probe and inclusion: where a half-space is cut, because rounding errors grow with its size
)
ROUND_EDGE_ERROR = (
    0.05  # relative, times (edge radius / minimum block size)^2: round edges change the contact lines alone, not the blocks
)
EDGE_PASSING_ERRORS = (
    0.005,
    0.05,
)  # relative errors of ratio and log-sensitivity where faces open: points pass an edge one by one


@dataclass(frozen=True)
class LoadedForces:
    """Film forces under one load.

    Attributes
    ----------
    point
        Point of the load path on the finest mesh.
    films
        Film forces per indentation with bounds, and charges where they are modelled; derivatives are taken at constant force.
    """

    point: PathPoint
    films: FilmForces


@dataclass(frozen=True)
class LoadedScene:
    """A scene on two meshes, with the load paths computed so far.

    Attributes
    ----------
    scene
        A scene with at most one sphere, on the axis.
    accuracy
        Relative accuracy of the result.
    linear
        Linear film forces; where faces may open, those of frictionless faces, for scale only.
    paths
        Load paths on two meshes, the finer last.
    known
        Mesh differences of film forces, and of charges if they are modelled, on the part of the load path that was not computed
        because the path began at a loaded state of another modulus.
    dense
        Whether lines that touch have twice the usual number of contact points.
    finenesses
        Of the meshes from which ``paths`` are taken, rising.
    corner_check
        The load path with fine corners; see ``LoadedOutputs``.
    """

    scene: Scene
    accuracy: float
    linear: Converged
    paths: tuple[Path, Path]
    known: tuple[MeshDifferences, ...] = ()
    dense: bool = False
    finenesses: tuple[MeridianFineness, ...] = MESH_FINENESSES
    corner_check: CornerCheck | None = None

    @classmethod
    def from_scene(cls, scene: Scene, accuracy: float, finenesses: tuple[MeridianFineness, ...] = MESH_FINENESSES) -> LoadedScene:
        """Solve a scene at rest, linearly and on the first two meshes of ``finenesses``, which rise.

        Raises
        ------
        SolveError
            The equations cannot be solved in double precision.
        LimitReached
            A limit of memory or time is exceeded.
        """
        linear = compute_converged_forces(_tie_faces(scene), LINEAR_SHARE * accuracy)
        first, second = (build_path(scene, linear, fineness) for fineness in finenesses[:2])
        check = _prepare_check(scene, linear)
        return cls(scene, accuracy, linear, (first, second), finenesses=finenesses, corner_check=check)

    @property
    def may_open(self) -> bool:
        """Whether faces may open: the linear result is then not their limit, nor another modulus' state a start."""
        return self.scene.contact.interface == "unilateral"

    def refine(self) -> LoadedScene | None:
        """Return the scene on the finer mesh and the next finer one; None if there is none."""
        following = self.finenesses.index(self.paths[1].model.mesh.layout.fineness) + 1
        if following == len(self.finenesses):
            return None
        return replace(self, paths=(self.paths[1], build_path(self.scene, self.linear, self.finenesses[following], self.dense)))

    def add_contact_points(self) -> LoadedScene | None:
        """Return the scene at rest with twice the contact points; None if it has them, or has faces that slide or open.

        With few points the pressure of each is so high that tissue may fold over between them. More points take longer. On
        faces that slide, which touch everywhere, they would be more constraints than the elements can follow.
        """
        if self.dense or self.scene.contact.interface != "bonded":
            return None
        first, second = (build_path(self.scene, self.linear, path.model.mesh.layout.fineness, True) for path in self.paths)
        return replace(self, paths=(first, second), dense=True, corner_check=_prepare_check(self.scene, self.linear, True))

    def with_modulus(self, modulus: float, linear: Converged) -> LoadedScene:
        """Return the scene at rest with another Young's modulus of the target, Pa; ``linear`` are its linear film forces."""
        body = self.scene.inclusion[0].model_copy(update={"youngs_modulus": modulus})
        scene = self.scene.model_copy(update={"inclusion": (body,)})
        rest_films = None if self.may_open else linear.films[0]
        first, second = (Path(path.model.with_modulus(modulus), True, rest_films) for path in self.paths)
        check = _prepare_check(scene, linear, self.dense)
        return LoadedScene(scene, self.accuracy, linear, (first, second), dense=self.dense, corner_check=check)

    def press_to_scene_load(self) -> LoadedForces:
        """Press the probe to the scene's load, or to its preload, whose tangent response is returned; see ``Load``.

        Raises
        ------
        StoppedError
            No further step converges.
        LimitReached
            The time limit is reached.
        """
        load = self.scene.load
        if load.indentation is not None:
            return self.press_to_indentation(load.indentation)
        return self.press_to_preload(load.preload) if load.preload else self.press_to_force(load.force or 0.0)

    def press_to_preload(self, force: float) -> LoadedForces:
        """Press to a preload, N, and return the tangent response about it; see ``press_to_scene_load``."""
        pressed, unit = self.press_to_force(force, "load.preload"), self.paths[1].unit
        if pressed.point.indentation <= (LIGHT_INDENTATION_RELATIVE if self.may_open else SMALL_INDENTATION_RELATIVE) * unit:
            return pressed  # all is proportional
        forces, *charges = (build_tangent_films(outputs, pressed.point) for outputs in self.outputs)
        return replace(pressed, films=replace(forces, charges=charges[0] if charges else None))

    def press_to_force(self, force: float, key: str = "load.force") -> LoadedForces:
        """Press to a force, N; see ``press_to_scene_load``.

        Raises
        ------
        Refusal
            The force, named by ``key``, is far above what any path reaches.
        """
        estimate, radius = force / self._stiffness, self.paths[1].radius
        if estimate > MAX_LINEAR_DEPTH_RELATIVE * radius:
            limit = (
                f"up to about {self._stiffness * radius:.2g} N for contact, which indents the tissue by the probe's outer radius"
            )
            raise Refusal(key, Words(f"{force:g} N"), limit)
        return self._press(estimate, lambda path: path.press_to_force(force))

    @property
    def _stiffness(self) -> float:
        """Stiffness at rest on the finer mesh, N/m."""
        return float(self.paths[1].points[0].tangent.sum())

    @property
    def min_errors(self) -> tuple[float, float]:
        """Minimum error bounds of film forces and log-sensitivity, relative: errors that no two meshes show.

        Where edges are round, blocks keep the material beyond the arcs. Where faces open, points pass an edge one by one.
        """
        s = self.paths[1].model.section
        sizes = (s.inner_radius, s.tube_radius - s.hole_radius, s.inner_height, s.outer_height)
        min_error = MIN_ERROR_RELATIVE + ROUND_EDGE_ERROR * float(s.edge_radius / min(sizes)) ** 2
        films, derivatives = EDGE_PASSING_ERRORS if self.may_open else (0.0, 0.0)
        return min_error + films, min_error + derivatives

    def press_to_indentation(self, indentation: float) -> LoadedForces:
        """Press to an indentation, m; see ``press_to_scene_load``."""
        return self._press(indentation, lambda path: path.press_to_indentation(indentation))

    def _press(self, estimate: float, press: Callable[[Path], PathPoint]) -> LoadedForces:
        """Press both meshes, or scale the light-load result if the estimated indentation, m, is negligible.

        ``press`` presses one mesh's path to the wanted load and returns the point there.
        """
        unit = self.paths[1].unit
        if self.may_open and estimate < LIGHT_INDENTATION_RELATIVE * unit:
            light = self.press_to_indentation(LIGHT_INDENTATION_RELATIVE * unit)
            return LoadedForces(light.point.scale(estimate), light.films)
        if estimate <= SMALL_INDENTATION_RELATIVE * unit:
            point = self.paths[1].points[0].advance(estimate)
            return LoadedForces(point, _widen_bounds(self.linear.films[0], max(self.min_errors)))
        _, fine = (press(path) for path in self.paths)
        forces, *charges = (outputs.build_films(fine) for outputs in self.outputs)
        return LoadedForces(fine, replace(forces, charges=charges[0] if charges else None))

    def find_first_stop(self, fault: StoppedError) -> StoppedError:
        """Return the stop of the mesh that ends first, given that of a mesh: a load counts as reached where both reach it."""
        for path in self.paths:
            try:
                for _ in path.iterate_steps(fault.last.indentation):
                    pass
            except StoppedError as earlier:
                return earlier
        return fault

    @property
    def outputs(self) -> tuple[LoadedOutputs, ...]:
        """The film forces on both load paths, and the charges where they are modelled."""
        linear = self.linear.films[0]
        films = (linear, *([] if linear.charges is None else [linear.charges]))
        known = self.known or (NO_DIFFERENCES,) * len(films)
        return tuple(
            LoadedOutputs(
                self.paths,
                values,
                values is not linear,
                not self.may_open,
                self.min_errors,
                differences,
                self.corner_check,
            )
            for values, differences in zip(films, known, strict=True)
        )

    @property
    def read_outputs(self) -> LoadedOutputs:
        """What the scene's readings are the ratio of: the charges where they are modelled and read, else the film forces."""
        forces, *charges = self.outputs
        return charges[0] if charges and self.scene.observable == "charge" else forces


def press_with_enough_points(
    loaded: LoadedScene, press: Callable[[LoadedScene], LoadedForces]
) -> tuple[LoadedForces, LoadedScene]:
    """Press a scene, with more contact points where no step converges; return the result and the scene that was pressed.

    Raises
    ------
    StoppedError
        No step converges with more points either; it is of the path that got further.
    LimitReached
        The time limit is reached.
    """
    try:
        return press(loaded), loaded
    except StoppedError as fault:
        denser = loaded.add_contact_points()
        if denser is None:
            raise loaded.find_first_stop(fault) from None
        try:
            return press(denser), denser
        except StoppedError as second:
            raise max(fault, second, key=lambda stop: stop.last.indentation) from None


def compute_modulus_curve(loaded: LoadedScene, moduli: Floats) -> list[LoadedForces]:
    """Return film forces at a scene's load for other moduli of the target, each started from its neighbour's state.

    Parameters
    ----------
    loaded
        The scene, pressed to its load.
    moduli
        Young's moduli, Pa, shape (k,).

    Raises
    ------
    SolveError, LimitReached
        See ``LoadedScene.from_scene`` and ``LoadedScene.press_to_scene_load``.
    """
    linear = compute_converged_forces(_tie_faces(loaded.scene), LINEAR_SHARE * loaded.accuracy, moduli)
    log_ratios = np.log(moduli / loaded.scene.inclusion[0].youngs_modulus)
    results: dict[int, LoadedForces] = {}
    for side in (log_ratios >= 0, log_ratios < 0):  # outwards from the scene's own modulus, to stiffer and to softer ones
        neighbour = loaded
        for k in sorted(np.flatnonzero(side).tolist(), key=lambda k: abs(log_ratios[k])):
            results[k], neighbour = _solve_neighbour(neighbour, float(moduli[k]), replace(linear, films=(linear.films[k],)))
    return [results[k] for k in range(len(moduli))]


def solve_neighbour(neighbour: LoadedScene, modulus: float) -> tuple[LoadedForces, LoadedScene]:
    """Return the film forces for one other modulus, and the pressed scene as a start for more; see ``compute_modulus_curve``."""
    linear = compute_converged_forces(_tie_faces(neighbour.scene), LINEAR_SHARE * neighbour.accuracy, np.array([modulus]))
    return _solve_neighbour(neighbour, modulus, linear)


def _solve_neighbour(neighbour: LoadedScene, modulus: float, linear: Converged) -> tuple[LoadedForces, LoadedScene]:
    """Solve for another modulus, Pa, from the neighbour's state; where that does not converge, from rest, like any scene.

    ``neighbour`` is the scene pressed to its load with a similar modulus; ``linear`` are the linear film forces for the other.
    """
    rest_scene = neighbour.with_modulus(modulus, linear)
    last = neighbour.paths[1].last.indentation
    # about a preload the paths end beyond it, and a state there would be no start for it
    if (
        not neighbour.may_open
        and not neighbour.scene.load.preload
        and last > SMALL_INDENTATION_RELATIVE * neighbour.paths[1].unit
    ):
        known = tuple(outputs.compute_differences(last) for outputs in neighbour.outputs)
        loaded = replace(rest_scene, known=known, corner_check=None)  # which they include
        try:
            for path, neighbour_path in zip(loaded.paths, neighbour.paths, strict=True):
                path.seed(neighbour_path.last.equilibrium.state)
            return loaded.press_to_scene_load(), loaded
        except StoppedError:
            rest_scene = neighbour.with_modulus(modulus, linear)  # new paths: the failed ones hold the neighbour's state
    return press_with_enough_points(rest_scene, LoadedScene.press_to_scene_load)


def build_path(scene: Scene, linear: Converged, fineness: MeridianFineness, dense: bool = False) -> Path:
    """Build the load path, on a mesh of the given fineness, of the section that the linear solution used."""
    rest_model = linear.sample.states.model
    inclusion = {Body.INCLUSION: scene.inclusion[0]} if scene.inclusion else {}
    section = truncate_half_space(scene, rest_model.section)
    faces, spring = scene.contact, SPRING_SHARES[fineness.order]
    model = ContactModel.from_section(
        section,
        {**rest_model.materials, **inclusion},
        faces.interface,
        fineness,
        faces.friction,
        spring=spring,
        dense=dense,
        films=rest_model.films,
    )
    return Path(model, scene.target is not None, None if faces.interface == "unilateral" else linear.films[0])


def _prepare_check(scene: Scene, linear: Converged, dense: bool = False) -> CornerCheck | None:
    """Return the check of corners onto which tissue folds: those of sharp edges beside faces that are bonded."""
    if scene.contact.interface != "bonded" or scene.contact.edge_radius > 0:
        return None
    return CornerCheck(lambda: build_path(scene, linear, CORNER_FINENESS, dense))


def _tie_faces(scene: Scene) -> Scene:
    """Return the scene for linear elements: faces that may open become frictionless."""
    faces = scene.contact
    if faces.interface != "unilateral":
        return scene
    return scene.model_copy(update={"contact": faces.model_copy(update={"interface": "frictionless", "friction": 0.0})})


def truncate_half_space(scene: Scene, section: Section) -> Section:
    """Return a scene's section, a half-space's cut where strains are negligible: the linear correction removes the effect."""
    if scene.tissue.shape != "half-space":
        return section
    scale = HALF_SPACE_EXTENT_RELATIVE / HALF_SPACE_SIZES
    return replace(section, tissue_radius=scale * section.tissue_radius, tissue_depth=scale * section.tissue_depth)


def _widen_bounds(films: FilmForces, relative_error: float) -> FilmForces:
    """Return film forces, and charges, with bounds widened by a relative error of each."""
    # two forces may err in opposite directions, so that ln of their ratio errs by twice as much
    bound = Bound(films.bound.totals + relative_error * np.abs(films.totals), films.bound.log_ratio + 2 * relative_error)
    error = films.sensitivity_error + relative_error * abs(films.log_sensitivity or 0.0)
    charges = None if films.charges is None else _widen_bounds(films.charges, relative_error)
    return replace(films, bound=bound, sensitivity_error=error, charges=charges)
