"""Differentiate films and stiffness under load by numbers of the scene: by how much the load changes these derivatives.

At an equilibrium the forces f(u, x) of the state u and the number x balance. One step of Newton's method from u with the changed
number gives the outputs y to first order in dx, with the tangent of the unchanged model; central differences over such steps give
dy/dx at one indentation w, and at one force F, the sum of the film forces,

    d ln y / dx |_F = (1/y) (dy/dx - (dy/dw) (dF/dx) / (dF/dw))                                    (CT.12)

Its difference between the loaded and a very light state is what the load adds to the exact derivatives of linear elasticity.
Nodes move with the section's lengths, and everything is differentiated on one mesh. A log-sensitivity is differentiated between
states that are solved anew.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from geometry.common.arrays import Floats
from geometry.meridian.section import Body
from geometry.scenes.variables import list_values
from solver.axisymmetric.sections import add_details, build_sections
from solver.contact.loaded_scene import LoadedScene, truncate_half_space
from solver.contact.model import ContactModel
from solver.contact.path import Path
from solver.contact.states import Equilibrium, Linearised, PathPoint, State
from solver.contact.tangent_outputs import STEP_RELATIVE as PRELOAD_STEP
from solver.linalg.threads import limit_to_one_thread
from solver.materials.hyperelastic import Hyperelastic

Sides = tuple[ContactModel, ContactModel]  # for a number below and above its own value
STEP_RELATIVE = 1e-3  # of a number: the differences' error is its square, and rounding errors of light states stay below it
SENSITIVITY_STEP_RELATIVE = 0.01  # likewise, of log-sensitivities: Newton's method leaves errors of 1e-6 in them


@dataclass(frozen=True)
class LoadedDerivatives:
    """Derivatives of the logarithms of k outputs under a load: both film forces and, where they are modelled, both charges.

    They are those at the scene's force, or at its indentation.

    Attributes
    ----------
    growths
        What the load adds to the derivatives by v numbers of the scene, per SI unit, shape (v, k).
    by_force
        Derivatives by ln of the force, less the 1 of linear elasticity, shape (k,); 0 about a preload.
    stiffness
        What the load adds to the derivatives of ln of the stiffness, shape (v,).
    sensitivities
        What it adds to those of the log-sensitivities of the forces' and the charges' ratio, shape (v, k / 2); None where they
        are not wanted.
    """

    growths: Floats
    by_force: Floats
    stiffness: Floats
    sensitivities: Floats | None = None


@dataclass(frozen=True)
class _Point:
    """An equilibrium with its tangent factorised.

    Attributes
    ----------
    state, equations
        The state and the equations about it.
    outputs
        The k outputs, and the indentation as the last, shape (k + 1,).
    tangent
        Derivatives of the k outputs by indentation, shape (k,).
    """

    state: State
    equations: Linearised
    outputs: Floats
    tangent: Floats

    @classmethod
    def from_equilibrium(cls, model: ContactModel, equilibrium: Equilibrium) -> _Point:
        """Factorise the tangent of an equilibrium."""
        equations, state = model.factorise_tangent(equilibrium.equations), equilibrium.state
        _, derivatives = model.compute_responses(state, equations)
        return cls(state, equations, np.append(model.compute_outputs(equations), state.indentation), derivatives[:, 0])

    @property
    def force(self) -> float:
        """Force on the base, N."""
        return float(self.outputs[:2].sum())

    @property
    def by_force(self) -> Floats:
        """Derivatives of ln of the k outputs by ln of the force, shape (k,)."""
        return np.asarray(self.tangent / self.tangent[:2].sum() * self.force / self.outputs[:-1])

    def differentiate(self, sides: Sides, distance: float, fixed: str) -> Floats:
        """Return eq. CT.12, and the derivative of ln of the secant stiffness as the last, shape (k + 1,).

        Parameters
        ----------
        sides
            The models on both sides, whose numbers are ``distance`` apart.
        distance
            See above, SI.
        fixed
            What the load fixes, "force" or "indentation".
        """
        low, high = (side.predict_outputs(side.linearise(self.state, self.equations, keep_tangent=True)) for side in sides)
        change = (high - low) / distance
        if fixed == "indentation":
            return np.append(change / self.outputs[:-1], change[:2].sum() / self.force)
        deeper = -change[:2].sum() / self.tangent[:2].sum()
        return np.append((change + self.tangent * deeper) / self.outputs[:-1], -deeper / self.outputs[-1])


def compute_loaded_derivatives(loaded: LoadedScene, names: Sequence[str], *, sensitive: bool = False) -> LoadedDerivatives:
    """Return the derivatives under the scene's load, or where it has a preload those of the tangent response about it.

    Parameters
    ----------
    loaded
        The scene on its load paths, of which the coarser is used; the load is above zero and not light.
    names
        Keys of ``list_values`` of the scene.
    sensitive
        Whether to differentiate the log-sensitivity, too, of a scene with a target and without preload.

    Raises
    ------
    StoppedError
        No step converges up to the load.
    """
    path, load, values = loaded.paths[0], loaded.scene.load, list_values(loaded.scene)
    with limit_to_one_thread():
        if load.indentation is not None:
            pressed, fixed = [path.press_to_indentation(load.indentation)], "indentation"
        else:
            forces = [load.preload * (1 + side * PRELOAD_STEP) for side in (-1, 1)] if load.preload else [load.force or 0.0]
            pressed, fixed = [path.press_to_force(force) for force in forces], "force"
        points = [_Point.from_equilibrium(path.model, item) for item in (path.light, *(point.equilibrium for point in pressed))]
        growths, by_force = np.zeros((len(names), len(points[0].outputs))), _combine(points[1:], [x.by_force for x in points[1:]])
        sensitivities = np.zeros((len(names), len(by_force) // 2)) if sensitive else None
        for row, name in enumerate(names):
            value = values[name]
            size = min(value, 0.5 - value) if name.endswith("poisson_ratio") else value
            if size == 0:
                continue
            step = STEP_RELATIVE * size
            sides = _change_model(loaded, {name: value - step}), _change_model(loaded, {name: value + step})
            at_rest, *derivatives = (point.differentiate(sides, 2 * step, fixed) for point in points)
            growths[row] = _combine(points[1:], derivatives) - at_rest
            if sensitivities is not None:
                step = SENSITIVITY_STEP_RELATIVE * size
                sides = _change_model(loaded, {name: value - step}), _change_model(loaded, {name: value + step})
                sensitivities[row] = _differentiate_sensitivities(path, pressed[0].force, points[1], sides, fixed) / (2 * step)
    is_ratio = load.preload > 0
    return LoadedDerivatives(
        growths[:, :-1], np.zeros_like(by_force) if is_ratio else by_force - 1, growths[:, -1], sensitivities
    )


def _combine(points: Sequence[_Point], derivatives: Sequence[Floats]) -> Floats:
    """Return derivatives of logarithms of the outputs at one point, or of their differences between two, their shape."""
    if len(points) == 1:
        return derivatives[0]
    low, high = (point.outputs[: len(derivatives[0])] for point in points)
    return np.asarray((high * derivatives[1] - low * derivatives[0]) / (high - low))


def _differentiate_sensitivities(path: Path, force: float, point: _Point, sides: Sides, fixed: str) -> Floats:
    """Return the difference of what the load adds to the log-sensitivities on both sides of a number, shape (k / 2,).

    ``force`` is that at the point of the path, N, and ``point`` the equilibrium there.
    """
    nearby = [path.press_to_force(force * (1 + side * PRELOAD_STEP)) for side in (-1, 1)]
    by_log_force = np.subtract(*map(_list_sensitivities, nearby[::-1])) / math.log(nearby[1].force / nearby[0].force)
    added = []
    for side in sides:
        changed = Path(side, sensitive=True)
        moved = changed.seed(point.state)
        heavier = math.log(moved.force / point.force) if fixed == "force" else 0.0
        added.append(_list_sensitivities(moved) - _list_sensitivities(changed.points[0]) - by_log_force * heavier)
    return np.asarray(added[1] - added[0])


def _list_sensitivities(point: PathPoint) -> Floats:
    """Return the log-sensitivities of the forces' ratio and, where they are modelled, of the charges' at a point."""
    return np.array([outputs.log_sensitivity for outputs in (point.forces, point.charges) if outputs is not None])


def _change_model(loaded: LoadedScene, values: dict[str, float]) -> ContactModel:
    """Return the coarser path's model for other numbers of the scene, on the same mesh, with the same lines that may touch."""
    scene, model = loaded.scene.replace(values), loaded.paths[0].model
    sections, faces = build_sections(scene), scene.contact
    if loaded.linear.sample.states.model.section.has_details:
        sections = add_details(scene, sections)
    section = truncate_half_space(scene, sections.section)
    changed = ContactModel.from_section(
        section, model.materials, faces.interface, model.mesh.layout.fineness, faces.friction,
        dense=loaded.dense, films=sections.films, mesh=model.mesh,
    )  # fmt: skip
    pairs = tuple(replace(pair, spring=old.spring) for pair, old in zip(changed.pairs, model.pairs, strict=True))
    # with other materials no line changes its part, slave or master
    laws = Hyperelastic.from_materials([sections.materials[Body(body)] for body in model.mesh.body])
    materials = {body: sections.materials[body] for body in model.materials}
    return replace(changed, materials=materials, pairs=pairs, elements=replace(changed.elements, material=laws))
