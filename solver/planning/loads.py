"""Rule for the largest load of linear elasticity: bounds on the effects of finite strain and of contact in the gap.

With x the indentation over the outer radius, finite strain changes ratio, stresses and stiffness by at most 0.1 x and the
log-sensitivity by at most exp(0.8 x) - 1, relative (PL.2). The rule is read off solutions with finite strain and contact, which
tests hold it against (``tests/reference/contact``); nothing is known beyond x = 0.3, nor beyond 1/20 of the force that closes
the gap in linear elasticity, see eq. PL.9: the true closure was found at 1/14 of it in the worst of 235 scenes. Those solutions
have stiff blocks on deep tissue, so that what else is strained counts as the indentation that would be as bad: shallow tissue by
PL.5, layers and faces that slide by PL.6, soft blocks by PL.3, laws that are not neo-Hookean by PL.12. Large inclusions near the
surface change ratio, stresses and stiffness more: PL.7; so does a film whose pressures nearly cancel: PL.10. Where a
log-sensitivity nearly vanishes as those of both films cancel, it counts as larger: PL.8. The ratio of charges on tape changes
more than that of forces: PL.13.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from geometry.common.arrays import Floats, Numeric
from geometry.common.percent import format_percent
from geometry.scenes.probe import Material
from geometry.scenes.scene import Scene
from geometry.scenes.variables import list_bonds
from solver.materials.strain_energies import StrainEnergy, build_strain_energy
from solver.planning.strains import (
    RATIO_CHANGE_PER_X,
    bound_nearing,
    compute_block_strain,
    compute_both_strains,
    compute_cancelling_factor,
    compute_cover_factor,
    compute_slimness,
)
from solver.results.film_charges import reads_film_states
from solver.results.film_forces import compute_sensitivity_tolerance
from solver.results.load_limits import LargestLoad

SENSITIVITY_GROWTH = 0.8  # of ln(log-sensitivity) per x
MAX_X = 0.3
CLOSURE_FORCE_SHARE = 1 / 20  # fraction of the linear closing force up to which the gap is known to stay open
CANCELLING_WALL_SHARE = 1 / 12  # of eq. PL.9
CANCELLING_FILM_SHARE = 0.2  # of eq. PL.8: the worst of 240 scenes needs 0.065
STIFFENING_COEFFICIENT, DISTORTION_COEFFICIENT = 0.24, 17.0  # of eq. PL.12: 11 scenes, c2 1 and 10, c3 1 and 30, need 0.7 of it
INNER_BODY_SHARE = 1 / 8  # likewise of blocks and inclusions: a soft tumour needs half of it
CHARGE_COEFFICIENT, MAX_TAPE_MODULUS_PA = 1.25, 50e6  # of eq. PL.13: measured against contact, films of 28 and 110 um
TESTED_COUNT, MIN_TESTED_X = 400, 1e-6  # values of x at which eq. PL.12 is evaluated, on a logarithmic scale

Cause = Literal["ratio", "log_sensitivity", "strain limit", "gap closure"]


def bound_ratio_change(x: float, covered: float = 1.0) -> float:
    """Bound the relative change of ratio, stresses and stiffness by finite strain: eq. PL.2 times ``covered``, eq. PL.7."""
    return RATIO_CHANGE_PER_X * covered * x


def bound_log_sensitivity_change(x: float) -> float:
    """Bound the relative change of the log-sensitivity by finite strain, eq. PL.2; infinite where it would overflow."""
    return math.expm1(SENSITIVITY_GROWTH * x) if x < 800 else math.inf


def compute_sensitivity_size(films: tuple[float, float]) -> float:
    """Return the size of the log-sensitivity S = S_inner - S_outer to which relative changes by finite strain refer.

    Where the films' own nearly cancel, each still changes, so that S counts as

        max(|S|, 0.2 |S_inner|, 0.2 |S_outer|)      (PL.8)

    Parameters
    ----------
    films
        d ln force / d ln E_object of inner and outer film at a given indentation.
    """
    inner, outer = films
    return max(abs(inner - outer), CANCELLING_FILM_SHARE * max(abs(inner), abs(outer)))


def find_largest_x(accuracy: float, promise: float | None, covered: float = 1.0) -> tuple[float, Cause]:
    """Return the largest x (indentation over outer radius) at which the rule keeps an accuracy, and what limits it.

    Parameters
    ----------
    accuracy
        Relative, on ratio, stresses and stiffness.
    promise
        Tolerance on the log-sensitivity, relative to its size by eq. PL.8; None where it does not matter.
    covered
        Factor on the change of ratio, stresses and stiffness, eq. PL.7.
    """
    limits: dict[Cause, float] = {"strain limit": MAX_X, "ratio": accuracy / RATIO_CHANGE_PER_X / covered}
    if promise is not None:
        limits["log_sensitivity"] = math.log1p(promise) / SENSITIVITY_GROWTH
    limiting_cause = min(limits, key=lambda cause: limits[cause])
    return limits[limiting_cause], limiting_cause


def bound_closure_force(scene: Scene, totals: Floats) -> float:
    """Return a lower bound on the force that closes the gap in linear elasticity, N, from formulas that do not model the walls.

    Parameters
    ----------
    scene
        The scene; its load does not matter.
    totals
        Force on each film, inner and outer, per indentation, N/m, shape (2,).
    """
    return float(totals.sum()) * scene.probe.gap / bound_wall_nearing(scene, totals)


def bound_wall_nearing(scene: Scene, totals: Floats) -> float:
    """Return an upper bound on the walls' approach per indentation, eq. PL.4; parameters as of ``bound_closure_force``."""
    probe = scene.probe
    areas, moduli = (probe.inner_area, probe.outer_area), (probe.inner.youngs_modulus, probe.outer.youngs_modulus)
    inner, outer = np.abs(totals) / areas / moduli  # mean strains of both blocks per indentation, 1/m
    radii = (probe.inner_radius, probe.hole_radius, probe.tube_radius)
    return float(bound_nearing(scene.tissue, radii, (inner, outer), moduli[1]))


