"""Differentiate ratio, stresses, stiffness and log-sensitivity exactly by every number of a scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import InputError, describe_choices
from geometry.meridian.section import LAYERS, STACKS, Body
from geometry.scenes.scene import Scene
from geometry.scenes.variables import PIEZO_KEYS, compute_length_derivatives, find_film_part, list_values
from solver.axisymmetric.base_states import MeridianModel
from solver.axisymmetric.energy_derivatives import differentiate_totals, list_variables
from solver.axisymmetric.film_states import CHARGE_UNIT, CHARGE_VARIABLES, differentiate_film_lift
from solver.axisymmetric.modulus_response import StateCurve, compute_tangent
from solver.axisymmetric.sample import MeshSample

OUTPUT_NAMES = ("ratio", "stress_inner", "stress_outer", "stiffness", "log_sensitivity")
FORCE_NAMES = ("ratio", "stress_inner", "stress_outer", "log_sensitivity")  # in the order of ``CHARGE_NAMES``
CHARGE_NAMES = ("charge_ratio", "charge_inner", "charge_outer", "charge_log_sensitivity")  # of samples with charges
UPPER_LENGTHS = {"inner_height", "outer_height", *(body.name.lower() for stack in STACKS for body in stack)}
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
        By name of ``OUTPUT_NAMES`` and, with charges, ``CHARGE_NAMES``, SI, shape (k,).
    derivatives
        By output, in SI units per SI unit of each variable, shape (k, v).
    """

    variables: tuple[str, ...]
    values: dict[str, Floats]
    derivatives: dict[str, Floats]


