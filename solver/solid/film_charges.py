"""Compute films' charges in three dimensions: exact in the symmetric part, and the change from it on meshes.

The mesh has no layers: its blocks end on a rigid face. The work of their end forces on the displacements w of the stacks as
actuators (``solver/multiple_scattering/stack_motion.py``) gives charges q for unit displacements of the blocks' ends. With the
mesh's film forces M the charges per force are q M^-1. These change little from scene to scene. The stack's own compliance, which
a rigid face leaves out, changes them by nearly the same factor in all. With the film forces F of eq. SO.5 the charges Q per unit
displacement of the base are

    Q = (Q_whole F_whole^-1 + k (q M^-1 - q_ref M_ref^-1)) F                                    (SO.11)

with Q_whole and F_whole of the symmetric part by ``axisymmetric``, films and bonds meshed, q_ref and M_ref of the reference on
the same mesh. For each film, k is the mean of 1 and the ratio of what d31 and d32 add to the charge per force in both symmetric
parts,

    k = 1/2 + (Q_whole / F_whole - d33) / (q_ref / M_ref - d33) / 2.                            (SO.12)

Tumours change the tractions more evenly over an end than its edges, where the stack gives way most: of 10 stacks with tumours on
the axis, the best factor lay between 1 and that ratio.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.percent import format_percent
from geometry.scenes.scene import Scene
from solver.axisymmetric.film_states import CHARGE_UNIT
from solver.multiple_scattering.stack_motion import compute_stack_motion
from solver.results.film_forces import Bound, FilmForces
from solver.results.result import Decision
from solver.solid.difference import SceneDifference
from solver.solid.symmetric_part import SymmetricPart

CORRECTION_SHARE = 1.5  # of what k of eq. SO.12 changes: the error of the correction, which was at most 1.2 times that
CUT_MARGIN_FACTOR = 1.5  # of the estimate of what edges by a groove change
MAX_COMPLIANCE_RATIO = 3.0  # the ratio in eq. SO.12 lies between this and its inverse
MIN_LATERAL_SHARE = 0.02  # of the charge per force: if d31 and d32 add less, the ratio counts as 1


@dataclass(frozen=True)
class ChargeSample:
    """Charges of both films from one mesh, for k moduli of the target.

    Attributes
    ----------
    charges
        Q_ij of film i per unit displacement of base j, C/m, shape (k, 2, 2).
    derivative
        Their derivative with respect to ln E of the target.
    tilt, tilt_derivative
        Charges per unit rotation of the base about y, C/rad, and their derivative likewise, shape (k, 2).
    correction, correction_derivative, tilt_correction
        Changes by eq. SO.12 of the charges per unit displacement of the whole base, of their derivative and of ``tilt``, shape
        (k, 2).
    """

    charges: Floats
    derivative: Floats
    tilt: Floats
    tilt_derivative: Floats
    correction: Floats
    correction_derivative: Floats
    tilt_correction: Floats


def compute_charges(scene: Scene, symmetric: SymmetricPart, difference: SceneDifference) -> ChargeSample | None:
    """Compute the charges of a scene's films by eq. SO.11; None where the films have none of their own."""
    films, mesh = symmetric.whole.films, difference.charges
    if films.charges is None or mesh is None:
        return None
    whole_forces, whole = films.forces, films.charges.forces
    reference = mesh.reference[:, :2] @ np.linalg.inv(difference.reference)
    inverse = np.linalg.inv(difference.reference + difference.forces)
    per_force = mesh.scene[..., :2] @ inverse
    # derivative of q M^-1
    per_force_derivative = (mesh.derivative[..., :2] - per_force @ difference.modulus_derivative) @ inverse
    d33 = np.array([film.d33 for film in scene.probe.film.by_block]) if scene.probe.film is not None else np.zeros(2)
    factors = _compute_compliance_factors(
        whole.sum(axis=1) / whole_forces.sum(axis=1),
        mesh.reference[:, :2].sum(axis=1) / difference.reference.sum(axis=1),
        d33,
    )
    rows = factors[:, None]
    change = per_force - reference
    corrected = whole @ np.linalg.inv(whole_forces) + rows * change
    forces = symmetric.correct_forces(difference)
    forces_derivative = symmetric.propagate_change(difference, difference.modulus_derivative)
    tilt, tilt_derivative = (
        symmetric.propagate_change(difference, part[..., None]) for part in (difference.tilt, difference.tilt_derivative)
    )
    # charges by the tilt of the blocks' ends beyond those of the forces that it causes
    free_tilt = (mesh.scene - mesh.reference)[..., 2:] - per_force @ difference.tilt[..., None]
    free_tilt_derivative = (
        mesh.derivative[..., 2:]
        - per_force_derivative @ difference.tilt[..., None]
        - per_force @ difference.tilt_derivative[..., None]
    )
    return ChargeSample(
        corrected @ forces,
        rows * per_force_derivative @ forces + corrected @ forces_derivative,
        (corrected @ tilt + rows * free_tilt)[..., 0],
        (rows * per_force_derivative @ tilt + corrected @ tilt_derivative + rows * free_tilt_derivative)[..., 0],
        correction=((rows - 1) * change @ forces).sum(axis=2),
        correction_derivative=((rows - 1) * (per_force_derivative @ forces + change @ forces_derivative)).sum(axis=2),
        tilt_correction=((rows - 1) * (change @ tilt + free_tilt))[..., 0],
    )


