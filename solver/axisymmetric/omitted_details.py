"""Bound the effects that a rotationally symmetric model of blocks and tissue leaves out."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import SolveError
from geometry.common.percent import format_percent
from geometry.meridian.mesh_lines import find_kind
from geometry.scenes.scene import Scene
from solver.axisymmetric.refinement import MESH_LEVELS
from solver.axisymmetric.sample import MeshSample, solve_on_mesh
from solver.axisymmetric.sections import HALF_SPACE_SIZES, Sections
from solver.results.detail_compliance import FILM_DETAIL, Detail, iterate_details
from solver.results.film_forces import Bound
from solver.results.result import Decision, Effect

IN_PLANE_DETAILS = FILM_DETAIL, "elastic base"  # details that the meridian plane can model
OUTER_TISSUE = f"the tissue beyond {HALF_SPACE_SIZES:g} probe sizes"
SECOND_ORDER_SHARE = 1 / 3  # remaining error, of the shift by the mean over cylinders
BRACKET_MARGIN_FACTOR = 1.2  # on the bracket of sides that are not round: the ratio may not be monotone in it


@dataclass(frozen=True)
class Change:
    """A feature and a bound on the change of the film forces by its omission, at each of k moduli.

    Attributes
    ----------
    feature
        Name of the feature.
    bounds
        Bounds on the change of the film forces, one for each modulus.
    sensitivity
        Estimate of the change of the log-sensitivities, shape (k,).
    totals
        Forces on each film to which the bounds are relative, N/m, shape (k, 2).
    shift
        Known part of the change, which is added to the forces, N/m, shape (k, 2, 2); 0 where none is known.
    modelled
        Whether the feature is modelled, so that its effect is no error.
    """

    feature: str
    bounds: tuple[Bound, ...]
    sensitivity: Floats
    totals: Floats
    modelled: bool = False
    shift: Floats | float = 0.0

    @property
    def effect(self) -> float:
        """The largest relative change of the ratio."""
        return max(bound.log_ratio for bound in self.bounds)

    def build_decision(self, accuracy: float) -> Decision:
        """Return the line of the plan for this feature."""
        totals = np.array([bound.totals for bound in self.bounds])
        with np.errstate(divide="ignore"):
            stresses = totals / np.abs(self.totals)
            stiffness = totals.sum(axis=1) / np.abs(self.totals.sum(axis=1))
        size = f"changes the ratio by at most about {format_percent(self.effect)}"
        reason = f"modelled: {size}" if self.modelled else f"left out: {size}, counted in error_estimate"
        changes = Effect(self.effect, float(stresses.max()), float(stiffness.max()))
        return Decision.from_effect(self.feature, self.modelled, changes, accuracy, reason)


def bound_omitted_changes(
    scene: Scene, plain: Sections, rough: Callable[[], MeshSample], moduli: Floats | None
) -> Iterable[Change]:
    """Yield bounds on the effects that round blocks on a rigid base and round tissue leave out.

    Parameters
    ----------
    scene
        Whose details are left out.
    plain
        Its sections without them.
    rough
        Solves the section on the coarsest mesh, ``MESH_LEVELS[0]``, at all moduli; called only if needed.
    moduli
        Of the inclusion, Pa, shape (k,), or None for its own.

    Raises
    ------
    SolveError
        The coarsest mesh cannot be solved.
    """
    zeros = np.zeros(1 if moduli is None else len(moduli))
    for detail in iterate_details(scene.probe):
        if detail.name != FILM_DETAIL or not scene.models_charges:
            yield bound_detail(detail, rough())
    if plain.bracket:
        yield _bound_sides(scene, plain, rough(), moduli)
    if scene.tissue.shape == "half-space":
        # 4 times size over distance: bounds what a finite model of the half-space changes
        relative_change = 4 / HALF_SPACE_SIZES
        bounds = tuple(Bound(relative_change * np.abs(totals), relative_change) for totals in rough().totals)
        yield Change(OUTER_TISSUE, bounds, zeros, rough().totals)


def bound_detail(detail: Detail, sample: MeshSample) -> Change:
    """Return the change of a sample's film forces by a detail that the sample leaves out; or, nearly the same, that it has."""
    bounds = tuple(detail.compute_bound(forces) for forces in sample.forces)
    return Change(detail.name, bounds, np.zeros(len(bounds)), sample.totals[:, :2])


