"""The closed form as an evaluator, for one scene or for many: scenes of one structure share one evaluation on arrays.

Each result is bit for bit that of the scene alone: what numpy and LAPACK do to one column of ``designs.compute_forces`` does
not depend on the other columns, as long as these come in fours, the variants of one scene;
``tests/solver/closed_form/test_level.py`` holds that.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import accumulate

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import InputError, Refusal
from geometry.common.resources import LimitReached, limited, limits, timed
from geometry.scenes.probe import Material
from geometry.scenes.scene import Inclusion, Scene
from solver.closed_form.designs import PROBE, TISSUE, Shape, answers, parameters, split
from solver.closed_form.error_bound import StatedErrors, errors
from solver.closed_form.error_features import CHANGED, STEP
from solver.layers.materials import material_layers
from solver.layers.measures import squeezed
from solver.linalg.workspace import in_own_workspace
from solver.results.evaluator import Answer, FilmLevel, Tell
from solver.results.film_forces import FilmForces, shortfalls
from solver.results.kinds import needs_solid

LEAST_COVER = 0.1  # of an inclusion, in its diameters
LARGEST_ERROR = 2.9  # of ln(ratio): scenes with a larger bound are refused
LARGEST_RESIDUAL = 1e-10
LEAST_DEPTH = 0.1  # of the tissue, in outer radii
# Poisson's ratios up to which rounding, in differences of terms that go with 1 / (1 - 2 nu), stays below a seventh of the stated
# errors; in tissue with a tumour it grows with the third power, and is beyond them from 0.4999999 on. ``tests`` hold both.
LARGEST_RATIO = {"tissue": 0.499999, "block": 0.499999999999}
FAR_SIDE_NODES = 16  # for sides as near as none that are left out
LARGEST_SQUEEZE = 50.0  # see ``solver.layers.measures``: beyond it totals are up to nine times too small
BROKEN = "axisymmetric, as the formulas break down for this scene"


@dataclass(frozen=True)
class ClosedFormForces:
    """Film forces with their bounds, the bounds on their errors, and the residual of eq. CF.12."""

    films: FilmForces
    errors: StatedErrors
    residual: float


@dataclass(frozen=True)
class ClosedForm(FilmLevel):
    """Two elastic blocks on an elastic layer, spheres by equivalent inclusion with their image: a first look, and the search."""

    name: str = "closed-form"
    summary: str = "formulas; spheres anywhere, covered by a tenth of their diameter; 1 to 30 % in milliseconds"

    def refusal(self, scene: Scene) -> str | None:
        """Return which evaluator to use instead, and why, for scenes that the formulas do not cover; else None."""
        if needs_solid(scene) is not None:
            return needs_solid(scene)
        if any(body.diameter is None for body in scene.inclusion):
            return "equivalent-inclusion or solid for an ellipsoid"
        if any(body.depth - body.diameter / 2 < LEAST_COVER * body.diameter for body in scene.inclusion if body.diameter):
            return f"axisymmetric for an inclusion covered by less than {LEAST_COVER:g} of its diameter"
        if any(_at_an_interface(body, scene) for body in scene.inclusion):
            return f"axisymmetric or solid for an inclusion nearer to an interface of layers than {LEAST_COVER:g} of its diameter"
        if scene.tissue.shape != "half-space" and scene.tissue.depth < LEAST_DEPTH * scene.probe.tube_radius:
            return f"axisymmetric for tissue thinner than {LEAST_DEPTH:g} outer radii"
        if squeezed(scene) > LARGEST_SQUEEZE:
            return "axisymmetric for a layer that blocks squeeze because it is thin and softer than its neighbours"
        return nearly_incompressible(scene)

    def answer(self, scene: Scene, accuracy: float, moduli: Floats | None = None) -> Answer:
        """Solve the scene with the formulas, with a warning where their error bound is above ``accuracy``.

        Raises:
            Refusal: the scene is of another kind, or the formulas break down.
        """
        scenes = [scene] if moduli is None else [_with_modulus(scene, one) for one in moduli.tolist()]
        every = []
        for one in self.films(scenes):
            if isinstance(one, InputError):
                raise one
            every.append(one)
        worst = max(every, key=lambda one: one.errors.largest)
        notes = tuple(shortfalls(worst.films, worst.errors.largest, accuracy))
        return Answer(tuple(one.films for one in every), max(one.residual for one in every), notes=notes)

    @in_own_workspace
    def answers(self, scenes: Sequence[Scene], accuracies: Sequence[float]) -> list[Answer | InputError]:
        """Solve each scene at its accuracy, or return its refusal; scenes of one structure are solved at once."""
        try:
            with limited(replace(limits(), seconds=len(scenes) * limits().seconds)), timed():
                found = self.films(scenes)
        except LimitReached:
            return super().answers(scenes, accuracies)
        pairs = zip(found, accuracies, strict=True)
        return [one if isinstance(one, InputError) else _answer(one, accuracy) for one, accuracy in pairs]

    @in_own_workspace
    def films(self, scenes: Sequence[Scene]) -> list[ClosedFormForces | InputError]:
        """Return the film forces of each scene with their error bounds, or its refusal."""
        every: dict[int, ClosedFormForces | InputError] = {}
        groups: dict[Shape, list[tuple[int, Floats]]] = defaultdict(list)
        for place, scene in enumerate(scenes):
            why = self.refusal(scene)
            if why is not None:
                every[place] = Refusal("evaluator", self.name, why)
                continue
            shape, values = parameters(scene)
            groups[shape].append((place, values))
        for shape, group in groups.items():
            stacked = variants(shape, [values for _, values in group])
            for (place, _), *one in zip(group, *stacked, strict=True):
                every[place] = self._bounded(scenes[place], *one)
        return [every[place] for place in range(len(scenes))]

    def _bounded(self, scene: Scene, forces: Floats, slopes: Floats, residuals: Floats) -> ClosedFormForces | InputError:
        """Return a scene's film forces with error bounds from its variants, or the refusal where the formulas break down."""
        if not (np.all(np.isfinite(forces)) and np.all(forces.sum(axis=2) > 0) and np.all(residuals < LARGEST_RESIDUAL)):
            return Refusal("evaluator", self.name, BROKEN)
        error = errors(scene, forces, slopes)
        if error.log_ratio > LARGEST_ERROR:
            return Refusal("evaluator", self.name, BROKEN)
        slope = slopes[0] if scene.target is not None else None
        films = FilmForces(forces[0], error.bound(forces[0].sum(axis=1)), slope, error.sensitivity)
        return ClosedFormForces(films, error, float(residuals[0]))