def _compute_compliance_factors(whole: Floats, reference: Floats, d33: Floats) -> Floats:
    """Return k of eq. SO.12 from the charges per force of both films in both symmetric parts, and d33, C/N; shape (2,) all."""
    lateral = reference - d33
    is_large = np.abs(lateral) > MIN_LATERAL_SHARE * np.abs(reference)
    ratios = np.divide(whole - d33, lateral, out=np.ones(2), where=is_large)
    return np.asarray((1 + np.clip(ratios, 1 / MAX_COMPLIANCE_RATIO, MAX_COMPLIANCE_RATIO)) / 2)


def estimate_cut_changes(scene: Scene, symmetric: FilmForces) -> Floats:
    """Return relative changes of both films' charges by what a groove does to the films, which no model includes; shape (2,).

    The outer film is open above the groove, and the inner film's leads leave through it. What lies between a film's charge and
    that of a clamped film, d33 + 2 d_p nu / (1 - nu), is due to its free edges. The groove adds two edges as long as the ring is
    wide, and takes one as long as the groove is wide from the inner film. The more freely a film stretches on its bond, the less
    an edge adds; w at the outer edge over that of a free film says how freely it does. On a soft bond the cut ends the hoop
    stress, which the outer film has within its width or the length over which its bond takes stress from it.

    With all layers meshed in three dimensions (``benchmarks.references.grooved_films``) the cut changed the outer film's charge
    per force by 3.1 % on a rigid bond (here 3.3 %) and by 3.2 % on tape of 1 MPa (here 9 %),
    and on two tapes of 0.4 MPa left it 6.5 % below the value with a whole film (here 10 %).
    """
    probe, film, charges = scene.probe, scene.probe.film, symmetric.charges
    if probe.groove is None or film is None or charges is None:
        return np.zeros(2)
    motion = compute_stack_motion(scene)
    edges = (
        probe.groove.width / (2 * np.pi * probe.inner_radius),
        2 * (probe.tube_radius - probe.hole_radius) / (2 * np.pi * (probe.tube_radius + probe.hole_radius)),
    )
    changes = []
    for k, (block_film, edge) in enumerate(zip(film.by_block, edges, strict=True)):
        lateral, nu = block_film.mean_lateral_charge, block_film.poisson_ratio
        per_force = float(charges.totals[k] / symmetric.totals[k])
        stretched = per_force - block_film.d33 - 2 * lateral * nu / (1 - nu)
        free = lateral * motion.radius[k][-1] / (block_film.thickness * CHARGE_UNIT)
        freedom = float(np.clip(motion.mean[k][-1, 0, k] / free, 0.0, 1.0)) if free else 0.0
        changes.append(CUT_MARGIN_FACTOR * edge * (1 - freedom) * abs(stretched / per_force))
    outer = film.by_block[1]
    width, circumference = probe.tube_radius - probe.hole_radius, np.pi * (probe.tube_radius + probe.hole_radius)
    relieved = 2 * min(outer.shear_length, width) / circumference
    lateral_share = abs(1 - outer.d33 * float(symmetric.totals[1] / charges.totals[1]))
    return np.array([changes[0], max(changes[1], relieved * lateral_share)])


def widen_charge_bound(films: FilmForces, sample: ChargeSample, k: int, cut: Floats) -> FilmForces:
    """Return film forces whose charges' bounds include what meshes do not show: the correction's error, and a groove's cut.

    Parameters
    ----------
    films
        Film forces at modulus number ``k`` with their charges.
    sample
        Charges on the finest mesh.
    cut
        See ``estimate_cut_changes``.
    """
    charges = films.charges
    if charges is None:
        return films
    relative = CORRECTION_SHARE * np.abs(sample.correction[k] / charges.totals) + cut
    bound = Bound(charges.bound.totals + relative * np.abs(charges.totals), charges.bound.log_ratio + float(relative.sum()))
    sensitivity_error = charges.sensitivity_error
    if charges.film_log_sensitivities is not None:
        sensitivities = np.abs(charges.film_log_sensitivities)
        correction = np.abs(sample.correction_derivative[k] / charges.totals)
        sensitivity_error += float((CORRECTION_SHARE * correction + relative * sensitivities).sum())
    return replace(films, charges=replace(charges, bound=bound, sensitivity_error=sensitivity_error))


def list_charge_decisions(sample: ChargeSample, cut: Floats, accuracy: float) -> Iterator[Decision]:
    """Yield the decisions on what the charges' errors include besides those of meshes; parameters as above."""
    correction = CORRECTION_SHARE * float(np.abs(sample.correction[0] / sample.charges[0].sum(axis=1)).sum())
    change = f"changes the ratio of charges by at most about {format_percent(correction)}"
    reason = f"by a factor from the symmetric part: {change}, counted"
    yield Decision("the stack's compliance in the change of charges", True, correction, accuracy, reason)
    if cut.any():
        size = float(cut.sum())
        reason = f"left out: changes the ratio of charges by at most about {format_percent(size)}, counted in its error"
        yield Decision("the film's cut above the groove, and leads in it", False, size, accuracy, reason)
