"""Compute readings by another evaluator: smooth functions of the unknown and of the nuisances.

The evaluator computes all readings at the Chebyshev points of a box, whose coordinates are the logarithm of the unknown and the
nuisances in standard deviations. Between these points stands the polynomial through them; ``defect`` holds it to the evaluator at
drawn points.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import reduce
from itertools import product

import numpy as np
from numpy.polynomial import chebyshev

from geometry.common.arrays import Floats
from geometry.scenes.scene import Scene
from geometry.scenes.scene_tables import Placement
from geometry.scenes.variables import list_values
from probe_design.estimation.model import TARGET_UNKNOWNS
from solver import evaluator

REACH_SD = 3.0  # of a nuisance: beyond it lie 0.3 % of the draws, which are drawn again


@dataclass(frozen=True)
class Press:
    """One press of the probe.

    Attributes
    ----------
    x
        Of its axis, m.
    blank
        Whether there is no tumour.
    stiff
        Whether its stiffness is read, too.
    """

    x: float = 0.0
    blank: bool = False
    stiff: bool = False


@dataclass(frozen=True)
class ReadingCase:
    """What is simulated, and what is asked about it.

    Attributes
    ----------
    kind
        Of the four kinds of the table.
    name
        Of the case.
    scene
        With the nuisances' priors in its numbers.
    unknown
        As in ``probe_design.estimate``.
    low, high
        Between which the unknown is drawn, evenly in its logarithm, SI.
    noise
        Relative standard deviation of ratios.
    stiffness_noise
        Of stiffnesses.
    presses
        Of one set of readings.
    nuisances
        Relative standard deviations by name.
    evaluator
        Of the truth.
    accuracy
        Asked of it.
    nodes
        Along the unknown, and along each nuisance.
    """

    kind: str
    name: str
    scene: Scene
    unknown: str
    low: float
    high: float
    noise: float
    presses: tuple[Press, ...] = (Press(),)
    stiffness_noise: float = 0.02
    nuisances: dict[str, float] = field(default_factory=dict)
    evaluator: str = "axisymmetric"
    accuracy: float = 3e-4
    nodes: tuple[int, int] = (24, 8)

    @property
    def key(self) -> str:
        """Of the unknown among the scene's numbers."""
        return f"inclusion.{self.unknown}" if self.unknown in TARGET_UNKNOWNS else self.unknown

    @property
    def box(self) -> list[tuple[float, float, int]]:
        """Lower end, upper end and number of points of each coordinate."""
        nuisances = [(-REACH_SD, REACH_SD, self.nodes[1])] * len(self.nuisances)
        return [(math.log(self.low), math.log(self.high), self.nodes[0]), *nuisances]

    @property
    def noises(self) -> Floats:
        """Standard deviations of the readings, shape (k,)."""
        return np.array([self.noise] * len(self.presses) + [self.stiffness_noise] * sum(press.stiff for press in self.presses))

    def scene_at(self, point: Sequence[float]) -> Scene:
        """Return the scene at a point of the box."""
        values, priors = list_values(self.scene), self.nuisances.items()
        new = {name: values[name] * math.exp(sd * eta) for (name, sd), eta in zip(priors, point[1:], strict=True)}
        return self.scene.replace(new | {self.key: math.exp(point[0])})

    def readings(self, point: Sequence[float], moduli: Floats | None = None) -> Floats:
        """Return ln ratio of each press, then ln stiffness of those whose stiffness is read, shape (n, k).

        Parameters
        ----------
        point
            Of the box.
        moduli
            n of the target, in place of the point's; left out: the scene's own, n = 1.
        """
        scene, readings_by_key = self.scene_at(point), dict[tuple[float, bool], Floats]()
        for press in self.presses:
            key = (abs(press.x), press.blank)  # one body on the tissue's axis looks the same from both sides
            if key not in readings_by_key:
                moved = scene.model_copy(update={"placement": Placement(x=abs(press.x))})
                readings_by_key[key] = self._answers(moved, press.blank, moduli)
        pairs = [readings_by_key[abs(press.x), press.blank] for press in self.presses]
        stiff = [pair[1] for pair, press in zip(pairs, self.presses, strict=True) if press.stiff]
        n = 1 if moduli is None else len(moduli)
        return np.stack([np.broadcast_to(row, n) for row in [pair[0] for pair in pairs] + stiff], axis=1)

    def _answers(self, scene: Scene, blank: bool, moduli: Floats | None) -> Floats:
        """Return ln ratio and ln stiffness, shape (2, n)."""
        level = evaluator(self.evaluator)
        if moduli is not None and not blank:
            curve = level.curve(scene, moduli, self.accuracy)
            return np.asarray(np.log(np.array([curve.ratio, curve.stiffness], dtype=float)))
        answer = level.evaluate(scene.model_copy(update={"inclusion": ()}) if blank else scene, self.accuracy)
        return np.asarray(np.log(np.array([[answer.ratio], [answer.stiffness]], dtype=float)))


