"""Rule for the largest load of linear elasticity: bounds on the effects of finite strain and of contact in the gap.

With x the indentation over the outer radius, finite strain changes ratio, stresses and stiffness by at most 0.1 x and the
log-sensitivity by at most exp(0.8 x) - 1, relative (PL.2). The rule is read off solutions with finite strain and contact, which
tests hold it against (``tests/reference/contact``); nothing is known beyond x = 0.3, nor beyond 1/20 of the force that closes
the gap in linear elasticity, see eq. PL.9: the true closure was found at 1/14 of it in the worst of 235 scenes. Those solutions
have stiff blocks on deep tissue, so that what else is strained counts as the indentation that would be as bad: shallow tissue by
PL.5, layers and faces that slide by PL.6, soft blocks by PL.3. Large inclusions near the surface change ratio, stresses and
stiffness more: PL.7; so does a film whose pressures nearly cancel: PL.10. Where a log-sensitivity nearly vanishes as those of
both films cancel, it counts as larger: PL.8.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from geometry.common.arrays import Floats
from geometry.scenes.scene import Scene
from solver.planning.strains import (
    RATIO_CHANGE,
    block_strain,
    both_strains,
    cancelling_factor,
    cover_factor,
    most_nearing,
    slimness,
)
from solver.results.load_limits import LargestLoad

SENSITIVITY_GROWTH = 0.8  # of ln(log-sensitivity) per x
LARGEST_X = 0.3
CLOSING = 1 / 20  # fraction of the linear closing force up to which the gap is known to stay open
CANCELLING_WALLS = 1 / 12  # of eq. PL.9
CANCELLING = 0.2  # of eq. PL.8: the worst of 240 scenes needs 0.065
LEAST_SENSITIVITY = 1e-5  # absolute, that a log-sensitivity is promised to

Cause = Literal["ratio", "log_sensitivity", "strain limit", "gap closure"]


def ratio_change(x: float, covered: float = 1.0) -> float:
    """Bound the relative change of ratio, stresses and stiffness by finite strain: eq. PL.2 times eq. PL.7."""
    return RATIO_CHANGE * covered * x


def log_sensitivity_change(x: float) -> float:
    """Bound the relative change of the log-sensitivity by finite strain, eq. PL.2; infinite where it would overflow."""
    return math.expm1(SENSITIVITY_GROWTH * x) if x < 800 else math.inf


def sensitivity_size(films: tuple[float, float]) -> float:
    """Return the size of the log-sensitivity S = S_inner - S_outer to which relative changes by finite strain refer.

    Where the films' own nearly cancel, each still changes, so that S counts as

        max(|S|, 0.2 |S_inner|, 0.2 |S_outer|)      (PL.8)

    Args:
        films: d ln force / d ln E_object of inner and outer film at a given indentation.
    """
    inner, outer = films
    return max(abs(inner - outer), CANCELLING * max(abs(inner), abs(outer)))


def largest_x(accuracy: float, promise: float | None, covered: float = 1.0) -> tuple[float, Cause]:
    """Return the largest x (indentation over outer radius) at which the rule keeps an accuracy, and what limits it.

    Args:
        accuracy: relative, on ratio, stresses and stiffness.
        promise: how good the log-sensitivity has to be, relative to its size by eq. PL.8; None where it does not matter.
        covered: eq. PL.7.
    """
    limits: dict[Cause, float] = {"strain limit": LARGEST_X, "ratio": accuracy / RATIO_CHANGE / covered}
    if promise is not None:
        limits["log_sensitivity"] = math.log1p(promise) / SENSITIVITY_GROWTH
    by = min(limits, key=lambda cause: limits[cause])
    return limits[by], by


def least_closure(scene: Scene, totals: Floats) -> float:
    """Return a lower bound on the force that closes the gap in linear elasticity, N, from formulas that do not model the walls.

    Args:
        scene: its load does not matter.
        totals: force on each film, inner and outer, per indentation, N/m, shape (2,).
    """
    return float(totals.sum()) * scene.probe.gap / nearing_at_most(scene, totals)


def nearing_at_most(scene: Scene, totals: Floats) -> float:
    """Return an upper bound on the walls' approach per indentation, eq. PL.4; arguments as of the closing force's bound."""
    probe = scene.probe
    areas, moduli = (probe.inner_area, probe.outer_area), (probe.inner.youngs_modulus, probe.outer.youngs_modulus)
    inner, outer = np.abs(totals) / areas / moduli
    radii = (probe.inner_radius, probe.hole_radius, probe.tube_radius)
    return float(most_nearing(scene.tissue, radii, (inner, outer), moduli[1]))


@dataclass(frozen=True)
class LoadRule:
    """The rule for one probe on one tissue.

    Attributes:
        strain: x per indentation, 1/m: ``tissue_strain`` and what the blocks' own strain adds.
        stiffness: linear, force per indentation, N/m.
        closure: force that closes the gap in linear elasticity, N; see ``CoarseModel.closure_force``.
        tilted: by how much a tilt lowers one side of the probe, m, which counts as indentation.
        covered: eqs. PL.7 and PL.11, times eq. PL.10.
        films: log-sensitivities of both film forces, where a result has them, see ``compute_sensitivity_size``.
    """

    strain: float
    stiffness: float
    closure: float
    tilted: float = 0.0
    covered: float = 1.0
    films: tuple[float, float] | None = None

    @classmethod
    def of(cls, scene: Scene, totals: Floats, closure: float) -> LoadRule:
        """Build the rule of a scene from its linear film forces.

        A block of height h whose mean strain is e per indentation d changes the stiffness by about e times its share e h / d of
        the indentation: it adds e^2 h / 0.1 to x per indentation; the tissue drags a tube along as well, the thinner the more,
        which adds 1 + 0.15 R / w times that with its outer radius R and wall w (PL.3). The block that adds more counts.

        Args:
            scene: its load does not matter.
            totals: force on each film, inner and outer, per indentation, N/m, shape (2,).
            closure: ``CoarseModel.closure_force``.
        """
        probe = scene.probe
        inner = block_strain(probe.core_height, totals[0] / probe.inner_area / probe.inner.youngs_modulus)
        outer = block_strain(probe.tube_height, totals[1] / probe.outer_area / probe.outer.youngs_modulus)
        outer *= slimness(probe.tube_radius, probe.tube_radius - probe.hole_radius)
        tilted = probe.tube_radius * math.tan(abs(scene.placement.tilt))
        added, cover = max(inner, outer), cover_factor(scene.inclusion)
        strain, of_ratio = (
            float(one) for one in both_strains(probe.tube_radius, scene.tissue, scene.contact.interface, added, cover)
        )
        covered = of_ratio / strain * cancelling_factor(totals, (probe.inner_area, probe.outer_area))
        return cls(strain, float(totals.sum()), closure, tilted, covered)

    def force(self, scene: Scene) -> float:
        """Return the force of a scene's load, N."""
        load = scene.load
        return self.stiffness * load.indentation if load.indentation is not None else load.force or 0.0

    def x(self, force: float) -> float:
        """Return x under a force, N."""
        return self.strain * (force / self.stiffness + self.tilted)

    def largest(self, accuracy: float, promise: bool) -> LargestLoad:
        """Return the largest load that keeps an accuracy; 0 where the tilt alone does not.

        Args:
            accuracy: relative, on ratio, stresses and stiffness.
            promise: whether the log-sensitivity has to be good to five times that.
        """
        limits = [self.largest_open, self.largest_for_ratio(accuracy)]
        limits += [self.largest_for_sensitivity(accuracy)] if promise else []
        return min(limits, key=lambda one: one.force)

    def largest_for_ratio(self, accuracy: float) -> LargestLoad:
        """Return the largest load that changes ratio, stresses and stiffness by at most an accuracy, relative."""
        return self._up_to(*largest_x(accuracy, None, self.covered))

    def largest_for_sensitivity(self, accuracy: float) -> LargestLoad:
        """Return the largest load that changes the log-sensitivity by at most five times an accuracy, relative."""
        return self._up_to(*largest_x(math.inf, self._promised(accuracy)))

    @property
    def largest_open(self) -> LargestLoad:
        """The largest load that the rule covers: the gap stays open up to it."""
        deepest = self._up_to(LARGEST_X, "strain limit")
        if deepest.force < CLOSING * self.closure:
            return deepest
        return LargestLoad(CLOSING * self.closure, CLOSING * self.closure / self.stiffness, "gap closure")

    def _up_to(self, x: float, by: Cause) -> LargestLoad:
        """Return the load under which x has a given value."""
        force = max(0.0, x / self.strain - self.tilted) * self.stiffness
        return LargestLoad(force, force / self.stiffness, by)

    def _promised(self, accuracy: float) -> float:
        """Return the tolerance on the log-sensitivity, relative to its size: five times the accuracy, relative to itself."""
        if self.films is None or not any(self.films):
            return 5 * accuracy
        own = abs(self.films[0] - self.films[1])
        return max(5 * accuracy * own, LEAST_SENSITIVITY) / sensitivity_size(self.films)

    def promise_taken(self, force: float, accuracy: float) -> float:
        """Return the fraction of the log-sensitivity's tolerance that a force, N, may use up; infinite where it is unknown."""
        return log_sensitivity_change(self.x(force)) / self._promised(accuracy) if self.knows(force) else math.inf

    @property
    def known(self) -> float:
        """The largest force that the rule covers, N."""
        return self.largest_open.force

    def knows(self, force: float) -> bool:
        """Return whether the rule covers a force, N."""
        return self.x(force) <= LARGEST_X and force <= CLOSING * self.closure

    def ratio_change(self, force: float) -> float:
        """Bound the relative change of ratio, stresses and stiffness by a force, N; infinite where it is unknown."""
        return ratio_change(self.x(force), self.covered) if self.knows(force) else math.inf

    def log_sensitivity_change(self, force: float) -> float:
        """Bound the relative change of the log-sensitivity by a force, N; infinite where unknown or for a sensitivity of 0."""
        if not self.knows(force):
            return math.inf
        if self.films is None or not any(self.films):
            return log_sensitivity_change(self.x(force))
        own = abs(self.films[0] - self.films[1])
        return log_sensitivity_change(self.x(force)) * sensitivity_size(self.films) / own if own else math.inf

    def describe_changes(self, force: float, promise: bool) -> str:
        """Return in words how much a force, N, within what the rule knows changes at most.

        Where the films' log-sensitivities may cancel, a fraction of their difference says nothing: the change itself is given.

        Args:
            force: N.
            promise: whether there is a log-sensitivity.
        """
        changes = f"ratio, stresses and stiffness by at most {self.ratio_change(force):.2g}"
        if not promise:
            return changes
        fraction = self.log_sensitivity_change(force)
        change = f"{fraction:.2g} of itself"
        if fraction > 1 and self.films is not None and any(self.films):
            change = f"{log_sensitivity_change(self.x(force)) * sensitivity_size(self.films):.2g} (absolute)"
        return f"{changes}, log_sensitivity by at most {change}"
