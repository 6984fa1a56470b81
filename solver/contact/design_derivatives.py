"""Differentiate film forces and charges under load by numbers of the scene: by how much the load changes these derivatives.

At an equilibrium the forces f(u, x) of the state u and the number x balance. One step of Newton's method from u with the changed
number gives the outputs y to first order in dx, with the tangent of the unchanged model; central differences over such steps give
dy/dx at one indentation w, and at one force F, the sum of the film forces,

    d ln y / dx |_F = (1/y) (dy/dx - (dy/dw) (dF/dx) / (dF/dw))                                    (CT.12)

Its difference between the loaded and a very light state is what the load adds to the exact derivatives of linear elasticity.
Nodes move with the section's lengths, and everything is differentiated on one mesh.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from geometry.common.arrays import Floats
from geometry.meridian.section import Body
from geometry.scenes.scene import Scene
from geometry.scenes.variables import list_values
from solver.axisymmetric.sections import add_details, build_sections
from solver.contact.loaded_scene import LoadedScene, truncate_section
from solver.contact.model import ContactModel
from solver.contact.states import Equilibrium, Linearised, State
from solver.contact.tangent_outputs import STEP_RELATIVE as PRELOAD_STEP
from solver.materials.hyperelastic import Hyperelastic

STEP_RELATIVE = 1e-3  # of a number: the differences' error is its square, and rounding errors of light states stay below it


@dataclass(frozen=True)
class LoadedDerivatives:
    """Derivatives of the logarithms of k outputs under one force: both film forces and, where they are modelled, both charges.

    Attributes
    ----------
    growths
        What the load adds to the derivatives by v numbers of the scene, at constant force, per SI unit, shape (v, k).
    by_force
        Derivatives by ln of the force, less the 1 of linear elasticity, shape (k,).
    """

    growths: Floats
    by_force: Floats


@dataclass(frozen=True)
class _Point:
    """An equilibrium with its tangent factorised, its k outputs and their derivatives by indentation, shape (k,) both."""

    state: State
    equations: Linearised
    outputs: Floats
    tangent: Floats

    @classmethod
    def from_equilibrium(cls, model: ContactModel, equilibrium: Equilibrium) -> _Point:
        """Factorise the tangent of an equilibrium."""
        equations = model.factorise_tangent(equilibrium.equations)
        _, derivatives = model.compute_responses(equilibrium.state, equations)
        return cls(equilibrium.state, equations, model.compute_outputs(equations), derivatives[:, 0])

    def differentiate(self, sides: tuple[ContactModel, ContactModel], distance: float) -> Floats:
        """Return eq. CT.12 from the models on both sides, whose numbers are ``distance`` apart, shape (k,)."""
        low, high = (side.predict_outputs(side.linearise(self.state, self.equations, keep_tangent=True)) for side in sides)
        change = (high - low) / distance
        return np.asarray((change - self.tangent * (change[:2].sum() / self.tangent[:2].sum())) / self.outputs)


def compute_loaded_derivatives(loaded: LoadedScene, force: float, names: Sequence[str]) -> LoadedDerivatives:
    """Return the derivatives under a force, N, or under the scene's preload those of the tangent response about it.

    Parameters
    ----------
    loaded
        The scene on its load paths, of which the coarser is used.
    force
        On the base, above zero and not light; of no account where the scene has a preload.
    names
        Keys of ``list_values`` of the scene.

    Raises
    ------
    StoppedError
        No step converges up to the force.
    """
    path, preload = loaded.paths[0], loaded.scene.load.preload
    forces = [preload * (1 - PRELOAD_STEP), preload * (1 + PRELOAD_STEP)] if preload else [force]
    equilibria = [path.light, *(path.press_to_force(value).equilibrium for value in forces)]
    light, *points = (_Point.from_equilibrium(path.model, equilibrium) for equilibrium in equilibria)
    growths = np.zeros((len(names), len(light.outputs)))
    for row, name in zip(growths, names, strict=True):
        value = list_values(loaded.scene)[name]
        step = STEP_RELATIVE * (min(value, 0.5 - value) if name.endswith("poisson_ratio") else value)
        if step == 0:
            continue
        below, above = (_change_model(loaded, path.model, loaded.scene.replace({name: value + h})) for h in (-step, step))
        at_rest, *derivatives = (point.differentiate((below, above), 2 * step) for point in (light, *points))
        row[:] = _combine(points, derivatives) - at_rest
    by_force = _combine(points, [point.tangent / point.tangent[:2].sum() * _sum(point) / point.outputs for point in points])
    return LoadedDerivatives(growths, np.zeros_like(by_force) if preload else by_force - 1)


def _sum(point: _Point) -> float:
    """Return the force on the base, N."""
    return float(point.outputs[:2].sum())


def _combine(points: Sequence[_Point], derivatives: Sequence[Floats]) -> Floats:
    """Return derivatives of logarithms of the outputs at one point, or of their differences between two, shape (k,)."""
    if len(points) == 1:
        return derivatives[0]
    low, high = points
    return np.asarray((high.outputs * derivatives[1] - low.outputs * derivatives[0]) / (high.outputs - low.outputs))


def _change_model(loaded: LoadedScene, model: ContactModel, scene: Scene) -> ContactModel:
    """Return a path's model for a similar scene, on the same mesh and with the same lines that may touch."""
    sections = build_sections(scene)
    if loaded.linear.sample.states.model.section.has_details:
        sections = add_details(scene, sections)
    section = truncate_section(sections.section) if scene.tissue.shape == "half-space" else sections.section
    faces = scene.contact
    changed = ContactModel.from_section(
        section, model.materials, faces.interface, model.mesh.layout.fineness, faces.friction,
        dense=loaded.dense, films=sections.films, mesh=model.mesh,
    )  # fmt: skip
    pairs = tuple(replace(pair, spring=old.spring) for pair, old in zip(changed.pairs, model.pairs, strict=True))
    # with other materials no line changes its part, slave or master
    laws = Hyperelastic.from_materials([sections.materials[Body(body)] for body in model.mesh.body])
    return replace(changed, pairs=pairs, elements=replace(changed.elements, material=laws))
