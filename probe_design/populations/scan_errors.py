"""Bound the error of the evaluator in a tumour's change of the readings, by cause.

With F_i the force on film i over the tumour, dF_i its difference from the force without the tumour, b_i the error bound of dF_i
by reflections and meshes, e_i the relative error bound of the force without the tumour except for the groove, and r_i eq. PO.14
for the groove, which is not modelled,

    |error of ln(F_i / F_i without)| <= -ln(1 - b_i / F_i - 2 (e_i + r_i) |dF_i| / F_i)                (PO.12)

since the relative error of dF_i is at most twice, and that of F_i once, that of the base states. The groove reduces a film's
force with and without the tumour alike. This cancels in a reading less the baseline reading, except for an effect of the
tumour's position. Finite strain under the load changes a signal as it changes the log-sensitivity, eq. PL.2.
"""

from __future__ import annotations

import numpy as np

from geometry.common.arrays import Floats
from geometry.scenes.scene import Scene
from probe_design.maps.sphere_effects import BASE_ERROR_FACTOR
from solver.equivalent_inclusion.probe_on_tissue import Undisturbed
from solver.equivalent_inclusion.readings import Readings
from solver.results.detail_compliance import CHARGE_CHANGE_FACTOR, iterate_details
from solver.results.film_forces import FilmForces

TUMOURS_CAUSE, BASE_CAUSE, GROOVE_CAUSE, LOAD_CAUSE = "reflections and meshes", "base states", "groove", "load"
ERROR_CAUSES = {  # causes of the model's error: description, and how to reduce it
    TUMOURS_CAUSE: ("tumours near the surface, whose effect is computed less accurately", "a larger population.least_cover"),
    BASE_CAUSE: (
        "the meshes and the tissue's sides, which the model takes as round about the probe",
        "wider tissue, or a scan nearer its middle,",
    ),
    GROOVE_CAUSE: ("the groove, which the model leaves out", "a narrower or shallower groove, [scene.probe.groove],"),
    LOAD_CAUSE: ("the load, whose effect on a tumour's signal is approximated", "a smaller limits.force"),
}
MAX_RELATIVE_ERROR = 0.999999  # error bound of a total at most
GROOVE_FLOOR_FACTOR = 2.0  # of eq. PO.14
GROOVE_SAFETY_FACTOR = 2.0  # over the effect without a tumour: ``python -m benchmarks.populations.groove`` needs 1.26 at most


def bound_groove_change(scene: Scene, forces: Floats) -> Floats:
    """Return r_i of eq. PO.12: a bound on the relative change of each film's force by the groove, shape (2,).

    The groove adds compliance, eq. RE.5. In addition the outer film loses the load that the floor under the groove, a strip that
    bends, does not carry. The strip has the fraction f of the film's area, width w, thickness t and modulus E, on tissue of
    modulus E_t:

        2 f eta / (1 + eta),   eta = E_t / E (5 / 32 (w / t)^3 + 0.45 w / t)                            (PO.14)

    eta is the deflection, by bending and shear, of a strip clamped at its ends, over that of the tissue under the same pressure.
    Eq. RE.6 replaces the result where it is smaller.

    Parameters
    ----------
    scene
        Scene whose probe may have a groove.
    forces
        F_ij on film i per unit displacement of base j, N/m, shape (2, 2).
    """
    probe, totals = scene.probe, forces.sum(axis=1)
    detail = next((item for item in iterate_details(probe) if item.name == "groove"), None)
    if detail is None or probe.groove is None:
        return np.zeros(2)
    # w / t and eta of eq. PO.14
    width_per_thickness = probe.groove.width / (probe.tube_height - probe.groove.depth)
    stiffest = max(item.youngs_modulus for item in (scene.tissue, *scene.tissue.layer))
    deflection_ratio = stiffest / probe.outer.youngs_modulus * (5 / 32 * width_per_thickness**3 + 0.45 * width_per_thickness)
    lost_fraction = min(
        detail.lost_share,
        GROOVE_FLOOR_FACTOR * probe.groove_footprint / probe.outer_area * deflection_ratio / (1 + deflection_ratio),
    )
    return np.asarray(np.abs(forces @ detail.compliance @ totals / totals) + lost_fraction)


def _bound_groove_total(scene: Scene, forces: Floats) -> Floats:
    """Return the groove's part of the error bounds of both films' forces in the base states, N/m, shape (2,).

    The base states are the two solutions in which one block's base is displaced by one unit and the other held.
    """
    return np.asarray(
        sum(
            (detail.compute_bound(forces).totals for detail in iterate_details(scene.probe) if detail.name == "groove"),
            np.zeros(2),
        )
    )


def bound_film_errors(base: Undisturbed, films: FilmForces, readings: Readings) -> dict[str, Floats]:
    """Return the bound of eq. PO.12 for both films at u readings, by cause except the load, shape (u, 2) each.

    The groove changes a film's charge as its force, and by as much again through the shear on the film.

    Parameters
    ----------
    base
        The probe on the tissue without tumours.
    films
        Its film forces or, for errors of charges, its charges.
    readings
        Readings over the tumours, of forces or of charges likewise.
    """
    forces, totals = base.films, np.abs(readings.totals)
    effect = np.abs(readings.totals - films.totals) / totals
    groove = _bound_groove_total(base.scene, forces.forces) / np.abs(forces.totals)
    shear = (CHARGE_CHANGE_FACTOR - 1) * groove if films is forces.charges else np.zeros(2)
    change = bound_groove_change(base.scene, forces.forces)
    base_errors = np.maximum(films.bound.totals / np.abs(films.totals) - groove - shear, 0.0)
    parts = {
        TUMOURS_CAUSE: np.maximum(readings.bound - films.bound.totals, 0.0) / totals,
        BASE_CAUSE: BASE_ERROR_FACTOR * base_errors * effect,
        GROOVE_CAUSE: (GROOVE_SAFETY_FACTOR * change + BASE_ERROR_FACTOR * shear) * effect,
    }
    total_error = np.asarray(sum(parts.values()))
    # -ln(1 - sum) over the sum: distributes the logarithm of eq. PO.12 over the causes in proportion
    logarithm_factor = -np.log1p(-np.minimum(total_error, MAX_RELATIVE_ERROR)) / np.maximum(total_error, 1e-300)
    return {cause: part * logarithm_factor for cause, part in parts.items()}
