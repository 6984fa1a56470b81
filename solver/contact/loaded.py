"""Compute film forces under load: the linear result, corrected by the changes that two meshes show, with error bounds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicHermiteSpline, PchipInterpolator

from geometry.common.arrays import Floats
from geometry.common.errors import Refusal, Words
from geometry.meridian.frame import MeridianFineness
from geometry.meridian.section import Body, Section
from geometry.scenes.probe import Material
from geometry.scenes.scene import Scene
from solver.axisymmetric.converged_forces import Converged, converged_forces
from solver.axisymmetric.sections import HALF_SPACE
from solver.contact.model import ContactModel
from solver.contact.path import Path
from solver.contact.pressed import NONE, Differences, Loaded, Pressed, StoppedError
from solver.results.film_forces import Bound, FilmForces

MESHES = tuple(MeridianFineness(1, 0, order) for order in (2, 3, 4))
SPRINGS = {2: 0.25, 3: 0.5, 4: 1.0}  # friction springs' stiffness by mesh order, so that meshes show the springs' error
LINEAR_SHARE = 0.2  # of the accuracy, for the linear solution
SAFETY = 2.0  # times the maximum difference of two meshes on the load path
SMALL = 1e-5  # indentation, in units of a path, below which the linear result holds within ...
LIGHT = 1e-3  # likewise where faces may open: the contact area no longer changes below it
UNSEEN = 1e-4  # ... this relative amount, the minimum error bound
FAR_TOO_DEEP = 3.0  # outer radii, estimated by the linear stiffness
FAR = 300.0  # sizes of probe and inclusion: where a half-space is cut, because rounding errors grow with its size
UNCUT = 0.05  # relative, times (edge radius / minimum block size)^2: round edges change the contact lines alone, not the blocks
PASSING = (0.005, 0.05)  # relative errors of ratio and log-sensitivity where faces open: points pass an edge one by one
ALIKE = 0.2  # relative: meshes nearer to the linear log-sensitivity are corrected by a factor


@dataclass(frozen=True)
class LoadedScene:
    """A scene on two meshes, with the load paths computed so far.

    Attributes:
        scene: a scene with at most one sphere, on the axis.
        accuracy: relative accuracy of the result.
        linear: linear film forces; where faces may open, those of frictionless faces, for scale only.
        paths: load paths on two meshes, the finer last.
        known: mesh differences on the part of the load path that was not computed because the path began at a loaded state of
            another modulus.
    """

    scene: Scene
    accuracy: float
    linear: Converged
    paths: tuple[Path, Path]
    known: Differences = NONE

    @classmethod
    def of(cls, scene: Scene, accuracy: float) -> LoadedScene:
        """Solve a scene at rest, linearly and on two meshes.

        Raises:
            SolveError: the equations cannot be solved in double precision.
            LimitReached: a limit of memory or time is exceeded.
        """
        linear = converged_forces(_tied(scene), LINEAR_SHARE * accuracy)
        first, second = (_path(scene, linear, fineness) for fineness in MESHES[:2])
        return cls(scene, accuracy, linear, (first, second))

    @property
    def opening(self) -> bool:
        """Whether faces may open: the linear result is then not their limit, nor another modulus' state a start."""
        return self.scene.contact.interface == "unilateral"

    def finer(self) -> LoadedScene | None:
        """Return the scene on the finer mesh and the next finer one; None if there is none."""
        following = MESHES.index(self.paths[1].model.mesh.layout.fineness) + 1
        if following == len(MESHES):
            return None
        return replace(self, paths=(self.paths[1], _path(self.scene, self.linear, MESHES[following])))

    def with_modulus(self, modulus: float, linear: Converged) -> LoadedScene:
        """Return the scene at rest with another Young's modulus of the target, Pa, and its linear film forces."""
        body = self.scene.inclusion[0].model_copy(update={"youngs_modulus": modulus})
        scene = self.scene.model_copy(update={"inclusion": (body,)})
        known = None if self.opening else linear.films[0].totals
        first, second = (Path(path.model.with_modulus(modulus), True, known) for path in self.paths)
        return LoadedScene(scene, self.accuracy, linear, (first, second))

    def at_scene_s_load(self) -> Loaded:
        """Press the probe to the scene's load.

        Raises:
            StoppedError: no further step converges.
            LimitReached: the time limit is reached.
        """
        load = self.scene.load
        if load.indentation is not None:
            return self.at_indentation(load.indentation)
        return self.at_force(load.force or 0.0)

    def at_force(self, force: float, key: str = "load.force") -> Loaded:
        """Press to a force, N; see ``press_to_scene_load``.

        Raises:
            Refusal: the force, named by ``key``, is far above what any path reaches.
        """
        about, radius = force / self._stiffness, self.paths[1].radius
        if about > FAR_TOO_DEEP * radius:
            most = f"for contact less than some {self._stiffness * radius:.2g} N, which drives it as deep as it is wide"
            raise Refusal(key, Words(f"{force:g} N"), most)
        return self._at(about, lambda path: path.at_force(force))

    @property
    def _stiffness(self) -> float:
        return float(self.paths[1].points[0].tangent.sum())

    @property
    def unseen(self) -> tuple[float, float]:
        """Minimum error bounds of film forces and log-sensitivity, relative: errors that no two meshes show.

        Where edges are round, blocks keep the material beyond the arcs. Where faces open, points pass an edge one by one.
        """
        s = self.paths[1].model.section
        sizes = (s.inner_radius, s.tube_radius - s.hole_radius, s.inner_height, s.outer_height)
        least = UNSEEN + UNCUT * float(s.edge_radius / min(sizes)) ** 2
        films, slopes = PASSING if self.opening else (0.0, 0.0)
        return least + films, least + slopes

    def at_indentation(self, indentation: float) -> Loaded:
        """Press to an indentation, m; see ``press_to_scene_load``."""
        return self._at(indentation, lambda path: path.at_indentation(indentation))

    def _at(self, about: float, press: Callable[[Path], Pressed]) -> Loaded:
        """Press both meshes, or scale the light-load result if the estimated indentation is negligible."""
        unit = self.paths[1].unit
        if self.opening and about < LIGHT * unit:
            light = self.at_indentation(LIGHT * unit)
            point = replace(light.point, indentation=about, films=about / (LIGHT * unit) * light.point.films)
            return Loaded(point, light.films)
        if about <= SMALL * unit:
            rest = self.paths[1].points[0]
            point = replace(rest, indentation=about, films=about * rest.tangent)
            return Loaded(point, _widened(self.linear.films[0], max(self.unseen)))
        _, fine = (press(path) for path in self.paths)
        return Loaded(fine, self._films(fine))

    def _films(self, point: Pressed) -> FilmForces:
        """Return film forces per indentation, bounded by the linear errors and the differences of the two meshes."""
        rest, off = self.linear.films[0], self.differences(point.indentation)
        totals = point.films / point.indentation
        least, least_slope = self.unseen
        errors = rest.relative_errors + SAFETY * off.films + least
        bound = Bound(errors * np.abs(totals), rest.bound.log_ratio + SAFETY * off.log_ratio + least)
        if rest.slope is None:
            return FilmForces(np.diag(totals), bound)
        value = self.sensitivity(self.paths[1], point)
        grown = abs(value / rest.log_sensitivity) if rest.log_sensitivity else 1.0
        own = (SAFETY * off.sensitivity + least_slope) * self._size(point.indentation)
        error = rest.sensitivity_error * max(1.0, grown) + own
        # at constant force the changes of the two film forces cancel
        shares = np.array([totals[1], -totals[0]]) / totals.sum() * value
        return FilmForces(np.diag(totals), bound, np.diag(totals * shares), error)

    def sensitivity(self, path: Path, point: Pressed) -> float:
        """Return the log-sensitivity at a point of a path, corrected for the mesh's error at rest if that is known."""
        if self.opening:
            return point.log_sensitivity
        exact, own = self.linear.films[0].log_sensitivity or 0.0, path.points[0].log_sensitivity
        if own * exact > 0 and abs(own / exact - 1) < ALIKE:
            return point.log_sensitivity * exact / own
        return point.log_sensitivity + exact - own

    def differences(self, until: float) -> Differences:
        """Return the maximum differences of both meshes up to an indentation, m."""
        places = np.unique([until, *(point.indentation for path in self.paths for point in path.points)])
        places = places[(places > 0) & (places <= until)]
        (films, first), (others, second) = (self._told(path, places) for path in self.paths)
        off, size = np.log(np.abs(films / others)), self._size(until)
        sensitivity = float(np.abs(first - second).max()) / size if size else 0.0
        return Differences(np.abs(off).max(axis=1), float(np.abs(off[0] - off[1]).max()), sensitivity) | self.known

    def _size(self, until: float) -> float:
        """Return the maximum magnitude of the log-sensitivity up to an indentation, m."""
        path = self.paths[1]
        return max(abs(self.sensitivity(path, point)) for point in path.points if point.indentation <= until)

    def _told(self, path: Path, places: Floats) -> tuple[Floats, Floats]:
        """Interpolate film forces, shape (2, k), and log-sensitivities, (k,), between the points of a path."""
        points = path.points
        at = np.array([point.indentation for point in points])
        films = CubicHermiteSpline(at, [point.films for point in points], [point.tangent for point in points])
        sensitivity = PchipInterpolator(at, [self.sensitivity(path, point) for point in points], extrapolate=True)
        return films(places).T, sensitivity(places)


