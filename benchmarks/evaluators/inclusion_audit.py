"""Check the error bounds of ``equivalent-inclusion`` on random scenes, by ``axisymmetric`` at a tenth of the accuracy."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from benchmarks.evaluators.inclusion_draws import DrawnScene, draw, draw_layered, draw_near
from benchmarks.tables import MeasuredTable
from geometry import InputError, Refusal
from geometry.common.errors import SolveError
from solver.axisymmetric.evaluator import Axisymmetric
from solver.equivalent_inclusion.probe_on_tissue import solve_undisturbed
from solver.equivalent_inclusion.readings import Readings, compute_readings
from solver.inclusions.tumours import Tumours
from solver.results.film_forces import FilmForces

REFERENCE = 0.1  # of the accuracy: the reference's own
GROUPS = (0.02, 0.05, 0.1, 0.25, 0.5, 1.0, 2.0)  # bounds of covers, diameters


@dataclass(frozen=True)
class ComparedReadings:
    """Readings of one scene compared with the reference.

    Attributes
    ----------
    true
        Error of ln(ratio).
    stated
        Bound on it.
    reference_bound
        The reference's own bound.
    totals
        Largest error of a film's total in excess of the reference's bound, over the bound stated.
    sensitivity, sensitivity_stated, sensitivity_reference_bound
        The same three of the log-sensitivity, absolute.
    """

    true: float
    stated: float
    reference_bound: float
    totals: float
    sensitivity: float
    sensitivity_stated: float
    sensitivity_reference_bound: float

    @property
    def excess(self) -> float:
        """What the reference's error cannot explain, over the bound stated: above 1 the bound is wrong."""
        return max(0.0, self.true - self.reference_bound) / self.stated if self.stated > 0 else np.inf

    @property
    def sensitivity_excess(self) -> float:
        """The same of the log-sensitivity."""
        return max(0.0, self.sensitivity - self.sensitivity_reference_bound) / max(self.sensitivity_stated, 1e-300)

    @property
    def wrong(self) -> str:
        """Which bounds are wrong, in words."""
        excesses = (("ratio", self.excess), ("stresses", self.totals), ("log_sensitivity", self.sensitivity_excess))
        return ", ".join(f"{name} {excess:.2f} times" for name, excess in excesses if excess > 1)


@dataclass(frozen=True)
class AuditedScene:
    """A scene with the readings of both tiers; ``None``: no ratio is stated."""

    seed: int
    number: int
    drawn: DrawnScene
    first: ComparedReadings | None
    reflected: ComparedReadings | None

    def __str__(self) -> str:
        """Where it comes from and its numbers."""
        return f"seed {self.seed}, number {self.number}: DrawnScene({self.drawn})"


def compare(readings: Readings, true: FilmForces) -> ComparedReadings | None:
    """Return the errors of readings, or None where no ratio is stated."""
    if not readings.resolved[0] or true.stress_below_error is not None:
        return None
    log_ratio = np.log(np.abs(readings.totals[0] / true.totals)) @ [1.0, -1.0]
    difference = np.abs(readings.totals[0] - true.totals) - true.bound.totals
    return ComparedReadings(
        true=float(abs(log_ratio)),
        stated=float(readings.log_ratio_bound[0]),
        reference_bound=true.bound.log_ratio,
        totals=float(np.max(difference / readings.bound[0])),
        sensitivity=float(abs(readings.log_sensitivity[0] - (true.log_sensitivity or 0.0))),
        sensitivity_stated=float(readings.sensitivity_error[0]),
        sensitivity_reference_bound=true.sensitivity_error,
    )


DRAWS = {"random": draw, "random layered": draw_layered, "all but touching": draw_near}


def case(seed: int, number: int, accuracy: float, kind: str) -> AuditedScene | None:
    """Evaluate one random scene by both tiers and by the reference; None where it does not fit or the reference fails."""
    drawn = DRAWS[kind](seed, number)
    try:
        scene = drawn.scene()
        true = Axisymmetric().compute_converged(scene, REFERENCE * accuracy).films[0]
        base, tumours = solve_undisturbed(scene, accuracy), Tumours.from_scene(scene)
        first, reflected = (compare(compute_readings(base, tumours, reflect=reflect), true) for reflect in (False, True))
    except (InputError, Refusal, SolveError, ValueError):
        return None
    return AuditedScene(seed, number, drawn, first, reflected)


