"""A line over the tissue along which the probe moves: allowed positions, tumours relative to the probe, effect of the sides.

The evaluator models the tissue as a cylinder of the same area about the probe's axis, at any position of the probe, and bounds
the error by the inscribed and the circumscribed cylinder. With the distance from the tissue's middle the first shrinks and the
second grows, so that the bound at the farthest of some positions holds at all of them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from geometry.common.arrays import Floats, Ints
from geometry.common.errors import InputError
from geometry.common.limits import most_mm
from geometry.scenes.probe import mm
from geometry.scenes.scene import Placement, Scene
from geometry.scenes.units import SI
from solver.equivalent_inclusion.level import EquivalentInclusion
from solver.equivalent_inclusion.probe_on_tissue import ProbeAlone, Undisturbed
from solver.equivalent_inclusion.readings import Readings
from solver.inclusions.tumours import Tumours

NOT_SQUARE = 0.3  # of the effect of the sides between two positions: error of its interpolation with the square of the distance
SPLITS = 3  # halvings of the positions for closer bounds: up to 8 solutions
ENOUGH = 0.5  # of the accuracy: error bounds that need no further halving


@dataclass(frozen=True)
class ScanLine:
    """The line of a scan.

    Attributes:
        scene: its own placement along the line is not used.
        axis: "x" or "y", along which the probe moves.
        offset: coordinate along the other axis, m.
        accuracy: relative, required of the evaluator.
    """

    scene: Scene
    along: str
    at: float
    accuracy: float

    @property
    def across(self) -> str:
        """The other axis."""
        return "y" if self.along == "x" else "x"

    @property
    def limit(self) -> float:
        """Largest distance of the probe's axis from the tissue's middle along the line, m; 0 or less where none is allowed."""
        tissue, reach = self.scene.tissue, self.scene.probe.tube_radius
        if tissue.shape == "half-space":
            return math.inf
        if tissue.shape == "cylinder":
            room = tissue.radius - reach
            return math.sqrt(room**2 - self.at**2) if room > abs(self.at) else 0.0
        length, breadth = (tissue.length, tissue.breadth) if self.along == "x" else (tissue.breadth, tissue.length)
        return length / 2 - reach if abs(self.at) < breadth / 2 - reach else 0.0

    def check(self, positions: Floats) -> None:
        """Raise ``InputError`` where the probe would leave the tissue."""
        if positions.ndim != 1 or not positions.size or not np.all(np.isfinite(positions)):
            raise InputError("position", "not all finite", "one or more finite positions, m")
        most = self.limit * (1 - 1e-9)
        why = f"the whole probe, of radius {mm(self.scene.probe.tube_radius)}, has to stand on the tissue"
        if most <= 0:
            widest = replace(self, along=self.across, at=0.0).limit
            raise InputError("at", mm(self.at), f"less than {most_mm(widest)} from the tissue's middle ({why})")
        for key, end in (("from", positions.min()), ("to", positions.max())):
            if abs(end) >= most:
                beside = f" at {self.across} = {mm(self.at)}" if self.at else ""
                raise InputError(key, mm(end), f"positions between -{most_mm(most)} and {most_mm(most)}{beside} ({why})")

    def tumours(self, positions: Floats) -> Tumours:
        """Return the inclusions relative to each position of the probe, shape (n, inclusions)."""
        keys = (self.along, self.across, "depth", "diameter", "youngs_modulus", "poisson_ratio")
        table = {key: np.array([[getattr(body, key) for body in self.scene.inclusion]], dtype=float) for key in keys}
        table[self.along] = table[self.along] - positions[:, None]
        table[self.across] = table[self.across] - self.at
        return Tumours(**table)

    def prepared(self, position: float) -> Undisturbed:
        """Solve the probe at a position on the tissue without tumours.

        Raises:
            Refusal: the evaluator cannot model the scene, or it is too extreme for double precision.
        """
        return EquivalentInclusion().prepared(self._at(position), self.accuracy)

    def alone(self, position: float) -> ProbeAlone:
        """Return only the film forces at a position without tumours.

        Raises:
            Refusal: see ``prepare``.
        """
        return EquivalentInclusion().alone(self._at(position), self.accuracy)

    def _at(self, position: float) -> Scene:
        at = {self.along: abs(position), self.across: abs(self.at), "tilt": self.scene.placement.tilt}
        placement = Placement.model_validate({key: float(value) for key, value in at.items()}, context=SI)
        return self.scene.model_copy(update={"placement": placement})

    def bounded(self, base: Undisturbed, answers: Readings, positions: Floats) -> Readings:
        """Return readings that were computed with one ``base``, corrected for the tissue's sides at each position.

        The film forces without tumours are interpolated with the square of the distance from the tissue's middle, between that of
        ``base`` and the farthest position of each part; the error bounds are those of the farthest position.
        """
        own, forces = answers.bound - base.films.bound.totals, answers.forces.copy()
        bound, log_ratio = np.empty_like(answers.bound), np.empty_like(answers.log_ratio_bound)
        order = np.argsort(np.abs(positions))
        near, away = positions[order[0]] ** 2, positions**2
        for part, there in self._parts(positions, order, self.alone(positions[order[-1]]), SPLITS):
            change, span = there.films.forces - base.films.forces, away[part].max() - near
            share = (away[part] - near) / span if span > 0 else np.zeros(len(part))
            forces[part] += share[:, None, None] * change
            apart = NOT_SQUARE * np.abs(change.sum(axis=1))
            bound[part], log_ratio[part] = there.with_bounds(own[part] + apart, forces[part])
        return replace(answers, forces=forces, bound=bound, log_ratio_bound=log_ratio)

    def _parts(self, positions: Floats, order: Ints, far: ProbeAlone, splits: int) -> list[tuple[Ints, ProbeAlone]]:
        """Halve the positions, sorted by distance, until the error bounds at the farthest of each part are small enough."""
        worst = max(far.films.ratio_error, far.films.relative_errors.max())
        if worst <= ENOUGH * self.accuracy or splits == 0 or len(order) < 2:
            return [(order, far)]
        near, rest = order[: len(order) // 2], order[len(order) // 2 :]
        return [
            *self._parts(positions, near, self.alone(positions[near[-1]]), splits - 1),
            *self._parts(positions, rest, far, splits - 1),
        ]