def curve(on: LoadedScene, moduli: Floats) -> list[Loaded]:
    """Return film forces at a scene's load for other moduli of the target, each started from its neighbour's state.

    Args:
        loaded: the scene, pressed to its load.
        moduli: Young's moduli, Pa, shape (k,).

    Raises:
        SolveError, LimitReached: see ``LoadedScene.from_scene`` and ``LoadedScene.press_to_scene_load``.
    """
    every = converged_forces(_tied(on.scene), LINEAR_SHARE * on.accuracy, moduli)
    far = np.log(moduli / on.scene.inclusion[0].youngs_modulus)
    found: dict[int, Loaded] = {}
    for side in (far >= 0, far < 0):
        near = on
        for k in sorted(np.flatnonzero(side).tolist(), key=lambda k: abs(far[k])):
            found[k], near = _beside(near, float(moduli[k]), replace(every, films=(every.films[k],)))
    return [found[k] for k in range(len(moduli))]


def beside(near: LoadedScene, modulus: float) -> tuple[Loaded, LoadedScene]:
    """Return the film forces for one other modulus, and the pressed scene as a start for more; see ``compute_modulus_curve``."""
    linear = converged_forces(_tied(near.scene), LINEAR_SHARE * near.accuracy, np.array([modulus]))
    return _beside(near, modulus, linear)