def compute_law_factor(scene: Scene) -> float:
    """Return the factor s by which the laws of a scene's materials increase x; 1 where all are neo-Hookean.

    A law f, in shear moduli, is stiffer or softer by 2 f' - 1 than a neo-Hookean one. In tissue and layers under x that adds

        0.24 max |2 f'(I) - 1|  over  I = I_1 - 3 up to 17 x^2      (PL.12)

    to x, in blocks and inclusions an eighth of it. It grows faster than x, of which the rule knows nothing above 0.3: s is the
    smallest number so that s x includes it for every x up to 0.3 / s.
    """
    probe, tissue = scene.probe, scene.tissue
    outer, inner = (_list_laws(bodies) for bodies in ((tissue, *tissue.layer), (probe.inner, probe.outer, *scene.inclusion)))
    if not outer and not inner:
        return 1.0
    x, added = np.geomspace(MIN_TESTED_X, MAX_X, TESTED_COUNT), np.zeros(TESTED_COUNT)
    for weight, laws in ((1.0, outer), (INNER_BODY_SHARE, inner)):
        for law in laws:
            change = np.maximum.accumulate(np.abs(2 * law.evaluate(DISTORTION_COEFFICIENT * x**2)[1] - 1))
            added = np.maximum(added, weight * STIFFENING_COEFFICIENT * change)
    # the factor at each x, rising; s is that at the x for which factor x reaches MAX_X
    factors = np.maximum.accumulate(1 + added / x)
    return MAX_X / float(np.interp(MAX_X, factors * x, x))


def compute_charge_factor(scene: Scene) -> float:
    """Return the factor on the change of the ratio where a scene reads charges of films on tape; else 1.

    The stretching of such films follows the shear tractions under the blocks, which change with the load more than the forces
    do, and the more, the lower the blocks are: with the outer radius R and the lower block's height h by

        max(1, 1.25 (R / h)^2)      (PL.13)

    times eq. PL.2. Of 25 scenes with tapes of 0.15 to 10 MPa the worst needs 0.85 of it; films on glue need no factor.
    """
    if not has_tape(scene):
        return 1.0
    probe = scene.probe
    height = min(probe.core_height, probe.tube_height)
    return max(1.0, float(compute_flatness_factor(probe.tube_radius, height)))


