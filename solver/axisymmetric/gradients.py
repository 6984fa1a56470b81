"""Differentiate ratio, stresses, stiffness and log-sensitivity exactly by every number of a scene."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import InputError, describe_choices
from geometry.meridian.section import LAYERS, Body
from geometry.scenes.scene import Scene
from geometry.scenes.variables import compute_length_derivatives, find_film_part, list_values
from solver.axisymmetric.base_states import MeridianModel
from solver.axisymmetric.energy_derivatives import differentiate_totals, list_variables
from solver.axisymmetric.modulus_response import StateCurve, compute_tangent
from solver.axisymmetric.sample import MeshSample

OUTPUT_NAMES = ("ratio", "stress_inner", "stress_outer", "stiffness", "log_sensitivity")
BODIES_OF_MATERIAL: dict[str, tuple[Body, ...]] = {
    "tissue": (Body.TISSUE,), "probe.inner": (Body.INNER,), "probe.outer": (Body.OUTER,), "inclusion": (Body.INCLUSION,),
    "probe.base": (Body.BASE,), **{f"tissue.layer[{k}]": (body,) for k, body in enumerate(LAYERS)},
}  # fmt: skip


@dataclass(frozen=True)
class Gradients:
    """Outputs at the scene's load, for k Young's moduli of the inclusion, and their derivatives.

    Attributes
    ----------
    variables
        Keys of ``geometry.scenes.variables.list_values``, v of them.
    values
        By name of ``OUTPUT_NAMES``, SI, shape (k,).
    derivatives
        By output, in SI units per SI unit of each variable, shape (k, v).
    """

    variables: tuple[str, ...]
    values: dict[str, Floats]
    derivatives: dict[str, Floats]


def compute_gradients(scene: Scene, sample: MeshSample, names: tuple[str, ...] | None = None) -> Gradients:
    """Differentiate the outputs of a sample exactly, as discretised, at a fixed topology of the mesh.

    Derivatives of log_sensitivity take one more solve with two right sides: u' = -K^-1 K' u of both states. Lengths of a
    base or a film stay constant.

    Parameters
    ----------
    scene
        Supplies the load and the variables.
    sample
        The scene's solution on one mesh, at k moduli of the inclusion.
    names
        Variables, keys of ``geometry.scenes.variables.list_values``; None for all that can be differentiated.

    Raises
    ------
    InputError
        A name is not one of the scene's variables.
    """
    allowed = _list_differentiable(scene, sample)
    chosen = allowed if names is None else names
    unknown = [name for name in chosen if name not in allowed]
    if unknown:
        raise InputError("variable", unknown[0], describe_choices(unknown[0], allowed))
    chain = np.array([differentiate_by_scene(scene, sample.states.model, name) for name in chosen])  # (v, section variables)
    logs = differentiate_by_section(sample)
    totals, f = sample.totals, logs.totals  # (k, 2), (k, section variables, 2)
    log_stress = f - differentiate_areas(scene, sample.states.model)
    if scene.load.indentation is None:  # a given force: the indentation is force over stiffness
        log_stress = log_stress - _differentiate_stiffness(totals, f)[..., None]
    logarithmic = {
        "ratio": log_stress[..., 0] - log_stress[..., 1],
        "stress_inner": log_stress[..., 0],
        "stress_outer": log_stress[..., 1],
        "stiffness": _differentiate_stiffness(totals, f),
    }
    outputs = _compute_outputs(scene, sample)
    derivatives = {name: outputs[name][:, None] * (change @ chain.T) for name, change in logarithmic.items()}
    derivatives["log_sensitivity"] = logs.sensitivity @ chain.T
    for change in derivatives.values():  # the variable is each value's own modulus, not that of the states
        change[:, [name == "inclusion.youngs_modulus" for name in chosen]] /= sample.modulus_ratios[:, None]
    return Gradients(chosen, outputs, derivatives)


def _list_differentiable(scene: Scene, sample: MeshSample) -> tuple[str, ...]:
    """Return the scene's variables that have a derivative.

    Where an elastic base lies flat on both films, the heights of single blocks have none: a change of one would put a step into
    the base, which the mesh does not have.
    """
    flush = sample.states.model.mesh.layout.kind.base == 0
    return tuple(name for name in list_values(scene) if not (flush and name in ("probe.inner_height", "probe.outer_height")))


@dataclass(frozen=True)
class SectionDerivatives:
    """Derivatives of ln of the films' totals, (k, v, 2), and of the log-sensitivities, (k, v), by the section's variables."""

    totals: Floats
    sensitivity: Floats


def differentiate_by_section(sample: MeshSample) -> SectionDerivatives:
    """Differentiate totals and log-sensitivities by the section's variables.

    Totals do not change with the states, which minimise the energy; their derivatives F' by ln E do:

    F' = dF / d ln E = t u^T K_b u:  dF' = 2 u'^T dK u + t u^T dK_b u,  u' = du / d ln E (AX.7).
    E is the inclusion's modulus, t its multiple of that of the states, K_b the inclusion's part of the stiffness K at t = 1.
    """
    model, t, curve = sample.states.model, sample.modulus_ratios[:, None, None], sample.curve
    if curve is None:
        curve = compute_tangent(sample.states) if Body.INCLUSION in model.materials else StateCurve(sample.states.edge)
    u, du = curve.compute_states(sample.modulus_ratios)
    outside, inside = differentiate_totals(model, model.recover_values(curve.edges), u, du, Body.INCLUSION)
    totals = sample.totals[:, None]
    logs = (outside.totals + t * inside.totals) / totals
    modulus_change = outside.changes + t * (inside.changes + inside.totals)
    change = modulus_change / totals - sample.modulus_derivative.sum(axis=-1)[:, None] / totals * logs
    return SectionDerivatives(logs, change[..., 0] - change[..., 1])


def _differentiate_stiffness(totals: Floats, logs: Floats) -> Floats:
    """Return derivatives of ln of the stiffness, the sum of both totals, by v variables, shape (k, v).

    ``totals`` are the films' forces per unit displacement, shape (k, 2), ``logs`` the derivatives of their logarithms, (k, v, 2).
    """
    return np.asarray((logs * totals[:, None]).sum(axis=-1) / totals.sum(axis=-1)[:, None])


def differentiate_areas(scene: Scene, model: MeridianModel) -> Floats:
    """Return derivatives of ln of the areas of both blocks' tissue ends by the section's variables, shape (v, 2).

    The variables are ln of the radii: area inner = pi inner_radius^2, outer = pi (tube_radius^2 - hole_radius^2).
    """
    names, probe = list_variables(model), scene.probe
    out = np.zeros((len(names), 2))
    ring = probe.outer_area / np.pi
    out[names.index("inner_radius"), 0] = 2.0
    out[names.index("hole_radius"), 1] = -2 * probe.hole_radius**2 / ring
    out[names.index("tube_radius"), 1] = 2 * probe.tube_radius**2 / ring
    return out


def differentiate_by_scene(scene: Scene, model: MeridianModel, name: str) -> Floats:
    """Return derivatives of the section's variables (ln of lengths and moduli, Poisson's ratios) by one of the scene's, (v,)."""
    section_variables = list_variables(model)
    out = np.zeros(len(section_variables))
    for length, change in compute_length_derivatives(scene).get(name, {}).items():
        if length in section_variables:
            out[section_variables.index(length)] = change / getattr(model.section, length)
    owner, _, quantity = name.rpartition(".")
    for body in BODIES_OF_MATERIAL.get(owner, ()) or _list_stack_bodies(scene, name):
        if body not in model.materials or quantity not in ("youngs_modulus", "poisson_ratio"):
            continue
        ratio = quantity == "poisson_ratio"
        key = f"{body.name.lower()}_{quantity if ratio else 'youngs_modulus'}"
        out[section_variables.index(key)] = 1.0 if ratio else 1 / model.materials[body].youngs_modulus
    return out


def _list_stack_bodies(scene: Scene, name: str) -> list[Body]:
    """Return the layers on the blocks that a number of the scene's films or bonds, by its key, belongs to; none for others."""
    part, blocks = find_film_part(scene.probe.film, name)
    return [Body[f"{block}_{part}".upper()] for block in blocks]


def _compute_outputs(scene: Scene, sample: MeshSample) -> dict[str, Floats]:
    """Return the outputs by name at the scene's load, shape (k,) each."""
    totals, ends = sample.totals, np.array([scene.probe.inner_area, scene.probe.outer_area])
    stiffness = totals.sum(axis=1)
    moved = scene.load.indentation
    indentation = (scene.load.force or 0.0) / stiffness if moved is None else np.full(len(totals), moved)
    stress = totals * indentation[:, None] / ends
    ratio = totals[:, 0] / totals[:, 1] * ends[1] / ends[0]
    columns = (ratio, stress[:, 0], stress[:, 1], stiffness, sample.log_sensitivities[:, 0])
    return dict(zip(OUTPUT_NAMES, columns, strict=True))