def _bound_sides(scene: Scene, plain: Sections, rough: MeshSample, moduli: Floats | None) -> Change:
    """Correct for tissue that is not round about the probe's axis, by the mean over cylinders, with an error bound.

    F = (1 / 2 pi) Int F_cylinder(R(theta)) d theta (AX.4) is right to first order in the deviation of the sides from a circle,
    R(theta) their distance in the direction theta. With b the relative change of a total for the inscribed or circumscribed
    cylinder, the remaining error is bounded by a third of the shift and b^2. In 3D references with b = 0.03 and 0.06 it was
    0.0001 and 0.002 (their own uncertainty).

    Parameters
    ----------
    scene
        Whose tissue is not round about the probe's axis.
    plain
        Its sections without films and base; ``plain.bracket`` are the cylinders, in increasing radius.
    rough
        Solution for the cylinder of equal area, on the coarsest mesh.
    moduli
        Of the inclusion, Pa, shape (k,), or None for its own.
    """
    kind = find_kind(plain.section)
    from scipy.interpolate import pchip_interpolate

    bracket_samples = []
    for section in plain.bracket:
        try:  # on a mesh of one topology errors cancel in the difference
            with np.errstate(all="ignore"):  # lengths may be in another order; the mesh then has no area
                bracket_samples.append(solve_on_mesh(section, plain, scene, MESH_LEVELS[0], moduli=moduli, kind=kind))
        except SolveError:
            bracket_samples.append(solve_on_mesh(section, plain, scene, MESH_LEVELS[0], moduli=moduli))
    radii = np.array([section.tissue_radius for section in (*plain.bracket[:2], plain.section, *plain.bracket[2:])])
    bracket_forces = np.array([sample.forces for sample in (*bracket_samples[:2], rough, *bracket_samples[2:])])
    shift = pchip_interpolate(radii, bracket_forces, plain.outline).mean(axis=0) - rough.forces
    # largest changes of the totals by the cylinders, absolute and relative: b of the docstring times totals, and b
    widest = BRACKET_MARGIN_FACTOR * np.max(
        [np.abs(bracket_sample.totals - rough.totals) for bracket_sample in bracket_samples], axis=0
    )
    relative_widest = np.minimum(widest / np.abs(rough.totals), 1.0)
    shifted_totals = rough.totals + shift.sum(axis=2)
    # the true total lies within the bracket, so that its distance from the corrected one is a bound, too
    brackets = BRACKET_MARGIN_FACTOR * np.max(
        [np.abs(bracket_sample.totals - shifted_totals) for bracket_sample in bracket_samples], axis=0
    )
    totals = np.minimum(SECOND_ORDER_SHARE * np.abs(shift.sum(axis=2)) + relative_widest * widest, brackets)
    bracket_log_ratios = [
        np.log(np.abs(bracket_sample.totals / rough.totals)) @ [1.0, -1.0] for bracket_sample in bracket_samples
    ]
    shifted_log_ratio = np.log(np.abs(1 + shift.sum(axis=2) / rough.totals)) @ [1.0, -1.0]
    ratios = SECOND_ORDER_SHARE * np.abs(shifted_log_ratio) + BRACKET_MARGIN_FACTOR * np.max(
        np.abs(bracket_log_ratios), axis=0
    ) * np.clip(2 * relative_widest.max(axis=1), 0.25, 1.0)
    sensitivity_bounds = BRACKET_MARGIN_FACTOR * np.max(
        [np.abs(bracket_sample.log_sensitivities - rough.log_sensitivities)[:, 0] for bracket_sample in bracket_samples], axis=0
    )
    bounds = tuple(Bound(total, float(ratio)) for total, ratio in zip(totals, ratios, strict=True))
    return Change("sides that are not round", bounds, sensitivity_bounds, rough.totals, shift=shift)