@dataclass(frozen=True)
class ReadingTruth:
    """All readings of a case as a polynomial on its box.

    Attributes
    ----------
    case
        which.
    coefficients
        Of products of Chebyshev polynomials, one axis for each coordinate and the last for the readings.
    """

    case: ReadingCase
    coefficients: Floats

    @classmethod
    def from_case(cls, case: ReadingCase, progress: Callable[[str], None] = lambda text: None) -> ReadingTruth:
        """Compute the readings at the points."""
        axes = [chebyshev.chebpts1(count) for _, _, count in case.box]
        by_curve = case.unknown == "youngs_modulus"  # one solution serves all moduli
        first = [np.zeros(1)] if by_curve else [axes[0]]
        points = [_scale_to_box(case.box, point) for point in product(*first, *axes[1:])]
        moduli = np.exp([_scale_to_box(case.box[:1], [share])[0] for share in axes[0]]) if by_curve else None
        rows = []
        for k, point in enumerate(points):
            rows.append(case.readings(point, moduli))
            progress(f"{case.name}: {k + 1} of {len(points)} points")
        counts = [len(axis) for axis in axes[1:]]
        table = np.array(rows).reshape(-1, *counts, *rows[0].shape)
        table = np.moveaxis(table[0], -2, 0) if by_curve else table[..., 0, :]
        for axis, nodes in enumerate(axes):
            inverse = np.linalg.inv(chebyshev.chebvander(nodes, len(nodes) - 1))
            table = np.moveaxis(np.tensordot(inverse, table, axes=(1, axis)), 0, axis)
        return cls(case, table)

    def interpolate(self, points: Floats) -> Floats:
        """Return the readings at points of shape (s, coordinates), shape (s, k)."""
        rows = [
            chebyshev.chebvander((2 * column - low - high) / (high - low), count - 1)
            for column, (low, high, count) in zip(points.T, self.case.box, strict=True)
        ]

        def contract(left: Floats, row: Floats) -> Floats:
            return np.asarray(np.einsum("sa,sa...->s...", row, left))

        first = np.tensordot(rows[0], self.coefficients, axes=1)
        return np.asarray(reduce(contract, rows[1:], first))

    def defect(self, draws: int, random: np.random.Generator) -> Floats:
        """Return the largest errors of ln ratios and ln stiffnesses at drawn points, shape (k,)."""
        points = self.draw_points(draws, random)
        real = np.concatenate([self.case.readings(point) for point in points])
        return np.asarray(np.abs(self.interpolate(points) - real).max(axis=0))

    def draw_points(self, draws: int, random: np.random.Generator) -> Floats:
        """Draw points of the box, shape (draws, coordinates): the unknown evenly, nuisances from their priors."""
        (low, high, _), *nuisance_axes = self.case.box
        normal = np.stack([_normal(draws, random) for _ in nuisance_axes], axis=1) if nuisance_axes else np.empty((draws, 0))
        return np.column_stack([random.uniform(low, high, draws), normal])


def _normal(draws: int, random: np.random.Generator) -> Floats:
    """Draw normal numbers within REACH_SD."""
    numbers = random.normal(size=2 * draws + 100)
    return np.asarray(numbers[np.abs(numbers) < REACH_SD][:draws])


def _scale_to_box(box: Sequence[tuple[float, float, int]], point: Sequence[float]) -> tuple[float, ...]:
    return tuple((low + high + share * (high - low)) / 2 for share, (low, high, _) in zip(point, box, strict=True))