def compute_gradients(scene: Scene, sample: MeshSample, names: tuple[str, ...] | None = None) -> Gradients:
    """Differentiate the outputs of a sample exactly, as discretised, at a fixed topology of the mesh.

    Derivatives of log_sensitivity take one more solve: u' = -K^-1 K' u of all states. Lengths of a base stay constant.

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
    chosen = choose_variables(scene, sample.states.model, names)
    outputs = compute_outputs(scene, sample.totals, sample.log_sensitivities)
    if not chosen:
        return Gradients((), outputs, {name: np.zeros((len(values), 0)) for name, values in outputs.items()})
    chain = np.array([differentiate_by_scene(scene, sample.states.model, name) for name in chosen])  # (v, section variables)
    forces = differentiate_by_section(sample)
    parts = (forces,) if forces.charges is None else (forces, forces.charges)
    derivatives = differentiate_outputs(
        scene,
        outputs,
        sample.totals,
        logs=np.concatenate([chain @ part.totals for part in parts], axis=-1),
        sensitivities=np.stack([part.sensitivity @ chain.T for part in parts], axis=-1),
        log_areas=chain @ differentiate_areas(scene, sample.states.model),
    )
    for change in derivatives.values():  # the variable is each value's own modulus, not that of the states
        change[:, [name == "inclusion.youngs_modulus" for name in chosen]] /= sample.modulus_ratios[:, None]
    return Gradients(chosen, outputs, derivatives)


def choose_variables(scene: Scene, model: MeridianModel, names: tuple[str, ...] | None) -> tuple[str, ...]:
    """Return the names of variables, None for all that have a derivative; raise ``InputError`` for one that has none."""
    allowed = list_differentiable(scene, model)
    unknown = [name for name in names or () if name not in allowed]
    if unknown:
        raise InputError("variable", unknown[0], describe_choices(unknown[0], allowed))
    return allowed if names is None else names


def compute_outputs(scene: Scene, totals: Floats, sensitivities: Floats) -> dict[str, Floats]:
    """Return the outputs by name at the scene's load, (k,) each, from films' totals (k, s) and log-sensitivities (k, s / 2)."""
    stiffness, ends = totals[:, :2].sum(axis=1), np.array([scene.probe.inner_area, scene.probe.outer_area])
    indentation = scene.load.find_indentation(stiffness)[:, None]
    outputs = {"stiffness": stiffness}
    for k, (ratio, inner, outer, sensitivity) in enumerate((FORCE_NAMES, CHARGE_NAMES)[: totals.shape[1] // 2]):
        pair = totals[:, 2 * k : 2 * k + 2]
        outputs[ratio] = pair[:, 0] / pair[:, 1] * ends[1] / ends[0]
        outputs[inner], outputs[outer] = (pair * indentation * (1 / ends if k == 0 else CHARGE_UNIT)).T
        outputs[sensitivity] = sensitivities[:, k]
    return {name: outputs[name] for name in (*OUTPUT_NAMES, *CHARGE_NAMES) if name in outputs}


def differentiate_outputs(
    scene: Scene, outputs: dict[str, Floats], totals: Floats, *, logs: Floats, sensitivities: Floats, log_areas: Floats
) -> dict[str, Floats]:
    """Return derivatives of the outputs by v variables, by name, shape (k, v) each.

    Parameters
    ----------
    scene
        Supplies the kind of load.
    outputs
        What ``compute_outputs`` returns.
    totals
        Of the films, shape (k, s).
    logs, sensitivities
        Derivatives of ln of the totals, shape (k, v, s), and of the log-sensitivities, shape (k, v, s / 2).
    log_areas
        Derivatives of ln of the areas of both blocks' ends, shape (v, 2).
    """
    log_stiffness = (logs[..., :2] * totals[:, None, :2]).sum(axis=-1) / outputs["stiffness"][:, None]
    # a given force: the indentation is force over stiffness
    log_indentation = -log_stiffness if scene.load.indentation is None else np.zeros_like(log_stiffness)
    derivatives = {"stiffness": outputs["stiffness"][:, None] * log_stiffness}
    for k, (ratio, *films, sensitivity) in enumerate((FORCE_NAMES, CHARGE_NAMES)[: totals.shape[1] // 2]):
        pair = logs[..., 2 * k : 2 * k + 2]
        derivatives[ratio] = outputs[ratio][:, None] * ((pair - log_areas) @ [1.0, -1.0])
        for film, name in enumerate(films):
            log_load = log_indentation - (log_areas[:, film] if k == 0 else 0.0)  # charges are not divided by the areas
            derivatives[name] = outputs[name][:, None] * (pair[..., film] + log_load)
        derivatives[sensitivity] = sensitivities[..., k]
    return {name: derivatives[name] for name in outputs}


def list_differentiable(scene: Scene, model: MeridianModel) -> tuple[str, ...]:
    """Return the scene's variables that have a derivative on a model's mesh.

    Where an elastic base lies flat on both films, the heights of what lies on one block alone have none: a change of one would
    put a step into the base, which the mesh does not have.
    """
    if model.mesh.layout.kind.base != 0:
        return tuple(list_values(scene))
    lengths = compute_length_derivatives(scene)
    return tuple(name for name in list_values(scene) if len(set(lengths.get(name, {})) & UPPER_LENGTHS) != 1)


@dataclass(frozen=True)
class SectionDerivatives:
    """Derivatives of ln of the films' totals, (k, v, 2), and of the log-sensitivities, (k, v), by the section's variables.

    ``charges`` are the same of the films' charges; None without them.
    """

    totals: Floats
    sensitivity: Floats
    charges: SectionDerivatives | None = None


def differentiate_by_section(sample: MeshSample) -> SectionDerivatives:
    """Differentiate totals and log-sensitivities by the section's variables.

    Totals do not change with the states, which minimise the energy; their derivatives F' by ln E do:

    F' = dF / d ln E = t u^T K_b u:  dF' = 2 u'^T dK u + t u^T dK_b u,  u' = du / d ln E (AX.7).
    E is the inclusion's modulus, t its multiple of that of the states, K_b the inclusion's part of the stiffness K at t = 1.

    A charge is the energy of the film state s_i with the sum U of both base states. It is the total of the first of the pair
    (s_i, U - s_i), and changes, too, as the film's lift does with the film's nodes and its d (``differentiate_film_lift``).
    """
    model, t, curve = sample.states.model, sample.modulus_ratios[:, None, None], sample.curve
    if curve is None:
        curve = compute_tangent(sample.states) if Body.INCLUSION in model.materials else StateCurve(sample.states.edge)
    basis, states = model.recover_values(curve.edges), curve.compute_states(sample.modulus_ratios)

    def differentiate(pairs: Sequence[Floats]) -> tuple[Floats, Floats]:
        """Return the derivatives of totals and of their derivatives by ln E, for pairs of states and their changes by ln E."""
        outside, inside = differentiate_totals(model, basis, pairs[0], pairs[1], Body.INCLUSION)
        return outside.totals + t * inside.totals, outside.changes + t * (inside.changes + inside.totals)

    slopes = sample.product_derivatives.sum(axis=-1)
    forces = _take_logarithms(*differentiate([part[..., :2] for part in states]), sample.totals[:, :2], slopes[:, :2])
    if curve.count == 2:
        return forces
    parts = []
    for k in (2, 3):
        sums = [part[..., 0] + part[..., 1] for part in states]
        pairs = [np.stack([part[..., k], both - part[..., k]], axis=-1) for part, both in zip(states, sums, strict=True)]
        parts.append([change[..., 0] for change in differentiate(pairs)])
    totals, changes = (np.stack(part, axis=-1) for part in zip(*parts, strict=True))  # (k, v, 2)
    lift_totals, lift_changes = _differentiate_lifts(model, curve, states)
    totals, changes = totals + lift_totals, changes + lift_changes
    return replace(forces, charges=_take_logarithms(totals, changes, sample.totals[:, 2:], slopes[:, 2:]))


def _take_logarithms(changes: Floats, slope_changes: Floats, totals: Floats, slopes: Floats) -> SectionDerivatives:
    """Return derivatives of ln of totals and of the difference of both totals' derivatives of ln by ln E.

    Parameters
    ----------
    changes, slope_changes
        Derivatives of the totals, and of their derivatives by ln E, by v variables, shape (k, v, 2).
    totals, slopes
        The totals and their derivatives by ln E, shape (k, 2).
    """
    logs = changes / totals[:, None]
    change = slope_changes / totals[:, None] - (slopes / totals)[:, None] * logs
    return SectionDerivatives(logs, change[..., 0] - change[..., 1])


def _differentiate_lifts(model: MeridianModel, curve: StateCurve, states: tuple[Floats, Floats]) -> tuple[Floats, Floats]:
    """Return what the change of the films' lifts adds to the derivatives of charges, and of their derivatives by ln E, (k, v, 2).

    ``states`` are the coefficients of all states on the curve's vectors, and their derivatives by ln E, (k, m, s) each.
    """
    assert model.films is not None
    rows = list_lift_variables(model)
    out = np.zeros((2, len(states[0]), len(list_variables(model)), 2))
    lifts = differentiate_film_lift(model.section, model.mesh, model.shapes.skeleton, model.films)
    for film, (chosen, by_variable) in enumerate(lifts):
        vectors = model.system.stiffness[chosen] @ curve.edges[chosen]
        for kind, part in enumerate(states):
            loads = vectors @ (part[..., 0] + part[..., 1]).T  # of U at each modulus, (c, 8 p, k)
            out[kind, :, rows, film] = np.einsum("vcp,cpk->vk", by_variable, loads)
    return out[0], out[1]


def list_lift_variables(model: MeridianModel) -> list[int]:
    """List the numbers of the section's variables that ``differentiate_film_lift`` differentiates by."""
    names = list_variables(model)
    return [*range(len(model.section.lengths)), *range(len(names) - len(CHARGE_VARIABLES), len(names))]


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
    """Return derivatives of the section's variables, see ``list_variables``, by one of the scene's, (v,)."""
    section_variables = list_variables(model)
    out = np.zeros(len(section_variables))
    for length, change in compute_length_derivatives(scene).get(name, {}).items():
        if length in section_variables:
            out[section_variables.index(length)] = change / getattr(model.section, length)
    owner, _, quantity = name.rpartition(".")
    if quantity in PIEZO_KEYS:
        for block in find_film_part(scene.probe.film, name)[1] if model.films is not None else ():
            charge, change = ("normal", 1.0) if quantity == "d33" else ("lateral", 0.5)
            out[section_variables.index(f"{block}_film_{charge}_charge")] = change
        return out
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
