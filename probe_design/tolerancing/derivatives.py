"""Derivatives of the outputs with respect to all uncertain numbers, from the finite elements, under the scene's load.

With F_i the force on film i (1 inner, 2 outer), or in the ratio its charge where the scene reads charges, g_i its gain and A_i
its area, built or drawn,

    ln ratio = ln(g_1 F_1 A_2 / (g_2 F_2 A_1)),   ln stiffness = ln(g_1 F_1 + g_2 F_2) - ln indentation.   (TO.3)

A scene has radii and the gap; a workshop makes three radii: the inner block's r_2, the hole's r_h and the outer one. With y
an output and S_radius, S_gap its derivatives with respect to the scene's inner radius and gap, the derivatives with respect to
r_2 at fixed r_h, and with respect to r_h at fixed r_2, are

    dy/dr_2 = S_radius - S_gap,   dy/dr_h = S_gap.   (TO.6)
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from threadpoolctl import threadpool_limits

from geometry.common.arrays import Floats
from geometry.common.errors import Refusal
from geometry.scenes.scene import Scene
from probe_design.built_probe.block_derivatives import differentiate_area_ratio
from probe_design.tolerancing.film_numbers import TAPE_COEFFICIENT_PER_K, TEMPERATURE_NAME, list_shared_moduli, list_tape_moduli
from probe_design.tolerancing.uncertain_numbers import GAIN_NAMES, GAP_KEY, RADIUS_KEY, UncertainNumber
from solver.axisymmetric.evaluator import Axisymmetric
from solver.axisymmetric.gradients import Gradients, compute_gradients
from solver.axisymmetric.sections import Sections, add_details, build_sections
from solver.contact.design_derivatives import compute_loaded_derivatives
from solver.contact.evaluator import ContactEvaluator
from solver.equivalent_inclusion.evaluator import EquivalentInclusion
from solver.equivalent_inclusion.gradients import compute_tumour_gradients, solve_first_order
from solver.results.film_charges import reads_film_states
from solver.results.refusals import is_round
from solver.results.result import Result

LOADED_ACCURACY = 0.1  # of contact, of whose results the changes by load alone are used here


def choose_evaluator(scene: Scene) -> str:
    """Return the name of the evaluator that computes the derivatives.

    Raises
    ------
    Refusal
        Neither ``axisymmetric`` nor ``equivalent-inclusion`` can evaluate the scene.
    """
    if Axisymmetric().refusal(scene) is None:
        return "axisymmetric"
    EquivalentInclusion().check(scene)
    return "equivalent-inclusion"


def compute_derivatives(
    scene: Scene, variables: Sequence[UncertainNumber], accuracy: float, loaded: Result | None = None
) -> Floats:
    """Return the derivatives of the four outputs with respect to v uncertain numbers, per SI unit, shape (4, v).

    Those of the inner radius and the gap follow eq. TO.6. Off the axis, reflections of a tumour's field at the surface and the
    blocks are neglected: the derivatives of the log-sensitivity then have errors of some 10 % where the overburden is half a
    diameter.

    With ``loaded``, the result of ``contact`` under the scene's load, what the load adds counts, too. Tumours off the axis are
    left out of that, and the derivatives of the log-sensitivity then rise as that itself does; so they do about a preload.

    Raises
    ------
    Refusal
        See ``choose_evaluator``; or a block's height has no derivative of its own, as an elastic base lies on both.
    """
    # names of the scene's numbers, always with the gap, which eq. TO.6 needs
    shared = list_shared_moduli(scene)
    own_names = [variable.name for variable in variables if variable.kind not in ("gain", "temperature")]
    scene_names = [key for name in own_names for key in shared.get(name, (name,))]
    tapes = list_tape_moduli(scene) if any(variable.kind == "temperature" for variable in variables) else {}
    names = tuple(dict.fromkeys([*scene_names, *tapes, GAP_KEY]))
    gradients = _compute_gradients(scene, names, accuracy)
    indices = [gradients.variables.index(name) for name in names]
    values = {output: float(part[0]) for output, part in gradients.values.items()}
    derivatives = {output: part[0, indices] for output, part in gradients.derivatives.items()}
    charge = "charge_" if reads_film_states(scene) else ""  # where psi gives the charges, ln of the ratio changes as by forces
    ln_ratio = derivatives[f"{charge}ratio"] / values[f"{charge}ratio"]
    ln_drawn_ratio = ln_ratio + [differentiate_area_ratio(scene.probe, name) for name in names]
    ln_stiffness = derivatives["stiffness"] / values["stiffness"]
    outputs = np.array([ln_ratio, ln_drawn_ratio, ln_stiffness, derivatives[f"{charge}log_sensitivity"]])
    forces = np.array([values["stress_inner"] * scene.probe.inner_area, values["stress_outer"] * scene.probe.outer_area])
    if loaded is not None:
        outputs += _compute_growths(scene, names, outputs[3], values[f"{charge}log_sensitivity"], loaded)
        assert loaded.stress_inner is not None
        assert loaded.stress_outer is not None
        forces = np.array([loaded.stress_inner * scene.probe.inner_area, loaded.stress_outer * scene.probe.outer_area])
    columns = dict(zip(names, outputs.T, strict=True))
    if RADIUS_KEY in columns:  # as the workshop makes it, eq. TO.6
        columns[RADIUS_KEY] = columns[RADIUS_KEY] - columns[GAP_KEY]
    columns |= {name: np.sum([columns[key] for key in keys], axis=0) for name, keys in shared.items() if keys[0] in columns}
    # one temperature changes the moduli of all tapes
    columns[TEMPERATURE_NAME] = sum(
        (-TAPE_COEFFICIENT_PER_K * modulus * columns[name] for name, modulus in tapes.items()), start=np.zeros(len(outputs))
    )
    # gains have value 1; the stiffness changes by the film's fraction of the force, the log-sensitivity not at all
    for name, sign, fraction in zip(GAIN_NAMES, (1.0, -1.0), forces / forces.sum(), strict=True):  # eq. TO.3
        columns[name] = np.array([sign, sign, fraction, 0.0])
    return np.array([columns[variable.name] for variable in variables]).T


def _compute_growths(
    scene: Scene, names: tuple[str, ...], sensitivity_derivatives: Floats, sensitivity: float, loaded: Result
) -> Floats:
    """Return what the load adds to the derivatives of the four outputs with respect to ``names``, shape (4, v).

    ``sensitivity_derivatives``, shape (v,), and ``sensitivity`` are those of a light load.
    """
    has_mesh = is_round(scene) and scene.load.preload == 0 and scene.target is not None
    pressed = scene if is_round(scene) else scene.model_copy(update={"inclusion": ()})
    paths = ContactEvaluator().load_scene(pressed, LOADED_ACCURACY)
    added = compute_loaded_derivatives(paths, names, sensitive=has_mesh)
    reads_charges = reads_film_states(scene)
    read = added.growths[:, 2:4] if reads_charges else added.growths[:, :2]
    ln_ratio = read[:, 0] - read[:, 1]
    if added.sensitivities is not None:
        by_sensitivity = added.sensitivities[:, 1 if reads_charges else 0]
    else:
        grown = (loaded.reading.log_sensitivity or 0.0) / sensitivity if sensitivity else 1.0
        by_sensitivity = (grown - 1) * sensitivity_derivatives
    return np.array([ln_ratio, ln_ratio, added.stiffness, by_sensitivity])


def _build_sections(scene: Scene) -> Sections:
    """Return the sections of a scene, with films and base where charges are read, which follow from the films' stress."""
    sections = build_sections(scene)
    return add_details(scene, sections) if reads_film_states(scene) else sections


def _compute_gradients(scene: Scene, names: tuple[str, ...], accuracy: float) -> Gradients:
    """Compute the evaluator's derivatives with respect to ``names``; refuse if one is missing."""
    with threadpool_limits(1, user_api="blas"):
        if choose_evaluator(scene) == "equivalent-inclusion":
            return compute_tumour_gradients(scene, solve_first_order(scene, _build_sections(scene)), names)
        gradients = compute_gradients(scene, Axisymmetric().compute_converged(scene, accuracy).sample)
    missing = [name for name in names if name not in gradients.variables]
    if missing:
        raise Refusal(missing[0], "a tolerance of its own", "a rigid base, or one height for both blocks")
    return gradients