def audit(
    seeds: Sequence[int], scenes: int, accuracy: float, worst: int, *, progress: Callable[[str], None], kind: str = "random"
) -> Iterator[MeasuredTable]:
    """Yield tables of how bounds compare with true errors, over ``scenes`` of each seed, of a kind of ``DRAWS``."""
    audited, wrong = [], 0
    for seed in seeds:
        for number in range(scenes):
            progress(f"audit: scene {number + 1} of {scenes}, seed {seed}; {wrong} bounds wrong so far")
            audited_scene = case(seed, number, accuracy, kind)
            if audited_scene is None:
                continue
            audited.append(audited_scene)
            wrong += sum(bool(compared and compared.wrong) for compared in (audited_scene.first, audited_scene.reflected))
    drawn = scenes * len(seeds)
    title = f"{len(audited)} {kind} scenes of {drawn} drawn (the rest do not fit or were refused), accuracy {accuracy:g}"
    yield _summary(title, audited)
    yield _groups(audited)
    yield _worst(audited, worst)


TIERS = {"first order": "first", "with reflections": "reflected"}


def _list_compared(audited: Sequence[AuditedScene], tier: str) -> list[tuple[AuditedScene, ComparedReadings]]:
    return [
        (audited_scene, compared) for audited_scene in audited if (compared := getattr(audited_scene, TIERS[tier])) is not None
    ]


def _summary(title: str, audited: Sequence[AuditedScene]) -> MeasuredTable:
    columns = (
        "tier",
        "with a ratio",
        "right",
        "wrong",
        "largest (true - reference's) / stated",
        "of stresses",
        "of log-sensitivity",
    )
    table = MeasuredTable(title, (*columns, "log-sensitivities wrong", "median true, error", "median stated, error"))
    for tier in TIERS:
        compared = [comparison for _, comparison in _list_compared(audited, tier)]
        if not compared:
            continue
        wrong = sum(comparison.excess > 1 or comparison.totals > 1 for comparison in compared)
        largest = [
            f"{max(values):.2f}" for values in zip(*((j.excess, j.totals, j.sensitivity_excess) for j in compared), strict=True)
        ]
        outside = sum(comparison.sensitivity_excess > 1 for comparison in compared)
        middle = (float(np.median([getattr(comparison, key) for comparison in compared])) for key in ("true", "stated"))
        table.add(tier, len(compared), len(compared) - wrong, wrong, *largest, outside, *middle)
    table.note("wrong: ratio or a stress is in error by more than stated and the reference's own bound together")
    return table


def _groups(audited: Sequence[AuditedScene]) -> MeasuredTable:
    table = MeasuredTable(
        "by cover over diameter",
        (
            "cover / D",
            "tier",
            "with a ratio",
            "any bound wrong",
            "largest (true - reference's) / stated",
            "largest true, error",
            "median stated, error",
        ),
    )
    for low, high in pairwise(GROUPS):
        for tier in TIERS:
            compared = [j for audited_scene, j in _list_compared(audited, tier) if low <= audited_scene.drawn.cover < high]
            if not compared:
                continue
            wrong, largest = sum(bool(j.wrong) for j in compared), max(max(j.excess, j.totals) for j in compared)
            true, stated = max(j.true for j in compared), float(np.median([j.stated for j in compared]))
            table.add(f"{low:g} to {high:g}", tier, len(compared), wrong, f"{largest:.2f}", true, stated)
    return table


def _worst(audited: Sequence[AuditedScene], count: int) -> MeasuredTable:
    table = MeasuredTable("worst scenes", ("tier", "true, error", "stated, error", "wrong bounds", "scene"))
    for tier in TIERS:
        ranked = sorted(
            _list_compared(audited, tier), key=lambda pair: -max(pair[1].excess, pair[1].totals, pair[1].sensitivity_excess)
        )
        for audited_scene, compared in ranked[:count]:
            table.add(
                tier,
                compared.true,
                compared.stated,
                compared.wrong or "none",
                f"seed {audited_scene.seed}, number {audited_scene.number}",
            )
            table.note(str(audited_scene))
    return table
