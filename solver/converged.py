"""Film forces of a scene to the accuracy asked for, with everything that is known of their errors."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np
from scipy.interpolate import pchip_interpolate

from geometry.errors import SolveError
from geometry.frame import Fineness, Kind
from geometry.frame import kind as kind_of
from geometry.grading import Floats
from geometry.probe import Material
from geometry.scene import Scene
from geometry.section import Body, Section
from solver.base_states import base_states, model
from solver.convergence import LEVELS, Errors, Sample, refined
from solver.details import details
from solver.film_forces import Bound, FilmForces
from solver.response import response
from solver.result import Decision
from solver.sections import HALF_SPACE, Sections, sections, with_layers

NEGLIGIBLE = 0.05  # of the accuracy: films and base that change less are left out
LAYERED = 2.0  # times the meshes' errors where films or a base are modelled: their corners are graded less finely
SECOND_ORDER = 1 / 3  # of what the mean over cylinders shifts: what it may leave
SLACK = 1.2  # on the bracket of tissue that is not round: within it the ratio need not be monotone


@dataclass(frozen=True)
class Converged:
    """Film forces at each modulus asked for.

    Attributes:
        films: with their errors.
        sample: where they come from; its states are those of one of the moduli, or of one between them.
        plan: what is modelled or left out, beyond blocks and tissue.
        notes: what stands in the way of a better answer, one line each.
    """

    films: tuple[FilmForces, ...]
    sample: Sample
    plan: tuple[Decision, ...]
    notes: tuple[str, ...]


@dataclass(frozen=True)
class Change:
    """A feature and a bound on what its omission changes of the film forces at each modulus.

    Attributes:
        sensitivity: estimate of what it changes of the log-sensitivities, shape (k,).
        shift: what is known of the change of the forces, and added to them, N/m, shape (k, 2, 2); or nothing.
    """

    feature: str
    bounds: tuple[Bound, ...]
    sensitivity: Floats
    modelled: bool = False
    shift: Floats | float = 0.0

    @property
    def effect(self) -> float:
        """The largest relative change of the ratio."""
        return max(bound.log_ratio for bound in self.bounds)


def converged(scene: Scene, accuracy: float, moduli: Floats | None = None) -> Converged:
    """Return film forces on the first mesh that meets ``accuracy``, or on the finest.

    Raises:
        SolveError: the scene's equations cannot be solved in double precision.
    """
    plain = sections(scene)
    rough = cache(lambda: sample(plain.section, plain, scene, LEVELS[0], moduli))
    changes = list(_left_out(scene, plain, rough, moduli))
    layers = [change for change in changes if change.feature in ("film compliance", "elastic base")]
    chosen = plain
    if any(change.effect > NEGLIGIBLE * accuracy for change in layers):
        chosen = with_layers(scene, plain)
        changes = [replace(change, modelled=True) if change in layers else change for change in changes]
    left_out = [change for change in changes if not change.modelled]
    solve = partial(sample, chosen.section, chosen, scene, moduli=moduli)

    def good(found: Sample, errors: Errors) -> bool:
        numerical, films = _films(scene, found, errors), _films(scene, found, errors, left_out)
        reached, least = (max(one.error_under(scene) for one in some) for some in (films, numerical))
        small = reached <= accuracy or (reached - least > accuracy and least <= accuracy / 2)
        return small and all(_sensitive_enough(one, accuracy) for one in numerical)

    found, errors, why = refined(
        lambda level: rough() if level == LEVELS[0] and chosen is plain else solve(level), accuracy, good
    )
    films = _films(scene, found, errors, left_out)
    return Converged(films, found, tuple(_decisions(changes, accuracy)), tuple(_notes(scene, films, left_out, accuracy, why)))


def sample(
    section: Section, of: Sections, scene: Scene, level: Fineness, moduli: Floats | None = None, kind: Kind | None = None
) -> Sample:
    """Solve one section on one mesh, at the inclusion's modulus or at all ``moduli``.

    Raises:
        SolveError: the equations cannot be solved in double precision.
    """
    materials, interface = dict(of.materials), scene.contact.interface
    assert interface != "unilateral"  # refused before
    if moduli is not None:
        shift = _middle(moduli, scene.tissue.youngs_modulus)
        ratio = scene.inclusion[0].poisson_ratio
        materials[Body.INCLUSION] = Material(youngs_modulus=shift, poisson_ratio=ratio)
    try:
        states = base_states(model(section, materials, interface, level, kind))
    except np.linalg.LinAlgError as fault:  # Poisson's ratio within rounding of 1/2
        raise SolveError(f"an element's matrix cannot be inverted: {fault}") from fault
    if moduli is None:
        slope = states.slope() if scene.inclusion else np.zeros((2, 2))
        return Sample(states.forces[None], slope[None], states, np.ones(1))
    times = moduli / shift
    spanned = response(states, times.min(), times.max())
    return Sample(*spanned.forces(times), states, times, spanned)


def _middle(moduli: Floats, tissue: float) -> float:
    """The modulus from which a curve is spanned: the middle of its part in which the film forces change."""
    low, high = np.clip([moduli.min(), moduli.max()], 0.01 * tissue, 100 * tissue)
    return float(np.sqrt(low * high))


def _left_out(scene: Scene, plain: Sections, rough: Callable[[], Sample], moduli: Floats | None) -> Iterable[Change]:
    """Bound what round blocks on a rigid base and round tissue leave out, from the coarsest mesh."""
    none = np.zeros(1 if moduli is None else len(moduli))
    for detail in details(scene.probe):
        yield Change(detail.name, tuple(detail.bound(forces) for forces in rough().forces), none)
    if plain.bracket:
        yield _sides(scene, plain, rough(), moduli)
    if scene.tissue.shape == "half-space":
        share = 4 / HALF_SPACE
        bounds = tuple(Bound(share * np.abs(totals), share) for totals in rough().totals)
        yield Change(f"the tissue beyond {HALF_SPACE:g} probe sizes", bounds, none)


def _sides(scene: Scene, plain: Sections, rough: Sample, moduli: Floats | None) -> Change:
    """The tissue's sides are not round about the probe's axis: the mean over cylinders of all their distances, eq. (A4).

    F = (1 / 2 pi) Int F_cylinder(R(theta)) d theta is right to first order in how far sides deviate from a circle. With b what
    the inscribed or circumscribed cylinder changes of a total, relative, what is left is bounded by a third of the shift and b^2;
    3D references with b = 0.03 and 0.06 leave 0.0001 and 0.002 (their own uncertainty).
    """
    kind = kind_of(plain.section)
    ends = []
    for section in plain.bracket:
        try:  # on a mesh of one topology errors cancel in the difference
            with np.errstate(all="ignore"):  # lengths may be in another order; the mesh's areas tell
                ends.append(sample(section, plain, scene, LEVELS[0], moduli, kind))
        except SolveError:
            ends.append(sample(section, plain, scene, LEVELS[0], moduli))
    radii = np.array([section.tissue_radius for section in (*plain.bracket[:2], plain.section, *plain.bracket[2:])])
    every = np.array([sample.forces for sample in (*ends[:2], rough, *ends[2:])])
    shift = pchip_interpolate(radii, every, plain.outline).mean(axis=0) - rough.forces
    widest = SLACK * np.max([np.abs(end.totals - rough.totals) for end in ends], axis=0)
    part = np.minimum(widest / np.abs(rough.totals), 1.0)
    moved = rough.totals + shift.sum(axis=2)
    brackets = SLACK * np.max([np.abs(end.totals - moved) for end in ends], axis=0)
    totals = np.minimum(SECOND_ORDER * np.abs(shift.sum(axis=2)) + part * widest, brackets)
    logs = [np.log(np.abs(end.totals / rough.totals)) @ [1.0, -1.0] for end in ends]
    shifted = np.log(np.abs(1 + shift.sum(axis=2) / rough.totals)) @ [1.0, -1.0]
    ratios = SECOND_ORDER * np.abs(shifted) + SLACK * np.max(np.abs(logs), axis=0) * np.clip(2 * part.max(axis=1), 0.25, 1.0)
    told = SLACK * np.max([np.abs(end.log_sensitivity - rough.log_sensitivity) for end in ends], axis=0)
    bounds = tuple(Bound(total, float(ratio)) for total, ratio in zip(totals, ratios, strict=True))
    return Change("the tissue's sides, taken as the mean of cylinders at all their distances", bounds, told, shift=shift)


def _films(scene: Scene, found: Sample, errors: Errors, changes: Iterable[Change] = ()) -> tuple[FilmForces, ...]:
    films = []
    for k, forces in enumerate(found.forces):
        margin = LAYERED if found.states.model.section.given_layers else 1.0
        bound = Bound.independent(margin * errors.totals[k], forces)
        told = margin * float(errors.sensitivity[k])
        for change in changes:
            bound, told = bound + change.bounds[k], told + float(change.sensitivity[k])
            forces = forces + np.broadcast_to(change.shift, found.forces.shape)[k]
        films.append(FilmForces(forces, bound, found.slope[k] if scene.target is not None else None, told))
    return tuple(films)


def _sensitive_enough(films: FilmForces, accuracy: float) -> bool:
    return films.sensitivity_error <= max(5 * accuracy * abs(films.log_sensitivity or 0.0), 1e-5)


def _decisions(changes: Iterable[Change], accuracy: float) -> Iterable[Decision]:
    for change in changes:
        size = f"changes the ratio by at most about {change.effect:.2g}"
        reason = f"modelled: {size}" if change.modelled else f"left out: {size}, counted in error_estimate"
        yield Decision(change.feature, change.modelled, float(min(change.effect, 1e9)), accuracy, reason)


def _notes(
    scene: Scene, films: tuple[FilmForces, ...], left_out: Iterable[Change], accuracy: float, why: str | None
) -> Iterable[str]:
    for change in left_out:
        if change.effect > NEGLIGIBLE * accuracy:
            yield f"left out: {change.feature}, changes the ratio by at most about {change.effect:.2g}, counted in error_estimate"
    reached = max(one.error_under(scene) for one in films)
    if reached > accuracy:
        bounds = f"error bounds of {reached:.2g}" if reached < 1 else "error bounds no smaller than the values themselves"
        text = f"{bounds} reached, accuracy {accuracy:g} asked for"
        yield text + (f"; no finer mesh helped: {why}" if why else ": what stands in the way is listed")
    worst = max((one.sensitivity_error / max(abs(one.log_sensitivity or 0.0), 2e-6 / accuracy) for one in films), default=0.0)
    if scene.target is not None and worst > 5 * accuracy:
        yield f"log_sensitivity is good to about {worst:.1g} of itself only"