def _beside(near: LoadedScene, modulus: float, linear: Converged) -> tuple[Loaded, LoadedScene]:
    """Solve for another modulus from the neighbour's state, or from rest if that does not converge."""
    at_rest = near.with_modulus(modulus, linear)
    last = near.paths[1].last.indentation
    if near.opening or last <= SMALL * near.paths[1].unit:
        return at_rest.at_scene_s_load(), at_rest
    on = replace(at_rest, known=near.differences(last))
    try:
        for path, other in zip(on.paths, near.paths, strict=True):
            path.seed(other.last.equilibrium.state)
        return on.at_scene_s_load(), on
    except StoppedError:
        on = near.with_modulus(modulus, linear)
        return on.at_scene_s_load(), on


def _path(scene: Scene, linear: Converged, fineness: MeridianFineness) -> Path:
    """Build the load path, on one mesh, of the section that the linear solution used."""
    at_rest, materials = linear.sample.states.model, {}
    if scene.inclusion:
        body = scene.inclusion[0]
        materials[Body.INCLUSION] = Material(youngs_modulus=body.youngs_modulus, poisson_ratio=body.poisson_ratio)
    section = at_rest.section if scene.tissue.shape != "half-space" else _nearer(at_rest.section)
    faces, spring = scene.contact, SPRINGS[fineness.order]
    model = ContactModel.of(section, {**at_rest.materials, **materials}, faces.interface, fineness, faces.friction, spring=spring)
    return Path(model, scene.target is not None, None if faces.interface == "unilateral" else linear.films[0].totals)


def _tied(scene: Scene) -> Scene:
    """Return the scene for linear elements: faces that may open become frictionless."""
    faces = scene.contact
    if faces.interface != "unilateral":
        return scene
    return scene.model_copy(update={"contact": faces.model_copy(update={"interface": "frictionless", "friction": 0.0})})


def _nearer(section: Section) -> Section:
    """Cut a half-space's section where strains are negligible; the linear correction at rest removes the effect of the cut."""
    share = FAR / HALF_SPACE
    return replace(section, tissue_radius=share * section.tissue_radius, tissue_depth=share * section.tissue_depth)


def _widened(films: FilmForces, share: float) -> FilmForces:
    """Return film forces with bounds widened by a relative amount."""
    bound = Bound(films.bound.totals + share * np.abs(films.totals), films.bound.log_ratio + 2 * share)
    error = films.sensitivity_error + share * abs(films.log_sensitivity or 0.0)
    return replace(films, bound=bound, sensitivity_error=error)