def has_tape(scene: Scene) -> bool:
    """Return whether a scene reads charges of films on tape."""
    tapes = [bond for bond in list_bonds(scene).values() if (bond.youngs_modulus or math.inf) <= MAX_TAPE_MODULUS_PA]
    return bool(tapes) and reads_film_states(scene)


def compute_flatness_factor(tube_radius: Numeric, height: Numeric) -> Numeric:
    """Return 1.25 (R / h)^2 of eq. PL.13 for outer radii and heights of the lower block, m; floats or arrays."""
    return CHARGE_COEFFICIENT * (tube_radius / height) ** 2


def _list_laws(materials: tuple[Material, ...]) -> list[StrainEnergy]:
    """List the laws of materials that are not neo-Hookean."""
    return [law for material in materials if (law := build_strain_energy(material)) is not None]


@dataclass(frozen=True)
class LoadRule:
    """The rule for one probe on one tissue.

    Attributes
    ----------
    strain
        x per indentation, 1/m: from ``compute_tissue_strain``, and what the blocks' own strain adds.
    stiffness
        Linear, force per indentation, N/m.
    closure
        Force that closes the gap in linear elasticity, N; see ``CoarseModel.closure_force``.
    tilted
        Distance by which a tilt lowers one side of the probe, m, which counts as indentation.
    covered
        Factor on the change of ratio, stresses and stiffness: eqs. PL.7 and PL.11, times eq. PL.10; at least eq. PL.13.
    films
        Log-sensitivities of both film forces, where a result has them, see ``compute_sensitivity_size``.
    """

    strain: float
    stiffness: float
    closure: float
    tilted: float = 0.0
    covered: float = 1.0
    films: tuple[float, float] | None = None

    @classmethod
    def from_totals(cls, scene: Scene, totals: Floats, closure: float) -> LoadRule:
        """Build the rule of a scene from its linear film forces.

        A block of height h whose mean strain is e per indentation d changes the stiffness by about e times its share e h / d of
        the indentation: it adds e^2 h / 0.1 to x per indentation; the tissue drags a tube along as well, the thinner the more,
        which adds 1 + 0.15 R / w times that with its outer radius R and wall w (PL.3). The block that adds more counts.

        Parameters
        ----------
        scene
            The scene; its load does not matter.
        totals
            Force on each film, inner and outer, per indentation, N/m, shape (2,).
        closure
            ``CoarseModel.closure_force``.
        """
        probe = scene.probe
        inner = compute_block_strain(probe.core_height, totals[0] / probe.inner_area / probe.inner.youngs_modulus)
        outer = compute_block_strain(probe.tube_height, totals[1] / probe.outer_area / probe.outer.youngs_modulus)
        outer *= compute_slimness(probe.tube_radius, probe.tube_radius - probe.hole_radius)
        tilted = probe.tube_radius * math.tan(abs(scene.placement.tilt))
        added, cover = max(inner, outer), compute_cover_factor(scene.inclusion)
        law = compute_law_factor(scene)
        strains = compute_both_strains(probe.tube_radius, scene.tissue, scene.contact.interface, added, cover, law=law)
        # for the log-sensitivity, and for ratio, stresses and stiffness
        strain, ratio_strain = (float(value) for value in strains)
        covered = ratio_strain / strain * compute_cancelling_factor(totals, (probe.inner_area, probe.outer_area))
        covered = max(covered, compute_charge_factor(scene))
        return cls(strain, float(totals.sum()), closure, tilted, covered)

    def compute_force(self, scene: Scene) -> float:
        """Return the force by which the readings depart from linear elasticity, N: of the peak, or of twice the preload."""
        load = scene.load.departure
        return self.stiffness * load.indentation if load.indentation is not None else load.force or 0.0

    def compute_x(self, force: float) -> float:
        """Return x under a force, N."""
        return self.strain * (force / self.stiffness + self.tilted)

    def find_largest_load(self, accuracy: float, promise: bool) -> LargestLoad:
        """Return the largest load that keeps an accuracy; its force is 0 where the tilt alone is too much.

        Parameters
        ----------
        accuracy
            Relative, on ratio, stresses and stiffness.
        promise
            Whether the log-sensitivity has to be accurate to five times that.
        """
        limits = [self.largest_open_load, self.find_ratio_limit(accuracy)]
        limits += [self.find_sensitivity_limit(accuracy)] if promise else []
        return min(limits, key=lambda load: load.force)

    def find_ratio_limit(self, accuracy: float) -> LargestLoad:
        """Return the largest load that changes ratio, stresses and stiffness by at most an accuracy, relative."""
        return self._find_load(*find_largest_x(accuracy, None, self.covered))

    def find_sensitivity_limit(self, accuracy: float) -> LargestLoad:
        """Return the largest load that changes the log-sensitivity by at most five times an accuracy, relative."""
        return self._find_load(*find_largest_x(math.inf, self._compute_promise(accuracy)))

    @property
    def largest_open_load(self) -> LargestLoad:
        """The largest load that the rule covers: the gap stays open up to it."""
        deepest = self._find_load(MAX_X, "strain limit")
        if deepest.force < CLOSURE_FORCE_SHARE * self.closure:
            return deepest
        return LargestLoad(CLOSURE_FORCE_SHARE * self.closure, CLOSURE_FORCE_SHARE * self.closure / self.stiffness, "gap closure")

    def _find_load(self, x: float, cause: Cause) -> LargestLoad:
        """Return the load under which x has a given value, with the cause that limits it there."""
        force = max(0.0, x / self.strain - self.tilted) * self.stiffness
        return LargestLoad(force, force / self.stiffness, cause)

    def _compute_promise(self, accuracy: float) -> float:
        """Return the tolerance on the log-sensitivity, relative to its size by eq. PL.8.

        It is five times the accuracy relative to the log-sensitivity itself, which is its size where ``films`` is not known.
        """
        if self.films is None or not any(self.films):
            return 5 * accuracy
        sensitivity = abs(self.films[0] - self.films[1])
        return float(compute_sensitivity_tolerance(accuracy, sensitivity)) / compute_sensitivity_size(self.films)

    def compute_promise_share(self, force: float, accuracy: float) -> float:
        """Return the fraction of the log-sensitivity's tolerance that a force, N, may use up; infinite if unknown."""
        return (
            bound_log_sensitivity_change(self.compute_x(force)) / self._compute_promise(accuracy)
            if self.is_known(force)
            else math.inf
        )

    @property
    def largest_known_force(self) -> float:
        """The largest force that the rule covers, N."""
        return self.largest_open_load.force

    def is_known(self, force: float) -> bool:
        """Return whether the rule covers a force, N."""
        return self.compute_x(force) <= MAX_X and force <= CLOSURE_FORCE_SHARE * self.closure

    def bound_ratio_change(self, force: float) -> float:
        """Bound the relative change of ratio, stresses and stiffness by a force, N; infinite where it is unknown."""
        return bound_ratio_change(self.compute_x(force), self.covered) if self.is_known(force) else math.inf

    def bound_log_sensitivity_change(self, force: float) -> float:
        """Bound the relative change of the log-sensitivity by a force, N; infinite where unknown or for a sensitivity of 0."""
        if not self.is_known(force):
            return math.inf
        change = bound_log_sensitivity_change(self.compute_x(force))
        if self.films is None or not any(self.films):
            return change
        sensitivity = abs(self.films[0] - self.films[1])
        return change * compute_sensitivity_size(self.films) / sensitivity if sensitivity else math.inf

    def describe_changes(self, force: float, promise: bool) -> str:
        """Describe in words how much a force, N, changes at most; the rule must cover it (``is_known``).

        Where the films' log-sensitivities may cancel, a fraction of their difference means nothing: then the absolute change is
        given.

        Parameters
        ----------
        force
            N.
        promise
            Whether there is a log-sensitivity.
        """
        changes = f"ratio, stresses and stiffness by at most {format_percent(self.bound_ratio_change(force))}"
        if not promise:
            return changes
        fraction = self.bound_log_sensitivity_change(force)
        change = f"{format_percent(fraction)} of its value"
        if fraction > 1 and self.films is not None and any(self.films):
            change = (
                f"{bound_log_sensitivity_change(self.compute_x(force)) * compute_sensitivity_size(self.films):.2g} (absolute)"
            )
        return f"{changes}, log_sensitivity by at most {change}"