def _answer(forces: ClosedFormForces, accuracy: float) -> Answer:
    return Answer((forces.films,), forces.residual, notes=tuple(shortfalls(forces.films, forces.errors.largest, accuracy)))


def _at_an_interface(body: Inclusion, scene: Scene) -> bool:
    """Return whether two layers of different materials meet in a sphere, or nearer to it than ``MIN_COVER_DIAMETERS``."""
    faces = accumulate(layer[0] for layer in material_layers(scene.tissue))
    return any(abs(body.depth - face) < (0.5 + LEAST_COVER) * (body.diameter or 0.0) for face in faces)


def nearly_incompressible(scene: Scene) -> str | None:
    """Return which Poisson's ratio is too near to 0.5 for the formulas in double precision, and its limit; else None."""
    probe = scene.probe
    bodies: dict[str, tuple[str, Material]] = {
        "probe.inner": ("block", probe.inner),
        "probe.outer": ("block", probe.outer),
        "tissue": ("tissue", scene.tissue),
    }
    bodies |= {f"tissue.layer[{index}]": ("tissue", layer) for index, layer in enumerate(scene.tissue.layer)}
    for key, (kind, body) in bodies.items():
        if body.poisson_ratio > LARGEST_RATIO[kind] and (scene.inclusion or kind == "block"):
            return f"{key}.poisson_ratio up to {LARGEST_RATIO[kind]:.12g}, or another evaluator"
    return None


def _with_modulus(scene: Scene, modulus: float) -> Scene:
    """Return the scene with another Young's modulus of its target, Pa."""
    bodies = list(scene.inclusion)
    target = scene.target or 0
    bodies[target] = bodies[target].model_copy(update={"youngs_modulus": modulus})
    return scene.model_copy(update={"inclusion": tuple(bodies)})


def variants(shape: Shape, values: Sequence[Floats]) -> tuple[Floats, Floats, Floats]:
    """Return forces, slopes and residuals of designs and of the variants for their error bounds, ordered as ``ALL_VARIANTS``.

    Args:
        shape: of all the designs.
        values: the parameters of each, see ``designs.build_parameters``.

    Returns:
        two arrays of shape (designs, variants, 2, 2), not finite or not positive where the formulas break down, and one of
        shape (designs, variants).
    """
    columns = np.concatenate([_variants(shape, one) for one in values], axis=1)
    plain = _asked(shape, columns)
    other = _asked(other_sides(shape), columns) if shape.bounded else plain
    finer = _asked(replace(shape, fine=True), columns)
    forces, slopes, residuals = (
        np.concatenate([one, two[:, :1], three[:, :1]], axis=1) for one, two, three in zip(plain, other, finer, strict=True)
    )
    return forces, slopes, residuals


def _asked(shape: Shape, columns: Floats) -> tuple[Floats, Floats, Floats]:
    """Return forces, slopes and residuals of the variants of designs that have other parameters."""
    with np.errstate(all="ignore"):
        parts = [(one.forces, one.slope, one.residual) for one in answers(shape, columns)]
        forces, slopes, residuals = (np.concatenate(part) for part in zip(*parts, strict=True))
    size = -1, len(CHANGED)
    return forces.reshape(*size, 2, 2), slopes.reshape(*size, 2, 2), residuals.reshape(size)


def other_sides(shape: Shape) -> Shape:
    """Return the structure that models the sides which ``shape`` leaves out, or leaves out those that it models."""
    return replace(shape, side_nodes=0 if shape.side_nodes else FAR_SIDE_NODES)


def _variants(shape: Shape, values: Floats) -> Floats:
    """Return the parameters of the variants ``PARAMETER_VARIANTS`` as columns."""
    own = values[len(PROBE) + len(TISSUE) - 2 : len(PROBE) + len(TISSUE)]
    columns = {"scene": values}
    for name in ("inner_modulus", "outer_modulus"):
        columns[name] = values.copy()
        columns[name][PROBE.index(name)] *= STEP
    columns["no inclusions"] = values.copy()
    bodies, layers = split(shape, columns["no inclusions"])
    materials = [*layers[:, 1:], own]
    for body, place in zip(bodies, shape.homes, strict=True):
        body[-2:] = materials[place]
    return np.stack([columns[name] for name in CHANGED], axis=1)


def level(tell: Tell | None = None) -> ClosedForm:
    """Return the evaluator; it reports no progress."""
    return ClosedForm()
