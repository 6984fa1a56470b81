"""A scene under load: the linear level's film forces, changed as two meshes say that the load changes them, with bounds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicHermiteSpline, PchipInterpolator

from geometry.common.arrays import Floats
from geometry.common.resources import LimitReached
from geometry.meridian.frame import MeridianFineness
from geometry.meridian.section import Body, Section
from geometry.scenes.probe import Material
from geometry.scenes.scene import Scene
from solver.axisymmetric.converged_forces import Converged, converged_forces
from solver.axisymmetric.sections import HALF_SPACE
from solver.contact.model import ContactModel
from solver.contact.path import Path
from solver.contact.pressed import Pressed, StoppedError
from solver.results.film_forces import Bound, FilmForces

MESHES = tuple(MeridianFineness(1, 0, order) for order in (2, 3, 4))
LINEAR_SHARE = 0.2  # of the accuracy, for the linear level
SAFETY = 2.0  # times the largest difference of two meshes on the way
SMALL = 1e-5  # indentations, in units of a path, that change nothing but by less than ...
UNSEEN = 1e-4  # ... this share, which the least error bound is
FAR = 300.0  # sizes of probe and inclusion: where a half-space ends, for rounding grows with it
ALIKE = 0.2  # a mesh's log-sensitivity at rest nearer to the linear level's than this is off by a factor, else by a difference


@dataclass(frozen=True)
class Loaded:
    """Film forces under one load.

    Attributes:
        point: of the finest path.
        films: per indentation, with bounds; their slopes at the same force.
    """

    point: Pressed
    films: FilmForces


@dataclass(frozen=True)
class LoadedScene:
    """A scene that is pressed on two meshes.

    Attributes:
        scene: bonded, one sphere on the axis at most.
        linear: its film forces at rest.
        paths: on two meshes, the finer last.
    """

    scene: Scene
    linear: Converged
    paths: tuple[Path, Path]

    @classmethod
    def of(cls, scene: Scene, accuracy: float, finest: int = 1) -> LoadedScene:
        """Solve a scene at rest.

        Args:
            scene: see the class.
            accuracy: that is wanted in all, relative.
            finest: number of the finer of the two meshes.

        Raises:
            SolveError: its equations cannot be solved in double precision.
            LimitReached: not within the limits of memory and time.
        """
        linear = converged_forces(scene, LINEAR_SHARE * accuracy)
        return cls._on(scene, linear, finest)

    @classmethod
    def _on(cls, scene: Scene, linear: Converged, finest: int) -> LoadedScene:
        at_rest, totals = linear.sample.states.model, linear.films[0].totals
        materials = dict(at_rest.materials)
        if scene.inclusion:
            body = scene.inclusion[0]
            materials[Body.INCLUSION] = Material(youngs_modulus=body.youngs_modulus, poisson_ratio=body.poisson_ratio)
        section = at_rest.section if scene.tissue.shape != "half-space" else _nearer(at_rest.section)
        models = [ContactModel.of(section, materials, "bonded", MESHES[finest - k]) for k in (1, 0)]
        first, second = (Path(model, scene.target is not None, totals) for model in models)
        return cls(scene, linear, (first, second))

    def finer(self) -> LoadedScene | None:
        """The same on the next two meshes, nothing pressed yet; None where there is no finer one."""
        used = MESHES.index(_fineness(self.paths[1])) if _fineness(self.paths[1]) in MESHES else len(MESHES)
        return None if used + 1 >= len(MESHES) else self._on(self.scene, self.linear, used + 1)

    def at_scene_s_load(self) -> Loaded:
        """Press as the scene's load says.

        Raises:
            StoppedError: no further step converges.
            LimitReached: the time is over.
        """
        load = self.scene.load
        if load.indentation is not None:
            return self.at_indentation(load.indentation)
        return self.at_force(load.force or 0.0)

    def at_force(self, force: float) -> Loaded:
        """Press to a force, N; see ``at_scene_s_load``."""
        stiffness = float(self.linear.films[0].totals.sum())
        return self._at(force / stiffness, lambda path: path.at_force(force))

    def at_indentation(self, indentation: float) -> Loaded:
        """Press to an indentation, m; see ``at_scene_s_load``."""
        return self._at(indentation, lambda path: path.at_indentation(indentation))

    def _at(self, about: float, press: Callable[[Path], Pressed]) -> Loaded:
        """Press both meshes, or neither where the indentation is ``about`` nothing."""
        if about <= SMALL * self.paths[1].unit:
            return Loaded(self.paths[1].points[0], _widened(self.linear.films[0], UNSEEN))
        _, fine = (press(path) for path in self.paths)
        return Loaded(fine, self._films(fine))

    def _films(self, point: Pressed) -> FilmForces:
        """Film forces per indentation with bounds: those of the linear level and what two meshes differ by on the way."""
        rest = self.linear.films[0]
        log_totals, log_ratio, sensitivity = self._differences(point.indentation)
        totals = point.films / point.indentation
        errors = rest.relative_errors + SAFETY * log_totals + UNSEEN
        bound = Bound(errors * np.abs(totals), rest.bound.log_ratio + SAFETY * log_ratio + UNSEEN)
        if rest.slope is None:
            return FilmForces(np.diag(totals), bound)
        value = self.sensitivity(self.paths[1], point)
        grown = abs(value / rest.log_sensitivity) if rest.log_sensitivity else 1.0
        off = rest.sensitivity_error * max(1.0, grown) + SAFETY * sensitivity + UNSEEN * abs(value)
        # at one force the films' changes add up to nothing
        shares = np.array([totals[1], -totals[0]]) / totals.sum() * value
        return FilmForces(np.diag(totals), bound, np.diag(totals * shares), off)

    def sensitivity(self, path: Path, point: Pressed) -> float:
        """The log-sensitivity at a point of a path, what its mesh is off at rest taken off."""
        exact, own = self.linear.films[0].log_sensitivity or 0.0, path.points[0].log_sensitivity
        if own * exact > 0 and abs(own / exact - 1) < ALIKE:
            return point.log_sensitivity * exact / own
        return point.log_sensitivity + exact - own

    def _differences(self, until: float) -> tuple[Floats, float, float]:
        """Largest differences of both meshes up to an indentation: of ln films, shape (2,), ln ratio and log-sensitivity."""
        places = np.unique([point.indentation for path in self.paths for point in path.points])
        places = places[(places > 0) & (places <= until * (1 + 1e-9))]
        (films, first), (others, second) = (self._told(path, places) for path in self.paths)
        off = np.log(np.abs(films / others))
        return np.abs(off).max(axis=1), float(np.abs(off[0] - off[1]).max()), float(np.abs(first - second).max())

    def _told(self, path: Path, places: Floats) -> tuple[Floats, Floats]:
        """Film forces, shape (2, k), and log-sensitivities, (k,), between the points of a path."""
        points = path.points
        at = np.array([point.indentation for point in points])
        films = CubicHermiteSpline(at, [point.films for point in points], [point.tangent for point in points])
        sensitivity = PchipInterpolator(at, [self.sensitivity(path, point) for point in points], extrapolate=True)
        return films(places).T, sensitivity(places)


def loaded(scene: Scene, accuracy: float, good: Callable[[FilmForces], bool]) -> tuple[Loaded, LoadedScene]:
    """Press a scene on meshes as fine as its accuracy needs.

    Args:
        scene: see ``LoadedScene``.
        accuracy: relative.
        good: whether an answer is exact enough.

    Raises:
        StoppedError: no further step converges on either mesh.
        SolveError, LimitReached: see ``LoadedScene.of``.
    """
    on = LoadedScene.of(scene, accuracy)
    found = on.at_scene_s_load()
    while not good(found.films):
        finer = on.finer()
        if finer is None:
            break
        try:
            better = finer.at_scene_s_load()
        except (StoppedError, LimitReached):
            break
        on = finer
        found = better if better.films.bound.log_ratio < found.films.bound.log_ratio else found
    return found, on


def curve(on: LoadedScene, moduli: Floats) -> list[Loaded]:
    """Return a scene's answers at its load for other moduli of its target, each from its neighbour's loaded state.

    Args:
        on: the scene, pressed to its load.
        moduli: Pa, shape (k,).

    Raises:
        SolveError, LimitReached: see ``LoadedScene.of`` and ``at_scene_s_load``.
    """
    own = on.scene.inclusion[0].youngs_modulus
    order = np.argsort(np.abs(np.log(moduli / own)))
    known = {own: on}
    found: dict[int, Loaded] = {}
    for k in order:
        nearest = min(known, key=lambda modulus: abs(np.log(modulus / moduli[k])))
        found[int(k)], known[float(moduli[k])] = _with_modulus(known[nearest], float(moduli[k]))
    return [found[k] for k in range(len(moduli))]


def _with_modulus(near: LoadedScene, modulus: float) -> tuple[Loaded, LoadedScene]:
    """The answer for another modulus, begun at the neighbour's state, or from rest where that does not converge."""
    body = near.scene.inclusion[0].model_copy(update={"youngs_modulus": modulus})
    scene = near.scene.model_copy(update={"inclusion": (body,)})
    linear = converged_forces(scene, LINEAR_SHARE * 0.01)
    finest = MESHES.index(_fineness(near.paths[1]))
    on = LoadedScene._on(scene, linear, finest)
    try:
        for path, other in zip(on.paths, near.paths, strict=True):
            if other.last.equilibrium is not None and other.last.indentation > SMALL * other.unit:
                path.seed(other.last.equilibrium.state)
        return on.at_scene_s_load(), on
    except StoppedError:
        on = LoadedScene._on(scene, linear, finest)
        return on.at_scene_s_load(), on


def _nearer(section: Section) -> Section:
    """A half-space's section with an end where nothing is strained finitely: what it changes at rest is taken off."""
    share = FAR / HALF_SPACE
    return replace(section, tissue_radius=share * section.tissue_radius, tissue_depth=share * section.tissue_depth)


def _fineness(path: Path) -> MeridianFineness:
    return path.model.mesh.layout.fineness


def _widened(films: FilmForces, share: float) -> FilmForces:
    """Film forces with wider bounds."""
    bound = Bound(films.bound.totals + share * np.abs(films.totals), films.bound.log_ratio + 2 * share)
    error = films.sensitivity_error + share * abs(films.log_sensitivity or 0.0)
    return replace(films, bound=bound, sensitivity_error=error)
